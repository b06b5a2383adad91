"""Other nodes on the same limbs: even spacing, eased bends, children moved along."""

from dataclasses import replace
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from plantsim.arrays import Array
from plantsim.errors import GeometryError
from plantsim.plant.curves import Splines, splines

if TYPE_CHECKING:
    from plantsim.plant.skeleton import Skeleton

S = TypeVar("S", bound="Skeleton")
EASY = 0.8  # radius / bend radius; a tube crosses itself at 1
SAMPLES = np.linspace(0, 1, 6)  # of an interval
ROUNDS = 60


def resampled(skeleton: S, spacing: float) -> S:
    """Return what `Skeleton.resampled` says."""
    if not (np.isfinite(spacing) and spacing > 0):
        raise GeometryError(f"spacing is {spacing} m; give a positive length.")
    axes = skeleton.splines
    i = axes.intervals
    grid = np.repeat(i[:, None], len(SAMPLES), axis=1)
    way = axes.velocity(grid, np.broadcast_to(SAMPLES, grid.shape))
    speed = np.ones(len(axes.points))  # of the smooth axis over its chords
    speed[i] = np.sqrt(np.einsum("ijk,ijk->ij", way, way)).max(axis=1)
    length = axes.arc[axes.last] * np.maximum.reduceat(speed, axes.first)
    counts = np.maximum(1, np.ceil(length / spacing - 1e-9)).astype(int)
    points, radius, first = _even(skeleton.splines, counts)
    return rebuilt(skeleton, points, radius, first)


def _even(axes: Splines, counts: Array) -> tuple[Array, Array, Array]:
    """Return nodes, radii and first nodes of limbs cut into `counts` even parts."""
    size = counts + 1
    first = np.cumsum(size) - size
    limb = np.repeat(np.arange(len(size)), size)
    part = np.arange(len(limb)) - first[limb]
    arc = axes.arc[axes.last][limb] * part / counts[limb]
    i, t = axes.locate(limb, arc)
    return axes.at(i, t), axes.thickness(i, t), first


def worst_bend(axes: Splines) -> Array:
    """Return the largest radius / bend radius of each limb, (limbs,)."""
    i = axes.intervals
    bend = np.zeros(len(axes.points))
    t = np.empty(len(i))
    for sample in SAMPLES:
        t[:] = sample
        here = axes.curvature(i, t) * axes.thickness(i, t)
        bend[i] = np.maximum(bend[i], here)
    return np.maximum.reduceat(bend, axes.first)


def smoothed(skeleton: S, limit: float) -> S:
    """Return what `Skeleton.smoothed` says."""
    if not limit > 0:
        raise GeometryError(f"limit is {limit}; give more than 0, at most 0.95.")
    tight = worst_bend(skeleton.splines) >= limit
    if not tight.any():
        return skeleton
    points, radius, first, sizes = _eased(skeleton, np.flatnonzero(tight), limit)
    # the eased limbs go back among the others
    limbs = np.split(skeleton.points, skeleton.first[1:])
    radii = np.split(skeleton.radius, skeleton.first[1:])
    for k, i in enumerate(np.flatnonzero(tight)):
        limbs[i] = points[first[k] : first[k] + sizes[k]]
        radii[i] = radius[first[k] : first[k] + sizes[k]]
    size = np.array([len(p) for p in limbs])
    return rebuilt(
        skeleton, np.concatenate(limbs), np.concatenate(radii), np.cumsum(size) - size
    )


def _eased(
    skeleton: "Skeleton", tight: Array, limit: float
) -> tuple[Array, Array, Array, Array]:
    """Return (points, radius, first, size) of the tight limbs, relaxed."""
    keep = np.isin(skeleton.limb, tight)
    own = skeleton.limb[keep]
    start = np.flatnonzero(np.diff(own, prepend=-1))
    axes = splines(skeleton.points[keep], skeleton.radius[keep], start)
    thick = np.maximum.reduceat(axes.radius, axes.first)
    length = axes.arc[axes.last]
    counts = np.clip(np.ceil(length / (1.5 * thick)), 4, 32).astype(int)
    points, radius, first = _even(axes, counts)
    ends = np.zeros(len(points), dtype=bool)
    ends[first] = ends[first + counts] = True
    limb = np.repeat(np.arange(len(counts)), counts + 1)
    for k in range(ROUNDS):
        todo = worst_bend(splines(points, radius, first)) >= limit
        if not todo.any():
            break
        move = todo[limb] & ~ends
        i = np.flatnonzero(move)
        if k < ROUNDS - 1:
            middle = (points[i - 1] + points[i + 1]) / 2
            points[i] += 0.7 * (middle - points[i])
        else:  # it does not unbend: lay it straight
            part = (i - first[limb[i]]) / counts[limb[i]]
            a, b = points[first[limb[i]]], points[first[limb[i]] + counts[limb[i]]]
            points[i] = a + part[:, None] * (b - a)
    return points, radius, first, counts + 1


def rebuilt(skeleton: S, points: Array, radius: Array, first: Array) -> S:
    """Return the skeleton with other nodes for its limbs, children put back on the axes.

    A child starts at the point of its parent's new axis that is nearest to where it
    started; it moves there with all that it carries.
    """
    same = points is skeleton.points and radius is skeleton.radius
    axes = skeleton.splines if same else splines(points, radius, first)
    size = axes.last - axes.first + 1
    limb = np.repeat(np.arange(len(size)), size)
    joints = skeleton.joints
    up = skeleton.carrier[joints.limb]
    old, new = skeleton.splines, axes
    guess = joints.arc * new.arc[new.last[up]] / old.arc[old.last[up]]
    arc, interval, t, _ = new.nearest(up, guess, points[first[joints.limb]])
    shift = np.zeros((len(size), 3))
    shift[joints.limb] = new.at(interval, t) - points[first[joints.limb]]
    depth = skeleton.depth
    for level in range(1, int(depth.max()) + 1):
        rows = np.flatnonzero(depth == level)
        shift[rows] += shift[skeleton.carrier[rows]]
    parent = np.arange(len(points)) - 1
    parent[first] = -1
    # within rounding of the next node, that node is the one at or before
    parent[first[joints.limb]] = interval + (t > 1 - 1e-9)
    moved = points + shift[limb]
    out = skeleton.trusted(points=moved, radius=radius, parent=parent, limb=limb)
    # known already: a shift changes neither lengths nor bends
    out.__dict__["splines"] = replace(axes, points=moved)
    out.__dict__["joints"] = joints._replace(
        arc=arc, interval=interval, t=t, distance=np.zeros(len(arc))
    )
    return out
