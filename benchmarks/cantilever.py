"""Tip deflection of straight, thick, tapered and curved cantilevers against beam theory.

    python benchmarks/cantilever.py            every order and size
    python benchmarks/cantilever.py --quick    default size only

End load and self-weight, both across the axis; of the quarter circle, end loads in its
plane and across it. Length / radius is 50, of the thick one 20. The reference is
Timoshenko's theory (bending and shear; torsion too where curved). A real clamp also stops
the section from contracting sideways, which no beam theory has: on fine meshes it leaves
the solid 0.3 % (self-weight: 0.4 %) stiffer at length / radius = 50, and 0.8 % (1.1 %) at
20. Without Poisson's effect (nu = 0) there is nothing to stop, and what is left is the
mesh's own error: so the thick one is bent so, too.
"""

import argparse
import time
from dataclasses import dataclass

import numpy as np

import plantsim as ps
from plantsim.elastic.analytic import arc_tip, cantilever_tip
from plantsim.plant.skeleton import Polyline
from plantsim.solid.tetrahedralize import grow

LENGTH, YOUNG, DENSITY = 1.0, 6e9, 800.0
# radii at base and tip [m], Poisson's ratio
SHAPES = {
    "straight": (0.02, 0.02, 0.3),
    "thick": (0.05, 0.05, 0.3),
    "thick, nu = 0": (0.05, 0.05, 0.0),
    "tapered": (0.02, 0.01, 0.3),
    "quarter circle": (0.02, 0.02, 0.3),
}
BEND = 2 * LENGTH / np.pi  # radius of the quarter circle
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
    seconds: float  # CPU: the mesh and this solve

    @property
    def error(self) -> float:
        """Relative error of the tip deflection."""
        return self.ours / self.analytic - 1


def limb(shape: str) -> ps.Skeleton:
    base, tip, _ = SHAPES[shape]
    if shape != "quarter circle":
        return ps.tapered(LENGTH, base, tip)
    a = np.linspace(0, np.pi / 2, 21)
    points = BEND * np.column_stack([1 - np.cos(a), 0 * a, np.sin(a)])
    return ps.Skeleton.from_limbs([Polyline(points, np.full(len(a), base))])


def loads(shape: str, end: np.ndarray) -> list[tuple[str, object, int, float]]:
    """Return name, load, direction and beam theory's answer of every load on a shape."""
    base, tip, poisson = SHAPES[shape]
    if shape == "quarter circle":
        return [
            (name, ps.force(end, END_LOAD * np.eye(3)[axis]), axis, known)
            for name, axis, known in (
                (
                    "end load, in plane",
                    2,
                    arc_tip(BEND, base, YOUNG, poisson, across=False),
                ),
                ("end load, across", 1, arc_tip(BEND, base, YOUNG, poisson, across=True)),
            )
        ]
    given = LENGTH, base, tip, YOUNG, poisson
    heavy = DENSITY * ACCELERATION
    return [
        (
            "end load",
            ps.force(end, (END_LOAD, 0, 0)),
            0,
            cantilever_tip(*given, end_load=END_LOAD),
        ),
        (
            "self-weight",
            ps.gravity((ACCELERATION, 0, 0)),
            0,
            cantilever_tip(*given, weight=heavy),
        ),
    ]


def deflections(shape: str, order: int, size: float | None) -> list[Row]:
    """Return all loads on one mesh."""
    began = time.process_time()
    solid = ps.sweep(limb(shape), tips="flat")
    mesh = ps.tetrahedralize(solid, size, order=order)
    model = ps.ElasticModel(mesh, ps.Material(YOUNG, SHAPES[shape][2], DENSITY))
    off = mesh.points - solid.tubes[0].axis(1.0)
    end = np.flatnonzero(np.abs(off @ solid.tubes[0].tangent(1.0)) < 1e-9)
    meshed = time.process_time() - began
    rows = []
    for load, act, axis, analytic in loads(shape, end):
        began = time.process_time()
        ours = float(model.solve(act).displacement[end, axis].mean())
        took = meshed + time.process_time() - began
        rows.append(
            Row(shape, load, order, size or DEFAULT, len(mesh.tets), analytic, ours, took)
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
        "| cantilever | load | order | size | tets | beam theory, mm | ours, mm | error | "
        "s |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    for r in rows:
        print(
            f"| {r.shape} | {r.load} | {r.order} | {r.size} | {r.tets:,} | "
            f"{1000 * r.analytic:.5f} | {1000 * r.ours:.5f} | {100 * r.error:+.2f} % | "
            f"{r.seconds:.2f} |"
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
