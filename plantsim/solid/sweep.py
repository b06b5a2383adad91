"""Skeleton -> Solid: an immutable recipe of swept limbs, bends and joints checked."""

import os
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, Self, TypeVar

import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator
from scipy.optimize import minimize_scalar
from scipy.spatial import KDTree

from plantsim.arrays import Array, few, frozen
from plantsim.cards import card
from plantsim.errors import GeometryError, check_kind
from plantsim.plant.skeleton import Limb, Skeleton

Tips = Literal["round", "flat"]
JOINT = 0.97  # a child thicker than this share of its parent would touch it along a line
SWING = (
    1.0  # largest distance of the axis from its nodes' polyline [radii, or 0.15 segments]
)
BEND = 0.95  # largest radius / bend radius: beyond 1 a tube crosses itself
LEAN = np.radians(45.0)  # a trunk that leans more is cut square at its foot, not level
S = TypeVar("S", bound="Solid")


@dataclass(frozen=True, eq=False)
class Tube:
    """One swept limb: circles normal to a cubic spline, radius monotone between nodes.

    Parameters u of the methods run from 0 (start) to 1 (tip), arrays of any length.
    """

    name: str
    parent: int  # index of the parent tube, -1 for the trunk
    points: Array  # (k, 3) nodes of the axis [m]; the first is on the parent's axis
    radii: Array  # (k,) [m]
    joint: float = 0.0  # u on the parent's axis where this tube starts
    round_tip: bool = True  # else cut flat at the last point

    def __post_init__(self) -> None:
        points = frozen(
            self.points, (None, 3), name=f"limb {self.name} points", error=GeometryError
        )
        radii = frozen(
            self.radii, (len(points),), name=f"limb {self.name} radii", error=GeometryError
        )
        if len(points) < 2 or (radii <= 0).any():
            raise GeometryError(
                f"limb {self.name}: {len(points)} points, thinnest radius "
                f"{radii.min():.2g} m; give at least two points and radii above 0."
            )
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "radii", radii)

    @cached_property
    def _fit(self) -> tuple[Array, CubicSpline]:
        """Knots and spline through the nodes, the first that stays close to the polyline.

        Over the arc length, with the ends like the rest of the limb; where that swings out,
        as it does when long and short segments meet, centripetal (Lee 1989), and then
        straight at its ends.
        """
        step = np.linalg.norm(np.diff(self.points, axis=0), axis=1)
        for power, ends in ((1.0, "not-a-knot"), (0.5, "not-a-knot"), (0.5, "natural")):
            s = np.r_[0, np.cumsum(step**power)]
            knots = s / s[-1]
            kind = ends if len(self.points) > 3 else "natural"
            fit = knots, CubicSpline(knots, self.points, bc_type=kind)
            if self._swing(*fit) < SWING:
                return fit
        raise GeometryError(
            f"limb {self.name}: a smooth axis through its nodes swings "
            f"{self._swing(*fit):.2g} radii away from the lines between them, wanted "
            f"{SWING}. Space the nodes more evenly."
        )

    def _swing(self, knots: Array, spline: CubicSpline) -> float:
        """Largest distance of the spline from its chords, in radii."""
        t = np.linspace(0, 1, 9)[1:-1]
        u = knots[:-1, None] + t * np.diff(knots)[:, None]
        a, d = self.points[:-1, None], np.diff(self.points, axis=0)[:, None]
        off = spline(u) - a
        along = (off * d).sum(axis=2) / (d**2).sum(axis=2)
        away = np.linalg.norm(off - np.clip(along, 0, 1)[:, :, None] * d, axis=2)
        radius = np.minimum(self.radii[1:], self.radii[:-1])[:, None]
        # a bend of so coarse a polyline may bulge by a share of its segment
        room = np.maximum(radius, 0.15 * np.linalg.norm(d, axis=2))
        return float((away / room).max())

    @property
    def _knots(self) -> Array:
        return self._fit[0]

    @property
    def _axis(self) -> CubicSpline:
        return self._fit[1]

    @cached_property
    def _radius(self) -> PchipInterpolator:
        return PchipInterpolator(self._knots, self.radii)

    def axis(self, u: Array | float) -> Array:
        """Return points of the axis, (..., 3) [m]."""
        return self._axis(u)

    def tangent(self, u: Array | float) -> Array:
        """Return unit tangents of the axis, (..., 3)."""
        d = self._axis(u, 1)
        return d / np.linalg.norm(d, axis=-1, keepdims=True)

    def radius(self, u: Array | float) -> Array:
        """Return radii (...) [m]."""
        return self._radius(u)

    def curvature(self, u: Array) -> Array:
        """Return curvatures of the axis (...) [1/m]."""
        d1, d2 = self._axis(u, 1), self._axis(u, 2)
        return np.linalg.norm(np.cross(d1, d2), axis=-1) / np.linalg.norm(d1, axis=-1) ** 3

    @cached_property
    def stations(self) -> Array:
        """Parameters u for sampling: at most half a radius apart, every node among them."""
        u = self._knots
        step = np.diff(u) * self.length / np.minimum(self.radii[1:], self.radii[:-1])
        counts = np.clip(np.ceil(2 * step).astype(int), 4, 400)
        parts = [
            np.linspace(a, b, n, endpoint=False)
            for a, b, n in zip(u[:-1], u[1:], counts, strict=True)
        ]
        return np.append(np.concatenate(parts), 1.0)

    @cached_property
    def length(self) -> float:
        """Length [m] of the axis."""
        u = np.unique(np.r_[self._knots, np.linspace(0, 1, 200)])
        return float(np.linalg.norm(np.diff(self._axis(u), axis=0), axis=1).sum())

    @cached_property
    def volume(self) -> float:
        """Volume [m^3] of the tube alone, pi times the integral of r^2 ds, tip included."""
        u = self.stations
        speed = np.linalg.norm(self._axis(u, 1), axis=1)
        dome = 2 / 3 * np.pi * self.radii[-1] ** 3 if self.round_tip else 0.0
        return float(np.pi * np.trapezoid(self.radius(u) ** 2 * speed, u) + dome)

    def nearest(self, x: Array) -> tuple[float, float]:
        """Return (u, distance [m]) of the axis point nearest to x."""
        u = self.stations
        i = int(np.linalg.norm(self.axis(u) - x, axis=1).argmin())
        low, high = u[max(i - 1, 0)], u[min(i + 1, len(u) - 1)]
        best: Any = minimize_scalar(
            lambda v: float(((self.axis(v) - x) ** 2).sum()),
            bounds=(low, high),
            method="bounded",
            options={"xatol": 1e-10},
        )
        return min(
            ((float(v), float(np.linalg.norm(self.axis(v) - x))) for v in (best.x, u[i])),
            key=lambda pair: pair[1],
        )

    @cached_property
    def _tree(self) -> KDTree:
        return KDTree(self.axis(self.stations))

    def radius_near(self, x: Array) -> Array:
        """Return the radii (k,) [m] at the stations nearest to points x (k, 3)."""
        return self.radius(self.stations)[self._tree.query(x)[1]]

    def foot(self, x: Array) -> tuple[Array, Array]:
        """Return axis points (k, 3) near points x (k, 3) and the radii (k,) there."""
        at = self.stations[self._tree.query(x)[1]]
        d = self._axis(at, 1)
        at = np.clip(at + ((x - self.axis(at)) * d).sum(axis=1) / (d**2).sum(axis=1), 0, 1)
        return self.axis(at), self.radius(at)


