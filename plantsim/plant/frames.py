"""Frames of many stems at once: x and y across a stem, z along it, turned as arrays."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from plantsim.arrays import Array


@dataclass(frozen=True, eq=False)
class Frames:
    """Orthonormal right-handed frames; each of x, y, z is (..., 3)."""

    x: Array
    y: Array
    z: Array

    def picked(self, rows: Any) -> "Frames":
        """Return the frames of some rows."""
        return Frames(self.x[rows], self.y[rows], self.z[rows])

    def put(self, rows: Any, other: "Frames") -> None:
        """Write frames into rows of these arrays, which the caller owns."""
        self.x[rows], self.y[rows], self.z[rows] = other.x, other.y, other.z


def _mix(a: Array, u: Array, b: Array, v: Array) -> Array:
    return a[..., None] * u + b[..., None] * v


def about_x(f: Frames, angle: Array) -> Frames:
    """Turn about the own x; a positive angle tips z away from y."""
    c, s = np.cos(angle), np.sin(angle)
    return Frames(f.x, _mix(c, f.y, s, f.z), _mix(-s, f.y, c, f.z))


def about_y(f: Frames, angle: Array) -> Frames:
    """Turn about the own y; a positive angle tips z towards x."""
    c, s = np.cos(angle), np.sin(angle)
    return Frames(_mix(c, f.x, -s, f.z), f.y, _mix(s, f.x, c, f.z))


def about_z(f: Frames, angle: Array) -> Frames:
    """Roll about the own z."""
    c, s = np.cos(angle), np.sin(angle)
    return Frames(_mix(c, f.x, s, f.y), _mix(-s, f.x, c, f.y), f.z)


def about_vertical(f: Frames, angle: Array) -> Frames:
    """Turn about the world's z."""
    c, s = np.cos(angle), np.sin(angle)

    def turned(v: Array) -> Array:
        return np.stack(
            [c * v[..., 0] - s * v[..., 1], s * v[..., 0] + c * v[..., 1], v[..., 2]], -1
        )

    return Frames(turned(f.x), turned(f.y), turned(f.z))


def towards(f: Frames, pull: Array, rate: float) -> Frames:
    """Turn z towards a vector by `rate` radians times |z x pull|."""
    cross = np.cross(f.z, pull)
    size = np.sqrt(np.einsum("...i,...i->...", cross, cross))
    axis = cross / np.maximum(size, 1e-12)[..., None]
    c, s = np.cos(rate * size)[..., None], np.sin(rate * size)[..., None]

    def turned(v: Array) -> Array:
        along = np.einsum("...i,...i->...", axis, v)[..., None]
        return c * v + s * np.cross(axis, v) + (1 - c) * along * axis

    return Frames(turned(f.x), turned(f.y), turned(f.z))


def declination(z: Array) -> Array:
    """Angle [degrees] from the vertical."""
    return np.degrees(np.arctan2(np.hypot(z[..., 0], z[..., 1]), z[..., 2]))


def on_tangent(y: Array, tangent: Array) -> Frames:
    """Return frames along tangents whose x is as near as can be to that of the old y."""
    x = np.cross(y, tangent)
    size = np.sqrt(np.einsum("...i,...i->...", x, x))
    bad = size < 1e-9
    if bad.any():  # the stem bent right onto its y: any frame will do
        other = np.where(np.abs(tangent[..., :1]) < 0.9, [1.0, 0, 0], [0, 1.0, 0])
        x = np.where(bad[..., None], np.cross(other, tangent), x)
        size = np.sqrt(np.einsum("...i,...i->...", x, x))
    x = x / size[..., None]
    return Frames(x, np.cross(tangent, x), tangent)
