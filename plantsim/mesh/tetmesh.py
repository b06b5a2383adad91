"""TetMesh: tetrahedra of order 1 or 2, with limbs as regions and named vertex sets."""

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from plantsim.arrays import Array, few, frozen, pieces, vertex_ids
from plantsim.cards import card
from plantsim.errors import MeshError
from plantsim.mesh.shapes import EDGES, INNER, gamma, jacobians

FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])  # outward normals
# gmsh numbers the last two middles of a tet the other way round than VTK: its own inverse
GMSH_ORDER = [0, 1, 2, 3, 4, 5, 6, 7, 9, 8]
FACE_MIDS = np.array([[6, 5, 4], [4, 8, 7], [5, 9, 8], [7, 9, 6]])  # on edges 01, 12, 20


@dataclass(frozen=True, eq=False, repr=False)
class TetMesh:
    """A tetrahedral mesh. Vertex ids are rows of `points`, midside nodes included.

    `tets` has 4 columns (order 1) or 10 (order 2, VTK order: corners, then the middles of
    edges 01, 12, 02, 03, 13, 23). `region` is the limb of each tet and indexes
    `region_names`. `sets` maps names to vertex ids. Raises MeshError on ids out of range,
    inverted or zero-volume tets, and vertices in no tet.
    """

    points: Array  # (n, 3) [m]
    tets: Array  # (m, 4 | 10)
    region: Array | None = None  # (m,) int, zeros where None
    sets: Mapping[str, Array] = field(default_factory=dict)
    region_names: tuple[str, ...] = ()
    report: Mapping[str, Any] | None = None  # what the mesher did, where it was ours

    def __post_init__(self) -> None:
        points = frozen(self.points, (None, 3), name="points", error=MeshError)
        columns = np.shape(self.tets)[-1] if np.ndim(self.tets) == 2 else 0
        if columns not in (4, 10) or len(self.tets) == 0:
            raise MeshError(
                f"tets: shape {np.shape(self.tets)}, wanted (m, 4) or (m, 10) with m at "
                "least 1. Give tetrahedra of order 1 or 2."
            )
        tets = frozen(self.tets, (None, columns), np.int64, name="tets", error=MeshError)
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "tets", tets)
        bad = np.flatnonzero(((tets < 0) | (tets >= len(points))).any(axis=1))
        if bad.size:
            raise MeshError(
                f"{bad.size} tets name vertices outside 0 to {len(points) - 1} (first "
                f"tets: {few(bad)}). Check that ids count from 0."
            )
        used = np.zeros(len(points), dtype=bool)
        used[tets] = True
        loose = np.flatnonzero(~used)
        if loose.size:
            raise MeshError(
                f"{loose.size} vertices are in no tet (first ids: {few(loose)}), which "
                "would make the system singular. Drop them: read_mesh(path, "
                "drop_unused=True)."
            )
        times = np.diff(np.flatnonzero(np.append(self._face_order[1], True)))
        if (times > 2).any():
            raise MeshError(
                f"{int((times > 2).sum())} faces belong to three tets or more, "
                "so tets are there twice or overlap. Take each once."
            )
        region = np.zeros(len(tets), int) if self.region is None else self.region
        region = frozen(region, (len(tets),), np.int64, name="region", error=MeshError)
        object.__setattr__(self, "region", region)
        if region.max() > len(tets) + len(self.region_names):
            raise MeshError(
                f"region: labels up to {region.max()} for {len(tets)} tets. Number "
                "regions from 0."
            )
        names = tuple(self.region_names) or tuple(str(i) for i in range(region.max() + 1))
        if region.min() < 0 or region.max() >= len(names):
            raise MeshError(
                f"region runs from {region.min()} to {region.max()}, but there are "
                f"{len(names)} region names. Number regions from 0, with a name for each."
            )
        object.__setattr__(self, "region_names", names)
        self._check_volumes()
        sets = {}
        for name, ids in self.sets.items():
            try:
                sets[str(name)] = vertex_ids(ids, len(points), f"set {name!r}")
            except ValueError as why:
                raise MeshError(str(why)) from None
        object.__setattr__(self, "sets", MappingProxyType(sets))

    def _check_volumes(self) -> None:
        x = self._corners
        longest = np.zeros(len(self.tets))  # squared
        for one, other in EDGES:
            side = x[:, other] - x[:, one]
            np.maximum(longest, np.einsum("im,im->m", side, side), out=longest)
        bad = np.flatnonzero(self.volumes <= 1e-12 * longest**1.5)
        if bad.size:
            inverted = int((self.volumes < 0).sum())
            raise MeshError(
                f"{bad.size} tets are inverted or have no volume ({inverted} inverted; "
                f"first ids: {few(bad)}, in region {self._region_of(bad[0])}). Swap two "
                "corners of an inverted tet; mesh again where flat."
            )
        if self.order == 2:
            curved = np.flatnonzero(self.bent)
            J = jacobians(self.points, self.tets[curved], INNER)
            bent = curved[J.min(axis=1, initial=np.inf) <= 0]
            if bent.size:
                raise MeshError(
                    f"{bent.size} curved tets are folded, that is, inverted at a node "
                    f"(first ids: {few(bent)}, in region {self._region_of(bent[0])}). "
                    "Straighten them: "
                    "mesh.with_order(1).with_order(2)."
                )

    def _region_of(self, tet: int) -> str:
        return self.region_names[np.asarray(self.region)[tet]]

    @property
    def order(self) -> int:
        """1 for linear tets, 2 for quadratic."""
        return 1 if self.tets.shape[1] == 4 else 2

    @cached_property
    def volumes(self) -> Array:
        """Signed volumes (m,) [m^3] of the tets with straight edges."""
        x = self._corners
        (a, b, c), (d, e, f), (g, h, i) = (x[:, k] - x[:, 0] for k in (1, 2, 3))
        return ((b * f - c * e) * g + (c * d - a * f) * h + (a * e - b * d) * i) / 6

    @property
    def _corners(self) -> Array:
        """Coordinates (3, 4, m) [m] of the corners: along memory by tets, which is fast."""
        corners = np.ascontiguousarray(self.tets[:, :4].T)
        return np.stack([np.ascontiguousarray(axis)[corners] for axis in self.points.T])

    @property
    def volume(self) -> float:
        """Volume [m^3] of the mesh; for order 2 with its curved surface."""
        if self.order == 1:
            return float(self.volumes.sum())
        # det J of a quadratic tet is cubic: a rule of degree 3 on 5 points (Keast 1986)
        a, b = 1 / 4, 1 / 6
        at = np.array([[a, a, a], [b, b, b], [0.5, b, b], [b, 0.5, b], [b, b, 0.5]])
        weights = np.array([-4 / 5, *[9 / 20] * 4]) / 6
        return float((jacobians(self.points, self.tets, at) @ weights).sum())

    @cached_property
    def quality(self) -> Array:
        """Gmsh's gamma of the corners, (m,): 1 regular, 0 flat, negative inverted."""
        return gamma(self.points[self.tets[:, :4]])

    @cached_property
    def _face_order(self) -> tuple[Array, Array]:
        """Faces (tet times four and number) by their vertices; which differ from the last.

        Both (4 m,).
        """
        return face_order(self.tets, len(self.points))

    @cached_property
    def _places(self) -> Array:
        return boundary_places(self._face_order)

    @cached_property
    def surface(self) -> Array:
        """Boundary triangles (k, 3 | 6), outward; corners, then middles of 01, 12, 20."""
        return boundary(self.tets, self._places)

    @cached_property
    def surface_tets(self) -> Array:
        """The tet (k,) behind each boundary triangle."""
        return self._places // len(FACES)

    @property
    def triangles(self) -> Array:
        """Flat triangles (k, 3) of the surface, outward; four for each curved face."""
        if self.order == 1:
            return self.surface
        parts = ([0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5])
        return np.concatenate([self.surface[:, part] for part in parts])

    @cached_property
    def surface_vertices(self) -> Array:
        """Ids (s,) of the vertices on the boundary, ascending."""
        return np.unique(self.surface)

    @cached_property
    def normals(self) -> Array:
        """Outward unit normals (s, 3) at `surface_vertices`, faces weighed by their area.

        Curved faces count as the four flat triangles between their nodes.
        """
        triangles = self.triangles
        x = self.points[triangles]
        area = np.cross(*_two(x))
        total = np.zeros_like(self.points)
        for corner in triangles.T:
            np.add.at(total, corner, area)
        total = total[self.surface_vertices]
        return total / np.maximum(np.linalg.norm(total, axis=1), 1e-300)[:, None]

    @cached_property
    def bent(self) -> Array:
        """Mask (m,) of the tets with a midside node off the middle of its edge."""
        if self.order == 1:
            return np.zeros(len(self.tets), dtype=bool)
        x = self._corners
        out = np.zeros(len(self.tets), dtype=bool)
        for (a, b), middle in zip(EDGES, self.tets.T[4:], strict=True):
            off = self.points[middle].T - (x[:, a] + x[:, b]) / 2
            side = x[:, b] - x[:, a]
            out |= (off**2).sum(axis=0) > 1e-18 * (side**2).sum(axis=0)
        return out

    @cached_property
    def neighbours(self) -> Array:
        """Pairs (k, 2) of tets that share a face."""
        order, new = self._face_order
        same = np.flatnonzero(~new)
        return np.stack([order[same - 1], order[same]], axis=1) // len(FACES)

    @cached_property
    def parents(self) -> Array:
        """The region that each region grows from (-1: none), away from the set "base"."""
        from plantsim.mesh.limbs import region_parents  # noqa: PLC0415  it imports TetMesh

        return region_parents(self)

    def at(self, limb: int | str, fraction: float) -> Array:
        """Return ids of the surface vertices of a limb at a fraction of its length.

        `limb` by name or number; 0 is where it leaves its parent (of the trunk: the foot),
        1 its tip. The vertices about the nearest ring of the mesh, ascending.
        """
        from plantsim.mesh.limbs import vertices_at  # noqa: PLC0415

        return vertices_at(self, limb, fraction)

    def size_report(self) -> tuple[Any, ...]:
        """Return how finely each limb is meshed, a row a limb; prints as a table."""
        from plantsim.mesh.limbs import size_report  # noqa: PLC0415

        return size_report(self)

    def plot(self, out: str | os.PathLike[str] = "mesh.png") -> Path:
        """Draw the mesh, limbs in colours, to a PNG; return its path."""
        # a picture is the only call that goes up, through this one door
        from plantsim.view.figures import figure_mesh  # noqa: PLC0415

        return figure_mesh(self, out)

    @property
    def curved(self) -> bool:
        """Whether any midside node is off the middle of its edge."""
        return bool(self.bent.any())

    @property
    def pieces(self) -> Array:
        """Label (n,) of the connected piece of each vertex, pieces counted from 0."""
        a = np.repeat(self.tets[:, :1], self.tets.shape[1] - 1, axis=1).ravel()
        b = self.tets[:, 1:].ravel()
        return pieces(len(self.points), np.stack([a, b], axis=1))

    def with_order(self, order: int) -> Self:
        """Return the mesh with tets of order 1 (corners) or 2 (straight edges added).

        A mesh that has that order already is returned as it is, curved edges and all. Ids
        of corner vertices stay when going up; going down, vertices are numbered anew in
        their order. A set gains the middle of an edge of which it has both ends; one on the
        surface gains middles on the surface only.
        """
        if order not in (1, 2):
            raise MeshError(f"order is {order!r}; give 1 or 2.")
        if order == self.order:
            return self
        if order == 1:
            return self._compact(self.tets[:, :4])
        points, tets, edges = quadratic(self.points, self.tets)
        n = len(self.points)
        sets = {}
        outside = np.zeros(len(points), dtype=bool)
        outside[boundary(tets)] = True
        for name, ids in self.sets.items():
            inside = np.zeros(n, dtype=bool)
            inside[ids] = True
            gained = inside[edges].all(axis=1)
            if outside[ids].all():
                gained &= outside[n:]
            sets[name] = np.append(ids, n + np.flatnonzero(gained))
        return replace(self, points=points, tets=tets, sets=sets)

    def _compact(self, tets: Array) -> Self:
        points, tets, sets = compact(self.points, tets, self.sets)
        return replace(self, points=points, tets=tets, sets=sets)

    def with_sets(self, **sets: ArrayLike) -> Self:
        """Return the mesh with these named vertex sets added or replaced."""
        return replace(
            self, sets={**self.sets, **{k: np.asarray(v) for k, v in sets.items()}}
        )

    def with_region(self, region: ArrayLike, names: tuple[str, ...] = ()) -> Self:
        """Return the mesh with other regions, (m,) int, and their names."""
        return replace(self, region=np.asarray(region), region_names=names)

    _repr_html_ = card  # what a notebook shows

    def __repr__(self) -> str:
        limbs = {f"limb {name}" for name in self.region_names} & set(self.sets)
        words = [f"{k} {len(v)}" for k, v in self.sets.items() if k not in limbs]
        words += [f"{len(limbs)} limbs"] if limbs else []
        sets = ", ".join(words) or "none"
        return (
            f"TetMesh(order {self.order}, {len(self.points):,} vertices, "
            f"{len(self.tets):,} tets, {len(self.region_names)} regions, sets: {sets}; "
            f"{self.volume:.3g} m^3, worst gamma {self.quality.min():.2f})"
        )