@dataclass(frozen=True, eq=False, repr=False)
class Solid:
    """The recipe of a plant's body: tubes, each buried in its parent at its start."""

    tubes: tuple[Tube, ...]

    @property
    def volume(self) -> float:
        """Volume [m^3] of all tubes without the stretches that are buried in a parent."""
        return sum(t.volume for t in self.tubes) - sum(self.buried)

    @cached_property
    def emergence(self) -> tuple[float, ...]:
        """For each tube, the u at which its axis leaves the parent (0 for the trunk)."""
        out = []
        for tube in self.tubes:
            if tube.parent < 0:
                out.append(0.0)
                continue
            parent = self.tubes[tube.parent]
            u = tube.stations
            away, near = parent._tree.query(tube.axis(u))
            outside = away > parent.radius(parent.stations[near])
            out.append(float(u[outside.argmax()]) if outside.any() else 1.0)
        return tuple(out)

    @property
    def buried(self) -> tuple[float, ...]:
        """For each tube, the volume [m^3] up to where its axis leaves the parent."""
        out = []
        for tube, end in zip(self.tubes, self.emergence, strict=True):
            u = tube.stations[tube.stations <= end]
            area = np.pi * tube.radius(u) ** 2 * np.linalg.norm(tube._axis(u, 1), axis=1)
            out.append(float(np.trapezoid(area, u)))
        return tuple(out)

    @cached_property
    def foot(self) -> tuple[Array, Array]:
        """Centre of the flat foot and its unit normal, out of the plant.

        Level, as the ground is, where the trunk leans by less than 45 degrees; else square
        to the trunk.
        """
        trunk = self.tubes[0]
        way = trunk.tangent(0.0)
        level = way[2] > np.cos(LEAN)
        return trunk.axis(0.0), np.array([0.0, 0.0, -1.0]) if level else -way

    def check(self) -> tuple[str, ...]:
        """Return what is wrong with the solid, a sentence each: bends, joints, burials."""
        faults = [_bend_fault(tube) for tube in self.tubes]
        for tube in self.tubes:
            if tube.parent >= 0:
                parent = self.tubes[tube.parent]
                joint, away = parent.nearest(tube.points[0])
                faults.append(_joint_fault(tube, parent, joint, away))
        faults += [
            f"limb {tube.name} never leaves its parent. Lengthen it, or drop it with "
            "skeleton.pruned(min_radius=...)."
            for tube, end in zip(self.tubes, self.emergence, strict=True)
            if end >= 1
        ]
        return tuple(fault for fault in faults if fault)

    def with_tips(self, tips: Tips) -> Self:
        """Return the solid with its limbs' tips rounded or cut flat.

        A limb that carries another at its tip is rounded in either case.
        """
        if tips not in ("round", "flat"):
            raise GeometryError(f"tips is {tips!r}; give 'round' or 'flat'.")
        carries = {t.parent for t in self.tubes if t.joint > 1 - 1e-6}
        return replace(
            self,
            tubes=tuple(
                replace(t, round_tip=tips == "round" or i in carries)
                for i, t in enumerate(self.tubes)
            ),
        )

    def with_radius(self, factor: float, limb: str | None = None) -> Self:
        """Return the solid with the radii of one limb, or of all, times a factor.

        Raises GeometryError where the limbs then do not fit each other or their bends.
        """
        if limb is not None and limb not in [t.name for t in self.tubes]:
            raise GeometryError(
                f"there is no limb {limb!r}. The limbs are "
                f"{few(t.name for t in self.tubes)}."
            )
        return _sound(
            replace(
                self,
                tubes=tuple(
                    replace(t, radii=factor * t.radii) if limb in (None, t.name) else t
                    for t in self.tubes
                ),
            )
        )

    def plot(self, out: str | os.PathLike[str] = "solid.png") -> Path:
        """Draw the tubes to a PNG; return its path."""
        # a picture is the only call that goes up, through this one door
        from plantsim.view.figures import figure_solid  # noqa: PLC0415

        return figure_solid(self, out)

    _repr_html_ = card  # what a notebook shows

    def __repr__(self) -> str:
        thin = min(t.radii.min() for t in self.tubes)
        count = len(self.tubes)
        return f"Solid({count} tubes, {self.volume:.3g} m^3, thinnest radius {thin:.2g} m)"


