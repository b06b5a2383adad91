"""Raw mesh to sound mesh: slivers repaired, surfaces curved, limbs labelled."""

import itertools
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial import KDTree

from plantsim.arrays import Array
from plantsim.mesh.tetmesh import (
    FACES,
    INNER,
    boundary,
    gamma,
    jacobians,
)
from plantsim.solid.sweep import Solid, Tube

ON = 0.05  # radii by which the ends of an edge on a limb's surface differ at most
TURNS, TANGENTIAL = 25, 10  # of repair, in all and keeping to the tangent planes


def repair(
    points: Array,
    tets: Array,
    held: Array,
    *,
    below: float = 0.10,
    target: float = 0.12,
    seed: int = 0,
) -> tuple[Array, int, int]:
    """Return corners with slivers mended, the number of slivers before, and after.

    Each corner of a tet whose gamma is under `below` is moved in turn to the best of some
    random steps, where that raises the worst gamma of the tets about it. Steps shrink from
    0.35 of the local edge; the long ones of a corner on the surface keep to its tangent
    plane, so that limbs keep their thickness. `tets` (m, 4); vertices in the mask `held`
    (n,) stay.
    """
    rng = np.random.default_rng(seed)
    points = points.copy()
    bad = np.flatnonzero(gamma(points[tets]) < below)
    before = len(bad)
    if not before:
        return points, 0, 0
    order = np.argsort(tets.ravel(), kind="stable")
    start = np.searchsorted(tets.ravel()[order], np.arange(len(points) + 1))
    normal = _normals(points, boundary(tets))
    for turn in range(TURNS):
        amplitude = 0.35 * 0.85**turn
        if turn == TANGENTIAL:
            normal[:] = 0
        for tet in bad:
            for v in tets[tet][~held[tets[tet]]]:
                star = order[start[v] : start[v + 1]] // 4
                _move(points, tets[star], v, amplitude, normal[v], rng)
        bad = bad[gamma(points[tets[bad]]) < target]
        if turn % 5 == 4 or not len(bad):
            bad = np.flatnonzero(gamma(points[tets]) < below)
        if not len(bad):
            break
    return points, before, int((gamma(points[tets]) < below).sum())


def _normals(points: Array, faces: Array) -> Array:
    """Return unit normals (n, 3) at the corners of triangles, zero at other points."""
    a, b, c = points[faces[:, :3]].transpose(1, 0, 2)
    total = np.zeros_like(points)
    for corner in faces[:, :3].T:
        np.add.at(total, corner, np.cross(b - a, c - a))
    return total / np.maximum(np.linalg.norm(total, axis=1), 1e-300)[:, None]


