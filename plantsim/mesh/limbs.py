"""Where along its limb each vertex is, from the mesh alone, and sizes limb by limb."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from plantsim.arrays import Array, few
from plantsim.errors import MeshError
from plantsim.mesh.tetmesh import EDGES, TetMesh


def limb_index(mesh: TetMesh, limb: int | str) -> int:
    """Return the region's number of a limb given by name or number, or MeshError."""
    if isinstance(limb, str) and limb in mesh.region_names:
        return mesh.region_names.index(limb)
    if isinstance(limb, (int, np.integer)) and 0 <= limb < len(mesh.region_names):
        return int(limb)
    raise MeshError(
        f"there is no limb {limb!r}. The regions are {few(mesh.region_names)} (0 to "
        f"{len(mesh.region_names) - 1})."
    )


def vertices_at(mesh: TetMesh, limb: int | str, fraction: float) -> Array:
    """Return the ids of the surface vertices about a place on a limb (see TetMesh.at)."""
    if not 0 <= fraction <= 1:
        raise MeshError(f"fraction is {fraction}; give 0 (base) to 1 (tip).")
    index = limb_index(mesh, limb)
    along = Along(mesh, index)
    mine = np.asarray(mesh.region)[mesh.surface_tets] == index
    outer = np.isin(along.ids, mesh.surface[mine])
    if not outer.any():
        raise MeshError(f"limb {limb!r} has no face on the surface. Name one that has.")
    ids, s = along.ids[outer], along.s[outer]
    away = np.abs(s - fraction * along.length)
    near = away <= max(0.25 * along.step, away.min() + 0.05 * along.step)
    return np.sort(ids[near])


class Along:
    """The vertices of a limb and how far along it they are.

    The way through the tets from the limb's base orders the vertices; the means of those
    that are equally far make an axis, onto which all are projected.
    """

    def __init__(self, mesh: TetMesh, index: int) -> None:
        mine = np.asarray(mesh.region) == index
        if not mine.any():
            raise MeshError(f"limb {mesh.region_names[index]} has no tets in this mesh.")
        tets = mesh.tets[mine]
        self.ids = np.unique(tets)
        x = mesh.points[self.ids]
        row = np.full(len(mesh.points), -1)
        row[self.ids] = np.arange(len(self.ids))
        corners = row[tets[:, :4]]
        a, b = corners[:, EDGES].reshape(-1, 2).T
        span = np.linalg.norm(x[a] - x[b], axis=1)
        key, first = np.unique(
            np.minimum(a, b) * len(x) + np.maximum(a, b), return_index=True
        )
        a, b = np.divmod(key, len(x))
        graph = coo_array((span[first], (a, b)), shape=(len(x),) * 2).tocsr()
        base = row[_base(mesh, index, self.ids)]
        far = dijkstra(graph, directed=False, indices=base, min_only=True)
        used = np.unique(corners)
        far, points = far[used], x[used]
        far[~np.isfinite(far)] = 0.0
        self.step = float(np.median(span))
        count = max(1, int(far.max() / (1.5 * self.step)))
        band = np.minimum((far / max(far.max(), 1e-300) * count).astype(int), count - 1)
        total = np.bincount(band, minlength=count)
        middle = np.stack(
            [np.bincount(band, p, count) / np.maximum(total, 1) for p in points.T], axis=1
        )[total > 0]
        # to both ends, the way that the first and last stretch go
        axis = [points[far == 0].mean(axis=0), *middle]
        last = points[far > far.max() - 0.5 * self.step].mean(axis=0)
        axis = np.array([*axis[: max(1, len(axis) - 1)], last])
        self.s = _project(axis, x)
        low, high = self.s.min(), self.s.max()
        self.s, self.length = np.maximum(self.s - max(low, 0), 0), float(high - max(low, 0))


def _base(mesh: TetMesh, index: int, ids: Array) -> Array:
    """Return the corners where the limb begins: shared with its parent, or the set base."""
    region = np.asarray(mesh.region)
    foot = np.intersect1d(mesh.sets.get("base", np.zeros(0, int)), ids)
    foot = np.intersect1d(foot, np.unique(mesh.tets[region == index, :4]))
    if len(foot):
        return foot
    mine = np.zeros(len(mesh.points), dtype=bool)
    mine[mesh.tets[region == index, :4]] = True
    parents = mesh.parents
    others = (
        mesh.tets[region == parents[index], :4] if parents[index] >= 0 else mesh.tets[:0]
    )
    shared = np.unique(others[mine[others]]) if len(others) else np.zeros(0, int)
    if len(shared):
        return shared
    corners = np.flatnonzero(mine)
    z = mesh.points[corners, 2]
    return corners[z <= z.min() + 1e-9 * max(np.ptp(z), 1e-300)]


