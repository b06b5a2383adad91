"""Draw the pictures of docs/benchmarks.md from its own tables: python docs/plots.py.

So a picture never says anything else than the table beside it.
"""

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.ticker import NullFormatter

HERE = Path(__file__).resolve().parent
# Okabe and Ito 2008: told apart by colour-blind eyes, and by shape besides
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
MARKS = "osD^vP"
Rows = list[dict[str, str]]


def tables(section: str) -> list[Rows]:
    """Return the tables under a heading of docs/benchmarks.md, cells by column name."""
    text = (HERE / "benchmarks.md").read_text()
    part = text.split(f"## {section}\n", 1)[1].split("\n## ", 1)[0]
    out: list[Rows] = []
    head: list[str] = []
    for line in [*part.splitlines(), ""]:
        if not line.startswith("|"):
            head = []
            continue
        cells = [c.strip() for c in line.strip("|").split("|")]
        if not head:
            head = cells
            out.append([])
        elif not set(line) <= set("|-"):
            out[-1].append(dict(zip(head, cells, strict=True)))
    return out


def number(cell: str) -> float:
    """Return a cell's number; NaN where there is none."""
    try:
        return float(cell.replace(",", "").replace("%", "").replace(" x", ""))
    except ValueError:
        return float("nan")


def lines(
    axes: plt.Axes, rows: Rows, by: tuple[str, ...], x: str, y: str, **style: str
) -> None:
    """Draw |y| over x, a line for each value of the columns `by`."""
    keys = list(dict.fromkeys(tuple(r[c] for c in by) for r in rows))
    for i, key in enumerate(keys):
        some = [r for r in rows if tuple(r[c] for c in by) == key]
        axes.plot(
            [number(r[x]) for r in some],
            [abs(number(r[y])) for r in some],
            color=COLOURS[i % len(COLOURS)],
            marker=MARKS[i % len(MARKS)],
            label=", ".join(
                f"{c} {v}" if c in ("order", "refined") else v
                for c, v in zip(by, key, strict=True)
            ),
            **style,
        )
    axes.set(xscale="log", yscale="log", xlabel=x)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter("{x:,g}")
        axis.set_minor_formatter(NullFormatter())
    axes.grid(alpha=0.3, which="both", lw=0.5)
    axes.legend(frameon=False, fontsize=8)


def bars(axes: plt.Axes, names: list[str], values: list[float], words: list[str]) -> None:
    """Draw signed values beside their names, each with what it says."""
    at = np.arange(len(names))[::-1]
    axes.barh(at, values, color=COLOURS[0], height=0.6)
    for y, v, word in zip(at, values, words, strict=True):
        axes.annotate(
            word,
            (v, y),
            (4 if v >= 0 else -4, 0),
            textcoords="offset points",
            va="center",
            ha="left" if v >= 0 else "right",
            fontsize=7,
        )
    axes.set_yticks(at, names, fontsize=7)
    axes.axvline(0, color="black", lw=0.8)
    axes.margins(x=0.18)
    for side in ("top", "right", "left"):
        axes.spines[side].set_visible(False)


def cantilevers() -> plt.Figure:
    """Draw the error of the tip's motion over the number of tets."""
    rows = tables("Cantilevers against beam theory")[0]
    figure, axes = plt.subplots(1, 2, figsize=(9, 3.6), sharey=True, layout="tight")
    for ax, shape in zip(axes, ("straight", "tapered"), strict=True):
        some = [r for r in rows if r["cantilever"] == shape]
        lines(ax, some, ("load", "order"), "tets", "error")
        ax.axhline(1, color="black", lw=0.8, ls=":")
        ax.set_title(f"{shape} cantilever", fontsize=10)
    axes[0].set_ylabel("error of the tip's motion, %")
    return figure


def proof() -> plt.Figure:
    """Draw the error of each case."""
    cases = tables("Theory of beams, frames, blocks and vibrations")[0]
    names = [r["case"].rsplit(" [", 1)[0] for r in cases]
    figure, ax = plt.subplots(figsize=(9, 5), layout="tight")
    bars(ax, names, [number(r["error"]) for r in cases], [r["error"] for r in cases])
    ax.set_xlabel("ours against theory, %")
    return figure