def quadratic(points: Array, tets: Array) -> tuple[Array, Array, Array]:
    """Return points and tets of order 2, edges straight, and the ends (k, 2) of each edge.

    `tets` (m, 4). The middle of edge i is point len(points) + i.
    """
    n = len(points)
    a, b = tets.T[EDGES.T]  # (6, m) each
    low, high = np.minimum(a, b), np.maximum(a, b)
    key, where = np.unique((low * n + high).T, return_inverse=True)
    edges = np.stack(np.divmod(key, n), axis=1)
    middles = points[edges].mean(axis=1)
    return np.vstack([points, middles]), np.hstack([tets, n + where.reshape(-1, 6)]), edges


def boundary(tets: Array, places: Array | None = None) -> Array:
    """Return the outer triangles (k, 3 | 6) of tets, outward, in the order of the tets."""
    if places is None:
        places = boundary_places(face_order(tets, int(tets.max()) + 1))
    corners = tets[:, FACES].reshape(-1, 3)[places]
    if tets.shape[1] == 4:
        return corners
    return np.hstack([corners, tets[:, FACE_MIDS].reshape(-1, 3)[places]])


def boundary_places(faces: tuple[Array, Array]) -> Array:
    """Return the places (k,), tet times four and face, of the outer triangles.

    Those that `face_order` has once.
    """
    order, new = faces
    return np.sort(order[new & np.append(new[1:], True)])


