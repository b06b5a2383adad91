"""How often, how fast and how well plants are meshed, beside fTetWild, TetGen and gmsh.

    python benchmarks/meshing.py trees --kernel union --limbs 100 --count 100
    python benchmarks/meshing.py given --kernel union --limbs 100 --count 8
    python benchmarks/meshing.py peers --limbs 30 --count 5
    python benchmarks/meshing.py species --kernel union --seeds 25 [--only NAME]
    python benchmarks/meshing.py agree [--only NAME]
    python benchmarks/meshing.py refine --only strawberry
    python benchmarks/meshing.py pool --count 50
    python benchmarks/meshing.py repeat --seeds 5 [--only NAME]
    python benchmarks/meshing.py table

Every mesh adds a line to a file (--log, by default meshing.jsonl), and what is there
already is not done again: a run may be ended at any time and taken up later. `table` prints
the tables of what is there; the other sections end with theirs. Seconds are CPU seconds of
this process with all its threads and children, from the solid to the mesh of order 2. Seeds
start at 5000; tuning was on 0 to 1010, and on 5000 to 5019 for surfaces made Delaunay.
"""

import argparse
import contextlib
import gc
import json
import multiprocessing
import resource
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from statistics import median
from typing import Any
from unittest import mock

import numpy as np
from littered import littered
from random_trees import random_tree

import plantsim as ps
from plantsim.mesh.tetmesh import gamma
from plantsim.solid.heap import glibc

FIRST = 5000
PEERS = ("occ", "union", "fTetWild", "TetGen", "gmsh")


def cpu() -> float:
    """CPU seconds of this process and of its children that have ended."""
    ended = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + ended.ru_utime + ended.ru_stime


class Log:
    """Results, one JSON line each; a key is done once."""

    def __init__(self, path: Path) -> None:
        self.path = path
        lines = path.read_text().splitlines() if path.exists() else []
        self.rows = [json.loads(line) for line in lines]
        self.known = {self.key(row) for row in self.rows}

    @staticmethod
    def key(row: dict[str, Any]) -> tuple[Any, ...]:
        return tuple(row[k] for k in ("section", "plant", "seed", "mesher"))

    def add(self, key: tuple[Any, ...], act: Callable[[], dict[str, Any]]) -> None:
        if key in self.known:
            return
        names = ("section", "plant", "seed", "mesher")
        row = dict(zip(names, key, strict=True)) | act()
        self.rows.append(row)
        self.known.add(key)
        with self.path.open("a") as f:
            f.write(json.dumps(row) + "\n")
        print("  " + " ".join(f"{k} {v}" for k, v in row.items()), flush=True)

    def of(self, section: str) -> Iterator[tuple[tuple[str, str], list[dict[str, Any]]]]:
        """Yield (plant, mesher) and its rows."""
        rows = [r for r in self.rows if r["section"] == section]
        for plant, mesher in dict.fromkeys((r["plant"], r["mesher"]) for r in rows):
            mine = [r for r in rows if (r["plant"], r["mesher"]) == (plant, mesher)]
            yield (plant, mesher), mine


def ours(skeleton: ps.Skeleton, kernel: Any) -> dict[str, Any]:
    """Mesh with a kernel; the ladder's rungs, seconds, tets and worst gamma."""
    solid = ps.sweep(skeleton)
    began = cpu()
    try:
        mesh = ps.tetrahedralize(solid, kernel=kernel)
    except ps.PlantsimError as why:
        return {"cpu": round(cpu() - began, 2), "attempts": 0, "failure": str(why)[:200]}
    took = cpu() - began
    assert mesh.report is not None
    return {
        "cpu": round(took, 2),
        "attempts": len(mesh.report["attempts"]),
        "limbs": len(solid.tubes),
        "tets": len(mesh.tets),
        "gamma": round(float(mesh.quality.min()), 4),
    }


def trees(log: Log, kernel: str, limbs: int, count: int) -> None:
    for seed in range(FIRST, FIRST + count):
        key = ("trees", f"random tree, {limbs} limbs", seed, kernel)
        log.add(key, lambda s=seed: ours(random_tree(limbs, s), kernel))


