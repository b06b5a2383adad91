"""Surfaces whose triangles are all Delaunay: what fills them keeps them without a search.

A triangle is Delaunay where some ball has its corners on the round and no point inside. If
all are, each is a face of the Delaunay tetrahedralization of the points (so no two cross),
and a filler need not recover any: that takes HXT most of its time, however few are lost.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import KDTree

from plantsim.arrays import Array

TURNS = 12
FLAT = 0.5  # least cosine between the normals of triangles that are flipped
PLANE = 0.999  # least cosine of those that are taken for a plane, flipped as there
EVEN = 1e-9  # share of the radius by which a point may be inside a ball
BALLS = 12  # tried for a triangle
FAR = 100  # radii of the circumcircle: centres no farther are tried
SIDES = np.array([[0, 1], [1, 2], [2, 0]])


def conforming(points: Array, faces: Array, flat: Array) -> tuple[Array, Array] | None:
    """Return triangles that are all Delaunay, and the ends (k, 2) of the edges split.

    Few of a good surface are not: their edges are flipped where that helps and they are
    nearly in one plane, or else split. The middle of split i is point len(points) + i, and
    may be an end of a later one. `points` (n, 3), `faces` (m, 3), of a closed surface; the
    rims of what is all `flat` (n,) stay. Returns None where TURNS do not do, as where limbs
    leave no room between.
    """
    ends = np.zeros((0, 2), dtype=np.int64)
    balls = np.full((len(faces), 4), np.nan)
    for turn in range(TURNS):
        tree, count = KDTree(points), len(points)
        look = np.flatnonzero(np.isnan(balls[:, 3]))
        balls[look] = empty_balls(points, faces[look], tree)
        bad = look[np.isnan(balls[look, 3])]
        if not len(bad):
            return faces, ends
        faces, done, cut = _changed(points, faces, flat, bad, tree, split=turn > 0)
        points = with_middles(points, cut)
        flat = np.concatenate([flat, flat[cut].all(axis=1)])
        ends = np.concatenate([ends, cut])
        balls = np.concatenate([balls, np.full((len(faces) - len(balls), 4), np.nan)])
        balls[: len(done)][done] = np.nan
        if len(cut):  # in which balls are the new points?
            known = np.flatnonzero(~np.isnan(balls[:, 3]))
            far = np.asarray(KDTree(points[count:]).query(balls[known, :3])[0])
            balls[known[far < (1 - EVEN) * balls[known, 3]]] = np.nan
    return None


def with_middles(points: Array, ends: Array) -> Array:
    """Return points with the middles of edges (k, 2), of which each may end a later one."""
    out = np.concatenate([points, np.empty((len(ends), 3))])
    for i, pair in enumerate(ends, len(points)):
        out[i] = out[pair].mean(axis=0)
    return out


def empty_balls(points: Array, faces: Array, tree: KDTree) -> Array:
    """Return centres and radii (m, 4) of empty balls about triangles (m, 3), NaN for none.

    The balls of a triangle have their centres on a line, h from its circumcentre. A point
    that is inside one bounds h from one side, and a ball is tried between the bounds.
    `tree` holds the points.
    """
    a, b, c = points[faces].transpose(1, 0, 2)
    u, v = b - a, c - a
    n = np.cross(u, v)
    uu, vv, nn = ((x**2).sum(axis=1)[:, None] for x in (u, v, n))
    with np.errstate(divide="ignore", invalid="ignore"):  # three in a line have no ball
        away = (np.cross(n, u) * vv + np.cross(v, n) * uu) / (2 * nn)
        centre, n, r = a + away, n / np.sqrt(nn), np.linalg.norm(away, axis=1)
    h, low, high = np.zeros(len(r)), -FAR * r, FAR * r
    live, out = np.flatnonzero(np.isfinite(r)), np.full((len(r), 4), np.nan)
    for _ in range(BALLS):
        x, radius = centre[live] + h[live, None] * n[live], np.hypot(r[live], h[live])
        far, near = map(np.asarray, tree.query(x))
        inside = far < (1 - EVEN) * radius
        out[live[~inside]] = np.c_[x, radius][~inside]
        live = live[inside]
        if not len(live):
            break
        off = points[near[inside]] - centre[live]
        up = (off * n[live]).sum(axis=1)
        bound = np.full(len(up), -np.inf)  # of a point in the plane: it is in every ball
        np.divide((off**2).sum(axis=1) - r[live] ** 2, 2 * up, out=bound, where=up != 0)
        above = up >= 0
        high[live[above]] = np.minimum(high[live[above]], bound[above])
        low[live[~above]] = np.maximum(low[live[~above]], bound[~above])
        live = live[high[live] - low[live] > EVEN * r[live]]
        # halfway, or where one side is open a step to there
        one, other, step = low[live], high[live], 0.05 * r[live]
        h[live] = np.where(
            one == -FAR * r[live],
            other - step - 0.1 * np.abs(other),
            np.where(
                other == FAR * r[live],
                one + step + 0.1 * np.abs(one),
                (one + other) / 2,
            ),
        )
    return out


def _about(faces: Array, some: Array, n: int) -> Array:
    """Return the ids of the triangles two rings about some others (k, 3)."""
    hit = np.zeros(n, dtype=bool)
    hit[some] = True
    hit[faces[hit[faces].any(axis=1)]] = True
    return np.flatnonzero(hit[faces].any(axis=1))


@dataclass(frozen=True)
class _Edges:
    """Edges from a to b of two triangles, whose third corners are c and d."""

    sides: Array  # (k, 2) ids of the triangles
    corners: Array  # (4, k): a, b, c and d
    now: Array  # (2, k, 3) the triangles
    flipped: Array  # (2, k, 3) what they are with an edge from c to d
    open: Array  # (k,) no edge is there from c to d, nor of another flip

    @classmethod
    def of(cls, faces: Array, lost: Array, near: Array, n: int) -> "_Edges":
        """Return those of the triangles in the mask `lost`; `near`: ids of all about."""
        ends = np.sort(faces[near][:, SIDES], axis=2).reshape(-1, 2)
        key = ends @ [n, 1]
        order = np.argsort(key, kind="stable")
        same = np.flatnonzero(key[order][1:] == key[order][:-1])
        places = (3 * near[:, None] + np.arange(3)).ravel()
        pairs = places[np.stack([order[same], order[same + 1]], axis=1)]
        pairs = pairs[lost[pairs // 3].any(axis=1)]
        sides, at = pairs // 3, pairs % 3
        a, b, c = (faces[sides[:, 0], (at[:, 0] + k) % 3] for k in range(3))
        d = faces[sides[:, 1], (at[:, 1] + 2) % 3]
        now, flipped = (
            np.array(two).transpose(0, 2, 1)
            for two in (((a, b, c), (b, a, d)), ((c, a, d), (d, b, c)))
        )
        made = np.minimum(c, d) * n + np.maximum(c, d)
        once = np.isin(np.arange(len(made)), np.unique(made, return_index=True)[1])
        return cls(sides, np.array([a, b, c, d]), now, flipped, once & ~np.isin(made, key))


def _changed(
    points: Array, faces: Array, flat: Array, bad: Array, tree: KDTree, split: bool
) -> tuple[Array, Array, Array]:
    """Return triangles with edges of some (ids) flipped or split; a mask; ends of splits.

    The mask is of the triangles that were there and are others now, each changed once. An
    edge is flipped where both triangles are Delaunay then, or, in a plane, by their angles;
    with `split` others are split of which both triangles are not Delaunay, or else a
    triangle's longest.
    """
    n = len(points)
    lost = np.zeros(len(faces), dtype=bool)
    lost[bad] = True
    edges = _Edges.of(faces, lost, _about(faces, faces[bad], n), n)
    sides, (a, b, c, d) = edges.sides, edges.corners
    way = np.concatenate([_normals(points, edges.now), _normals(points, edges.flipped)])
    level: Any = np.min([(v * w).sum(axis=1) for v in way for w in way], axis=0)
    rim: Any = flat[edges.now].all(axis=2)
    able = (level > FLAT) & (rim[0] == rim[1]) & edges.open
    helps = able & (level > PLANE) & (_opposite(points, edges.corners) > np.pi + EVEN)
    rest = able & ~helps
    for some in edges.flipped:
        rest[rest] = ~np.isnan(empty_balls(points, some[rest], tree)[:, 3])
    helps |= rest
    both: Any = lost[sides].all(axis=1)
    cuts = (both | ~np.isin(sides, sides[both]).any(axis=1)) & split
    if helps.any():  # in a plane flips do in the end
        cuts &= (way[0] * way[1]).sum(axis=1) < PLANE
    length = np.linalg.norm(points[a] - points[b], axis=1)
    faces, done = faces.copy(), np.zeros(len(faces), dtype=bool)
    new, cut = [], []
    for e in np.lexsort((-length, ~both, ~helps)):  # flips first, each kind by length
        if done[sides[e]].any() or not (helps[e] or cuts[e]):
            continue
        done[sides[e]] = True
        if helps[e]:
            faces[sides[e]] = edges.flipped[:, e]
        else:
            middle = n + len(cut)
            cut.append((a[e], b[e]))
            faces[sides[e]] = (a[e], middle, c[e]), (b[e], middle, d[e])
            new += [(middle, b[e], c[e]), (middle, a[e], d[e])]
    added = np.array(new, dtype=faces.dtype).reshape(-1, 3)
    ends = np.array(cut, dtype=np.int64).reshape(-1, 2)
    return np.concatenate([faces, added]), done, ends


def _opposite(points: Array, corners: Array) -> Array:
    """Return the sums of the angles [rad] at c and d that see edges from a to b."""
    x, y, *others = points[corners]
    out = np.zeros(len(x))
    for z in others:
        n = np.linalg.norm(np.cross(x - z, y - z), axis=1)
        out += np.arctan2(n, ((x - z) * (y - z)).sum(axis=1))
    return out


def _normals(points: Array, faces: Array) -> Array:
    """Return the unit normals of triangles (..., 3)."""
    a, b, c = np.moveaxis(points[faces], -2, 0)
    n = np.cross(b - a, c - a)
    return n / np.maximum(np.linalg.norm(n, axis=-1), 1e-300)[..., None]
