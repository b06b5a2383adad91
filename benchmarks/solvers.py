"""Direct factor against multigrid by unknowns: the table behind solver="auto".

    python benchmarks/solvers.py [--sizes 1.05 0.8 0.63]

The demo's plant, order 2, ten vertices moved: seconds to prepare a solver, to apply it
once, the iterations, and how far the two answers are apart. The ratio is of the totals.
"""

import argparse
import time

import numpy as np

import plantsim as ps
from plantsim.demo import touch_points, young_aspen


def timed(model: ps.ElasticModel, load: object) -> tuple[float, float, ps.Equilibrium]:
    """Return seconds to prepare, seconds to apply, and the state."""
    began = time.perf_counter()
    model.solve(load)
    both = time.perf_counter() - began
    began = time.perf_counter()
    state = model.solve(load)
    apply = time.perf_counter() - began
    return both - apply, apply, state


def main(sizes: list[float]) -> None:
    skeleton = ps.weber_penn(young_aspen(), rng=7, levels=2).pruned(min_radius=0.0035)
    solid = ps.sweep(skeleton)
    print(
        "| unknowns | direct: prepare, s | apply, s | multigrid: prepare, s | apply, s | "
        "iterations | direct / multigrid | difference |\n|---|---|---|---|---|---|---|---|"
    )
    for size in sizes:
        mesh = ps.tetrahedralize(solid, size)
        load = ps.move(touch_points(mesh, np.random.default_rng(0)), (0, 0, -0.03))
        model = ps.ElasticModel(mesh, ps.Material(), solver="direct")
        model.stiffness  # noqa: B018  blocks and K are not what is timed
        d0, d1, direct = timed(model, load)
        twin = ps.ElasticModel(
            mesh, ps.Material(), solver="multigrid", _shared=model._shared
        )
        twin.stiffness  # noqa: B018
        m0, m1, multigrid = timed(twin, load)
        apart = np.linalg.norm(direct.displacement - multigrid.displacement)
        apart /= np.linalg.norm(direct.displacement)
        print(
            f"| {direct.stats.unknowns:,} | {d0:.2f} | {d1:.2f} | {m0:.2f} | {m1:.2f} | "
            f"{multigrid.stats.iterations} | {(d0 + d1) / (m0 + m1):.2f} | {apart:.0e} |",
            flush=True,
        )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--sizes", type=float, nargs="+", default=[1.05, 0.8, 0.63, 0.52, 0.45]
    )
    main(parser.parse_args().sizes)