def given(log: Log, kernel: str, limbs: int, count: int) -> None:
    """Mesh trees in turn as they are, and with surfaces not made Delaunay before."""
    from plantsim.solid import gmsh_model

    for seed in range(FIRST, FIRST + count):
        plant = random_tree(limbs, seed)
        for way in ("", ", surface as given"):
            ask = mock.patch.object(gmsh_model, "conforming", return_value=None)
            with ask if way else contextlib.nullcontext():
                key = ("given", f"random tree, {limbs} limbs", seed, kernel + way)
                log.add(key, lambda p=plant: ours(p, kernel))


def species(log: Log, kernel: str, seeds: int, only: str) -> None:
    for name in [only] if only else ps.species_names():
        for seed in range(FIRST, FIRST + seeds):
            key = ("species", name, seed, kernel)
            log.add(key, lambda n=name, s=seed: ours(ps.weber_penn(n, rng=s), kernel))


def agree(log: Log, only: str) -> None:
    """Bend each species' twelve thickest limbs, meshed by either kernel."""
    for name in [only] if only else ps.species_names():
        key = ("agree", name, FIRST, "occ and union")
        log.add(key, lambda n=name: apart(ps.weber_penn(n, rng=FIRST).pruned(max_limbs=12)))


def apart(skeleton: ps.Skeleton) -> dict[str, Any]:
    """Return how far the kernels are apart: in volume, and in the motion of the tips.

    The plant bends by its weight and half of it sideways.
    """
    solid = ps.sweep(skeleton)
    got = [bent(solid, kernel) for kernel in ("occ", "union")]
    volume, size = zip(*got, strict=True)
    off = size[1] / size[0] - 1
    return {
        "limbs": len(solid.tubes),
        "volume": round(volume[1] / volume[0] - 1, 5),
        "tip": round(float(off[size[0].argmax()]), 5),
        "worst_tip": round(float(off[np.abs(off).argmax()]), 5),
        "worst_of_all": round(float(np.abs(size[1] - size[0]).max() / size[0].max()), 5),
    }


def bent(
    solid: ps.Solid, kernel: Any, size: float | None = None
) -> tuple[float, np.ndarray]:
    """Return a mesh's volume [m^3] and how far the tip of every limb moves [m]."""
    mesh = ps.tetrahedralize(solid, size, kernel=kernel)
    model = ps.ElasticModel(mesh, ps.Material(6e9, 0.3, 800.0))
    u = model.solve(ps.gravity((5.0, 0, -9.81))).displacement
    ends = np.array([tube.axis(1.0) for tube in solid.tubes])
    away = np.linalg.norm(mesh.points - ends[:, None], axis=2)
    return mesh.volume, np.linalg.norm(u[away.argmin(axis=1)], axis=1)


def refine(name: str) -> None:
    """Print what the motions of the tips that `agree` compares go to with smaller sizes."""
    solid = ps.sweep(ps.weber_penn(name, rng=FIRST).pruned(max_limbs=12))
    print("| size | kernel | volume, cm3 | motion of the tips, um |\n|---|---|---|---|")
    for size in (None, 0.63, 0.45):
        for kernel in ("occ", "union"):
            volume, moved = bent(solid, kernel, size)
            tips = " ".join(f"{1e6 * m:.1f}" for m in moved)
            print(
                f"| {size or 'default'} | {kernel} | {1e6 * volume:.3f} | {tips} |",
                flush=True,
            )


def repeat(log: Log, seeds: int, only: str) -> None:
    """Fill surfaces of each species three times, on a heap littered in other ways."""
    for name in [only] if only else ps.species_names():
        for seed in range(FIRST, FIRST + seeds):
            key = ("repeat", name, seed, "HXT")
            log.add(key, lambda n=name, s=seed: meshes(ps.weber_penn(n, rng=s)))


