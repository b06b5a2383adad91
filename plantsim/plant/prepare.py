"""From any skeleton to one that can be meshed: cut, eased, joined, cleared."""

from typing import TYPE_CHECKING, Literal, TypeVar

import numpy as np
from scipy.spatial.transform import Rotation

from plantsim.arrays import Array
from plantsim.errors import GeometryError
from plantsim.plant.bends import EASY, rebuilt, smoothed, worst_bend
from plantsim.plant.collisions import ZONE, without_collisions
from plantsim.plant.hindrances import leaves
from plantsim.plant.prune import STUB, pruned, without

if TYPE_CHECKING:
    from plantsim.plant.skeleton import Skeleton

S = TypeVar("S", bound="Skeleton")
Forks = Literal["model", "area"]
CAP = 0.85  # a child's radius over its parent's where it starts
NARROW = 22.0  # degrees; a limb that leaves at less hugs its parent
SPARE = 1.3  # limbs kept until it is known which of them collide


def prepared(
    skeleton: S,
    min_radius: float,
    max_limbs: int,
    forks: Forks,
    known: int | None = None,
    deeper: str = "",
) -> S:
    """Return what `Skeleton.ready` says.

    `known`: how many limbs there were before some were spared, and `deeper` what else there
    would be, for the note.
    """
    if forks not in ("model", "area"):
        raise GeometryError(f"forks is {forks!r}; give 'model' or 'area'.")
    out, words = skeleton, ""
    trunks = np.flatnonzero(out.carrier < 0)
    if len(trunks) > 1:
        tall = trunks[np.argmax(out.splines.arc[out.last[trunks]])]
        drop = np.zeros(len(out.first), dtype=bool)
        drop[trunks] = True
        drop[tall] = False
        out = without(out, drop)
        words = f"1 of {len(trunks)} trunks kept, the longest, with what it carries"
    out = _begun(out, min_radius)
    out = pruned(out, min_radius, int(SPARE * max_limbs) + 2, None)
    out = rebuilt(out, out.points, out.radius, out.first)
    out = opened(smoothed(out, EASY))
    out = area_conserving(out) if forks == "area" else out
    out = capped(out, min_radius)
    out = _without_stubs(out)
    before = len(out.first)
    out = without_collisions(out, 1, max_limbs)
    clashes = before - len(out.first)
    if len(out.first) > max_limbs:
        out = pruned(out, 0.0, max_limbs, None)
    # else radii have only sunk since bends were eased
    if forks == "area" and (worst_bend(out.splines) >= EASY + 0.1).any():
        out = smoothed(out, EASY)
    total = len(skeleton.first) if known is None else known
    gone = total - len(out.first)
    note = (
        f"{deeper + ' and ' if deeper else ''}{gone} of {total} limbs left out: thinner "
        f"than {1e3 * min_radius:.2g} mm, beyond the {max_limbs} thickest, or short"
        f"{f'; {clashes} for running through others' if clashes else ''}"
    )
    out = out.trusted(
        points=np.round(out.points, 9),  # so that all machines agree
        radius=np.round(out.radius, 10),
        note=skeleton.note,
    )
    return out.with_note(words, note) if gone or deeper else out


def _begun(skeleton: S, least: float) -> S:
    """Return the skeleton with no limb thin at its very start alone, as beads are."""
    first = skeleton.first
    low = skeleton.radius[first] < np.minimum(least, skeleton.radius[first + 1])
    if not low.any():
        return skeleton
    radius = skeleton.radius.copy()
    radius[first[low]] = radius[first[low] + 1]
    return skeleton.trusted(radius=radius)


def opened(skeleton: S, least: float = NARROW) -> S:
    """Return the skeleton with limbs tipped until they leave at `least` degrees or more.

    The angle is between the chords of limb and parent over the reach of their joint. A limb
    moves with all that it carries.
    """
    axes, joints = skeleton.splines, skeleton.joints
    if not len(joints.limb):
        return skeleton
    up = skeleton.carrier[joints.limb]
    foot = axes.at(joints.interval, joints.t)
    thick = axes.thickness(joints.interval, joints.t)
    reach = ZONE * (thick + skeleton.radius[skeleton.first[joints.limb]])
    mine = axes.at(*axes.locate(joints.limb, reach)) - foot
    ahead = np.minimum(joints.arc + reach, axes.arc[axes.last[up]])
    way = axes.at(*axes.locate(up, ahead)) - foot
    tip = ahead - joints.arc < 0.5 * reach  # at the parent's tip: along its last stretch
    way[tip] = axes.velocity(joints.interval, joints.t)[tip]
    axis = np.cross(way, mine)
    sine = np.linalg.norm(axis, axis=1)
    angle = np.degrees(np.arctan2(sine, np.einsum("ij,ij->i", way, mine)))
    tilt = np.zeros(len(skeleton.first))
    tilt[joints.limb] = np.radians(np.maximum(0.0, least - angle))
    turn = np.zeros((len(tilt), 3))
    turn[joints.limb] = axis / np.maximum(sine, 1e-12)[:, None]
    if not (tilt > 1e-9).any():
        return skeleton
    matrix = Rotation.from_rotvec(tilt[:, None] * turn).as_matrix()
    old = skeleton.points[skeleton.first]
    new = old.copy()
    depth = skeleton.depth
    for level in range(1, int(depth.max()) + 1):
        rows = np.flatnonzero(depth == level)
        p = skeleton.carrier[rows]
        new[rows] = new[p] + np.einsum("ijk,ik->ij", matrix[p], old[rows] - old[p])
        matrix[rows] = matrix[p] @ matrix[rows]
    limb = skeleton.limb
    points = new[limb] + np.einsum("ijk,ik->ij", matrix[limb], skeleton.points - old[limb])
    out = skeleton.trusted(points=points)
    out.__dict__["joints"] = joints
    return out