def face_order(tets: Array, n: int) -> tuple[Array, Array]:
    """Return faces (tet times four and number) by vertices; which differ from the last.

    Both (4 m,), ids of vertices being below n.
    """
    corners = np.ascontiguousarray(tets[:, :4].T)
    a, b, c = (corners[side] for side in FACES.T)  # (4, m) each
    low, high = np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)
    key, high = (low * n + (a + b + c - low - high)).T.ravel(), high.T.ravel()
    if n < 2_000_000:  # else three ids overflow one key
        key = key * n + high
        order = np.argsort(key)  # not stable, which is four times slower
        key = key[order]
        new = np.append(True, key[1:] != key[:-1])
        same = np.flatnonzero(~new)
        pair = order[same - 1], order[same]
        order[same - 1], order[same] = np.minimum(*pair), np.maximum(*pair)
        return order, new
    order = np.lexsort((high, key))
    new = np.diff(key[order], prepend=-1) != 0
    return order, new | (np.diff(high[order], prepend=-1) != 0)


def compact(
    points: Array, tets: Array, sets: Mapping[str, Array]
) -> tuple[Array, Array, dict[str, Array]]:
    """Return points, tets and sets without the vertices that are in no tet."""
    used = np.zeros(len(points), dtype=bool)
    used[tets] = True
    new = np.cumsum(used) - 1
    kept = {name: new[ids[used[ids]]] for name, ids in sets.items()}
    return points[used], new[tets], kept


def _two(x: Array) -> tuple[Array, Array]:
    return x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]