def meshes(skeleton: ps.Skeleton) -> dict[str, Any]:
    """Return how many surfaces were filled, and how many of them in more than one way."""
    from plantsim.solid import gmsh_model, occ
    from plantsim.solid.quality import flat_ends
    from plantsim.solid.tetrahedralize import grow

    solid = ps.sweep(skeleton.pruned(max_limbs=40))
    filled = several = 0
    for around, order in ((7, 2), (5, 2), (6, 1)):
        try:
            points, faces = occ.surface(solid, around, grow(around, order))
            flat, found = flat_ends(solid, points), set()
            for turn in range(3):
                with littered(turn):
                    x, tets = gmsh_model.fill(points, faces, flat, gmsh_model.HXT)
                found.add((x.tobytes(), tets.tobytes()))
        except ps.MeshError:
            continue  # what the ladder's next rungs are for
        filled += 1
        several += len(found) > 1
    return {"filled": filled, "several": several}


def raw_surface(skeleton: ps.Skeleton) -> tuple[np.ndarray, np.ndarray]:
    """Return the union of the tubes as manifold3d leaves it: what the others are given."""
    from plantsim.solid import union
    from plantsim.solid.tetrahedralize import AROUND, grow

    solid = ps.sweep(skeleton)
    seams = np.random.default_rng(0).uniform(0, 2 * np.pi, len(solid.tubes))
    skin, _ = union.unite(solid, AROUND, grow(AROUND, 2), seams)
    return skin.points, skin.faces