def capped(skeleton: S, least: float = 0.0) -> S:
    """Return the skeleton with no limb above 0.85 of its parent's radius at its start.

    A limb that is too thick is thinned in proportion, but not below `least` [m] unless its
    parent is thinner still.
    """
    radius = skeleton.radius.copy()
    depth, joints = skeleton.depth, skeleton.joints
    slot = np.zeros(len(depth), dtype=int)
    slot[joints.limb] = np.arange(len(joints.limb))
    for level in range(1, int(depth.max()) + 1):
        rows = np.flatnonzero(depth == level)
        i, t = joints.interval[slot[rows]], joints.t[slot[rows]]
        # a bound from below of the monotone radius between two nodes
        thick = np.minimum(radius[i], radius[i + 1])
        thick = np.maximum(thick, (1 - t) * radius[i] + t * radius[i + 1] - 0.1 * thick)
        own = radius[skeleton.first[rows]]
        factor = np.ones(len(depth))
        factor[rows] = np.minimum(1.0, CAP * thick / own)
        limit = np.full(len(depth), np.inf)
        limit[rows] = np.maximum(CAP * thick, 1e-9)
        thin = radius * factor[skeleton.limb]
        floor = np.minimum(np.minimum(least, radius), limit[skeleton.limb])
        radius = np.maximum(thin, floor)
    out = skeleton.trusted(radius=radius)
    out.__dict__["joints"] = joints
    out.__dict__["splines"] = skeleton.splines.with_radius(radius)
    return out


def area_conserving(skeleton: S, power: float = 2.0) -> S:
    """Return the skeleton with radii that add up at every fork, r^p = sum of r_i^p.

    Each limb keeps its tip radius but for one factor for all, by which the trunk keeps its
    foot; between forks the radius is constant but for the last stretch before a tip.
    Source: L. da Vinci's rule (p = 2); K. Shinozaki et al., Jpn. J. Ecol. 14 (1964) 97.
    """
    axes, joints = skeleton.splines, skeleton.joints
    points, radius, first, where = _with_joint_nodes(skeleton)
    out = rebuilt(skeleton, points, radius, first)
    last = np.append(first[1:], len(points)) - 1
    power_at = np.zeros(len(points))  # r^p at each node
    need = np.zeros(len(points))  # r^p that leaves at each node
    slot = np.full(len(first), -1)
    slot[joints.limb] = where
    for i in range(len(first) - 1, -1, -1):  # children come after their parents
        nodes = slice(first[i], last[i] + 1)
        load = need[nodes][::-1].cumsum()[::-1]
        power_at[nodes] = radius[last[i]] ** power + load
        if slot[i] >= 0:
            need[slot[i]] += power_at[first[i]]
    grown = power_at ** (1 / power)
    return out.trusted(radius=grown * (axes.radius[0] / grown[0]))


def _with_joint_nodes(skeleton: "Skeleton") -> tuple[Array, Array, Array, Array]:
    """Return nodes with one at every joint: (points, radius, first, node of each joint)."""
    axes, joints = skeleton.splines, skeleton.joints
    span = axes.arc[joints.interval + 1] - axes.arc[joints.interval]
    arc = axes.arc[joints.interval] + joints.t * span
    up = skeleton.carrier[joints.limb]
    size = axes.arc[axes.last]
    far = float(size.max()) + 1.0
    line = np.concatenate([axes.arc + far * skeleton.limb, arc + far * up])
    order = np.argsort(line, kind="stable")
    rank = np.empty(len(line), dtype=int)
    fresh = np.append(True, np.diff(line[order]) > 1e-4 * size.min())
    rank[order] = np.cumsum(fresh) - 1
    n = len(axes.points)
    _, pick = np.unique(rank, return_index=True)
    limb = np.concatenate([skeleton.limb, up])[pick]
    points = np.vstack([axes.points, axes.at(joints.interval, joints.t)])[pick]
    radius = np.append(axes.radius, axes.thickness(joints.interval, joints.t))[pick]
    return points, radius, np.flatnonzero(np.diff(limb, prepend=-1)), rank[n:]


def _without_stubs(skeleton: S) -> S:
    """Return the skeleton without limbs that hardly leave their parents."""
    joints = skeleton.joints
    reach = skeleton.splines.arc[skeleton.last[joints.limb]]
    thick = skeleton.splines.thickness(joints.interval, joints.t)
    own = skeleton.radius[skeleton.first[joints.limb]]
    drop = np.zeros(len(skeleton.first), dtype=bool)
    drop[joints.limb] = (reach < 1.5 * thick + STUB * own) | ~leaves(skeleton)
    return without(skeleton, drop) if drop.any() else skeleton