def region_parents(mesh: TetMesh) -> Array:
    """Return for each region the one that it grows from, -1 for the first and the apart.

    The way through faces between regions, from the one with most of the set "base" (or the
    lowest).
    """
    region = np.asarray(mesh.region)
    count = len(mesh.region_names)
    pairs = region[mesh.neighbours]
    pairs = pairs[pairs[:, 0] != pairs[:, 1]]
    graph = coo_array((np.ones(len(pairs)), pairs.T), shape=(count, count)).tocsr()
    held = np.zeros(len(mesh.points), dtype=bool)
    foot = mesh.sets.get("base", np.zeros(0, int))
    held[foot if len(foot) else mesh.points[:, 2].argmin()] = True
    root = int(np.bincount(region, held[mesh.tets].sum(axis=1), count).argmax())
    _, before, _ = dijkstra(
        graph,
        directed=False,
        unweighted=True,
        indices=[root],
        min_only=True,
        return_predecessors=True,
    )
    return np.where(before < 0, -1, before)


def _project(axis: Array, x: Array) -> Array:
    """Return how far along a polyline the nearest place to each point is."""
    way = np.diff(axis, axis=0)
    long = np.linalg.norm(way, axis=1)
    keep = long > 1e-9 * max(long.max(initial=0), 1e-300)
    start, way, long = axis[:-1][keep], way[keep], long[keep]
    if not len(long):
        return np.zeros(len(x))
    before = np.r_[0, np.cumsum(long)[:-1]]
    best, s = np.full(len(x), np.inf), np.zeros(len(x))
    for i, (a, d, n, s0) in enumerate(zip(start, way, long, before, strict=True)):
        t = (x - a) @ d / n**2
        # the first and last stretch go on beyond their ends
        t = np.clip(t, -np.inf if i == 0 else 0, np.inf if i == len(long) - 1 else 1)
        off = np.linalg.norm(x - a - t[:, None] * d, axis=1)
        mine = off < best
        best[mine], s[mine] = off[mine], (s0 + t * n)[mine]
    return s


@dataclass(frozen=True)
class LimbSize:
    """How finely one limb is meshed."""

    name: str
    tets: int
    length: float  # [m], from where it leaves its parent
    radius: float  # [m], of the round rod of its volume
    edge: float  # [m], mean of the edges on its surface; within, of all
    worst: float  # gamma

    @property
    def relative(self) -> float:
        """Mean edge over the radius."""
        return self.edge / self.radius


class SizeReport(tuple[LimbSize, ...]):
    """Sizes limb by limb; prints as a table."""

    __slots__ = ()

    def __str__(self) -> str:
        lines = [
            "limb        tets  length, m  radius, mm  edge, mm  edge/radius  worst gamma"
        ]
        lines += [
            f"{row.name:8} {row.tets:7,} {row.length:10.3g} {1e3 * row.radius:11.3g} "
            f"{1e3 * row.edge:9.3g} {row.relative:12.2f} {row.worst:12.2f}"
            for row in self
        ]
        return "\n".join(lines)


def size_report(mesh: TetMesh) -> SizeReport:
    """Return how finely each limb of a mesh is meshed, limbs without tets left out."""
    region = np.asarray(mesh.region)
    faces = mesh.surface[:, :3]
    span = np.linalg.norm(
        mesh.points[faces] - mesh.points[np.roll(faces, 1, axis=1)], axis=2
    ).mean(axis=1)
    owner = region[mesh.surface_tets]
    rows: Sequence[LimbSize] = [
        _limb_size(mesh, int(i), region == i, span[owner == i]) for i in np.unique(region)
    ]
    return SizeReport(rows)


def _limb_size(mesh: TetMesh, index: int, mine: Array, span: Array) -> LimbSize:
    length = Along(mesh, index).length
    volume = float(mesh.volumes[mine].sum())
    if not len(span):
        ends = mesh.points[mesh.tets[mine][:, EDGES]]
        span = np.linalg.norm(ends[:, :, 1] - ends[:, :, 0], axis=2)
    return LimbSize(
        mesh.region_names[index],
        int(mine.sum()),
        length,
        float(np.sqrt(volume / (np.pi * max(length, 1e-300)))),
        float(span.mean()),
        float(mesh.quality[mine].min()),
    )


def mean_by_region(mesh: TetMesh, values: ArrayLike, volumes: Array) -> dict[str, float]:
    """Return the mean of values, () or (m,), over each region that has tets, by volume."""
    region, count = np.asarray(mesh.region), len(mesh.region_names)
    each = np.broadcast_to(values, (len(mesh.tets),))
    total = np.bincount(region, volumes, count)
    mean = np.bincount(region, volumes * each, count) / np.maximum(total, 1e-300)
    rows = zip(mesh.region_names, mean, total, strict=True)
    return {name: float(x) for name, x, v in rows if v > 0}
