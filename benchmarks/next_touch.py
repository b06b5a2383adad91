"""Touches chosen by what they teach, against random and evenly spread ones.

    python benchmarks/next_touch.py [--plants 20] [--touches 12] [--candidates 24]
        [--log rows.jsonl]

Plants are grown: five each of four species, eight limbs, order 1; Young's modulus of each
limb is drawn from the prior of `ps.per_limb`. A touch pushes one surface vertex down by 0.5
% of the plant's height; the wrist feels its force with noise (5 % of a typical force), and
a camera sees every fifth surface vertex with noise of 40 % of the push. After each touch
the error is the root mean square over limbs of the error of log Young. All start with the
same random touch. "Evenly spread" takes the candidate farthest from those touched already.
Medians over plants; the ratio is that of the touches needed for the error that the others
end with. With `--log` each plant's errors are kept, and a run that was cut goes on.
"""

import argparse
import json
import time
from pathlib import Path

import numpy as np

import plantsim as ps

WAYS = ("random", "spread", "next")
SPECIES = ("apple", "cherry", "citrus_young", "quaking_aspen")
DEEP = 0.005  # of the height
SIGHT = 0.4  # noise of the camera over the push


def plant(seed: int) -> tuple[ps.ElasticModel, ps.ElasticModel, np.ndarray]:
    """Return truth, prior and the true log Young's modulus over the prior's, by limb."""
    kind = SPECIES[seed % len(SPECIES)]
    skeleton = ps.weber_penn(kind, seed, levels=2, max_limbs=8)
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
    push = np.array([0.0, 0.0, -DEEP * np.ptp(mesh.points[:, 2])])
    sight = SIGHT * abs(push[2])
    typical = np.median([np.linalg.norm(prior.contact([v]).force(push)) for v in pool[:8]])
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
                    ps.move([pool[choice]], push),
                    seen=mesh.surface_vertices[::5],
                    displacement_noise=sight,
                    force_noise=0.05 * typical,
                    rng=noise,
                )
            )
            found = ps.estimate(prior, seen, parameters=kind)
            young = np.array([found.young()[name] for name in mesh.region_names])
            errors.append(float(np.sqrt(np.mean((np.log(young / 6e9) - z) ** 2))))
            left = np.setdiff1d(np.arange(candidates), taken)
            if way == "random":
                choice = int(order[(n + 1) % candidates])
            elif way == "spread":
                gap = np.linalg.norm(
                    mesh.points[pool[left]][:, None] - mesh.points[pool[taken]], axis=2
                )
                choice = int(left[gap.min(axis=1).argmax()])
            else:
                loads = [ps.move([pool[c]], push) for c in left]
                plan = ps.next_touch(found, loads, seen=mesh.surface_vertices[::5])
                choice = int(left[plan.index])
        out[way] = errors
    return out


def needed(errors: np.ndarray, goal: float) -> int:
    """Return the first number of touches whose error is at most the goal."""
    good = np.flatnonzero(errors <= goal)
    return int(good[0]) + 1 if len(good) else len(errors) + 1


def main(
    plants: int = 20, touches: int = 12, candidates: int = 24, log: Path | None = None
) -> dict[str, np.ndarray]:
    began = time.perf_counter()
    known = {}
    if log is not None and log.exists():
        kept = map(json.loads, log.read_text(encoding="utf-8").splitlines())
        known = {k["plant"]: k for k in kept}
    made = 0
    rows = []
    for seed in range(plants):
        asked = {"plant": seed, "touches": touches, "candidates": candidates}
        row = known.get(seed, {})
        if {name: row.get(name) for name in asked} != asked:
            row = asked | {"errors": run(seed, touches, candidates)}
            made += 1
            if log is not None:
                with log.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(row) + "\n")
            gone = time.perf_counter() - began
            print(
                f"plant {seed + 1} of {plants}: {gone:.0f} s gone, some "
                f"{gone / made * (plants - seed - 1):.0f} s left",
                flush=True,
            )
        rows.append({way: np.array(row["errors"][way]) for way in WAYS})
    errors = {way: np.array([row[way] for row in rows]) for way in WAYS}
    print("\n| touches | " + " | ".join(WAYS) + " |\n|---|---|---|---|")
    for n in range(touches):
        cells = [f"{np.median(errors[way][:, n]):.3f}" for way in WAYS]
        print(f"| {n + 1} | " + " | ".join(cells) + " |")
    for way in ("random", "spread"):
        ratio = [
            needed(row["next"], row[way][-1]) / needed(row[way], row[way][-1])
            for row in rows
        ]
        low, high = np.quantile(ratio, [0.25, 0.75])
        goal = float(np.median(errors[way][:, -1]))
        both = [needed(np.median(errors[w], axis=0), goal) for w in ("next", way)]
        print(
            f"touches that `next_touch` needs, over those of {way}, for the error of "
            f"{way} at the end: {np.median(ratio):.2f} (quartiles {low:.2f} to "
            f"{high:.2f}); by the medians above {both[0]} against {both[1]}"
        )
    return errors


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plants", type=int, default=20)
    parser.add_argument("--touches", type=int, default=12)
    parser.add_argument("--candidates", type=int, default=24)
    parser.add_argument("--log", type=Path)
    options = parser.parse_args()
    main(options.plants, options.touches, options.candidates, options.log)