def _move(
    points: Array,
    star: Array,
    v: int,
    amplitude: float,
    normal: Array,
    rng: np.random.Generator,
) -> None:
    """Move vertex v to the best of 48 random places if the worst tet of its star gains."""
    x = points[star]
    mine = star == v
    edges = np.sort(np.linalg.norm(x - points[v], axis=2)[~mine])
    edge = (edges[(len(edges) - 1) // 2] + edges[len(edges) // 2]) / 2  # their median
    step = rng.normal(size=(48, 3)) * (
        amplitude * edge * rng.uniform(0.1, 1, (48, 1)) / 1.7
    )
    step -= (step @ normal)[:, None] * normal
    trial = np.repeat(x[None], 49, axis=0)  # the last stays as it is
    trial[:48, mine] = points[v] + step[:, None]
    worst = gamma(trial).min(axis=1)
    best = int(worst.argmax())
    if worst[best] > worst[48]:
        points[v] += step[best]


def curve(
    points: Array, tets: Array, solid: Solid, places: Array, owner: Array | None = None
) -> tuple[Array, int]:
    """Return points with the surface's middles on the tubes, and the tets held back.

    Tets (m, 10) with straight edges. An edge of the surface whose ends are on one limb has
    its middle moved radially to the mean of its ends' distances from the axis, in radii;
    edges within a flat end stay. Where a tet would fold, the middles of its edges go back
    by halves. `places`: `boundary_places` of the tets; `owner`: the limb of each corner
    where it is known, else -1.
    """
    surface = boundary(tets, places)
    on = np.zeros(len(points), dtype=bool)
    on[surface[:, :3]] = True
    corners = np.flatnonzero(on)
    faces, mids = (np.cumsum(on) - 1)[surface[:, :3]], surface[:, 3:]
    side = ~flat_ends(solid, points[corners])[faces].all(axis=1)
    ends = faces[side][:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    middle, where = np.unique(mids[side], return_index=True)
    ends = ends[where]
    limb = np.full(len(corners), -1)
    ratio = np.empty(len(corners))
    if owner is not None:
        limb[corners < len(owner)] = owner[corners[corners < len(owner)]]
    known = limb >= 0
    ratio[known] = on_axis(solid, points[corners[known]], limb[known])[1]
    limb[~known], ratio[~known], _, _ = on_axis(solid, points[corners[~known]])
    limb, wanted = _limb_of_edges(solid, points[corners], ends, limb, ratio)
    known = limb >= 0
    middle, ends, limb, wanted = (part[known] for part in (middle, ends, limb, wanted))
    _, now, foot, _ = on_axis(solid, points[middle], limb)
    stretch = wanted / now
    target = points.copy()
    target[middle] = foot + (points[middle] - foot) * stretch[:, None]
    # the rim of a level foot stays level
    rim = middle[on_foot(solid, points[corners])[ends].all(axis=1)]
    centre, normal = solid.foot
    way = solid.tubes[0].tangent(0.0)
    target[rim] -= ((target[rim] - centre) @ normal / (way @ normal))[:, None] * way
    return _unfold(target, points, tets)


def _limb_of_edges(
    solid: Solid, points: Array, ends: Array, limb: Array, ratio: Array
) -> tuple[Array, Array]:
    """Return the limb that each edge (k, 2) is on, or -1, and its ends' mean ratio there.

    `limb`, `ratio`: of points; at a joint, where two limbs are as near, they say either.
    So an edge between two limbs is on the one that both its ends are on; if that is so of
    both, on the thinner, from whose round it is farther.
    """
    out = limb[ends[:, 0]].copy()
    mean = ratio[ends].mean(axis=1)
    mixed = np.flatnonzero(out != limb[ends[:, 1]])
    out[mixed] = -1
    thinnest = np.full(len(mixed), np.inf)
    for one, other in ((0, 1), (1, 0)):
        a, b = ends[mixed, one], ends[mixed, other]
        _, there, _, radius = on_axis(solid, points[b], limb[a])
        fits = (np.abs(there - ratio[a]) < ON) & (radius < thinnest)
        out[mixed[fits]] = limb[a[fits]]
        mean[mixed[fits]] = ((there + ratio[a]) / 2)[fits]
        thinnest[fits] = radius[fits]
    return out, mean


def _unfold(target: Array, straight: Array, tets: Array) -> tuple[Array, int]:
    """Return target with middles drawn back where a tet would fold, and how many.

    While a tet's smallest det J near its nodes is under 2 % of the mean, its middles go
    half the way back to their straight places, and all the way after five times.
    """
    points = target.copy()
    about = np.flatnonzero((target != straight).any(axis=1)[tets].any(axis=1))
    tets = tets[about]
    turns = np.zeros(len(tets), dtype=int)
    while True:
        J = jacobians(points, tets, INNER)
        folds = (J.min(axis=1, initial=np.inf) < 0.02 * np.abs(J).mean(axis=1)) & (
            turns < 6
        )
        if not folds.any():
            return points, int((turns > 0).sum())
        turns[folds] += 1
        keep = np.where(turns[folds] < 6, 0.5, 0.0)[:, None, None]
        nodes = tets[folds, 4:]
        points[nodes] = straight[nodes] + keep * (points[nodes] - straight[nodes])


def on_disc(tube: Tube, u: float, points: Array) -> Array:
    """Mask the points (..., 3) on the flat disc across the axis at u."""
    r = float(tube.radius(u))
    off = points - tube.axis(u)
    # a ring may stand out by a tenth and more, to make up for its polygon
    return (np.abs(off @ tube.tangent(u)) < 1e-6 * r) & (
        np.linalg.norm(off, axis=-1) < 1.3 * r
    )


def on_foot(solid: Solid, points: Array) -> Array:
    """Mask the points (n, 3) on the foot."""
    centre, normal = solid.foot
    trunk = solid.tubes[0]
    r = float(trunk.radius(0.0))
    off = points - centre
    reach = 1.3 * r / abs(normal @ trunk.tangent(0.0))
    return (np.abs(off @ normal) < 1e-6 * r) & (np.linalg.norm(off, axis=-1) < reach)


def flat_ends(solid: Solid, points: Array) -> Array:
    """Mask the points (n, 3) on the foot and on flat tips."""
    flat = on_foot(solid, points)
    for tube in solid.tubes:
        if not tube.round_tip:
            flat |= on_disc(tube, 1.0, points)
    return flat


def limb_sets(
    solid: Solid, points: Array, tets: Array, region: Array, places: Array
) -> dict[str, Array]:
    """Return the sets "base", "tips" and, for every limb, its surface: "limb NAME".

    `places`: `boundary_places` of the tets.

    "tips": the flat ends of limbs cut flat, the rounded caps of others; limbs that carry
    another at their tip have none.
    """
    faces, behind = boundary(tets, places), region[places // len(FACES)]
    of_surface = np.zeros(len(points), dtype=bool)
    of_surface[faces] = True
    outer = np.flatnonzero(of_surface)
    tips = np.zeros(len(outer), dtype=bool)
    carries = {t.parent for t in solid.tubes if t.joint > 1 - 1e-6}
    ends = [t for i, t in enumerate(solid.tubes) if i not in carries]
    centre = np.array([t.axis(1.0) for t in ends])
    r = np.array([float(t.radius(1.0)) for t in ends])
    near = KDTree(points[outer]).query_ball_point(centre, 1.3 * r)
    for tube, at, size, mine in zip(ends, centre, r, near, strict=True):
        off = points[outer[mine]] - at
        tips[mine] |= off @ tube.tangent(1.0) > -1e-6 * size
    sets = {"base": np.flatnonzero(on_foot(solid, points)), "tips": outer[tips]}
    at = np.repeat(behind, faces.shape[1]), faces.ravel()
    once = csr_array((np.ones(faces.size), at), shape=(len(solid.tubes), len(points)))
    for tube, mine in zip(
        solid.tubes, np.split(once.indices, once.indptr[1:-1]), strict=True
    ):
        sets[f"limb {tube.name}"] = mine
    return sets


def on_axis(
    solid: Solid, x: Array, limb: Array | None = None
) -> tuple[Array, Array, Array, Array]:
    """Return limb, distance from its axis in radii, nearest axis point and radius there.

    For points (k, 3). The limb is the one given, or the nearest in units of its radius; of
    a child's axis only the part outside its parent counts.
    """
    if limb is not None:
        return limb, *_on_own_axis(solid, x, limb)
    owner = np.zeros(len(x), dtype=np.int64)
    ratio, foot, radius = np.full(len(x), np.inf), np.zeros((len(x), 3)), np.ones(len(x))
    axes, boxes = _axes(solid), _Boxes(x)
    for reach in (1.6, np.inf):  # in radii: who is in no limb's box is compared with all
        waiting = np.isinf(ratio)
        for i, axis in enumerate(axes):
            if reach == np.inf:
                rows = np.flatnonzero(waiting)
            else:
                rows = boxes.about(axis.points, reach * axis.radii)
            if not len(rows):
                continue
            far, here, thick = axis.near(x[rows], np.asarray(axis.tree.query(x[rows])[1]))
            won = far < ratio[rows]
            mine = rows[won]
            owner[mine], ratio[mine] = i, far[won]
            foot[mine], radius[mine] = here[won], thick[won]
    return owner, ratio, foot, radius


def _on_own_axis(solid: Solid, x: Array, limb: Array) -> tuple[Array, Array, Array]:
    """Return distance from the axis of the limb given in radii, axis point and radius."""
    axis, tree, apart = _all_axes(solid)
    return axis.near(x, np.asarray(tree.query(np.c_[x, apart * limb])[1]))


class _Boxes:
    """Points sorted by height, to find those in a box."""

    def __init__(self, x: Array) -> None:
        self.order = np.argsort(x[:, 2], kind="stable")
        self.columns = np.ascontiguousarray(x[self.order].T)

    def about(self, axis: Array, room: Array) -> Array:
        """Return the rows of the points in the boxes of eight parts of an axis."""
        out = []
        cuts = np.linspace(0, len(axis) - 1, 9 if len(axis) > 16 else 2).astype(int)
        for a, b in itertools.pairwise(cuts):
            low = (axis[a : b + 1] - room[a : b + 1, None]).min(axis=0)
            high = (axis[a : b + 1] + room[a : b + 1, None]).max(axis=0)
            first, last = np.searchsorted(self.columns[2], (low[2], high[2]))
            x, y = self.columns[:2, first:last]
            inside = (x >= low[0]) & (x <= high[0]) & (y >= low[1]) & (y <= high[1])
            out.append(self.order[first + np.flatnonzero(inside)])
        return np.unique(np.concatenate(out))


@dataclass(frozen=True, eq=False)
class Axis:
    """Points along an axis, half a radius apart; or along several."""

    points: Array  # (k, 3) [m]
    tangents: Array  # (k, 3)
    radii: Array  # (k,) [m]
    slopes: Array  # (k,) dr/ds, infinite at tips

    @cached_property
    def tree(self) -> KDTree:
        """Tree of the points."""
        return KDTree(self.points)

    def near(self, x: Array, at: Array) -> tuple[Array, Array, Array]:
        """Return distance in radii, axis point and radius at x, whose nearest is `at`."""
        axis, r, slope = self.points[at], self.radii[at], self.slopes[at]
        along = ((x - axis) * self.tangents[at]).sum(axis=1)
        # do not run along the tangent beyond
        last = np.isinf(slope)
        along = np.clip(along, -r, np.where(last, 0, r))
        here = axis + along[:, None] * self.tangents[at]
        thick = r + along * np.where(last, 0, slope)
        return np.linalg.norm(x - here, axis=1) / thick, here, thick


@lru_cache(maxsize=1)  # a mesh asks five times
def _axes(solid: Solid) -> list[Axis]:
    """Return the axis of each tube, of a child's the part outside its parent."""
    out = []
    for tube, leaves in zip(solid.tubes, solid.emergence, strict=True):
        u = tube.stations[tube.stations >= leaves]
        x, r = tube.axis(u), tube.radius(u)
        s = np.r_[0, np.cumsum(np.linalg.norm(np.diff(x, axis=0), axis=1))]
        slope = np.gradient(r, s) if len(u) > 1 else np.zeros(1)
        slope[-1] = np.inf
        out.append(Axis(x, tube.tangent(u), r, slope))
    return out


@lru_cache(maxsize=1)
def _all_axes(solid: Solid) -> tuple[Axis, KDTree, float]:
    """Return all axes as one, a tree, and how far apart limbs are in its fourth dimension.

    So that each point finds the axis of its own limb.
    """
    axes = _axes(solid)
    points = np.concatenate([a.points for a in axes])
    whole = Axis(
        points,
        np.concatenate([a.tangents for a in axes]),
        np.concatenate([a.radii for a in axes]),
        np.concatenate([a.slopes for a in axes]),
    )
    apart = 100 * float(np.ptp(points, axis=0).max() + whole.radii.max())
    limb = np.repeat(np.arange(len(axes)), [len(a.points) for a in axes])
    return whole, KDTree(np.c_[points, apart * limb]), apart
