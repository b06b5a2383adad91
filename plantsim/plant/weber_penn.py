"""Procedural trees by the model of Weber and Penn: parameters -> Skeleton.

Source: J. Weber, J. Penn, "Creation and Rendering of Realistic Trees", SIGGRAPH 1995. This
module has the model's stems, curvature, down angles, rotation, lengths, radii, taper below
2, flare and vertical attraction; stem splits, lobes and the pruning envelope are not in it
yet.
"""

import tomllib
from dataclasses import dataclass, fields, replace
from functools import cache
from importlib import resources
from typing import Any, Self

import numpy as np
from scipy.interpolate import CubicSpline

from plantsim.arrays import Array, Random, generator
from plantsim.errors import GeometryError
from plantsim.plant.skeleton import Polyline, Skeleton

LEVELS = 4  # deeper levels reuse the values of the last
Four = tuple[float, float, float, float]


@dataclass(frozen=True)
class WeberPenn:
    """Parameters of the model under their published names; one value a level in the tuples.

    Lengths in m, angles in degrees; a name with `_v` is a half-width of uniform variation.
    Raises GeometryError that names the value that is wrong and what is allowed.
    """

    shape: int = 7
    scale: float = 13.0
    scale_v: float = 3.0
    levels: int = 3
    ratio: float = 0.015
    ratio_power: float = 1.2
    flare: float = 0.6
    base_size: float = 0.4
    attraction_up: float = 0.5
    length: Four = (1.0, 0.3, 0.6, 0.0)
    length_v: Four = (0.0, 0.0, 0.0, 0.0)
    taper: Four = (1.0, 1.0, 1.0, 1.0)
    branches: Four = (1, 50, 30, 10)
    down_angle: Four = (0.0, 60.0, 45.0, 45.0)
    down_angle_v: Four = (0.0, -50.0, 10.0, 10.0)
    rotate: Four = (0.0, 140.0, 140.0, 77.0)
    rotate_v: Four = (0.0, 0.0, 0.0, 0.0)
    curve_res: Four = (3, 5, 3, 1)
    curve: Four = (0.0, -40.0, -40.0, 0.0)
    curve_back: Four = (0.0, 0.0, 0.0, 0.0)
    curve_v: Four = (20.0, 50.0, 75.0, 0.0)
    source: str = ""

    def __post_init__(self) -> None:
        for f in fields(self):
            value = getattr(self, f.name)
            if f.type == Four or isinstance(f.default, tuple):
                if not isinstance(value, (list, tuple)) or len(value) != LEVELS:
                    raise GeometryError(
                        f"{f.name} is {value!r}: give {LEVELS} numbers, one a level."
                    )
                object.__setattr__(self, f.name, tuple(value))
            for number in np.atleast_1d(np.asarray(getattr(self, f.name))):
                if f.name != "source" and (
                    isinstance(number, str) or not np.isfinite(float(number))
                ):
                    raise GeometryError(f"{f.name} is {value!r}: give finite numbers.")
        allowed = (
            ("shape", self.shape in range(8), "a whole number from 0 to 7"),
            ("scale", self.scale > 0, "more than 0 m"),
            ("scale_v", 0 <= self.scale_v < self.scale, "from 0 to below scale"),
            ("levels", self.levels in range(1, 9), "a whole number from 1 to 8"),
            ("ratio", 0 < self.ratio < 0.5, "above 0 and below 0.5"),
            ("flare", 0 <= self.flare <= 5, "from 0 to 5"),
            ("base_size", 0 <= self.base_size < 1, "from 0 to below 1"),
            ("taper", all(0 <= t < 2 for t in self.taper), "from 0 to below 2"),
            ("branches", all(b >= 0 for b in self.branches), "0 or more"),
            ("curve_res", all(c >= 1 for c in self.curve_res), "1 or more"),
            ("length", all(x >= 0 for x in self.length), "0 or more"),
        )
        for name, good, want in allowed:
            if not good:
                raise GeometryError(
                    f"{name} is {getattr(self, name)!r}: allowed is {want}."
                )

    def with_(self, **values: Any) -> Self:
        """Return the same parameters with some replaced."""
        return replace(self, **values)


def species_names() -> tuple[str, ...]:
    """Return the names of the species that plantsim ships."""
    files = resources.files("plantsim.plant").joinpath("species").iterdir()
    return tuple(sorted(f.name[:-5] for f in files if f.name.endswith(".toml")))


