"""Four crops from one seed: skeletons meshed, a colour a limb."""

import plantsim as ps

plants = {}
for name in ("apple_spindle", "citrus_young", "grapevine", "pepper"):
    skeleton = ps.weber_penn(name, rng=7, levels=2).pruned(max_limbs=6)
    plants[name] = ps.tetrahedralize(ps.sweep(skeleton), order=1)
ps.figure_gallery(plants, "species.png")
