"""A prepared contact against the paper's frame, in one run.

    OMP_NUM_THREADS=1 python benchmarks/realtime.py [mesh.npz ...] [--repeat 15]

The paper's protocol: the lowest 10 % of the vertices fixed, ten of the upper 85 % moved
together. Its frame is a fresh `spsolve` of the condensed system, K being there. Medians of
CPU time in ms, taken in turn; the ratios are to the frame.
"""

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from scipy.sparse.linalg import spsolve

import plantsim as ps

COLUMNS = {
    "frame": "fresh spsolve",
    "force": "force, same 10",
    "field": "field, each its own way",
    "together": "field, all 10 alike",
    "surface": "field of the surface",
    "single": "field, float32",
    "vertex": "first answer, new vertex",
    "ten": "force, ten other vertices",
    "ten field": "force and field, ten others",
    "solve": "model.solve, ten others",
}


def compare(mesh: ps.TetMesh, repeat: int = 15) -> dict[str, float]:
    """Return the median time [ms] of each column."""
    fixed = ps.lowest(mesh)
    model = ps.ElasticModel(mesh, ps.Material.lame(7.0, 6.0), fixed=fixed)
    K = model.stiffness
    touches = ps.sample_touches(model, 4 * repeat + 3, rng=0)
    first = touches[0]
    contact = model.contact(first.ids)
    single = model.contact(first.ids, dtype=np.float32)
    d = np.random.default_rng(0).normal(size=(10, 3)) * 0.01
    d32 = d.astype(np.float32)
    n = len(mesh.points)

    def frame(touch: Any) -> np.ndarray:
        held = np.append(fixed, touch.ids)
        free = np.setdiff1d(np.arange(n), held)
        rows = (3 * free[:, None] + np.arange(3)).ravel()
        u = np.zeros((n, 3))
        u[touch.ids] = touch.moves[-1]
        part = K[rows]
        u[free] = spsolve(part[:, rows].tocsc(), -(part @ u.ravel())).reshape(-1, 3)
        return u

    known = frame(first)
    ours = contact.displacement(first.moves[-1])
    assert np.linalg.norm(ours - known) < 1e-6 * np.linalg.norm(known)
    base = model.base_factor()
    for array in (contact.displacement, contact.surface_displacement, single.displacement):
        array(d)
    contact.displacement(d[0])
    fresh = iter(touches[3:])
    pool = np.setdiff1d(
        np.arange(n), np.append(fixed, np.concatenate([t.ids for t in touches]))
    )
    new = iter(np.random.default_rng(1).permutation(pool))

    def vertex() -> None:
        point = model.contact([next(new)])
        point.force(d[0]), point.displacement(d[0])

    def ten() -> None:
        model.contact(next(fresh).ids).force(d)

    def ten_field() -> None:
        patch = model.contact(next(fresh).ids)
        patch.force(d), patch.displacement(d)

    acts: dict[str, Callable[[], Any]] = {
        "frame": lambda: frame(first),
        "force": lambda: contact.force(d),
        "field": lambda: contact.displacement(d),
        "together": lambda: contact.displacement(d[0]),
        "surface": lambda: contact.surface_displacement(d),
        "single": lambda: single.displacement(d32),
        "vertex": vertex,
        "ten": ten,
        "ten field": ten_field,
        "solve": lambda: model.solve(next(fresh).last),
    }
    seconds: dict[str, list[float]] = {name: [] for name in acts}
    for _ in range(repeat):
        for name, act in acts.items():
            times = 50 if name in ("force", "together") else 1
            began = time.process_time()
            for _ in range(times):
                act()
            seconds[name].append((time.process_time() - began) / times)
    assert model.base_factor()[1] is base[1]
    return {name: 1000 * median(values) for name, values in seconds.items()}


def main(meshes: dict[str, ps.TetMesh], repeat: int = 15) -> list[dict[str, float]]:
    rows = []
    for name, mesh in meshes.items():
        row = compare(mesh, repeat)
        rows.append(row)
        print(f"\n{name}: {len(mesh.points):,} vertices, order {mesh.order}\n")
        print("| what | ms | faster than the frame |\n|---|---|---|")
        for key, title in COLUMNS.items():
            print(f"| {title} | {row[key]:.4g} | {row['frame'] / row[key]:,.0f} x |")
    return rows


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("meshes", nargs="*", type=Path)
    parser.add_argument("--repeat", type=int, default=15)
    options = parser.parse_args()
    chosen = {path.stem: ps.read_mesh(path) for path in options.meshes} or {
        "fork": ps.tetrahedralize(ps.sweep(ps.fork()), order=1)
    }
    main(chosen, options.repeat)
