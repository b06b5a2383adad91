"""Direct factors against multigrid by unknowns: the table behind solver="auto".

    OMP_NUM_THREADS=1 python benchmarks/solvers.py [--from 1e4] [--up-to 2e6]

The demo's plant, ten vertices moved, from 10,000 to 2 million unknowns: meshes of orders 1
and 2, the largest refined uniformly. Each solver in a process of its own: CPU seconds to
prepare it and to apply it once, the iterations, the peak memory of the whole process (mesh,
blocks and K with it), and how far the answer is from the first solver's. SuperLU is left
out above 450,000 unknowns. PARDISO is measured where pypardiso is installed.
"""

import argparse
import contextlib
import importlib.util
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from multigrid import refined

import plantsim as ps
from plantsim.demo import touch_points, young_aspen
from plantsim.solve import direct

# size (edge over radius), uniform refinements, order
MESHES = ((1.05, 0, 1), (1.05, 0, 2), (0.63, 0, 2), (0.45, 0, 2), (0.8, 1, 2), (0.47, 1, 2))
SUPERLU_LIMIT = 450_000
MEMORY = 20 * 2**30  # bytes that a process may have, less where others leave less
TIME_LIMIT = 1200  # CPU seconds for one solver
SOLVERS = ("SuperLU", "PARDISO", "multigrid")


def one(mesh_file: Path, solver: str) -> dict[str, float]:
    """Solve twice with one solver; the displacements go to a file beside the mesh."""
    free = MEMORY
    with contextlib.suppress(OSError):  # Linux says what others leave
        lines = Path("/proc/meminfo").read_text().splitlines()
        (line,) = (s for s in lines if s.startswith("MemAvailable"))
        free = min(MEMORY, 1024 * int(line.split()[1]) - 2**30)
    resource.setrlimit(resource.RLIMIT_AS, (free, free))
    resource.setrlimit(resource.RLIMIT_CPU, (TIME_LIMIT, TIME_LIMIT))
    mesh = ps.read_mesh(mesh_file)
    load = ps.move("moved", (0, 0, -0.03))
    direct.PARDISO_FROM = 0 if solver == "PARDISO" else 10**9
    name = "multigrid" if solver == "multigrid" else "direct"
    model = ps.ElasticModel(mesh, ps.Material(), solver=name)
    model.stiffness  # noqa: B018  blocks and K are not what is timed
    before = time.process_time()
    model.solve(load)
    between = time.process_time()
    state = model.solve(load)
    after = time.process_time()
    np.save(mesh_file.with_suffix(f".{solver}.npy"), state.displacement)
    return {
        "unknowns": state.stats.unknowns,
        "prepare": 2 * between - before - after,
        "apply": after - between,
        "iterations": state.stats.iterations,
        "memory": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20,
    }


def main(least: float, most: float, solvers: tuple[str, ...]) -> None:
    skeleton = ps.weber_penn(young_aspen(), rng=7, levels=2).pruned(min_radius=0.0035)
    solid = ps.sweep(skeleton)
    if importlib.util.find_spec("pypardiso") is None:
        solvers = tuple(s for s in solvers if s != "PARDISO")
    print(
        "| unknowns | order | solver | prepare, s | apply, s | iterations | memory, GiB | "
        "apart |\n|---|---|---|---|---|---|---|---|"
    )
    with tempfile.TemporaryDirectory() as folder:
        for size, times, order in MESHES:
            mesh = ps.tetrahedralize(solid, size, order=1 if times else order)
            # refined, the first vertices are still these
            moved = touch_points(mesh, np.random.default_rng(0))
            if times:
                base = mesh.points[mesh.sets["base"], 2].max()
                fine = refined(mesh, times).with_order(order)
                foot = np.flatnonzero(fine.points[:, 2] <= base)
                mesh = ps.TetMesh(fine.points, fine.tets, sets={"base": foot})
            mesh = mesh.with_sets(moved=moved)
            count = 3 * len(mesh.points)
            if not least <= count <= most:
                continue
            file = Path(folder) / f"{count}.npz"
            ps.write_mesh(mesh, file)
            known = None
            for solver in solvers:
                if solver == "SuperLU" and count > SUPERLU_LIMIT:
                    continue
                command = [sys.executable, __file__, "--one", str(file), solver]
                done = subprocess.run(command, capture_output=True, text=True, check=False)
                if done.returncode:
                    why = (done.stderr.strip().splitlines() or ["killed"])[-1]
                    print(f"| {count:,} | {order} | {solver} | {why[:90]} |||||")
                    continue
                r = json.loads(done.stdout.splitlines()[-1])
                u = np.load(file.with_suffix(f".{solver}.npy"))
                known = u if known is None else known
                apart = np.linalg.norm(u - known) / np.linalg.norm(known)
                print(
                    f"| {r['unknowns']:,} | {order} | {solver} | {r['prepare']:.2f} | "
                    f"{r['apply']:.2f} | {r['iterations']} | {r['memory']:.1f} | "
                    f"{apart:.0e} |",
                    flush=True,
                )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--from", dest="least", type=float, default=0)
    parser.add_argument("--up-to", dest="most", type=float, default=3e6)
    parser.add_argument("--solvers", nargs="+", default=SOLVERS, choices=SOLVERS)
    parser.add_argument("--one", nargs=2, metavar=("MESH", "SOLVER"))
    options = parser.parse_args()
    if options.one:
        print(json.dumps(one(Path(options.one[0]), options.one[1])))
    else:
        main(options.least, options.most, tuple(options.solvers))