def wild(points: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    import pytetwild

    # it leaves a file in the current folder
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        return pytetwild.tetrahedralize(points, faces.astype(np.int32), num_threads=1)


def tetgen(points: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    import tetgen as package

    made = package.TetGen(points, faces.astype(np.int32))
    made.tetrahedralize(order=1, mindihedral=20, minratio=1.5)
    return made.node, made.elem


def gmsh(points: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    from plantsim.solid import gmsh_model

    still = np.ones(len(points), dtype=bool)  # not shaken, as it is not for the others
    return gmsh_model.fill(points, faces, still, gmsh_model.HXT)


def peers(log: Log, limbs: int, count: int) -> None:
    """All on the same plants; the others on the same surface."""
    for seed in range(FIRST, FIRST + count):
        plant = random_tree(limbs, seed)
        name = f"random tree, {limbs} limbs"
        for kernel in ("occ", "union"):
            log.add(("peers", name, seed, kernel), lambda p=plant, k=kernel: ours(p, k))
        for mesher, act in (("TetGen", tetgen), ("gmsh", gmsh), ("fTetWild", wild)):
            key = ("peers", name, seed, mesher)
            log.add(key, lambda p=plant, a=act: theirs(p, a))


def theirs(skeleton: ps.Skeleton, act: Callable[..., Any]) -> dict[str, Any]:
    points, faces = raw_surface(skeleton)
    began = cpu()
    try:
        x, tets = act(points, faces)
    except Exception as why:  # each package has its own
        return {"cpu": round(cpu() - began, 2), "attempts": 0, "failure": str(why)[:200]}
    took = cpu() - began
    worst = float(np.abs(gamma(np.asarray(x)[np.asarray(tets)[:, :4]])).min())
    return {"cpu": round(took, 2), "attempts": 1, "tets": len(tets), "gamma": worst}


def one(task: tuple[int, str]) -> tuple[int, float, tuple[float, float]]:
    """Mesh one tree in a worker; its pid, worst gamma and memory [MB].

    The memory is its peak so far, and what is held when what is free was given back.
    """
    seed, kernel = task
    got = ours(random_tree(30, seed), kernel)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    gc.collect()
    if libc := glibc():
        libc.malloc_trim(0)
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    pid = multiprocessing.current_process().pid or 0
    return pid, got.get("gamma", 0.0), (peak, pages * resource.getpagesize() / 2**20)


def pool(kernel: str, count: int) -> None:
    """Mesh in a spawn pool of two processes; the memory of each must not climb."""
    began = time.perf_counter()
    tasks = [(FIRST + i, kernel) for i in range(count)]
    memory: dict[int, list[tuple[float, float]]] = {}
    worst = 1.0
    with multiprocessing.get_context("spawn").Pool(2) as workers:
        for pid, quality, used in workers.imap_unordered(one, tasks):
            memory.setdefault(pid, []).append(used)
            worst = min(worst, quality)
    print(
        "\n| kernel | trees | processes | peak after 5, 25, all, MB | held after 5, 25, all"
        " | worst gamma |\n|---|---|---|---|---|---|"
    )
    done = sum(map(len, memory.values()))
    peak, held = (
        " and ".join(
            ", ".join(f"{used[min(n, len(used)) - 1][i]:.0f}" for n in (5, 25, count))
            for used in memory.values()
        )
        for i in (0, 1)
    )
    print(
        f"| {kernel} | {done} of {count} | {len(memory)} | {peak} | {held} | {worst:.2f} |"
    )
    print(f"{time.perf_counter() - began:.0f} s")


def table(log: Log) -> None:
    head = (
        "plants | mesher | meshed | at once | median CPU s | worst | median tets "
        "| median worst gamma | worst gamma"
    )
    for section in ("trees", "given", "species", "peers"):
        rows = list(log.of(section))
        if not rows:
            continue
        print(f"\n{section}\n\n| {head} |\n|{'---|' * 9}")
        for (plant, mesher), mine in sorted(rows):
            good = [r for r in mine if r["attempts"]]
            at_once = sum(r["attempts"] == 1 for r in mine)
            times = [r["cpu"] for r in mine]
            line = [plant, mesher, f"{len(good)} of {len(mine)}", str(at_once)]
            line += [f"{median(times):.1f}", f"{max(times):.1f}"]
            if good:
                line.append(f"{median(r['tets'] for r in good):,.0f}")
                gammas = [r["gamma"] for r in good]
                line += [f"{median(gammas):.2g}", f"{min(gammas):.2g}"]
            print(f"| {' | '.join(line)} |")
    ratios(log)
    rows = [r for r in log.rows if r["section"] == "agree"]
    if rows:
        print(
            "\n| species | limbs | volume | farthest tip | worst of it | worst tip |\n|"
            + "---|" * 6
        )
    for r in rows:
        parts = [
            f"{100 * r[k]:+.2f} %" for k in ("volume", "tip", "worst_of_all", "worst_tip")
        ]
        print(f"| {r['plant']} | {r['limbs']} | {' | '.join(parts)} |")
    rows = [r for r in log.rows if r["section"] == "repeat"]
    if rows:
        filled, several = (sum(r[k] for r in rows) for k in ("filled", "several"))
        print(f"\n{filled} surfaces filled three times each: {several} not always the same")


def ratios(log: Log) -> None:
    """How many times less CPU than fTetWild, plant by plant."""
    rows = {
        (r["plant"], r["seed"], r["mesher"]): r for r in log.rows if r["section"] == "peers"
    }
    for kernel in ("occ", "union"):
        found = [
            rows[plant, seed, "fTetWild"]["cpu"] / row["cpu"]
            for (plant, seed, mesher), row in rows.items()
            if mesher == kernel and (plant, seed, "fTetWild") in rows
        ]
        if found:
            print(f"\nfTetWild's CPU over that of {kernel}: median {median(found):.1f}")


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    sections = "trees given peers species agree refine pool repeat table".split()
    options.add_argument("section", choices=sections)
    options.add_argument("--kernel", choices=("occ", "union"), default="union")
    options.add_argument("--limbs", type=int, default=100)
    options.add_argument("--count", type=int, default=50, help="trees")
    options.add_argument("--seeds", type=int, default=25, help="of every species")
    options.add_argument("--only", default="", help="one species")
    options.add_argument("--log", type=Path, default=Path("meshing.jsonl"))
    asked = options.parse_args()
    if asked.section == "pool":
        return pool(asked.kernel, asked.count)
    if asked.section == "refine":
        return refine(asked.only or "strawberry")
    log = Log(asked.log)
    if asked.section == "trees":
        trees(log, asked.kernel, asked.limbs, asked.count)
    elif asked.section == "given":
        given(log, asked.kernel, asked.limbs, asked.count)
    elif asked.section == "peers":
        peers(log, asked.limbs, asked.count)
    elif asked.section == "species":
        species(log, asked.kernel, asked.seeds, asked.only)
    elif asked.section == "agree":
        agree(log, asked.only)
    elif asked.section == "repeat":
        repeat(log, asked.seeds, asked.only)
    return table(log)


if __name__ == "__main__":
    sys.exit(main())
