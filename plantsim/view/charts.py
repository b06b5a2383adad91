"""Histograms of many plants, drawn off screen with matplotlib."""

import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from plantsim.arrays import Array
from plantsim.view.style import blank_figure, saved

BAR = "#6f8f45"
WIDE = 30.0  # largest over smallest value from which the axis is logarithmic


def histograms(
    columns: Mapping[str, Array], out: str | os.PathLike[str], *, across: int = 4
) -> Path:
    """Draw a histogram a column, titled by its name, to a PNG; return its path."""
    rows = max(1, -(-len(columns) // across))
    figure = blank_figure(3.1 * across, 2.3 * rows)
    for i, (title, column) in enumerate(columns.items()):
        axes = figure.add_subplot(rows, across, i + 1)
        values = np.asarray(column, dtype=float)
        low, high = float(values.min()), float(values.max())
        if low > 0 and high / low > WIDE:
            bins = np.geomspace(low, high, 21)
            axes.set_xscale("log")
            axes.xaxis.set_minor_formatter("")  # powers of ten alone have room
        elif high > low and high - low < 40 and not (values % 1).any():
            bins = np.arange(low - 0.5, high + 1)  # whole numbers: a bar each
        elif high > low:
            bins = np.linspace(low, high, 21)
        else:
            bins = np.linspace(low - 0.5, low + 0.5, 4)
        axes.hist(values, bins, color=BAR)
        axes.set_title(f"{title} (median {np.median(values):.3g})", fontsize=8)
        axes.tick_params(labelsize=7)
        axes.yaxis.get_major_locator().set_params(integer=True)
        axes.spines[["top", "right"]].set_visible(False)
    figure.tight_layout()
    return saved(figure, out)
