"""What a data set costs: by stage, on one and two processes, by limbs and tets, at scale.

    python benchmarks/dataset.py               the recipe that ships, 16 plants each
    python benchmarks/dataset.py --plants 40
    python benchmarks/dataset.py --rows DIR    tables of a data set that is there already

The same plants are made by one worker and by two, in turns. On a machine that does other
work too, seconds by the clock say little, so that two figures stand beside them: seconds of
the processor a plant, and the share of their time that the workers were at plants. The
efficiency of two workers is the ratio of the first times that of the second.
"""

import argparse
import tempfile
import time
import tomllib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import plantsim as ps
from plantsim.datasets.folder import CPU, SECONDS, STAGES
from plantsim.datasets.recipe import example

SCALES = (10_000, 1_000_000)
WORKERS = (1, 2, 8, 64, 512)
LIMBS = ((1, 3), (4, 5), (6, 7), (8, 100))


@dataclass(frozen=True)
class Run:
    """One data set made."""

    workers: int
    seconds: float  # by the clock, from the first plant begun to the last one done
    rows: tuple[dict, ...]

    @property
    def cpu(self) -> float:
        """Mean seconds of the processor a plant."""
        return float(np.mean([row[CPU] for row in self.rows]))

    @property
    def busy(self) -> float:
        """Share of their time that the workers were at plants."""
        return float(spent(self.rows).sum() / (self.workers * self.seconds))


def spent(rows) -> np.ndarray:
    """Seconds by the clock, (plants, stages)."""
    return np.array([[row[name] for name in SECONDS] for row in rows])


def make(recipe: ps.Recipe, workers: int) -> Run:
    """Make a recipe's plants anew."""
    first: list[float] = []

    def tell(step) -> None:
        now = time.perf_counter()
        if step.made == 1:  # that one was begun its own seconds ago
            own = sum(step.row[name] for name in SECONDS)
            first.append(now - own)

    with tempfile.TemporaryDirectory() as folder:
        data = ps.dataset(recipe, Path(folder) / "plants", workers=workers, tell=tell)
        return Run(workers, time.perf_counter() - first[0], data.rows)


def stages(rows) -> None:
    """Print seconds a plant by stage."""
    print("\n| stage | median, s | mean, s | most, s | share |")
    print("|---|---|---|---|---|")
    each = spent(rows)
    total = each.sum(axis=1)
    for name, column in (*zip(STAGES, each.T, strict=True), ("all", total)):
        print(
            f"| {name} | {np.median(column):.2f} | {column.mean():.2f} | "
            f"{column.max():.2f} | {column.sum() / total.sum():.0%} |"
        )
    cpu = np.array([row[CPU] for row in rows])
    print(
        f"| all, processor | {np.median(cpu):.2f} | {cpu.mean():.2f} | {cpu.max():.2f} | |"
    )


def rates(runs: dict[int, Run]) -> None:
    """Print plants a minute by stage: what all workers would do at that stage alone."""
    print("\n| stage |" + "".join(f" {n} at work: s a plant | a minute |" for n in runs))
    print("|---|" + "---|---|" * len(runs))
    each = {n: spent(run.rows).mean(axis=0) for n, run in runs.items()}
    for i, name in enumerate(STAGES):
        cells = [f" {s[i]:.3f} | {60 * n / s[i]:,.0f} |" for n, s in each.items()]
        print(f"| {name} |" + "".join(cells))
    cells = [f" {s.sum():.3f} | {60 * n / s.sum():,.0f} |" for n, s in each.items()]
    print("| all |" + "".join(cells))