@cache
def species(name: str) -> WeberPenn:
    """Return the parameters of a species; GeometryError lists those there are."""
    if name not in species_names():
        raise GeometryError(
            f"species {name!r} is not known; there are: {', '.join(species_names())}."
        )
    file = resources.files("plantsim.plant").joinpath("species", f"{name}.toml")
    return WeberPenn(**tomllib.loads(file.read_text(encoding="utf-8")))


def weber_penn(
    parameters: str | WeberPenn = "quaking_aspen",
    rng: Random = 0,
    *,
    levels: int | None = None,
    ready: bool = True,
) -> Skeleton:
    """Return a tree of the given species or parameters.

    `rng`: seed or Generator; the same seed gives the same tree. `levels` limits the
    recursion (1: trunk alone). With `ready` (default) the skeleton can be meshed: limbs are
    cut where they are thinner than 2 % of the trunk (at least 1 mm), the 100 thickest stay,
    a child is at most 0.85 as thick as its parent where it leaves it, and `note` says what
    was left out. Without, it is everything the model grows, down to radii of 0.1 % of a
    stem's own.
    """
    model = species(parameters) if isinstance(parameters, str) else parameters
    grower = _Grower(
        model, generator(rng), model.levels if levels is None else levels, ready
    )
    full = Skeleton.from_limbs(grower.grow())
    if not ready:
        return full
    return full.pruned(
        min_radius=max(0.001, 0.02 * full.limbs[0].base_radius), max_limbs=100
    )


def shape_ratio(shape: int, q: float) -> float:
    """Return the crown profile S(shape, q), q = 0 at the top and 1 at the crown's base."""
    flame = q / 0.7 if q <= 0.7 else (1 - q) / 0.3
    return (
        0.2 + 0.8 * q,
        0.2 + 0.8 * np.sin(np.pi * q),
        0.2 + 0.8 * np.sin(np.pi * q / 2),
        1.0,
        0.5 + 0.5 * q,
        flame,
        1 - 0.8 * q,
        0.5 + 0.5 * flame,
    )[shape]


@dataclass(frozen=True, eq=False)
class _Stem:
    """A stem while its children are placed."""

    limb: int
    level: int
    length: float
    base_radius: float
    length_max: float  # the children's longest length as a fraction of this stem's
    curve: CubicSpline  # through the segments' ends, over 0 .. 1
    frames: Array  # frame of each segment, columns x, y, z (k, 3, 3)

    def at(self, offset: float) -> tuple[Array, Array]:
        """Return the curve's point and the segment's frame at an offset [m]."""
        t = min(offset / self.length, 1.0)
        k = len(self.frames)
        return self.curve(t), self.frames[min(int(t * k), k - 1)]


