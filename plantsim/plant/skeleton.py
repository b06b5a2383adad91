"""Skeleton: a rooted tree of limbs, each a polyline with radii."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike

from plantsim.arrays import Array, few, frozen
from plantsim.errors import GeometryError


@dataclass(frozen=True, eq=False)
class Limb:
    """One limb of a skeleton, from its start on the parent's axis to its tip."""

    index: int
    name: str  # "0" trunk; "3" its third child; "3.1" the first child of that
    level: int  # 0 trunk, 1 branch, ...
    parent: int  # index of the parent limb, -1 for the trunk
    points: Array  # (k, 3) [m]
    radius: Array  # (k,) [m]

    @property
    def length(self) -> float:
        """Length [m] of the polyline."""
        return float(np.linalg.norm(np.diff(self.points, axis=0), axis=1).sum())

    @property
    def base_radius(self) -> float:
        """Radius [m] at the start."""
        return float(self.radius[0])

    @property
    def tip_radius(self) -> float:
        """Radius [m] at the end."""
        return float(self.radius[-1])

    @property
    def tip(self) -> Array:
        """Last point, (3,) [m]."""
        return self.points[-1]

    def __repr__(self) -> str:
        return (
            f"Limb({self.name}: level {self.level}, {self.length:.3g} m, "
            f"radius {self.base_radius:.3g} to {self.tip_radius:.3g} m)"
        )


class Polyline(NamedTuple):
    """What `Skeleton.from_limbs` takes: a limb before it has nodes in a skeleton."""

    points: ArrayLike  # (k, 3) [m], the first on the parent's polyline
    radius: ArrayLike  # (k,) [m]
    parent: int = -1  # index of an earlier limb, -1 for the trunk
    level: int | None = None  # one more than the parent's where None