def limits() -> plt.Figure:
    """Draw errors over slenderness, and those of the manufactured solution."""
    _, slender, made = tables("Theory of beams, frames, blocks and vibrations")
    figure, axes = plt.subplots(1, 2, figsize=(9, 3.6), layout="tight")
    lines(axes[0], slender, ("case", "against"), "length / radius", "error")
    axes[0].set(ylabel="distance from theory, %", ylim=(4e-3, 5))
    axes[0].set_xticks([50, 100, 200])
    lines(axes[1], made, ("order",), "cells a side", "error in L2")
    axes[1].set_ylabel("error in L2 of a manufactured solution")
    axes[1].set_xticks([3, 5, 8, 12, 18])
    return figure


def solvers() -> plt.Figure:
    """Draw time and memory over unknowns."""
    rows = tables("Direct factors against multigrid")[0]
    figure, axes = plt.subplots(1, 2, figsize=(9, 3.6), layout="tight")
    total = [
        r | {"total": str(number(r["prepare, s"]) + number(r["apply, s"]))} for r in rows
    ]
    lines(axes[0], total, ("solver",), "unknowns", "total")
    axes[0].set_ylabel("first solve, CPU s")
    lines(axes[1], rows, ("solver",), "unknowns", "memory, GiB")
    axes[1].set_ylabel("peak memory of the process, GiB")
    return figure


def multigrid() -> plt.Figure:
    """Draw iterations over unknowns."""
    rows = tables("Multigrid")[0]
    figure, ax = plt.subplots(figsize=(6, 3.6), layout="tight")
    lines(ax, rows, ("mesh", "order"), "unknowns", "iterations")
    ax.axhline(45, color="black", lw=0.8, ls=":")
    ax.set(yscale="linear", ylim=(0, 50), xlim=(None, 4e6), ylabel="iterations to 1e-12")
    return figure


def packages() -> plt.Figure:
    """Draw the time of each stage, package by package."""
    rows = tables("Other packages")[0]
    stages = list(rows[0])[1:-2]
    figure, ax = plt.subplots(figsize=(9, 3.8), layout="tight")
    wide = 0.8 / len(rows)
    for i, r in enumerate(rows):
        at = np.arange(len(stages)) + (i - (len(rows) - 1) / 2) * wide
        values = [number(r[s]) for s in stages]
        ax.bar(at, values, wide, color=COLOURS[i], label=r["package"], edgecolor="white")
    ax.set_xticks(np.arange(len(stages)), [s.replace(", ", ",\n") for s in stages])
    ax.set(yscale="log", ylim=(0.05, 3000), ylabel="CPU ms, smaller is better")
    ax.tick_params(axis="x", labelsize=8)
    ax.legend(frameon=False, fontsize=8, ncols=len(rows))
    return figure


def contact() -> plt.Figure:
    """Draw how many times faster than the frame each answer is."""
    rows = tables("Contact against the paper's frame")[0]
    ratio = [number(r["faster than the frame"]) for r in rows]
    figure, ax = plt.subplots(figsize=(8, 3.4), layout="tight")
    words = [f"{r['ms']} ms, {r['faster than the frame']}" for r in rows]
    bars(ax, [r["what"] for r in rows], ratio, words)
    ax.set(xscale="log", xlim=(0.8, 3e5), xlabel="times faster than the frame")
    return figure


def assembly() -> plt.Figure:
    """Draw the time of each matrix."""
    rows = tables("Assembly")[0]
    figure, ax = plt.subplots(figsize=(6, 3), layout="tight")
    stages = ("scikit-fem", "first model", "new material", "mass")
    for i, r in enumerate(rows):
        at = np.arange(len(stages)) + (i - 0.5) * 0.4
        ax.bar(
            at,
            [number(r[s]) for s in stages],
            0.4,
            color=COLOURS[i],
            label=f"order {r['order']}",
            edgecolor="white",
        )
    ax.set_xticks(np.arange(len(stages)), stages)
    ax.set(yscale="log", ylabel="CPU ms")
    ax.legend(frameon=False)
    return figure


if __name__ == "__main__":
    for draw in (
        cantilevers,
        proof,
        limits,
        solvers,
        multigrid,
        packages,
        contact,
        assembly,
    ):
        figure = draw()
        figure.savefig(HERE / "images" / f"{draw.__name__}.png", dpi=110)
        plt.close(figure)
