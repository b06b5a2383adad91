"""How good a mesh is, as a histogram."""

import os
from typing import Any

import numpy as np

from plantsim.errors import check_kind
from plantsim.mesh.tetmesh import TetMesh
from plantsim.view.style import blank_figure, saved

BINS = np.linspace(0, 1, 41)


def figure_quality(mesh: TetMesh, out: str | os.PathLike[str] | None = None) -> Any:
    """Draw the histogram of gamma (1: regular, 0: flat), the worst tet marked.

    With `out` (.png, .svg or .pdf) it returns the path, else the matplotlib Figure.
    Raises DependencyError where matplotlib is not installed.
    """
    check_kind(mesh, TetMesh, "figure_quality")
    figure = blank_figure(6.4, 4.0)
    axes = figure.add_axes((0.13, 0.15, 0.83, 0.72))
    worst, middle = float(mesh.quality.min()), float(np.median(mesh.quality))
    axes.hist(mesh.quality, BINS, color="#8a6d4d", edgecolor="white", linewidth=0.5)
    axes.axvline(worst, color="#c8342b", linewidth=1.5)
    axes.annotate(
        f"worst {worst:.2f}, limb {mesh.region_names[mesh.region[mesh.quality.argmin()]]}",  # type: ignore[index]
        (worst, 0.93),
        xycoords=("data", "axes fraction"),
        xytext=(5, 0),
        textcoords="offset points",
        color="#c8342b",
        fontsize=9,
    )
    axes.set_xlim(0, 1)
    axes.set_ylim(0, 1.15 * axes.get_ylim()[1])  # room for the word above the bars
    axes.set_xlabel("gamma (1: regular, 0: flat)")
    axes.set_ylabel("tets")
    axes.set_title(
        f"{len(mesh.tets):,} tets of order {mesh.order}, median gamma {middle:.2f}",
        fontsize=10,
    )
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    return figure if out is None else saved(figure, out)
