"""How fast plants grow, how near the reference program, and whether all pass check().

    python benchmarks/grow.py                  speed, and the comparison where it is there
    python benchmarks/grow.py --check 1000     that many seeds of every species too
    python benchmarks/grow.py --mesh 2         and meshes of that many seeds of each

The reference figures are looked for in $PLANTSIM_SHARED or ../shared; without them that
table is left out. Times are CPU seconds of one process over many seeds, best and median.
"""

import argparse
import json
import os
import time
from pathlib import Path

import numpy as np

import plantsim as ps
from plantsim.plant.parameters import WeberPenn

REFERENCE_ASPEN = 0.23  # s of CPU for the same aspen in the reference program
PLACES = (
    os.environ.get("PLANTSIM_SHARED", ""),
    Path(__file__).parents[1] / ".." / "shared",
)


def reference() -> dict:
    for place in PLACES:
        file = Path(place) / "reference_species.json"
        if place and file.exists():
            data = json.loads(file.read_text())
            return {k: v for k, v in data.items() if not k.startswith("_")}
    return {}


def took(grow, runs: int) -> tuple[float, float]:
    """Least and median CPU milliseconds of a call over seeds."""
    grow(runs)  # what is imported and cached once
    times = []
    for seed in range(runs):
        start = time.process_time()
        grow(seed)
        times.append(1e3 * (time.process_time() - start))
    return min(times), float(np.median(times))


def speed(runs: int) -> None:
    print("CPU ms               ready: best  median  limbs   whole: best  median   stems")
    for name in ps.species_names():
        ready = took(lambda s, n=name: ps.weber_penn(n, rng=s), runs)
        whole = took(lambda s, n=name: ps.weber_penn(n, rng=s, ready=False), runs)
        limbs = len(ps.weber_penn(name, rng=7).first)
        stems = len(ps.weber_penn(name, rng=7, ready=False).first)
        print(
            f"{name:22s} {ready[0]:9.1f} {ready[1]:7.1f} {limbs:6d} "
            f"{whole[0]:13.1f} {whole[1]:7.1f} {stems:7d}"
        )


def compare(seeds: int) -> None:
    for name, entry in reference().items():
        model = WeberPenn.from_mapping(entry["parameters"])
        grown = list(entry["grown"].values())
        one = took(lambda s, m=model: ps.weber_penn(m, rng=s, ready=False), seeds)
        plants = [ps.weber_penn(model, rng=s, ready=False) for s in range(seeds)]
        note = f"; the reference program {1e3 * REFERENCE_ASPEN:.0f}"
        note = note if name == "quaking_aspen" else ""
        print(f"\n{name}: best {one[0]:.1f}, median {one[1]:.1f} ms of CPU for all{note}")
        print(f"  {'':16s} {'ours':>10s} {'reference':>10s} {'scatter':>9s} {'ratio':>6s}")
        row("height [m]", [p.height for p in plants], [g["height"] for g in grown])
        for level in range(model.levels):
            lengths = [[b.length for b in p.limbs if b.level == level] for p in plants]
            theirs = [g["levels"][level] for g in grown]
            row(f"stems {level}", [len(x) for x in lengths], [t["stems"] for t in theirs])
            ours = [np.mean(x) for x in lengths]
            row(f"mean length {level}", ours, [t["length_mean"] for t in theirs])


def row(label: str, ours, theirs) -> None:
    mean, want, scatter = np.mean(ours), np.mean(theirs), np.std(theirs, ddof=1)
    good = abs(mean - want) <= max(0.1 * want, scatter)
    print(
        f"  {label:16s} {mean:10.3f} {want:10.3f} {scatter:9.3f} {mean / want:6.3f}"
        f"{'' if good else '  off'}"
    )


def check(seeds: int) -> None:
    print(f"\n{seeds} default skeletons of every species")
    for name in ps.species_names():
        start, bad, limbs = time.process_time(), [], []
        for seed in range(seeds):
            plant = ps.weber_penn(name, rng=seed)
            limbs.append(len(plant.first))
            if plant.check():
                bad.append(seed)
        each = (time.process_time() - start) / seeds
        print(
            f"  {name:22s} {len(bad)} fail {bad[:5] or ''} "
            f"limbs {min(limbs)}-{max(limbs)}, {1e3 * each:.0f} ms each with check",
            flush=True,
        )


def mesh(seeds: int) -> None:
    print(f"\nlinear meshes of {seeds} default skeletons of every species")
    for name in ps.species_names():
        for seed in range(seeds):
            plant = ps.weber_penn(name, rng=seed)
            start = time.perf_counter()
            found = ps.tetrahedralize(ps.sweep(plant), order=1)
            print(
                f"  {name:22s} seed {seed}: {len(plant.first)} limbs, {len(found.tets):,} "
                f"tets, worst quality {found.quality.min():.2f}, "
                f"{time.perf_counter() - start:.0f} s",
                flush=True,
            )


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    options.add_argument("--seeds", type=int, default=20, help="for the comparison")
    options.add_argument("--runs", type=int, default=20, help="for the speed")
    options.add_argument("--check", type=int, default=0, help="seeds of every species")
    options.add_argument("--mesh", type=int, default=0, help="seeds of every species")
    given = options.parse_args()
    speed(given.runs)
    compare(given.seeds)
    if given.check:
        check(given.check)
    if given.mesh:
        mesh(given.mesh)


if __name__ == "__main__":
    main()
