"""Frames of many stems at once: x and y across a stem, z along it, turned as arrays."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from plantsim.arrays import Array


@dataclass(frozen=True, eq=False)
class Frames:
    """Orthonormal right-handed frames: the rows of `axes` (..., 3, 3) are x, y and z."""

    axes: Array

    @property
    def x(self) -> Array:
        """Across the stem, (..., 3)."""
        return self.axes[..., 0, :]

    @property
    def y(self) -> Array:
        """Across the stem, (..., 3)."""
        return self.axes[..., 1, :]

    @property
    def z(self) -> Array:
        """Along the stem, (..., 3)."""
        return self.axes[..., 2, :]

    def picked(self, rows: Any) -> "Frames":
        """Return the frames of some rows."""
        return Frames(self.axes[rows])

    def put(self, rows: Any, other: "Frames") -> None:
        """Write frames into rows of this array, which the caller owns."""
        self.axes[rows] = other.axes


def _turned(f: Frames, i: int, j: int, angle: Array) -> Frames:
    """Turn the axes i and j in their plane, i towards j."""
    c, s = np.cos(angle)[..., None], np.sin(angle)[..., None]
    u, v = f.axes[..., i, :], f.axes[..., j, :]
    out = f.axes.copy(order="K")
    out[..., i, :] = c * u + s * v
    out[..., j, :] = c * v - s * u
    return Frames(out)


def about_x(f: Frames, angle: Array) -> Frames:
    """Turn about the own x; a positive angle tips z away from y."""
    return _turned(f, 1, 2, angle)


def about_y(f: Frames, angle: Array) -> Frames:
    """Turn about the own y; a positive angle tips z towards x."""
    return _turned(f, 2, 0, angle)


def about_z(f: Frames, angle: Array) -> Frames:
    """Roll about the own z."""
    return _turned(f, 0, 1, angle)


def about_vertical(f: Frames, angle: Array) -> Frames:
    """Turn about the world's z."""
    c, s = np.cos(angle)[..., None], np.sin(angle)[..., None]
    x, y = f.axes[..., 0], f.axes[..., 1]
    out = f.axes.copy()
    out[..., 0] = c * x - s * y
    out[..., 1] = s * x + c * y
    return Frames(out)


def towards(f: Frames, pull: Array, rate: float) -> Frames:
    """Turn z towards a vector by `rate` radians times |z x pull|."""
    cross = np.cross(f.z, pull)
    size = np.sqrt(np.einsum("...i,...i->...", cross, cross))
    axis = (cross / np.maximum(size, 1e-12)[..., None])[..., None, :]
    c, s = np.cos(rate * size)[..., None, None], np.sin(rate * size)[..., None, None]
    along = np.einsum("...ki,...ki->...k", axis, f.axes)[..., None]
    return Frames(c * f.axes + s * np.cross(axis, f.axes) + (1 - c) * along * axis)


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
    return Frames(np.stack([x, np.cross(tangent, x), tangent], axis=-2))
