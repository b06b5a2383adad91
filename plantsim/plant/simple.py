"""Shapes with analytic answers: straight and tapered limbs, forks, whorls, zigzags."""

import numpy as np
from numpy.typing import ArrayLike

from plantsim.arrays import Array
from plantsim.errors import GeometryError
from plantsim.plant.skeleton import Polyline, Skeleton


def straight(
    length: float = 1.0, radius: float = 0.02, *, direction: ArrayLike = (0, 0, 1)
) -> Skeleton:
    """Return one straight limb of constant radius from the origin.

    `length` and `radius` in m. Raises GeometryError unless both are positive.

    >>> straight(length=1.0, radius=0.02).limbs[0].length
    1.0
    """
    return tapered(length, radius, radius, direction=direction)


def tapered(
    length: float = 1.0,
    base_radius: float = 0.02,
    tip_radius: float = 0.01,
    *,
    direction: ArrayLike = (0, 0, 1),
) -> Skeleton:
    """Return one straight limb whose radius [m] falls linearly from base to tip.

    Raises GeometryError unless the length and the radii are positive.
    """
    _positive(length=length, base_radius=base_radius, tip_radius=tip_radius)
    s = np.array([0.0, 1.0])
    axis = _unit(direction) * length
    return Skeleton.from_limbs(
        [Polyline(s[:, None] * axis, np.array([base_radius, tip_radius]))]
    )


def fork(
    length: float = 1.0,
    radius: float = 0.02,
    *,
    angle: float = 35.0,
    branches: int = 2,
    branch_length: float | None = None,
    branch_radius: float | None = None,
) -> Skeleton:
    """Return a vertical trunk with `branches` equal limbs at its tip.

    Each leaves at `angle` degrees from the trunk, evenly turned about it; `branch_length`
    [m] defaults to 0.6 `length`. `branch_radius` [m] defaults to the area-conserving radius
    / sqrt(branches) (da Vinci's rule), but at most 0.9 of the trunk's. Raises GeometryError
    on sizes that are not positive or angles outside (0, 120) degrees.

    >>> [limb.name for limb in fork().limbs]
    ['0', '1', '2']
    """
    if branches < 1:
        raise GeometryError(f"fork: {branches} branches; give at least one.")
    reach = 0.6 * length if branch_length is None else branch_length
    fair = min(radius / branches**0.5, 0.9 * radius)
    thick = fair if branch_radius is None else branch_radius
    _positive(length=length, radius=radius, branch_length=reach, branch_radius=thick)
    if thick > 0.9 * radius:
        raise GeometryError(
            f"fork: branch_radius {thick:.3g} m over 0.9 of the trunk's "
            f"{radius:.3g} m. Take at most {0.9 * radius:.3g} m."
        )
    if not 0 < angle < 120:
        raise GeometryError(
            f"fork: angle {angle} degrees; want more than 0 and less than 120."
        )
    top = np.array([0.0, 0.0, length])
    limbs = [Polyline([np.zeros(3), top], [radius, radius])]
    tilt = np.radians(angle)
    for turn in 2 * np.pi * np.arange(branches) / branches:
        way = np.array(
            [np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)]
        )
        limbs.append(Polyline([top, top + reach * way], [thick] * 2, parent=0))
    return Skeleton.from_limbs(limbs)


def whorl(
    length: float = 1.0,
    radius: float = 0.02,
    *,
    branches: int = 4,
    angle: float = 60.0,
    at: float = 0.6,
    branch_length: float | None = None,
    branch_radius: float | None = None,
) -> Skeleton:
    """Return a vertical trunk with `branches` equal limbs round it at one height.

    They leave at `angle` degrees from the trunk at `at` of its `length` [m];
    `branch_length` [m] defaults to 0.4 `length`, `branch_radius` [m] to the area-conserving
    radius / sqrt(branches + 1), at most half the trunk's. Raises GeometryError on sizes
    that are not positive, on `at` outside (0, 1) or angles outside [20, 160] degrees.

    >>> len(whorl(branches=5).limbs)
    6
    """
    if branches < 1:
        raise GeometryError(f"whorl: {branches} branches; give at least one.")
    reach = 0.4 * length if branch_length is None else branch_length
    fair = min(radius / (branches + 1) ** 0.5, 0.5 * radius)
    thick = fair if branch_radius is None else branch_radius
    _positive(length=length, radius=radius, branch_length=reach, branch_radius=thick)
    if not 0 < at < 1 or not 20 <= angle <= 160:
        raise GeometryError(
            f"whorl: at {at}, angle {angle} degrees; want at between 0 and 1 and an angle "
            "from 20 to 160."
        )
    if thick > 0.9 * radius:
        raise GeometryError(
            f"whorl: branch_radius {thick:.3g} m over 0.9 of the trunk's {radius:.3g} m. "
            f"Take at most {0.9 * radius:.3g} m."
        )
    foot, tilt = np.array([0.0, 0.0, at * length]), np.radians(angle)
    trunk = [[0.0, 0.0, 0.0], foot.tolist(), [0.0, 0.0, length]]
    limbs = [Polyline(trunk, [radius] * 3)]
    for turn in 2 * np.pi * np.arange(branches) / branches:
        way = np.array(
            [np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)]
        )
        limbs.append(Polyline([foot, foot + reach * way], [thick] * 2, parent=0))
    return Skeleton.from_limbs(limbs)


def zigzag(
    length: float = 1.0, radius: float = 0.01, *, bends: int = 4, angle: float = 40.0
) -> Skeleton:
    """Return one limb in the x-z plane that turns by `angle` degrees `bends` times.

    It turns to alternate sides, so that it leans by half the angle; `length` [m] is that of
    its nodes' chords, and the smooth axis through them bends between. Raises GeometryError
    on sizes that are not positive, or where the bends are too tight for the radius.

    >>> zigzag(bends=1).limbs[0].length
    1.0
    """
    _positive(length=length, radius=radius)
    if bends < 1 or not 0 < angle < 120:
        raise GeometryError(
            f"zigzag: {bends} bends of {angle} degrees; want at least one, above 0 and "
            "below 120 degrees."
        )
    lean = np.radians(angle / 2) * (-1.0) ** np.arange(bends + 1)
    step = length / (bends + 1) * np.stack([np.sin(lean), 0 * lean, np.cos(lean)], axis=1)
    points = np.vstack([np.zeros(3), np.cumsum(step, axis=0)])
    out = Skeleton.from_limbs([Polyline(points, [radius] * len(points))])
    if out.check():
        raise GeometryError(
            f"zigzag: radius {radius:.3g} m is too thick for bends of {angle} degrees "
            f"every {length / (bends + 1):.3g} m. Thin it, or lengthen it."
        )
    return out


def _positive(**sizes: float) -> None:
    for name, value in sizes.items():
        if not (np.isfinite(value) and value > 0):
            raise GeometryError(f"{name} is {value} m; give a positive length.")


def _unit(direction: ArrayLike) -> Array:
    d = np.asarray(direction, dtype=float)
    if d.shape != (3,) or not np.linalg.norm(d) > 0:
        raise GeometryError(f"direction {direction!r}: give three numbers, not all zero.")
    return d / np.linalg.norm(d)
