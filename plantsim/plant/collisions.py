"""Limbs that pass through others: found by sweeping over capsules, turned or dropped.

Every axis is cut into short straight pieces; a piece and its radius are a capsule. Only
pieces whose boxes meet are compared.
Source of the segment distance: C. Ericson, Real-Time Collision Detection (2005), 5.1.9.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from plantsim.arrays import Array, repeated
from plantsim.plant.prune import without

if TYPE_CHECKING:
    from plantsim.plant.skeleton import Skeleton

S = TypeVar("S", bound="Skeleton")
CLEAR = 1.1  # wanted distance over the sum of radii
ZONE = 4.0  # sums of radii along a limb in which it may still touch its parent: 15 degrees
GOLDEN = np.radians(137.507764)  # turns that never repeat


@dataclass(frozen=True, eq=False)
class Capsules:
    """Pieces of all axes, k of them."""

    a: Array  # (k, 3) [m]
    b: Array  # (k, 3) [m]
    radius: Array  # (k,) the larger of its two ends [m]
    limb: Array  # (k,)
    arc: Array  # (k,) of the middle, along the limb [m]


def capsules(skeleton: "Skeleton", zone: Array) -> Capsules:
    """Return the pieces: short up to `zone` [m], elsewhere as straight as need be."""
    axes = skeleton.splines
    i = axes.intervals
    limb = skeleton.limb[i]
    h = axes.arc[i + 1] - axes.arc[i]
    thick = np.minimum(axes.radius[i], axes.radius[i + 1])
    bend = np.sqrt(np.maximum((axes.bend[i] ** 2).sum(-1), (axes.bend[i + 1] ** 2).sum(-1)))
    sag = np.sqrt(bend * h * h / (8 * 0.2 * thick))
    fine = np.where(axes.arc[i] < zone[limb], h / (3 * thick), 1.0)
    parts = np.clip(np.ceil(np.maximum(sag, fine)), 1, 12).astype(int)
    cell, k = repeated(parts)
    cell = i[cell]
    n = np.repeat(parts, parts)
    a, thick = axes.at(cell, k / n), axes.thickness(cell, k / n)
    # a piece ends where the next begins, the last of an interval at its node
    b, after = np.roll(a, -1, axis=0), np.roll(thick, -1)
    end = np.cumsum(parts) - 1
    b[end], after[end] = axes.points[i + 1], axes.radius[i + 1]
    return Capsules(
        a,
        b,
        np.maximum(thick, after),
        skeleton.limb[cell],
        axes.arc[cell] + (k + 0.5) / n * np.repeat(h, parts),
    )


def colliding(
    skeleton: "Skeleton", clear: float = CLEAR, only: Array | None = None
) -> Array:
    """Return pairs of limbs (k, 2), the smaller index first, that are too near.

    A limb may touch its parent, and its siblings at about the same place, until it is out
    of the joint. A pair (i, i) is a limb that comes back to itself. `only`: a mask of limbs
    of which at least one must be in a pair.
    """
    carrier, foot = skeleton.carrier, skeleton.points[skeleton.first]
    own, thick = skeleton.radius[skeleton.first], np.zeros(len(foot))
    joints = skeleton.joints
    thick[joints.limb] = skeleton.splines.thickness(joints.interval, joints.t)
    zone = ZONE * (own + thick)  # of each limb, from its foot
    c = capsules(skeleton, zone)
    i, j = _near(c, clear, None if only is None else only[c.limb])
    gap = segment_distance(c.a[i], c.b[i], c.a[j], c.b[j])
    hit = gap < clear * (c.radius[i] + c.radius[j])
    i, j = i[hit], j[hit]
    p, q = c.limb[i], c.limb[j]
    last = np.zeros(len(c.limb), dtype=bool)
    last[np.append(np.flatnonzero(np.diff(c.limb)), len(c.limb) - 1)] = True

    bad = np.ones(len(i), dtype=bool)
    same = p == q
    bad[same] = (np.abs(c.arc[i] - c.arc[j]) > 4 * (c.radius[i] + c.radius[j]))[same]
    for child, parent, piece in ((p, q, i), (q, p, j)):
        kin = carrier[child] == parent
        leaving = (c.arc[piece] < zone[child]) & ~last[piece]
        bad[kin] = ~leaving[kin]
    kin = (carrier[p] == carrier[q]) & (carrier[p] >= 0) & ~same
    # siblings: the crotch between them is one body as far as it reaches
    near = np.linalg.norm(foot[p] - foot[q], axis=1) < np.maximum(thick[p], thick[q])
    crotch = 1.5 * thick + 2.5 * own
    inside = (c.arc[i] < crotch[p]) & (c.arc[j] < crotch[q])
    bad[kin] = ~(near & inside)[kin]
    pairs = np.sort(np.stack([p[bad], q[bad]], axis=1), axis=1)
    return np.unique(pairs, axis=0) if len(pairs) else np.zeros((0, 2), dtype=int)


def _near(c: Capsules, clear: float, only: Array | None) -> tuple[Array, Array]:
    """Return pairs of capsules whose boxes and bounding balls meet.

    By sweep and prune: boxes are sorted along the longest axis within the cells of a grid
    over the other two; a pair counts in the first cell that both stand in.
    """
    pad = (clear * c.radius)[:, None]
    low, high = np.minimum(c.a, c.b) - pad, np.maximum(c.a, c.b) + pad
    low, high = low - low.min(axis=0), high - low.min(axis=0)
    size = (high - low).mean(axis=0)
    z, y, x = np.argsort(low.max(axis=0) / size)
    wide = np.maximum(4 * size, high.max(axis=0) / 100)
    begin, end = np.floor(low / wide).astype(int), np.floor(high / wide).astype(int)
    rows = end[:, z] - begin[:, z] + 1
    each = (end[:, y] - begin[:, y] + 1) * rows
    box, k = repeated(each)
    cell_y, cell_z = begin[box, y] + k // rows[box], begin[box, z] + k % rows[box]
    line = 2 * high[:, x].max() * (cell_y * (end[:, z].max() + 1) + cell_z)
    left, right = line + low[box, x], line + high[box, x]
    order = np.argsort(left)
    box, cell_y, cell_z = box[order], cell_y[order], cell_z[order]
    until = np.searchsorted(left[order], right[order], side="right")
    one, k = repeated(until - np.arange(len(box)) - 1)
    two = one + 1 + k
    for axis, cell in ((y, cell_y), (z, cell_z)):
        down, up, here = low[box, axis], high[box, axis], begin[box, axis]
        meet = (down[one] <= up[two]) & (down[two] <= up[one])
        one, two = one[meet], two[meet]
        meet = cell[one] == np.maximum(here[one], here[two])
        one, two = one[meet], two[meet]
    i, j = box[one], box[two]
    # neighbours on one limb always touch
    meet = (c.limb[i] != c.limb[j]) | (np.abs(i - j) > 2)
    if only is not None:
        meet &= only[i] | only[j]
    i, j = i[meet], j[meet]
    centre = (c.a + c.b) / 2
    ball = np.linalg.norm(c.b - c.a, axis=1) / 2 + pad[:, 0]
    d = centre[i] - centre[j]
    meet = np.einsum("ij,ij->i", d, d) < (ball[i] + ball[j]) ** 2
    return i[meet], j[meet]


def segment_distance(a: Array, b: Array, c: Array, d: Array) -> Array:
    """Return distances between the segments a-b and c-d, each (k, 3).

    >>> x = np.eye(3)[None]
    >>> float(segment_distance(x[:, 0], -x[:, 0], x[:, 2], x[:, 2] + x[:, 1])[0])
    1.0
    """
    u, v, w = b - a, d - c, a - c

    def dot(x: Array, y: Array) -> Array:
        return np.einsum("ij,ij->i", x, y)

    uu, vv, uv, uw, vw = dot(u, u), dot(v, v), dot(u, v), dot(u, w), dot(v, w)
    cross = uu * vv - uv * uv
    flat = cross <= 1e-12 * uu * vv
    s = np.where(flat, 0.5, np.clip((uv * vw - vv * uw) / np.where(flat, 1, cross), 0, 1))
    t = np.clip((uv * s + vw) / vv, 0, 1)
    s = np.clip((uv * t - uw) / uu, 0, 1)
    t = np.clip((uv * s + vw) / vv, 0, 1)
    gap = w + s[:, None] * u - t[:, None] * v
    return np.sqrt(dot(gap, gap))


def without_collisions(skeleton: S, tries: int, enough: int | None = None) -> S:
    """Return what `Skeleton.without_collisions` says.

    `enough`: so many limbs are wanted that, if as many are left, none needs to be turned.
    """
    turned, moved = skeleton, None
    for attempt in range(tries + 1):
        pairs = colliding(turned, only=moved)
        if not len(pairs):
            break
        victims = _victims(turned, pairs)
        if enough is not None and attempt < tries:
            left = without(turned, victims)
            if len(left.first) >= enough:
                turned = left
                break
        if attempt < tries:
            turned, moved = _rolled(turned, victims, GOLDEN)
        else:
            turned = without(turned, victims)  # of every pair one: none is left
    gone = len(skeleton.first) - len(turned.first)
    return turned.with_note(f"{gone} that ran through others dropped") if gone else turned


def _victims(skeleton: "Skeleton", pairs: Array) -> Array:
    """Return a mask of limbs without which no pair collides, few and light ones.

    A limb that runs along what carries it must go. Of the others goes, one after the other,
    the one that settles most pairs for the limbs that go with it, the thinnest of equals.
    """
    base = skeleton.radius[skeleton.first].tolist()
    carrier = skeleton.carrier.tolist()
    cost = [1] * len(base)  # limbs that go when one goes
    for i in range(len(base) - 1, 0, -1):
        if carrier[i] >= 0:
            cost[carrier[i]] += cost[i]
    out = np.zeros(len(base), dtype=bool)

    def below(i: int, j: int) -> bool:  # whether j carries i, at any remove
        while i >= 0 and i != j:
            i = carrier[i]
        return i == j

    def gone(i: int) -> bool:
        while i >= 0 and not out[i]:
            i = carrier[i]
        return i >= 0

    open_ = []
    for i, j in pairs.tolist():
        if below(i, j):
            out[i] = True
        elif below(j, i):
            out[j] = True
        else:
            open_.append((i, j))
    while open_ := [(i, j) for i, j in open_ if not (gone(i) or gone(j))]:
        hits: dict[int, int] = {}
        for pair in open_:
            for i in pair:
                hits[i] = hits.get(i, 0) + 1
        out[max(hits, key=lambda i: (hits[i] / cost[i], -base[i], i))] = True
    if out[0]:  # a trunk that meets itself cannot be dropped
        out[0] = False
    return out


def _rolled(skeleton: S, limbs: Array, angle: float) -> tuple[S, Array]:
    """Turn limbs about their parents' axes at their feet; (skeleton, limbs that moved)."""
    top = np.full(len(limbs), -1)  # the limb with which each one turns
    for i, p in enumerate(skeleton.carrier.tolist()):
        above = top[p] if p >= 0 else -1
        top[i] = above if above >= 0 else (i if limbs[i] and p >= 0 else -1)
    joints = skeleton.joints
    axis = np.zeros((len(limbs), 3))
    way = skeleton.splines.velocity(joints.interval, joints.t)
    axis[joints.limb] = way / np.linalg.norm(way, axis=1, keepdims=True)
    node = top[skeleton.limb]
    move = np.flatnonzero(node >= 0)
    k, foot = axis[node[move]], skeleton.points[skeleton.first[node[move]]]
    v = skeleton.points[move] - foot
    c, s = np.cos(angle), np.sin(angle)
    along = np.einsum("ij,ij->i", k, v)[:, None]
    points = skeleton.points.copy()
    points[move] = foot + c * v + s * np.cross(k, v) + (1 - c) * along * k
    out = skeleton.trusted(points=points)
    out.__dict__["joints"] = joints  # a turn about its parent's axis moves no foot
    return out, top >= 0
