"""Plots of errors and ratios in one style: Table I, convergence, ours beside others."""

import os
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from plantsim.errors import ModelError
from plantsim.view.style import blank_figure, saved, styled

# Source: Yao and Hauser, Generating and Estimating Linear FEM Plant Simulation Models,
# table I: shots; visual error [cm]; tactile error [N]
PAPER = ((0, 1, 5, 10), (1.61, 1.60, 1.08, 1.07), (13.411, 13.394, 9.330, 6.733))


def figure_table_one(
    shots: Sequence[int],
    ours: Mapping[str, tuple[ArrayLike, ArrayLike]],
    out: str | os.PathLike[str] | None = None,
    *,
    paper: bool = True,
) -> Any:
    """Draw visual [cm] and tactile [N] errors over shots, ours beside the paper's Table I.

    `ours`: name -> (visual, tactile), one value a shot. Errors on a log scale. With `out`
    (.png, .svg or .pdf) the path is returned, else the matplotlib figure.
    """
    _check_named(ours, "(visual, tactile)")
    lines: dict[str, tuple[Sequence[int], ArrayLike, ArrayLike]] = {}
    if paper:
        lines["paper, Table I"] = PAPER
    lines |= {name: (shots, *errors) for name, errors in ours.items()}
    with styled():
        figure = blank_figure(8.4, 3.6)
        for k, what in enumerate(("visual error, cm", "tactile error, N")):
            axes = figure.add_subplot(1, 2, k + 1)
            for name, line in lines.items():
                _line(axes, name, line[0], line[1 + k])
            axes.set_yscale("log")
            axes.set_xlabel("shots")
            axes.set_ylabel(what)
            axes.set_xticks(sorted({*shots, *(PAPER[0] if paper else ())}))
        figure.axes[0].legend()
        figure.tight_layout()
        return figure if out is None else saved(figure, out)


def figure_convergence(
    sizes: ArrayLike,
    errors: Mapping[str, ArrayLike],
    out: str | os.PathLike[str] | None = None,
    *,
    xlabel: str = "size of the elements",
    ylabel: str = "relative error",
) -> Any:
    """Draw errors over element sizes on log scales, with the fitted rate of each line."""
    _check_named(errors, "errors")
    h = np.asarray(sizes, dtype=float)
    with styled():
        figure = blank_figure(5.2, 4.0)
        axes = figure.add_subplot()
        for name, error in errors.items():
            e = np.abs(np.asarray(error, dtype=float))
            rate = np.polyfit(np.log(h), np.log(np.maximum(e, 1e-300)), 1)[0]
            _line(axes, f"{name}: rate {rate:.2f}", h, e)
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_xlabel(xlabel)
        axes.set_ylabel(ylabel)
        axes.legend()
        figure.tight_layout()
        return figure if out is None else saved(figure, out)


def figure_ratios(
    ratios: Mapping[str, float],
    out: str | os.PathLike[str] | None = None,
    *,
    xlabel: str = "times as fast as the reference",
) -> Any:
    """Draw ratios of ours to a reference as bars on a log scale, 1 marked."""
    _check_named(ratios, "a ratio")
    values = np.array(list(ratios.values()), dtype=float)
    if not len(values) or not (values > 0).all():
        raise ModelError(f"ratios {ratios}. Give at least one, all above 0.")
    with styled():
        figure = blank_figure(6.4, 0.7 + 0.42 * len(values))
        axes = figure.add_subplot()
        axes.barh(range(len(values)), values - 1, left=1.0, height=0.6)
        for i, v in enumerate(values):
            axes.annotate(
                f"{v:.3g}",
                (v, i),
                xytext=(4 if v >= 1 else -4, 0),
                textcoords="offset points",
                ha="left" if v >= 1 else "right",
                va="center",
            )
        axes.set_yticks(range(len(values)), list(ratios))
        axes.set_xscale("log")
        axes.set_xlim(min(values.min() / 2, 0.5), max(values.max() * 2.5, 2))
        axes.axvline(1.0, color="black", linewidth=0.8)
        axes.grid(visible=False, axis="y")
        axes.invert_yaxis()
        axes.set_xlabel(xlabel)
        figure.tight_layout()
        return figure if out is None else saved(figure, out)


def _check_named(values: object, what: str) -> None:
    if not isinstance(values, Mapping):
        kind = type(values).__name__
        raise ModelError(f"a {kind} where names are wanted. Give {{name: {what}}}.")


def _line(axes: Any, name: str, x: ArrayLike, y: ArrayLike) -> None:
    x, y = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    if x.shape != y.shape:
        raise ModelError(f"{name}: {y.size} values for {x.size} places. Give one each.")
    axes.plot(x, y, label=name)
