"""Multigrid iterations to a backward error of 1e-12, by set-up and by refinement.

    python benchmarks/multigrid.py [tree.npz] [--orders 1 2] [--variants]

A 60:1 cantilever, and a tree by the paper's protocol, each refined uniformly twice, at
orders 1 and 2; CPU seconds. With `--variants`: what pyamg offers, on the tree (or the
cantilever) refined once at order 1, and at order 2.
"""

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np
import pyamg
import skfem
from scipy.sparse import bsr_matrix, csr_array, csr_matrix
from scipy.sparse.csgraph import connected_components, dijkstra

import plantsim as ps
from plantsim.solve.multigrid import MultigridFactor
from plantsim.solve.rigid import rigid_modes


def refined(mesh: ps.TetMesh, times: int) -> ps.TetMesh:
    """Return the mesh with each tet cut into eight, `times` over; order 1."""
    m = skfem.MeshTet(
        np.ascontiguousarray(mesh.points.T), np.ascontiguousarray(mesh.tets[:, :4].T)
    ).refined(times)
    tets = m.t.T.copy()
    x = m.p[:, tets]
    left = np.linalg.det((x[:, :, 1:] - x[:, :, :1]).transpose(1, 2, 0)) < 0
    tets[left] = tets[left][:, [0, 2, 1, 3]]
    return ps.TetMesh(m.p.T, tets)


def iterations(model: ps.ElasticModel, load: Any) -> tuple[int, float, float]:
    """Return the iterations, the backward error and the seconds of one solve."""
    model.stiffness  # noqa: B018
    began = time.process_time()
    try:
        stats = model.solve(load).stats
    except ps.SolverError:
        return -1, np.nan, time.process_time() - began
    return stats.iterations, stats.backward_error, time.process_time() - began


def refinements(
    name: str,
    mesh: ps.TetMesh,
    height: float,
    moved: np.ndarray,
    times: int = 2,
    order: int = 1,
) -> list[int]:
    """Print and return the iterations on a mesh and its refinements."""
    found = []
    for k in range(times + 1):
        fine = refined(mesh, k).with_order(order)
        fixed = np.flatnonzero(fine.points[:, 2] <= height)
        model = ps.ElasticModel(
            fine, ps.Material.lame(7.0, 6.0), fixed=fixed, solver="multigrid"
        )
        count, error, seconds = iterations(model, ps.move(moved, (0, 0.01, -0.01)))
        found.append(count)
        unknowns = 3 * (len(fine.points) - len(fixed) - len(moved))
        print(
            f"| {name} | {order} | {k} | {unknowns:,} | {count} | {error:.1e} | "
            f"{seconds:.1f} |",
            flush=True,
        )
    return found


GAUSS = ("block_gauss_seidel", {"sweep": "symmetric", "iterations": 1})
TWICE = ("block_gauss_seidel", {"sweep": "symmetric", "iterations": 2})
TWO = {"max_levels": 2, "max_coarse": 10}
MANY = {"max_coarse": 300}


def strong(theta: float) -> dict[str, Any]:
    return {"strength": ("symmetric", {"theta": theta})}


VARIANTS: dict[str, tuple[dict[str, Any], str]] = {
    "two levels, strength 0.08 (ours)": (TWO | strong(0.08), "V"),
    "two levels, strength 0": (TWO | strong(0.0), "V"),
    "two levels, strength 0.25": (TWO | strong(0.25), "V"),
    "two levels, 0.08, two sweeps": (
        TWO | strong(0.08) | {"presmoother": TWICE, "postsmoother": TWICE},
        "V",
    ),
    "two levels, 0.08, unsmoothed aggregates": (TWO | strong(0.08) | {"smooth": None}, "V"),
    "two levels, 0.08, smoothed twice": (
        TWO | strong(0.08) | {"smooth": ("jacobi", {"degree": 2})},
        "V",
    ),
    "two levels, energy smoothing": (
        TWO | strong(0.0) | {"smooth": ("energy", {"krylov": "cg", "maxiter": 4})},
        "V",
    ),
    "two levels, aggregates along the limbs": (TWO | {"aggregate": "limbs"}, "V"),
    "three levels, strength 0.08": (TWO | strong(0.08) | {"max_levels": 3}, "V"),
    "three levels, strength 0.08, W cycle": (TWO | strong(0.08) | {"max_levels": 3}, "W"),
    "many levels, strength 0": (MANY | strong(0.0), "V"),
    "many levels, strength 0, W cycle": (MANY | strong(0.0), "W"),
    "many levels, evolution, energy, W": (
        MANY
        | {
            "strength": ("evolution", {"epsilon": 4.0, "k": 2}),
            "smooth": ("energy", {"krylov": "cg", "maxiter": 4, "degree": 2}),
        },
        "W",
    ),
    "many levels, no rigid modes": (MANY | strong(0.0) | {"B": None}, "V"),
}


