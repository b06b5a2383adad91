"""A touch, frame by frame: rest in black, the plant in grey, the hand's force in green."""

import plantsim as ps

skeleton = ps.weber_penn("citrus_young", rng=3, levels=2).pruned(max_limbs=5)
mesh = ps.tetrahedralize(ps.sweep(skeleton), order=1)
model = ps.ElasticModel(mesh, ps.Material(6e9, 0.35, 900.0))
limb = max(skeleton.limbs[1:], key=lambda limb: limb.length)
contact = model.contact(ps.nearest_vertices(mesh, limb.tip, count=6))
states = [contact.solve((-0.012 * k, 0.0, -0.004 * k)) for k in range(9)]
ps.animate_touch(states, "touch.gif", size=(480, 480))