@dataclass(frozen=True, eq=False, repr=False)
class Skeleton:
    """A rooted tree of limbs. Node 0 is the root; parent[0] == -1.

    The nodes of a limb are consecutive, from its start to its tip, each the parent of the
    next. A limb's first node lies on its parent limb's polyline; its `parent` is the last
    node of that limb at or before it. Lengths in metres, z up.
    """

    points: Array  # (n, 3) [m]
    radius: Array  # (n,) [m], positive
    parent: Array  # (n,) int, parent[i] < i
    limb: Array  # (n,) int, 0 .. limbs - 1 in order of appearance
    level: Array | None = None  # (limbs,) int; depth in the tree of limbs where None
    note: str = field(default="", kw_only=True)  # what a generator left out, in words

    def __post_init__(self) -> None:
        def check(name: str, shape: tuple[int | None, ...], dtype: type) -> Array:
            value = frozen(
                getattr(self, name), shape, dtype, name=name, error=GeometryError
            )
            object.__setattr__(self, name, value)
            return value

        n = len(check("points", (None, 3), float))
        radius = check("radius", (n,), float)
        parent = check("parent", (n,), np.int64)
        limb = check("limb", (n,), np.int64)
        if n < 2:
            raise GeometryError(f"a skeleton of {n} nodes: give at least two.")
        thin = np.flatnonzero(radius <= 0)
        if thin.size:
            raise GeometryError(
                f"{thin.size} nodes have no positive radius (first: {few(thin)}). "
                "Give every node a radius above 0 m, or cut the limb before it vanishes."
            )
        if parent[0] != -1 or (parent[1:] < 0).any() or (parent >= np.arange(n)).any():
            bad = np.flatnonzero(
                (parent >= np.arange(n)) | ((parent < 0) & (np.arange(n) > 0))
            )
            raise GeometryError(
                f"parent: node 0 must have -1 and every other an earlier node; wrong at "
                f"{few(bad) or '0'}. Sort the nodes from the root outwards."
            )
        starts = np.flatnonzero(np.diff(limb, prepend=-1))
        if not np.array_equal(limb[starts], np.arange(len(starts))):
            raise GeometryError(
                "limb: labels must be 0, 1, 2, ... with the nodes of a limb together. "
                "Build with Skeleton.from_limbs."
            )
        inner = np.setdiff1d(np.arange(n), starts)
        broken = inner[parent[inner] != inner - 1]
        if broken.size:
            raise GeometryError(
                f"nodes {few(broken)} do not follow the node before them on their limb. "
                "Build with Skeleton.from_limbs."
            )
        short = np.flatnonzero(np.diff(np.append(starts, n)) < 2)
        if short.size:
            raise GeometryError(
                f"limbs {few(short)} have one node. Give each at least two."
            )
        step = np.linalg.norm(self.points[inner] - self.points[inner - 1], axis=1)
        if (step <= 0).any():
            raise GeometryError(
                f"nodes {few(inner[step <= 0])} coincide with the node before them. Drop "
                "them."
            )
        if self.level is None:
            owner = np.where(parent[starts] < 0, -1, limb[parent[starts]])
            depth = np.zeros(len(starts), dtype=np.int64)
            for i, p in enumerate(owner):
                depth[i] = 0 if p < 0 else depth[p] + 1
            object.__setattr__(self, "level", depth)
        check("level", (len(starts),), np.int64)

    @classmethod
    def from_limbs(cls, limbs: Sequence[Polyline], *, note: str = "") -> Self:
        """Return the skeleton of these limbs, parents before children.

        A limb's first point is attached to the last node of its parent that is not beyond
        it. Raises GeometryError where a limb names a parent that does not come before it.
        """
        points: list[Array] = []
        radius: list[Array] = []
        parent: list[Array] = []
        levels: list[int] = []
        first: list[int] = []
        count = 0
        for i, limb in enumerate(limbs):
            p = frozen(limb.points, (None, 3), name=f"limb {i} points", error=GeometryError)
            r = frozen(limb.radius, (len(p),), name=f"limb {i} radius", error=GeometryError)
            if (i == 0) != (limb.parent == -1) or not -1 <= limb.parent < i:
                raise GeometryError(
                    f"limb {i} names limb {limb.parent} as its parent: the trunk comes "
                    "first with -1, and every other limb names an earlier one."
                )
            joint = -1
            if limb.parent >= 0:
                before, _ = nearest_on_polyline(points[limb.parent], p[0])
                joint = first[limb.parent] + before
            levels.append(
                limb.level
                if limb.level is not None
                else (0 if i == 0 else levels[limb.parent] + 1)
            )
            first.append(count)
            points.append(p)
            radius.append(r)
            parent.append(np.r_[joint, np.arange(count, count + len(p) - 1)])
            count += len(p)
        if not points:
            raise GeometryError("no limbs given: a skeleton needs at least a trunk.")
        return cls(
            np.concatenate(points),
            np.concatenate(radius),
            np.concatenate(parent),
            np.repeat(np.arange(len(points)), [len(p) for p in points]),
            np.array(levels),
            note=note,
        )

    @cached_property
    def limbs(self) -> tuple[Limb, ...]:
        """The limbs, trunk first, parents before children."""
        starts = np.flatnonzero(np.diff(self.limb, prepend=-1))
        ends = np.append(starts[1:], len(self.points))
        names: list[str] = []
        children = np.zeros(len(starts), dtype=int)
        out = []
        assert self.level is not None
        for i, (a, b) in enumerate(zip(starts, ends, strict=True)):
            p = int(self.limb[self.parent[a]]) if self.parent[a] >= 0 else -1
            if p < 0:
                names.append("0")
            else:
                children[p] += 1
                stem = "" if p == 0 else names[p] + "."
                names.append(f"{stem}{children[p]}")
            out.append(
                Limb(i, names[i], int(self.level[i]), p, self.points[a:b], self.radius[a:b])
            )
        return tuple(out)

    @property
    def height(self) -> float:
        """Largest z over the root's z [m]."""
        return float(self.points[:, 2].max() - self.points[0, 2])

    @property
    def length(self) -> float:
        """Length [m] of all limbs together."""
        return sum(limb.length for limb in self.limbs)

    def with_radius(self, radius: ArrayLike) -> Self:
        """Return the same skeleton with other radii, (n,) or a scalar [m]."""
        return replace(self, radius=np.broadcast_to(radius, self.radius.shape))

    def scaled(self, factor: float) -> Self:
        """Return the skeleton with all lengths and radii multiplied, about the root."""
        root = self.points[0]
        return replace(
            self, points=root + factor * (self.points - root), radius=factor * self.radius
        )

    def pruned(
        self,
        *,
        min_radius: float = 0.0,
        max_limbs: int | None = None,
        levels: int | None = None,
    ) -> Self:
        """Return the skeleton without what is too thin, too many or too deep.

        A limb is cut where its radius first falls below `min_radius` [m] and is dropped
        where less than four radii of length would be left. Of the others the `max_limbs`
        thickest stay, and only those of level below `levels`. Whatever hung on a dropped
        part goes with it. Raises GeometryError when nothing of the trunk is left.
        """
        if min_radius < 0 or (max_limbs is not None and max_limbs < 1):
            raise GeometryError(
                f"pruned: min_radius {min_radius} m, max_limbs {max_limbs}; want at least "
                "0 m and at least one limb."
            )
        reach = np.zeros(len(self.limbs))  # arc length that is kept of each limb
        kept = np.zeros(len(self.limbs), dtype=bool)
        cut: list[Polyline] = []
        for limb in self.limbs:
            points, radius = _until_thin(limb.points, limb.radius, min_radius)
            cut.append(Polyline(points, radius))
            if len(points) < 2 or (levels is not None and limb.level >= levels):
                continue
            reach[limb.index] = np.linalg.norm(np.diff(points, axis=0), axis=1).sum()
            stub = limb.index > 0 and reach[limb.index] < 4 * radius[0]
            if limb.parent >= 0:
                parent = self.limbs[limb.parent]
                _, arc = nearest_on_polyline(parent.points, limb.points[0])
                stub = stub or not kept[limb.parent] or arc > reach[limb.parent] + 1e-12
            kept[limb.index] = not stub
        if not kept[0]:
            raise GeometryError(
                f"pruned: nothing of the trunk (radius {self.limbs[0].base_radius:.2g} m) "
                f"is left above min_radius {min_radius:.2g} m. Lower it."
            )
        if max_limbs is not None and kept.sum() > max_limbs:
            kept = self._thickest(kept, max_limbs)
        order = np.flatnonzero(kept)
        new = {int(old): i for i, old in enumerate(order)}
        out = type(self).from_limbs(
            [
                cut[i]._replace(
                    parent=new.get(self.limbs[i].parent, -1), level=self.limbs[i].level
                )
                for i in order
            ]
        )
        gone = len(self.limbs) - len(order)
        note = f"{gone} of {len(self.limbs)} limbs pruned" if gone else ""
        return replace(out, note="; ".join(t for t in (self.note, note) if t))

    def _thickest(self, kept: Array, count: int) -> Array:
        """Return a mask of the `count` thickest limbs of `kept`, closed under parents."""
        base = np.array([limb.base_radius for limb in self.limbs])
        for limb in self.limbs:  # a child never counts as thicker than what carries it
            if limb.parent >= 0:
                base[limb.index] = min(base[limb.index], base[limb.parent])
        order = np.lexsort((np.arange(len(base)), -base))
        mask = np.zeros(len(base), dtype=bool)
        mask[[i for i in order if kept[i]][:count]] = True
        return mask

    def __repr__(self) -> str:
        assert self.level is not None
        per = ", ".join(str(n) for n in np.bincount(self.level))
        note = f"; {self.note}" if self.note else ""
        return (
            f"Skeleton({len(self.limbs)} limbs by level: {per}; {len(self.points)} nodes; "
            f"{self.height:.3g} m high, radius {self.radius.min():.2g} to "
            f"{self.radius.max():.2g} m{note})"
        )


