"""One style for every picture: colours that colour-blind eyes tell apart, lines, bars."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from plantsim.arrays import Array
from plantsim.errors import needs
from plantsim.paths import Picture, replacing, writable

# Source: Okabe and Ito, Color Universal Design, 2008 (jfly.uni-koeln.de/color)
BLACK, ORANGE, SKY, GREEN = "#000000", "#e69f00", "#56b4e9", "#009e73"
YELLOW, BLUE, VERMILION, PURPLE = "#f0e442", "#0072b2", "#d55e00", "#cc79a7"
CYCLE = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY, BLACK)
MARKS = ("o", "s", "^", "D", "v", "P", "X")  # a shape beside the colour: print is grey
LIMBS = (BLUE, VERMILION, GREEN, PURPLE, ORANGE)  # one after the other, then again
REST, DEFORMED = "#000000", "#9a9a9a"  # the paper's Figure 1
MOVED, CONTACT = "#e31a1c", "#1b9e4b"
# perceptually even and monotone in lightness, so that they survive a grey print
STIFFNESS, UNCERTAINTY, STRESS = "viridis", "cividis", "plasma"
FORMATS = (".png", ".svg", ".pdf")  # of plots
_SETTINGS: dict[str, Any] = {
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.6,
    "font.size": 10,
    "legend.frameon": False,
    "lines.linewidth": 1.8,
    "lines.markersize": 6,
    "svg.hashsalt": "plantsim",  # the same picture, the same bytes
    "svg.fonttype": "none",
}


@contextmanager
def styled() -> Iterator[Any]:
    """Yield matplotlib with our settings while a figure is made.

    Raises DependencyError where matplotlib is not installed.
    """
    mpl, cycler = needs("matplotlib", "view"), needs("cycler", "view").cycler
    settings: Any = _SETTINGS | {
        "axes.prop_cycle": cycler(color=CYCLE) + cycler(marker=MARKS)
    }
    with mpl.rc_context(settings):
        yield mpl


def blank_figure(width: float, height: float) -> Any:
    """Return a white matplotlib figure, inches; DependencyError without matplotlib."""
    canvas: Any = needs("matplotlib.backends.backend_agg", "view")
    drawing: Any = needs("matplotlib.figure", "view")
    figure = drawing.Figure(figsize=(width, height), facecolor="white")
    canvas.FigureCanvasAgg(figure)  # no window, whatever the backend
    return figure


def saved(figure: Any, out: str | os.PathLike[str]) -> Path:
    """Write a matplotlib figure as .png, .svg or .pdf, the same bytes each time."""
    path = writable(out, *FORMATS)
    kind = path.suffix.lower()[1:]
    stamp = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}.get(kind)
    with replacing(path) as temporary, styled():
        figure.savefig(temporary, dpi=150, format=kind, metadata=stamp)
    return Picture(path)


def colours(
    values: ArrayLike, cmap: str = STIFFNESS, span: tuple[float, float] | None = None
) -> Array:
    """Return 8-bit colours (k, 3) of values (k,), the span's ends at the map's ends."""
    x = np.asarray(values, dtype=float)
    low, high = span if span is not None else extent(x)
    with styled() as mpl:
        table = mpl.colormaps[cmap]
    share = np.clip((x - low) / max(high - low, 1e-300), 0, 1)
    return (255 * table(share)[..., :3]).round().astype(np.uint8)


def extent(values: ArrayLike) -> tuple[float, float]:
    """Return lowest and highest value; a single value stands in the middle."""
    x = np.asarray(values, dtype=float)
    low, high = float(x.min()), float(x.max())
    pad = 0.0 if high > low else (0.05 * abs(high) or 1.0)
    return low - pad, high + pad


def rgb(code: str) -> tuple[int, int, int]:
    """Return red, green and blue, 0 to 255, of a colour such as "#0072b2"."""
    return int(code[1:3], 16), int(code[3:5], 16), int(code[5:7], 16)


def plain(value: float) -> str:
    """Return a number with three figures or more, and no power of ten where it is large.

    >>> plain(0.01234), plain(5860.4)
    ('0.0123', '5,860')
    """
    return f"{value:.3g}" if abs(value) < 1000 else f"{value:,.0f}"
