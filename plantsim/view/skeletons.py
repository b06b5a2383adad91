"""Pictures of skeletons, drawn off screen with matplotlib."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from plantsim.arrays import Array
from plantsim.errors import check_kind
from plantsim.plant.skeleton import Skeleton
from plantsim.view.style import GREEN, VERMILION, blank_figure, saved

BARK = ("#5b4636", "#8a6d4d", "#6f8f45", "#93b35a")  # by level
LEAF, FRUIT = GREEN, VERMILION
SLICES = 6  # pieces that an interval of the axis is drawn in


def figure_skeleton(
    skeleton: Skeleton, out: str | os.PathLike[str] | None = None, *, title: str = ""
) -> Any:
    """Draw a skeleton from the side, limbs as thick as they are, with what hangs on it.

    With `out` (.png, .svg or .pdf) it returns the path, else the matplotlib Figure.
    Raises DependencyError where matplotlib is not installed.
    """
    check_kind(skeleton, Skeleton, "figure_skeleton")
    figure = blank_figure(6.4, 7.2)
    axes = figure.add_axes((0.12, 0.08, 0.84, 0.84))
    _draw(axes, skeleton)
    axes.set_xlabel("m")
    axes.set_ylabel("m")
    words = repr(skeleton).split(";")[0].replace("Skeleton(", "")
    axes.set_title(title or words, fontsize=9)
    return figure if out is None else saved(figure, out)


def contact_sheet(
    skeletons: Sequence[tuple[str, Skeleton]],
    out: str | os.PathLike[str],
    *,
    columns: int = 5,
) -> Path:
    """Draw named skeletons, each to its own scale, to a PNG; return its path."""
    rows = -(-len(skeletons) // columns)
    figure = blank_figure(3.1 * columns, 3.5 * rows)
    for i, (name, skeleton) in enumerate(skeletons):
        axes = figure.add_subplot(rows, columns, i + 1)
        _draw(axes, skeleton)
        axes.set_title(
            f"{name}\n{skeleton.height:.2g} m, {len(skeleton.first)} limbs", fontsize=9
        )
        axes.tick_params(labelsize=7)
    figure.tight_layout()
    return saved(figure, out)


def _draw(axes: Any, skeleton: Skeleton) -> None:
    """Draw limbs as filled bands, the far ones first."""
    from matplotlib.collections import PolyCollection  # noqa: PLC0415

    assert skeleton.level is not None
    bands, colours, depth = [], [], []
    view = _view(skeleton.points)
    low = high = skeleton.points @ view[:2].T
    span = float(np.ptp(low, axis=0).max())
    for i, (a, b) in enumerate(zip(skeleton.first, skeleton.last, strict=True)):
        line, radius, far = _axis(skeleton, int(a), int(b), view)
        way = np.gradient(line, axis=0)
        way /= np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-12)
        out = np.stack([-way[:, 1], way[:, 0]], axis=1)
        wide = np.maximum(radius, 4e-4 * span)[:, None] * out
        bands.append(np.vstack([line + wide, (line - wide)[::-1]]))
        colours.append(BARK[min(int(skeleton.level[i]), len(BARK) - 1)])
        depth.append(far)
    order = np.argsort(depth)[::-1]
    axes.add_collection(
        PolyCollection(
            [bands[k] for k in order], facecolors=[colours[k] for k in order], linewidths=0
        )
    )
    if skeleton.hung.kind:
        masses = skeleton.masses
        flat = masses.points @ view[:2].T
        low, high = np.vstack([low, flat]), np.vstack([high, flat])
        small = min(1.0, 3.0 / span)
        for kind, colour, size in (("leaf", LEAF, 3 * small), ("fruit", FRUIT, 16 * small)):
            pick = np.array([k == kind for k in masses.kind])
            axes.scatter(*flat[pick].T, s=size, c=colour, alpha=0.7, linewidths=0, zorder=3)
    margin = 0.05 * span
    axes.set_xlim(low[:, 0].min() - margin, high[:, 0].max() + margin)
    axes.set_ylim(low[:, 1].min() - margin, high[:, 1].max() + margin)
    axes.set_aspect("equal")


def _view(points: Array) -> Array:
    """Return unit vectors across, up and away from the eye, (3, 3): at the broad side."""
    flat = points[:, :2] - points[:, :2].mean(axis=0)
    _, vectors = np.linalg.eigh(flat.T @ flat)
    x, y = vectors[:, 1] * (1 if vectors[0, 1] >= 0 else -1)
    return np.array([[x, y, 0.0], [0.0, 0.0, 1.0], [-y, x, 0.0]])


def _axis(skeleton: Skeleton, a: int, b: int, view: Array) -> tuple[Array, Array, float]:
    """Return a limb's smooth axis in the picture, radii, and distance from the eye."""
    i = np.repeat(np.arange(a, b), SLICES)
    t = np.tile(np.arange(SLICES) / SLICES, b - a)
    points = np.vstack([skeleton.splines.at(i, t), skeleton.points[b]])
    radius = np.append(skeleton.splines.thickness(i, t), skeleton.radius[b])
    return points @ view[:2].T, radius, float((points @ view[2]).mean())
