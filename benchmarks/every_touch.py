"""What every added touch brings: errors on unseen touches after 1, 2, ... 10 touches.

    python benchmarks/every_touch.py [--plants fork apple] [--seeds 100] [--shots 10]
        [--log rows.jsonl]

Plants, fields and touches are those of `table1.py`: moduli by limb, 3 mm and 5 %, what one
camera sees, prior mu = 1, lam = 10; of one seed the touches are nested. For every touch:
the median over seeds of the error over that of no touch; how that median changes with the
touch, with its 90 % interval by bootstrap over seeds; and the median over seeds of how the
error itself changes. Below 1 the error falls.
"""

import argparse
from pathlib import Path

import numpy as np

try:
    from benchmarks import table1
except ImportError:  # run as a script
    import table1  # pyright: ignore[reportMissingImports]

DRAWS = 4000


def shares(rows: list[table1.Row], what: str, shots: int) -> np.ndarray:
    """Return the errors over those of the prior, (seeds, shots), of seeds done whole."""
    by_seed: dict[int, dict[int, float]] = {}
    for row in rows:
        error = getattr(row, what) / getattr(row, f"prior_{what}")
        by_seed.setdefault(row.seed, {})[row.shots] = error
    whole = [s for s in by_seed.values() if len(s) >= shots]
    return np.array([[s[n] for n in range(1, shots + 1)] for s in whole])


def table(rows: list[table1.Row], shots: int) -> str:
    lines = [
        "| touches | visual n/0 | median's change (90 %) | change, median | tactile n/0 | "
        "median's change (90 %) | change, median |",
        "|---|---|---|---|---|---|---|",
    ]
    columns = []
    for what in ("visual", "tactile"):
        x = shares(rows, what, shots)
        draw = np.random.default_rng(0).integers(len(x), size=(DRAWS, len(x)))
        drawn = np.median(x[draw], axis=1)
        low, high = np.quantile(drawn[:, 1:] / drawn[:, :-1], [0.05, 0.95], axis=0)
        now = np.median(x, axis=0)
        paired = np.median(x[:, 1:] / x[:, :-1], axis=0)
        cells = [f"{now[0]:.3g} | | "]
        for n in range(1, shots):
            change = f"{now[n] / now[n - 1]:.2f} ({low[n - 1]:.2f} to {high[n - 1]:.2f})"
            cells.append(f"{now[n]:.3g} | {change} | {paired[n - 1]:.2f}")
        columns.append(cells)
    for n in range(shots):
        lines.append(f"| {n + 1} | {columns[0][n]} | {columns[1][n]} |")
    return "\n".join(lines)


def main(
    plants: list[str], seeds: int = 100, shots: int = 10, log: Path | None = None
) -> None:
    for name in plants:
        rows = table1.main(
            table1.own_plants([name]),
            ["limb"],
            ["camera"],
            ["map"],
            list(range(1, shots + 1)),
            seeds,
            log=log,
        )
        mine = [r for r in rows if r.mesh == name and not np.isnan(r.visual)]
        print(f"\n{name}, {len(shares(mine, 'visual', shots))} seeds\n")
        print(table(mine, shots), flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plants", nargs="+", default=["fork", "apple"])
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--shots", type=int, default=10)
    parser.add_argument("--log", type=Path)
    options = parser.parse_args()
    main(options.plants, options.seeds, options.shots, options.log)