def sweep(skeleton: Skeleton, *, tips: Tips = "round") -> Solid:
    """Return the solid of a skeleton: a tapered tube along every limb.

    `tips="round"` ends a limb in a dome about its last point; `"flat"` cuts it off there. A
    limb that carries another at its tip is rounded in either case. The trunk's foot is cut
    flat, level with the ground unless it leans by 45 degrees and more. A limb's start is
    moved onto its parent's smooth axis.

    Raises GeometryError, naming the limb, where a limb is thicker than its bend allows,
    swallowed by its parent, too thick for it, or does not start on its parent's axis.
    """
    check_kind(skeleton, Skeleton, "sweep", GeometryError)
    tubes: list[Tube] = []
    for limb in skeleton.limbs:
        points, joint = limb.points, 0.0
        if limb.parent >= 0:
            parent = tubes[limb.parent]
            joint, away = parent.nearest(points[0])
            _refuse(_joint_fault(limb, parent, joint, away))
            points = np.vstack([parent.axis(joint), points[1:]])
        tube = Tube(limb.name, limb.parent, points, limb.radius, joint)
        _refuse(_bend_fault(tube))
        tubes.append(tube)
    return _sound(Solid(tuple(tubes))).with_tips(tips)


def _sound(solid: S) -> S:
    """Return the solid, or raise the first of its faults."""
    for fault in solid.check():
        raise GeometryError(fault)
    return solid


def _refuse(fault: str) -> None:
    if fault:
        raise GeometryError(fault)


def _bend_fault(tube: Tube) -> str:
    u = np.unique(np.r_[tube.stations, np.linspace(0, 1, 400)])
    bend = tube.curvature(u) * tube.radius(u)
    worst = int(bend.argmax())
    if bend[worst] <= BEND:
        return ""
    radius = float(tube.radius(u[worst]))
    return (
        f"limb {tube.name}: radius {radius:.3g} m where it bends with a radius of "
        f"{radius / bend[worst]:.3g} m, so the tube would cross itself. Thin it below "
        f"{BEND * radius / bend[worst]:.3g} m there, or give the bend more room."
    )


def _joint_fault(limb: Limb | Tube, parent: Tube, joint: float, away: float) -> str:
    thick = float(parent.radius(joint))
    radii = limb.radii if isinstance(limb, Tube) else limb.radius
    if away > 0.7 * thick:
        x, y, z = parent.axis(joint)
        return (
            f"limb {limb.name} starts {away:.3g} m off the axis of limb {parent.name} "
            f"(radius {thick:.3g} m). Start it on its parent's axis, as at "
            f"({x:.4g}, {y:.4g}, {z:.4g})."
        )
    if radii[0] > JOINT * thick * (1 + 1e-9):
        return (
            f"limb {limb.name} is {radii[0]:.3g} m thick (radius) where limb "
            f"{parent.name} is {thick:.3g} m. Make it at most {JOINT * thick:.3g} m there."
        )
    return ""
