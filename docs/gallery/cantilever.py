"""A cantilever against beam theory: order 1 locks, order 2 does not."""

import numpy as np

import plantsim as ps
from plantsim.elastic.analytic import cantilever_tip

sizes = np.array([1.2, 0.9, 0.6])
errors = {}
for order in (1, 2):
    line = []
    for size in sizes:
        mesh = ps.tetrahedralize(
            ps.sweep(ps.straight(0.5, 0.02), tips="flat"), size, order=order
        )
        model = ps.ElasticModel(mesh, ps.Material(6e9, 0.3))
        end = np.flatnonzero(mesh.points[:, 2] > 0.5 - 1e-9)
        state = model.solve(ps.force(end, (1.0, 0.0, 0.0)))
        known = cantilever_tip(0.5, 0.02, 0.02, 6e9, 0.3, end_load=1.0)
        line.append(abs(state.displacement[end, 0].mean() / known - 1))
    errors[f"order {order}"] = line
ps.figure_convergence(sizes, errors, "cantilever.png", xlabel="edge / radius")
