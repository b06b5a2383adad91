"""Skeleton: a rooted tree of limbs, each a polyline with radii."""

import os
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from plantsim.arrays import Array, Random, few, frozen
from plantsim.cards import card
from plantsim.errors import GeometryError
from plantsim.plant import bends, collisions, foliage, hindrances, prepare, prune
from plantsim.plant.curves import Splines, arcs, splines
from plantsim.plant.hung import Hung, Masses
from plantsim.plant.limb import Joints, Limb, Polyline, nearest_on_polyline


@dataclass(frozen=True, eq=False, repr=False)
class Skeleton:
    """A rooted tree of limbs. Node 0 is the root; parent[0] == -1.

    The nodes of a limb are consecutive, from its start to its tip, each the parent of the
    next. A limb's first node lies on its parent limb's axis; its `parent` is the last node
    of that limb at or before it, -1 for a trunk (most plants have one). A clone, the
    model's word for a limb that begins at a split, has the level of the limb it split from.
    Lengths in metres, z up.
    """

    points: Array  # (n, 3) [m]
    radius: Array  # (n,) [m], positive
    parent: Array  # (n,) int, parent[i] < i
    limb: Array  # (n,) int, 0 .. limbs - 1 in order of appearance
    level: Array | None = None  # (limbs,) int; depth in the tree of limbs where None
    note: str = field(default="", kw_only=True)  # what a generator left out, in words
    hung: Hung = field(default=Hung(), kw_only=True)  # leaves and fruit

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
        starts = np.flatnonzero(np.diff(limb, prepend=-1))
        rooted = np.zeros(n, dtype=bool)
        rooted[starts] = True  # a plant may have more than one trunk
        bad = (parent >= np.arange(n)) | (parent < -1) | ((parent < 0) & ~rooted)
        if parent[0] != -1 or bad.any():
            raise GeometryError(
                f"parent: node 0 must have -1 and every other an earlier node; wrong at "
                f"{few(np.flatnonzero(bad)) or '0'}. Sort the nodes from the root outwards."
            )
        if not np.array_equal(limb[starts], np.arange(len(starts))):
            raise GeometryError(
                "limb: labels must be 0, 1, 2, ... with the nodes of a limb together. "
                "Build with Skeleton.from_limbs."
            )
        inner = np.flatnonzero(~rooted)
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
            object.__setattr__(self, "level", self.depth)
        check("level", (len(starts),), np.int64)
        lost = self.hung.limb
        if ((lost < 0) | (lost >= len(starts))).any():
            raise GeometryError(
                f"hung: limbs {few(lost[(lost < 0) | (lost >= len(starts))])}; there are "
                f"{len(starts)}. Hang leaves and fruit on limbs that there are."
            )

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
            if not -1 <= limb.parent < i:
                raise GeometryError(
                    f"limb {i} names limb {limb.parent} as its parent: a trunk has -1, and "
                    "every other limb names an earlier one. Sort them."
                )
            joint = -1
            if limb.parent >= 0:
                before, _ = nearest_on_polyline(points[limb.parent], p[0])
                joint = first[limb.parent] + before
            levels.append(
                limb.level
                if limb.level is not None
                else (0 if limb.parent < 0 else levels[limb.parent] + 1)
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
        names: list[str] = []
        children = [0] * len(self.first)
        trunks = 0
        out = []
        assert self.level is not None
        rows = zip(
            self.first.tolist(),
            (self.last + 1).tolist(),
            self.carrier.tolist(),
            self.level.tolist(),
            strict=True,
        )
        for i, (a, b, p, level) in enumerate(rows):
            if p < 0:
                trunks += 1
                names.append("0" if trunks == 1 else f"t{trunks}")
            else:
                children[p] += 1
                stem = "" if p == 0 else names[p] + "."
                names.append(f"{stem}{children[p]}")
            out.append(Limb(i, names[i], level, p, self.points[a:b], self.radius[a:b]))
        return tuple(out)

    @cached_property
    def first(self) -> Array:
        """First node of each limb, (limbs,)."""
        return np.flatnonzero(np.diff(self.limb, prepend=-1))

    @cached_property
    def last(self) -> Array:
        """Last node of each limb, (limbs,)."""
        return np.append(self.first[1:], len(self.points)) - 1

    @cached_property
    def carrier(self) -> Array:
        """Parent limb of each limb, (limbs,); -1 for a trunk."""
        joint = self.parent[self.first]
        return np.where(joint < 0, -1, self.limb[joint])

    @cached_property
    def depth(self) -> Array:
        """Number of limbs below each limb down to its trunk, (limbs,)."""
        out = np.zeros(len(self.first), dtype=int)
        for i, p in enumerate(self.carrier.tolist()):
            out[i] = 0 if p < 0 else out[p] + 1
        return out

    @cached_property
    def arc(self) -> Array:
        """Length [m] along each node's limb, by chords from its start, (n,)."""
        return arcs(self.points, self.first)[0]

    @cached_property
    def splines(self) -> Splines:
        """The limbs' smooth axes, as the sweep lays them through the nodes."""
        return splines(self.points, self.radius, self.first)

    @cached_property
    def joints(self) -> "Joints":
        """Where on their parents' axes the limbs start; void for trunks."""
        axes, first, carrier = self.splines, self.first, self.carrier
        mine = np.flatnonzero(carrier >= 0)
        up, node = carrier[mine], self.parent[first[mine]]
        x = self.points[first[mine]]
        tries = node[:, None] + np.arange(-2, 2)
        tries = np.clip(tries, axes.first[up, None], axes.last[up, None] - 1)
        t = np.linspace(0, 1, 5)
        at = axes.at(
            np.repeat(tries[:, :, None], 5, axis=2), np.broadcast_to(t, (*tries.shape, 5))
        )
        far = ((at - x[:, None, None]) ** 2).sum(axis=-1).reshape(len(mine), 4 * 5)
        best = far.argmin(axis=1) if len(mine) else np.zeros(0, dtype=int)
        i = tries[np.arange(len(mine)), best // 5]
        arc = axes.arc[i] + t[best % 5] * (axes.arc[i + 1] - axes.arc[i])
        return Joints(mine, *axes.nearest(up, arc, x))

    @property
    def height(self) -> float:
        """Largest z over the root's z [m]."""
        return float(self.points[:, 2].max() - self.points[0, 2])

    @property
    def length(self) -> float:
        """Length [m] of all limbs together."""
        return float(self.arc[self.last].sum())

    @property
    def masses(self) -> Masses:
        """What hangs on the plant, in space: leaves, fruit."""
        hung, axes = self.hung, self.splines
        limb = hung.limb
        arc = hung.fraction * axes.arc[axes.last[limb]]
        foot = axes.at(*axes.locate(limb, arc))
        return Masses(foot + hung.offset, foot, hung.mass, limb, hung.kind)

    def with_leaves(
        self,
        species: str | None = None,
        *,
        mass: float | None = None,
        spacing: float | None = None,
        stalk: float | None = None,
        rng: Random = 7,
    ) -> Self:
        """Return the skeleton with leaves on its outer limbs, as point masses.

        `mass` [kg] of one, `spacing` [m] along a limb, `stalk` [m] from the axis to its
        centre; what is not given is that of the species. Leaves of limbs that were left out
        are left out too. Raises GeometryError where a number is missing.
        """
        more = foliage.leaves(self, species, mass, spacing, stalk, rng)
        return replace(self, hung=self.hung.joined(more))

    def with_fruit(
        self,
        species: str | None = None,
        *,
        count: int | None = None,
        mass: float | None = None,
        stalk: float | None = None,
        rng: Random = 7,
    ) -> Self:
        """Return the skeleton with fruit below its bearing limbs, as point masses.

        `count` in all, `mass` [kg] of one, `stalk` [m] down to its centre; what is not
        given is that of the species. Raises GeometryError where a number is missing.
        """
        more = foliage.fruit(self, species, count, mass, stalk, rng)
        return replace(self, hung=self.hung.joined(more))

    def plot(self, out: str | os.PathLike[str] | None = None) -> Any:
        """Draw the skeleton: to a PNG, whose path it returns, or as a matplotlib figure."""
        # a picture is the only call that goes up, through this one door
        from plantsim.view.skeletons import figure_skeleton  # noqa: PLC0415

        return figure_skeleton(self, out)

    def with_radius(self, radius: ArrayLike) -> Self:
        """Return the same skeleton with other radii, (n,) or a scalar [m]."""
        return replace(self, radius=np.broadcast_to(radius, self.radius.shape))

    def with_note(self, *notes: str) -> Self:
        """Return the same skeleton with words added to its note."""
        out = self.trusted()
        out.__dict__.update(self.__dict__)  # what is computed stays true
        out.__dict__["note"] = "; ".join(t for t in (self.note, *notes) if t)
        return out

    def trusted(self, **values: Any) -> Self:
        """Return a copy with some fields replaced, unchecked: for kernels only."""
        out = object.__new__(type(self))
        for f in fields(self):
            value = values.get(f.name, getattr(self, f.name))
            if isinstance(value, np.ndarray):
                value.flags.writeable = False
            out.__dict__[f.name] = value
        return out

    def scaled(self, factor: float) -> Self:
        """Return the skeleton with all lengths and radii multiplied, about the root."""
        root = self.points[0]
        return replace(
            self,
            points=root + factor * (self.points - root),
            radius=factor * self.radius,
            hung=replace(self.hung, offset=factor * self.hung.offset),
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
        return prune.pruned(self, min_radius, max_limbs, levels)

    def resampled(self, spacing: float) -> Self:
        """Return the same axes with nodes at most `spacing` [m] apart, evenly on a limb."""
        return bends.resampled(self, spacing)

    def smoothed(self, limit: float = bends.EASY) -> Self:
        """Return the skeleton with bends eased until radius / bend radius < `limit`.

        Limbs that bend no more than that stay as they are; the others are relaxed between
        their ends, and what they carry moves along.
        """
        return bends.smoothed(self, limit)

    def without_collisions(self, *, tries: int = 3) -> Self:
        """Return the skeleton without limbs that pass through others.

        Of two limbs that collide the thinner is turned about its parent, with all that it
        carries, up to `tries` times, and dropped where that does not help.
        """
        return collisions.without_collisions(self, tries)

    def check(self) -> tuple[str, ...]:
        """Return what would hinder a mesh, one sentence each; empty if nothing."""
        return hindrances.hindrances(self)

    def ready(
        self,
        *,
        min_radius: float | None = None,
        max_limbs: int = 100,
        forks: "prepare.Forks" = "model",
    ) -> Self:
        """Return the skeleton cut, eased and cleared until `check()` finds nothing.

        `min_radius` [m], 2 % of the trunk's where None; `forks`: "model" keeps the radii
        but for a cap of 0.85 of the parent's, "area" makes areas add up at every fork.
        `note` says what was left out.
        """
        thin = 0.02 * float(self.radius[0]) if min_radius is None else min_radius
        return prepare.prepared(self, thin, max_limbs, forks)

    _repr_html_ = card  # what a notebook shows

    def __repr__(self) -> str:
        assert self.level is not None
        per = " + ".join(str(n) for n in np.bincount(self.level))
        note = f"; {self.note}" if self.note else ""
        return (
            f"Skeleton({len(self.limbs)} limbs by level: {per}; {len(self.points)} nodes; "
            f"{self.height:.3g} m high, radius {self.radius.min():.2g} to "
            f"{self.radius.max():.2g} m{note})"
        )
