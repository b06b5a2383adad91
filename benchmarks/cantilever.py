"""Tip deflection of straight and tapered cantilevers against beam theory.

    python benchmarks/cantilever.py            every order and size
    python benchmarks/cantilever.py --quick    default size only

End load and self-weight, both across the axis. The reference is Timoshenko's theory
(bending and shear). A real clamp also stops the section from contracting sideways, which no
beam theory has: on fine meshes it leaves the solid about 0.3 % stiffer at length / radius =
50.
"""

import argparse
from dataclasses import dataclass

import numpy as np

import plantsim as ps
from plantsim.elastic.analytic import cantilever_tip
from plantsim.solid.tetrahedralize import grow

LENGTH, BASE, YOUNG, POISSON, DENSITY = 1.0, 0.02, 6e9, 0.3, 800.0
SHAPES = {"straight": 0.02, "tapered": 0.01}  # tip radius [m]
# edge around the limb over its radius, by order; 0.9, seven points around, is the default
DEFAULT = 0.9
SIZES = {1: (0.9, 0.63, 0.45, 0.32, 0.22), 2: (1.26, 1.05, 0.9, 0.79, 0.63, 0.45, 0.32)}
ACCELERATION = 9.81
END_LOAD = 1.0


@dataclass(frozen=True)
class Row:
    """One cantilever, one mesh, one load."""

    shape: str
    load: str
    order: int
    size: float
    tets: int
    analytic: float  # [m]
    ours: float  # [m]

    @property
    def error(self) -> float:
        """Relative error of the tip deflection."""
        return self.ours / self.analytic - 1


def deflections(shape: str, order: int, size: float | None) -> list[Row]:
    """Return both loads on one mesh."""
    tip_radius = SHAPES[shape]
    skeleton = ps.tapered(LENGTH, BASE, tip_radius)
    mesh = ps.tetrahedralize(ps.sweep(skeleton, tips="flat"), size, order=order)
    model = ps.ElasticModel(mesh, ps.Material(YOUNG, POISSON, DENSITY))
    end = np.flatnonzero(mesh.points[:, 2] > LENGTH - 1e-9)
    rows = []
    for load, act, known in (
        ("end load", ps.force(end, (END_LOAD, 0, 0)), {"end_load": END_LOAD}),
        (
            "self-weight",
            ps.gravity((ACCELERATION, 0, 0)),
            {"weight": DENSITY * ACCELERATION},
        ),
    ):
        analytic = cantilever_tip(LENGTH, BASE, tip_radius, YOUNG, POISSON, **known)
        ours = float(model.solve(act).displacement[end, 0].mean())
        rows.append(
            Row(shape, load, order, size or DEFAULT, len(mesh.tets), analytic, ours)
        )
    return rows


def rate(rows: list[Row]) -> float:
    """Return the fitted power of the size with which the error falls.

    Of order 1 the error against theory, finest three. Of order 2 the distance from the
    finest mesh (what is left there is the clamp), bending undone of the radius that makes
    up for the elements' stiffness, which would hide their error.
    """
    rows = sorted(rows, key=lambda r: -r.size)
    if rows[0].order == 1:
        rows = rows[-3:]
        error = [abs(r.error) for r in rows]
    else:
        bare = [r.ours * grow(round(2 * np.pi / r.size), 2) ** 4 for r in rows]
        error = [abs(u / bare[-1] - 1) for u in bare[:-1]]
    size = [r.size for r in rows][: len(error)]
    return float(np.polyfit(np.log(size), np.log(error), 1)[0])


def main(sizes: dict[int, tuple[float, ...]] = SIZES) -> list[Row]:
    rows = [
        row
        for shape in SHAPES
        for order, chosen in sizes.items()
        for size in chosen
        for row in deflections(shape, order, size)
    ]
    rows.sort(key=lambda r: (r.shape, r.load, r.order, -r.size))
    print(
        "| cantilever | load | order | size | tets | beam theory, mm | ours, mm | error |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for r in rows:
        print(
            f"| {r.shape} | {r.load} | {r.order} | {r.size} | {r.tets:,} | "
            f"{1000 * r.analytic:.5f} | {1000 * r.ours:.5f} | {100 * r.error:+.2f} % |"
        )
    if sizes is SIZES:
        print("\n| cantilever | load | order | rate of convergence |\n|---|---|---|---|")
        for key in sorted({(r.shape, r.load, r.order) for r in rows}):
            fit = rate([r for r in rows if (r.shape, r.load, r.order) == key])
            print(f"| {key[0]} | {key[1]} | {key[2]} | {fit:.1f} |")
    return rows


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="default size only")
    main({1: (DEFAULT,), 2: (DEFAULT,)} if parser.parse_args().quick else SIZES)
