"""Assembly against scikit-fem's own, in one run.

    OMP_NUM_THREADS=1 python benchmarks/assembly.py [mesh.npz] [--repeat 5]

Medians of CPU time in ms: scikit-fem's `assemble` of the same form (its Basis not counted),
our first model (pattern, blocks and K), K for a new material, the mass matrix. Without a
mesh, a fork.
"""

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import skfem

import plantsim as ps
from plantsim.elastic.stiffness import elasticity, scalar_basis


def timed(act: Callable[[], Any], repeat: int) -> float:
    """Return the median time [ms]."""
    act()
    seconds = []
    for _ in range(repeat):
        began = time.process_time()
        act()
        seconds.append(time.process_time() - began)
    return 1000 * median(seconds)


def main(mesh: ps.TetMesh, repeat: int = 5) -> list[dict[str, float]]:
    print(
        "| order | tets | scikit-fem | first model | ratio | new material | ratio | mass | "
        "kB a tet |\n|---|---|---|---|---|---|---|---|---|"
    )
    table = []
    for order in (1, 2):
        m = mesh.with_order(1).with_order(order)
        rng = np.random.default_rng(0)
        mu, lam = rng.uniform(1, 2, (2, len(m.tets)))
        scalar = scalar_basis(m.points, m.tets, False)
        rule = (scalar.X, scalar.W)
        vector = skfem.Basis(scalar.mesh, skfem.ElementVector(scalar.elem), quadrature=rule)
        flat = skfem.Basis(scalar.mesh, skfem.ElementTetP0(), quadrature=rule)
        fields = {"mu": flat.interpolate(mu), "lam": flat.interpolate(lam)}
        fixed = np.argsort(m.points[:, 2])[:10]
        first, second = ps.Material.lame(mu, lam), ps.Material.lame(lam, mu)
        model = ps.ElasticModel(m, first, fixed=fixed)
        model.stiffness  # noqa: B018
        acts = {
            "skfem": lambda v=vector, f=fields: elasticity.assemble(v, **f),
            "first": lambda m=m, a=first, f=fixed: ps.ElasticModel(m, a, fixed=f).stiffness,
            "again": lambda k=model, a=second: k.with_material(a).stiffness,
            "mass": lambda k=model, a=second: k.with_material(a).mass_matrix,
        }
        row = {name: timed(act, repeat) for name, act in acts.items()}
        b, p = model.blocks, model.pattern
        arrays = [*vars(b).values(), *vars(p).values(), *p._scalar]
        row["kB"] = sum(getattr(a, "nbytes", 0) for a in arrays) / len(m.tets) / 1000
        table.append(row)
        print(
            f"| {order} | {len(m.tets):,} | {row['skfem']:.0f} | {row['first']:.1f} | "
            f"{row['skfem'] / row['first']:.1f} | {row['again']:.1f} | "
            f"{row['skfem'] / row['again']:.1f} | {row['mass']:.1f} | {row['kB']:.1f} |"
        )
    return table


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("mesh", nargs="?", type=Path)
    parser.add_argument("--repeat", type=int, default=5)
    options = parser.parse_args()
    chosen = (
        ps.read_mesh(options.mesh)
        if options.mesh
        else ps.tetrahedralize(ps.sweep(ps.fork()), order=1)
    )
    main(chosen, options.repeat)