class _Grower:
    """One growth of the model: the random numbers and the limbs so far."""

    def __init__(
        self, model: WeberPenn, rng: np.random.Generator, levels: int, ready: bool
    ) -> None:
        if levels < 1:
            raise GeometryError(f"levels is {levels}: give 1 (trunk alone) or more.")
        self.model, self.rng, self.levels, self.ready = model, rng, levels, ready
        self.limbs: list[Polyline] = []
        self.offset: dict[int, float] = {}  # of each child limb, along its parent [m]
        self.carrier: dict[int, _Stem] = {}  # the parent of each child limb

    def vary(self, value: float, half_width: float) -> float:
        return value + self.rng.uniform(-1, 1) * half_width

    def grow(self) -> list[Polyline]:
        m = self.model
        height = self.vary(m.scale, m.scale_v)
        length = self.vary(m.length[0], m.length_v[0]) * height
        trunk = self.stem(-1, 0, np.zeros(3), np.eye(3), length, length * m.ratio)
        base = m.base_size * height
        waiting = [(trunk, base)]
        while waiting:
            stem, bare = waiting.pop(0)
            if stem.level + 1 < self.levels:
                waiting += [(child, 0.0) for child in self.children(stem, bare)]
        return self.limbs

    def stem(
        self,
        parent: int,
        level: int,
        start: Array,
        frame: Array,
        length: float,
        radius: float,
    ) -> _Stem:
        """Walk along a new stem, add its limb and return it."""
        m, n = self.model, min(level, LEVELS - 1)
        segments = max(1, round(m.curve_res[n]))
        points, frames = [start], []
        for i in range(segments):
            if i or level:
                turn = m.curve[n] / segments
                if m.curve_back[n]:
                    half = m.curve[n] if i < segments / 2 else m.curve_back[n]
                    turn = half / (segments / 2)
                turn += self.rng.uniform(-1, 1) * m.curve_v[n] / segments
                frame = frame @ _about_x(np.radians(turn))
                if level >= 2:
                    frame = self.attracted(frame, segments)
            frames.append(frame)
            points.append(points[-1] + frame[:, 2] * length / segments)
        longest = self.vary(m.length[min(level + 1, 3)], m.length_v[min(level + 1, 3)])
        curve = CubicSpline(
            np.linspace(0, 1, segments + 1), np.array(points), bc_type="natural"
        )
        stem = _Stem(
            len(self.limbs), level, length, radius, longest, curve, np.array(frames)
        )
        # more nodes than segments, so that the polyline follows the curve and the radius
        z = np.linspace(0, 1, 3 * segments + 1)
        if level == 0 and m.flare:
            z = np.union1d(z, [1 / 32, 1 / 16, 1 / 8])
        radii = np.array([self.radius(level, radius, length, t) for t in z])
        self.limbs.append(Polyline(curve(z), radii, parent, level))
        return stem

    def attracted(self, frame: Array, segments: int) -> Array:
        """Turn a segment's frame towards the vertical (negative: away from it)."""
        z = frame[:, 2]
        declination = np.arccos(np.clip(z[2], -1, 1))
        upward = self.model.attraction_up * declination * abs(frame[2, 1]) / segments
        axis = np.cross(z, [0.0, 0.0, 1.0])
        size = np.linalg.norm(axis)
        return frame if size < 1e-9 else _about(axis / size, upward) @ frame

    def radius(self, level: int, radius: float, length: float, z: float) -> float:
        """Radius [m] at the fraction z of a stem: unit taper and flare, never zero."""
        m = self.model
        taper = m.taper[min(level, LEVELS - 1)]
        unit = taper if taper < 1 else 2 - taper
        r = radius * (1 - unit * z)
        if taper > 1:  # a hemispherical tip, by degrees
            left = (1 - z) * length
            if left < r:
                r = (2 - taper) * r + (taper - 1) * np.sqrt(max(r**2 - (left - r) ** 2, 0))
        if level == 0:
            r *= 1 + m.flare * (100 ** max(0.0, 1 - 8 * z) - 1) / 100
        return max(r, 1e-3 * radius)

    def children(self, stem: _Stem, bare: float) -> list[_Stem]:
        """Place the children of a stem, evenly over what is not bare."""
        m, level = self.model, stem.level + 1
        n = min(level, LEVELS - 1)
        most = m.branches[n]
        if level == 1:
            count = most
        elif level == 2:
            grand = self.carrier[stem.limb]
            share = stem.length / grand.length / max(grand.length_max, 1e-9)
            count = most * (0.2 + 0.8 * share)
        else:
            grand = self.carrier[stem.limb]
            count = most * (1 - 0.5 * self.offset[stem.limb] / grand.length)
        count = int(count + self.rng.uniform())
        out, azimuth = [], self.rng.uniform(0, 360)
        for k in range(count):
            offset = bare + (stem.length - bare) * (k + 0.5) / count
            if level == 1:
                q = (stem.length - offset) / (stem.length - bare)
                length = stem.length * stem.length_max * shape_ratio(m.shape, q)
            else:
                length = stem.length_max * (stem.length - 0.6 * offset)
            turn = self.vary(m.rotate[n], m.rotate_v[n])
            azimuth = azimuth + turn if m.rotate[n] >= 0 else azimuth + 180 + turn
            down = self.down(n, (stem.length - offset) / (stem.length - bare))
            here, frame = stem.at(offset)
            frame = frame @ _about_z(np.radians(azimuth)) @ _about_x(np.radians(down))
            radius = stem.base_radius * (length / stem.length) ** m.ratio_power
            limit = self.radius(
                stem.level, stem.base_radius, stem.length, offset / stem.length
            )
            radius = min(radius, limit * (0.85 if self.ready else 1.0))
            if length <= 0 or radius <= 0:
                continue
            self.offset[len(self.limbs)] = offset
            self.carrier[len(self.limbs)] = stem
            out.append(self.stem(stem.limb, level, here, frame, length, radius))
        return out

    def down(self, n: int, q: float) -> float:
        """Down angle [degrees] of a child; q = 1 at the crown's base, 0 at the tip."""
        m = self.model
        if m.down_angle_v[n] >= 0:
            return self.vary(m.down_angle[n], m.down_angle_v[n])
        return m.down_angle[n] + m.down_angle_v[n] * (1 - 2 * shape_ratio(0, q))


def _about(axis: Array, angle: float) -> Array:
    """Return the rotation matrix about a unit axis."""
    x, y, z = axis
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * (K @ K)


def _about_x(angle: float) -> Array:
    return _about(np.array([1.0, 0.0, 0.0]), angle)


def _about_z(angle: float) -> Array:
    return _about(np.array([0.0, 0.0, 1.0]), angle)