def along_limbs(model: ps.ElasticModel, free: np.ndarray) -> csr_array:
    """Return aggregates (k, a) of free vertices: slices across limbs, as nodes of a beam.

    Vertices as far from the base along the edges, to within twice the median edge, and
    connected.
    """
    graph = csr_array(model.pattern.positions[free][:, free]).tocoo()
    row, column = graph.row, graph.col
    length = np.linalg.norm(
        np.diff(model.mesh.points[free[[row, column]]], axis=0)[0], axis=1
    )
    at_base = model.pattern.positions[free][:, model.fixed_ids].sum(axis=1) > 0
    edges = csr_array((length, (row, column)), shape=graph.shape)
    far = dijkstra(edges, indices=np.flatnonzero(at_base), min_only=True)
    far[np.isinf(far)] = 0  # cut off by what is moved
    slab = (far / (2 * np.median(length[row != column]))).astype(int)
    same = slab[row] == slab[column]
    ones = np.ones(int(same.sum()))
    within = csr_array((ones, (row[same], column[same])), shape=graph.shape)
    count, label = connected_components(within, directed=False)
    each = np.arange(len(free) + 1)
    return csr_array((np.ones(len(free)), label, each), shape=(len(free), count))


class Cycle(MultigridFactor):
    """Levels with a cycle of their own."""

    @property
    def preconditioner(self) -> Any:
        """One cycle of the kind that the name says."""
        return self.levels.aspreconditioner(cycle=self.name)


def variants(mesh: ps.TetMesh, height: float, moved: np.ndarray) -> None:
    """Print a line for each set-up: iterations, set-up and solve seconds."""
    fixed = np.flatnonzero(mesh.points[:, 2] <= height)
    model = ps.ElasticModel(mesh, ps.Material.lame(7.0, 6.0), fixed=fixed)
    free = np.setdiff1d(np.arange(len(mesh.points)), np.append(fixed, moved))
    K = model.pattern.condense(model.stiffness, free, free)
    matrix = bsr_matrix((K.data, K.indices, K.indptr), shape=K.shape)
    matrix.sort_indices()
    at = np.sort(moved)
    f = -model.pattern.condense(model.stiffness, free, at) @ np.tile(
        [0, 0.01, -0.01], len(at)
    )
    for name, (options, cycle) in VARIANTS.items():
        began = time.process_time()
        given = {
            "B": rigid_modes(mesh.points[free]),
            "presmoother": GAUSS,
            "postsmoother": GAUSS,
            "improve_candidates": None,
            "coarse_solver": "splu",
        } | options
        if given.get("aggregate") == "limbs":
            # pyamg has its own kind of matrix
            slices = csr_matrix(along_limbs(model, free))
            given["aggregate"] = [("predefined", {"AggOp": slices})]
            given["strength"] = [None]
        build: Any = pyamg.smoothed_aggregation_solver
        levels = build(matrix, **given)
        ready = time.process_time()
        try:
            _, count, error = Cycle(matrix, levels, 1e-12, 150, name=cycle)(f)
            took = f"{count} | {float(error):.0e}"
        except ps.SolverError:
            took = "over 150 | -"
        done = time.process_time()
        print(
            f"| {name} | {took} | {ready - began:.2f} | {done - ready:.2f} | "
            f"{levels.operator_complexity():.2f} |",
            flush=True,
        )


def slender() -> tuple[ps.TetMesh, float, np.ndarray]:
    """Return a 60:1 cantilever, length over diameter, its foot's height, and its tip."""
    mesh = ps.tetrahedralize(ps.sweep(ps.straight(1.2, 0.01), tips="flat"), 1.3, order=1)
    return mesh, 1e-9, np.flatnonzero(mesh.points[:, 2] > 1.2 - 1e-9)


def main(tree: Path | None, orders: tuple[int, ...], all_variants: bool) -> None:
    mesh, height, tip = slender()
    cases = [("60:1 cantilever", mesh, height, tip)]
    if tree is not None:
        m = ps.read_mesh(tree)
        low = m.points[ps.lowest(m), 2].max()
        model = ps.ElasticModel(m, ps.Material(), fixed=ps.lowest(m))
        cases.append((tree.stem, m, low, ps.sample_touches(model, 1, rng=0)[0].ids))
    if not all_variants:
        print("| mesh | order | refined | unknowns | iterations | backward error | s |")
        print("|---|---|---|---|---|---|---|")
        for order in orders:
            for case in cases:
                refinements(*case, order=order)
        return
    name, mesh, height, tip = cases[-1]
    for order in orders:
        fine = refined(mesh, 1) if order == 1 else mesh.with_order(2)
        print(f"\n{name}, order {order}, {3 * len(fine.points):,} unknowns\n")
        print("| set-up | iterations | backward error | set-up, s | solve, s | operator |")
        print("|---|---|---|---|---|---|")
        variants(fine, height, tip)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("tree", nargs="?", type=Path)
    parser.add_argument("--orders", type=int, nargs="+", default=(1, 2), choices=(1, 2))
    parser.add_argument("--variants", action="store_true")
    options = parser.parse_args()
    main(options.tree, tuple(options.orders), options.variants)
