"""A limb under its own weight and under fruit: where the stress is."""

import plantsim as ps

skeleton = ps.fork(0.8, 0.02).with_fruit(count=6, mass=0.25, stalk=0.03)
mesh = ps.tetrahedralize(ps.sweep(skeleton))
model = ps.ElasticModel(mesh, ps.Material(6e9, 0.35, 900.0))
state = model.solve(ps.gravity(masses=skeleton.masses))
print(state.limbs)
ps.figure_material(mesh, state.von_mises / 1e6, "sag.png", label="von Mises [MPa]")