def nearest_on_polyline(points: Array, x: Array) -> tuple[int, float]:
    """Return the node at or before the point nearest to `x`, and its arc length [m].

    >>> line = np.array([[0.0, 0, 0], [1, 0, 0], [3, 0, 0]])
    >>> nearest_on_polyline(line, np.array([2.0, 1, 0]))
    (1, 2.0)
    """
    a, d = points[:-1], np.diff(points, axis=0)
    length = np.linalg.norm(d, axis=1)
    t = np.clip(np.einsum("ij,ij->i", x - a, d) / length**2, 0, 1)
    distance = np.linalg.norm(a + t[:, None] * d - x, axis=1)
    i = int(distance.argmin())
    arc = length[:i].sum() + t[i] * length[i]
    # within rounding of the next node, that node is the one at or before
    node = i + int(t[i] > 1 - 1e-9)
    return node, float(arc)


def _until_thin(points: Array, radius: Array, limit: float) -> tuple[Array, Array]:
    """Return the limb up to where its radius first equals `limit`, by interpolation."""
    thin = np.flatnonzero(radius < limit)
    if not thin.size:
        return points, radius
    i = int(thin[0])
    if i == 0:
        return points[:0], radius[:0]
    t = (radius[i - 1] - limit) / (radius[i - 1] - radius[i])
    if t < 1e-6:
        return points[:i], radius[:i]
    end = points[i - 1] + t * (points[i] - points[i - 1])
    return np.vstack([points[:i], end]), np.append(radius[:i], limit)