def sizes(rows) -> None:
    """Print what a plant costs by its limbs, and a line through its tets."""
    limbs, tets, cpu, disk = (
        np.array([row[name] for row in rows], dtype=float)
        for name in ("limbs", "tets", CPU, "bytes")
    )
    print("\n| limbs | plants | median tets | processor, s | a thousand tets, s | MB |")
    print("|---|---|---|---|---|---|")
    for low, high in LIMBS:
        own = (limbs >= low) & (limbs <= high)
        if own.any():
            name = f"{low} to {high}" if high < 100 else f"{low} and more"
            print(
                f"| {name} | {own.sum()} | {np.median(tets[own]):,.0f} | "
                f"{np.median(cpu[own]):.2f} | "
                f"{1e3 * np.median(cpu[own] / tets[own]):.2f} | "
                f"{disk[own].mean() / 1e6:.2f} |"
            )
    slope, foot = np.polyfit(tets / 1e3, cpu, 1)
    off = np.corrcoef(tets, cpu)[0, 1]
    print(
        f"\nprocessor, s = {foot:.2f} + {slope:.3f} thousand tets (correlation {off:.2f})"
    )


def scale(rows, efficiency: float) -> None:
    """Print what many plants take on N workers, a core each."""
    cpu = float(np.mean([row[CPU] for row in rows]))
    disk = float(np.mean([row["bytes"] for row in rows]))
    print("\n| plants | disk, GB |" + "".join(f" {n} workers |" for n in WORKERS))
    print("|---|---|" + "---|" * len(WORKERS))
    for plants in SCALES:
        cells = []
        for n in WORKERS:
            hours = plants * cpu / 3600 / (n if n == 1 else n * efficiency)
            cells.append(
                f"{hours / 24:,.0f} days"
                if hours > 48
                else f"{hours:,.1f} h"
                if hours > 1
                else f"{60 * hours:.0f} min"
            )
        print(f"| {plants:,} | {plants * disk / 1e9:,.0f} | " + " | ".join(cells) + " |")


def compare(recipe: ps.Recipe, turns: int) -> tuple[float, tuple[dict, ...]]:
    """Print one worker against two; return the efficiency, and rows of one worker."""
    runs: dict[int, list[Run]] = {1: [], 2: []}
    for _ in range(turns):
        for workers, done in runs.items():
            done.append(make(recipe, workers))
    print("| workers | plants a minute | processor, s a plant | at plants |")
    print("|---|---|---|---|")
    cpu, busy = {}, {}
    for workers, done in runs.items():
        minutes = np.median([60 * len(r.rows) / r.seconds for r in done])
        cpu[workers] = np.median([r.cpu for r in done])
        busy[workers] = np.median([r.busy for r in done])
        print(f"| {workers} | {minutes:.1f} | {cpu[workers]:.2f} | {busy[workers]:.1%} |")
    efficiency = cpu[1] / cpu[2] * busy[2] / busy[1]
    clock = [np.median([r.seconds for r in done]) for done in runs.values()]
    print(
        f"\nefficiency of two workers: {efficiency:.0%}; by the clock alone "
        f"{clock[0] / clock[1] / 2:.0%}"
    )
    same = all(
        a["digest"] == b["digest"]
        for a, b in zip(runs[1][0].rows, runs[2][-1].rows, strict=True)
    )
    print(f"the same numbers by one worker and by two: {'yes' if same else 'NO'}")
    rates({n: done[-1] for n, done in runs.items()})
    return float(min(efficiency, 1.0)), runs[1][0].rows


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--plants", type=int, default=16)
    parser.add_argument("--turns", type=int, default=1)
    parser.add_argument("--rows", type=Path)
    parser.add_argument("--efficiency", type=float, default=1.0)
    asked = parser.parse_args()
    if asked.rows is not None:
        efficiency, rows = asked.efficiency, ps.open_dataset(asked.rows).rows
    else:
        recipe = {**tomllib.loads(example()), "plants": asked.plants}
        efficiency, rows = compare(ps.Recipe.from_mapping(recipe), asked.turns)
    stages(rows)
    sizes(rows)
    scale(rows, efficiency)


if __name__ == "__main__":
    main()
