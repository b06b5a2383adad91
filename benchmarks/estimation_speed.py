"""How long an estimate from ten touches takes, by the clock.

    python benchmarks/estimation_speed.py [mesh.npz] [--repeat 3] [--shots 10]
        [--cases element limbs]

`element`: every tet of the mesh on its own, both Lame parameters, log-normal fields of 0.5,
1 mm and 2 %. `limbs`: fifty limbs, moduli log-normal of 0.4 by limb, the same noise, both
Lame parameters (the default of `per_limb`) and Young's modulus alone. Without a mesh an
apple tree of fifty limbs of our own, order 1, is made; a mesh without fifty regions is
cut in fifty by k-means of the tets' centroids. Prior mu = 1, lam = 10.

Times are of `ps.estimate` alone, the posterior not included; medians over `--repeat`
times ten touches, each with a seed of its own, and of the first in a process too, which
pays imports.
"""

import argparse
import time
from pathlib import Path

import numpy as np
from scipy.cluster.vq import kmeans2

import plantsim as ps

try:
    from benchmarks.table1 import seen_touches, truth_of
except ImportError:  # run as a script
    from table1 import seen_touches, truth_of  # pyright: ignore[reportMissingImports]

LIMBS = 50


def own_tree() -> ps.TetMesh:
    skeleton = ps.weber_penn("apple", rng=1, max_limbs=LIMBS)
    return ps.tetrahedralize(ps.sweep(skeleton), 1.5, order=1)


def limbs_of(mesh: ps.TetMesh) -> np.ndarray:
    if len(mesh.region_names) >= LIMBS:
        return mesh.region
    x = mesh.points[mesh.tets[:, :4]].mean(axis=1)
    return kmeans2(x, LIMBS, rng=1, minit="++")[1]


def main(mesh: ps.TetMesh, cases: list[str], shots: int = 10, repeat: int = 3) -> None:
    fixed = ps.lowest(mesh)
    label = limbs_of(mesh)
    z = 0.4 * np.random.default_rng(5).normal(size=label.max() + 1)[label]
    kinds = {
        "element": [(truth_of(mesh, "rough", 0), "every tet", ps.per_element())],
        "limbs": [
            (
                ps.Material.lame(8 * np.exp(z), 7 * np.exp(z)),
                f"{len(np.unique(label))} limbs, {moduli}",
                ps.per_region(label, moduli=moduli),
            )
            for moduli in ("lame", "young")
        ],
    }
    n = 3 * (len(mesh.points) - len(fixed))
    print(f"{len(mesh.tets):,} tets, {n:,} unknowns, {shots} touches\n")
    print("| what | parameters | iterations | clock, s | first | processor, s | off, log |")
    print("|---|---|---|---|---|---|---|")
    for material, what, kind in (kind for case in cases for kind in kinds[case]):
        truth = ps.ElasticModel(mesh, material, fixed=fixed)
        # where Poisson's ratio is not estimated, it is known
        guess = ps.Material.lame(1.0, 10.0 if "young" not in what else 7 / 8)
        prior = truth.with_material(guess)
        spent, counts = [], []
        for seed in range(repeat):
            seen = seen_touches(truth, "1mm", shots, seed)
            start = time.perf_counter(), time.process_time()
            found = ps.estimate(prior, seen, parameters=kind)
            spent.append((time.perf_counter() - start[0], time.process_time() - start[1]))
            counts.append(found.stats.iterations)
        clock, cpu = np.median(spent, axis=0)
        log = np.log(found.material.young / material.young)
        off = np.sqrt(np.mean(log**2))
        print(
            f"| {what} | {found.stats.parameters:,} | {np.median(counts):g} | "
            f"{clock:.2f} | {spent[0][0]:.2f} | {cpu:.2f} | {off:.3f} |",
            flush=True,
        )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("mesh", nargs="?", type=Path)
    parser.add_argument("--cases", nargs="+", default=["element", "limbs"])
    parser.add_argument("--shots", type=int, default=10)
    parser.add_argument("--repeat", type=int, default=3)
    options = parser.parse_args()
    given = own_tree() if options.mesh is None else ps.read_mesh(options.mesh)
    main(given, options.cases, options.shots, options.repeat)
