"""Touches chosen by what they teach, against random and evenly spread ones.

    python benchmarks/next_touch.py [--plants 20] [--touches 8] [--candidates 24]

Plants are whorls of four branches, order 1, Young's modulus of each limb drawn from the
prior of `ps.per_limb`. A touch pushes one surface vertex 5 mm down; the wrist feels its
force with noise (5 % of a typical force), and a camera sees every fifth surface vertex
with 2 mm. After each touch the error is the root mean square over limbs of the error of log
Young. "Evenly spread" takes the candidate farthest from those touched already. Medians over
plants; the ratio is that of the touches needed for the error that the others end with.
"""

import argparse
import time

import numpy as np

import plantsim as ps

WAYS = ("random", "spread", "next")
PUSH = (0.0, 0.0, -0.005)


def plant(seed: int) -> tuple[ps.ElasticModel, ps.ElasticModel, np.ndarray]:
    """Return truth, prior and the true log Young's modulus over the prior's, by limb."""
    skeleton = ps.whorl()
    mesh = ps.tetrahedralize(ps.sweep(skeleton), 1.2, order=1)
    random = np.random.default_rng(seed)
    count = len(mesh.region_names)
    z = np.log(3.0) * random.normal() + np.log(1.5) / np.sqrt(2) * random.normal(size=count)
    prior = ps.ElasticModel(mesh, ps.Material(6e9, 0.3))
    truth = prior.with_material(ps.Material(6e9 * np.exp(z)[mesh.region], 0.3))
    return truth, prior, z


def run(seed: int, touches: int, candidates: int) -> dict[str, list[float]]:
    """Return the error after each touch, by way of choosing."""
    truth, prior, z = plant(seed)
    mesh = truth.mesh
    random = np.random.default_rng(seed + 1000)
    high = mesh.surface_vertices[
        mesh.points[mesh.surface_vertices, 2] > 0.15 * mesh.points[:, 2].max()
    ]
    pool = random.choice(high, candidates, replace=False)
    typical = np.median([np.linalg.norm(prior.contact([v]).force(PUSH)) for v in pool[:8]])
    kind = ps.per_limb(moduli="young")
    first = int(random.integers(candidates))
    order = [first, *random.permutation(np.delete(np.arange(candidates), first))]
    out: dict[str, list[float]] = {}
    for way in WAYS:
        noise = np.random.default_rng(seed + 2000)
        seen: list[ps.Observation] = []
        taken: list[int] = []
        errors = []
        choice = first
        for n in range(touches):
            taken.append(choice)
            seen.append(
                ps.observe(
                    truth,
                    ps.move([pool[choice]], PUSH),
                    seen=mesh.surface_vertices[::5],
                    displacement_noise=2e-3,
                    force_noise=0.05 * typical,
                    rng=noise,
                )
            )
            found = ps.estimate(prior, seen, parameters=kind)
            young = np.array([found.young()[name] for name in mesh.region_names])
            errors.append(float(np.sqrt(np.mean((np.log(young / 6e9) - z) ** 2))))
            left = np.setdiff1d(np.arange(candidates), taken)
            if way == "random":
                choice = int(order[n + 1])
            elif way == "spread":
                gap = np.linalg.norm(
                    mesh.points[pool[left]][:, None] - mesh.points[pool[taken]], axis=2
                )
                choice = int(left[gap.min(axis=1).argmax()])
            else:
                loads = [ps.move([pool[c]], PUSH) for c in left]
                plan = ps.next_touch(found, loads, seen=mesh.surface_vertices[::5])
                choice = int(left[plan.index])
        out[way] = errors
    return out


def needed(errors: np.ndarray, goal: float) -> int:
    """Return the first number of touches whose error is at most the goal."""
    good = np.flatnonzero(errors <= goal)
    return int(good[0]) + 1 if len(good) else len(errors) + 1


def main(plants: int = 20, touches: int = 6, candidates: int = 12) -> dict[str, np.ndarray]:
    began = time.perf_counter()
    rows = []
    for seed in range(plants):
        rows.append(run(seed, touches, candidates))
        gone = time.perf_counter() - began
        print(
            f"plant {seed + 1} of {plants}: {gone:.0f} s gone, some "
            f"{gone / (seed + 1) * (plants - seed - 1):.0f} s left",
            flush=True,
        )
    errors = {way: np.array([row[way] for row in rows]) for way in WAYS}
    print("\n| touches | " + " | ".join(WAYS) + " |\n|---|---|---|---|")
    for n in range(touches):
        cells = [f"{np.median(errors[way][:, n]):.3f}" for way in WAYS]
        print(f"| {n + 1} | " + " | ".join(cells) + " |")
    for way in ("random", "spread"):
        ratio = [
            needed(row["next"], row[way][-1]) / needed(np.array(row[way]), row[way][-1])
            for row in ({k: np.array(v) for k, v in r.items()} for r in rows)
        ]
        low, high = np.quantile(ratio, [0.25, 0.75])
        print(
            f"touches that `next_touch` needs, over those of {way}, for the error of "
            f"{way} at the end: {np.median(ratio):.2f} (quartiles {low:.2f} to {high:.2f})"
        )
    return errors


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plants", type=int, default=20)
    parser.add_argument("--touches", type=int, default=8)
    parser.add_argument("--candidates", type=int, default=24)
    options = parser.parse_args()
    main(options.plants, options.touches, options.candidates)
