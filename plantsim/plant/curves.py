"""Natural cubic splines through the nodes of many limbs at once.

The sweep lays a limb's axis through its nodes as a natural cubic spline over chord length,
its radius as a monotone cubic. Here are the same curves for all limbs of a skeleton in one
banded solve, so that what is checked is what is swept, at a thousandth of a second a plant.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import solve_banded

from plantsim.arrays import Array


@dataclass(frozen=True, eq=False)
class Splines:
    """The axes of limbs whose nodes stand one limb after the other.

    Interval i runs from node i to node i + 1; it is void where node i ends a limb.
    """

    points: Array  # (n, 3) [m]
    radius: Array  # (n,) [m]
    first: Array  # (limbs,) first node of each limb
    last: Array  # (limbs,) last node
    arc: Array  # (n,) chord length from the limb's start [m]
    bend: Array  # (n, 3) second derivative by chord length [1/m]
    slope: Array  # (n,) derivative of the radius by chord length

    def with_radius(self, radius: Array) -> "Splines":
        """Return the same axes with other radii (n,) [m]."""
        h = np.append(np.diff(self.arc), 0.0)
        h[self.last] = 0.0
        back = np.append(0.0, h[:-1])
        slope = _slopes(radius, back, h, self.first, self.last)
        return replace(self, radius=radius, slope=slope)

    def picked(self, nodes: Array, first: Array) -> "Splines":
        """Return those of whole limbs: a mask of their nodes, and their new first nodes."""
        last = np.append(first[1:], np.count_nonzero(nodes)) - 1
        return Splines(
            self.points[nodes],
            self.radius[nodes],
            first,
            last,
            self.arc[nodes],
            self.bend[nodes],
            self.slope[nodes],
        )

    @cached_property
    def cubic(self) -> Array:
        """Coefficients of 1, t, t^2, t^3 of the points on each interval, (n, 4, 3)."""
        out = np.zeros((len(self.points), 4, 3))
        h2 = (np.diff(self.arc) ** 2)[:, None]
        a, b = h2 * self.bend[:-1], h2 * self.bend[1:]
        out[:, 0] = self.points
        out[:-1, 1] = np.diff(self.points, axis=0) - (2 * a + b) / 6
        out[:-1, 2] = a / 2
        out[:-1, 3] = (b - a) / 6
        return out

    @cached_property
    def conic(self) -> Array:
        """Coefficients of 1, t, t^2, t^3 of the radius on each interval, (n, 4)."""
        out = np.zeros((len(self.points), 4))
        h = np.diff(self.arc)
        rise = np.diff(self.radius)
        a, b = h * self.slope[:-1], h * self.slope[1:]
        out[:, 0] = self.radius
        out[:-1, 1] = a
        out[:-1, 2] = 3 * rise - 2 * a - b
        out[:-1, 3] = a + b - 2 * rise
        return out

    def at(self, interval: Array, t: Array) -> Array:
        """Return points (..., 3) at the fractions t of intervals."""
        c, t = self.cubic.take(interval, axis=0), t[..., None]
        return ((c[..., 3, :] * t + c[..., 2, :]) * t + c[..., 1, :]) * t + c[..., 0, :]

    def velocity(self, interval: Array, t: Array) -> Array:
        """Return derivatives (..., 3) by chord length; about 1 long."""
        c, t = self.cubic.take(interval, axis=0), t[..., None]
        h = (self.arc[interval + 1] - self.arc[interval])[..., None]
        return ((3 * c[..., 3, :] * t + 2 * c[..., 2, :]) * t + c[..., 1, :]) / h

    def curvature(self, interval: Array, t: Array) -> Array:
        """Return curvatures [1/m]."""
        c = self.cubic.take(interval, axis=0)
        x, y, z = (
            (3 * c[..., 3, i] * t + 2 * c[..., 2, i]) * t + c[..., 1, i] for i in range(3)
        )
        p, q, r = (6 * c[..., 3, i] * t + 2 * c[..., 2, i] for i in range(3))
        cross = (y * r - z * q) ** 2 + (z * p - x * r) ** 2 + (x * q - y * p) ** 2
        speed = x * x + y * y + z * z
        return np.sqrt(cross / speed) / speed

    def thickness(self, interval: Array, t: Array) -> Array:
        """Return radii [m]: monotone between nodes."""
        c = self.conic.take(interval, axis=0)
        return ((c[..., 3] * t + c[..., 2]) * t + c[..., 1]) * t + c[..., 0]

    def locate(self, limb: Array, arc: Array) -> tuple[Array, Array]:
        """Return (interval, fraction) at arc lengths [m] along limbs."""
        far = self.arc[self.last].max() + 1.0  # so that all limbs stand in one line
        line = self.arc + far * np.repeat(
            np.arange(len(self.first)), self.last - self.first + 1
        )
        i = np.searchsorted(line, arc + far * limb, side="right") - 1
        i = np.clip(i, self.first[limb], self.last[limb] - 1)
        h = self.arc[i + 1] - self.arc[i]
        return i, np.clip((arc - self.arc[i]) / h, 0, 1)

    def nearest(
        self, limb: Array, arc: Array, x: Array
    ) -> tuple[Array, Array, Array, Array]:
        """Return (arc, interval, t, distance) of the axis points nearest to x (k, 3) [m].

        By Gauss-Newton from the arcs given, which must be near.
        """
        full = self.arc[self.last[limb]]
        for _ in range(3):
            i, t = self.locate(limb, arc)
            d = self.velocity(i, t)
            step = ((x - self.at(i, t)) * d).sum(axis=-1) / (d * d).sum(axis=-1)
            arc = np.clip(arc + step, 0, full)
        i, t = self.locate(limb, arc)
        return arc, i, t, np.linalg.norm(self.at(i, t) - x, axis=-1)

    @property
    def intervals(self) -> Array:
        """The intervals that are not void."""
        inside = np.ones(len(self.points), dtype=bool)
        inside[self.last] = False
        return np.flatnonzero(inside)


def splines(points: Array, radius: Array, first: Array) -> Splines:
    """Return the natural splines through nodes (n, 3), limbs starting at `first`."""
    n = len(points)
    last = np.append(first[1:], n) - 1
    way = np.diff(points, axis=0)
    arc, step = arcs(points, first)

    ends = np.zeros(n, dtype=bool)
    ends[first] = ends[last] = True
    inner = ~ends
    h = np.append(step[1:], 0.0)  # of the interval that begins at a node
    safe = np.where(h > 0, h, 1.0)
    chord = np.vstack([way, np.zeros(3)]) / safe[:, None]
    band = np.zeros((3, n))
    band[1] = np.where(inner, 2 * (step + h), 1.0)
    band[0, 1:] = np.where(inner, h, 0.0)[:-1]
    band[2, :-1] = np.where(inner, step, 0.0)[1:]
    right = np.zeros((n, 3))
    right[1:] = 6 * (chord[1:] - chord[:-1])
    right[ends] = 0.0
    bend = solve_banded((1, 1), band, right, check_finite=False)
    return Splines(
        points, radius, first, last, arc, bend, _slopes(radius, step, h, first, last)
    )


def arcs(points: Array, first: Array) -> tuple[Array, Array]:
    """Return chord lengths from each limb's start, and of the interval before a node."""
    step = np.zeros(len(points))
    way = np.diff(points, axis=0)
    step[1:] = np.sqrt(np.einsum("ij,ij->i", way, way))
    step[first] = 0.0
    total = np.cumsum(step)
    size = np.diff(np.append(first, len(points)))
    return total - np.repeat(total[first], size), step


def _slopes(r: Array, back: Array, ahead: Array, first: Array, last: Array) -> Array:
    """Return slopes of the monotone cubic through radii; scipy's PchipInterpolator.

    Source: F. N. Fritsch, J. Butland, SIAM J. Sci. Stat. Comput. 5 (1984) 300-304.
    """
    rise = np.append(np.diff(r), 0.0) / np.where(ahead > 0, ahead, 1.0)  # after a node
    before = np.append(0.0, rise[:-1])
    w1, w2 = 2 * ahead + back, ahead + 2 * back
    same = (rise * before) > 0
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = (w1 + w2) / (w1 / before + w2 / rise)
    d = np.where(same, mean, 0.0)
    two = last - first == 1
    near, far = first, np.minimum(first + 1, len(r) - 1)
    d[first] = np.where(
        two, rise[first], _end(ahead[near], ahead[far], rise[near], rise[far])
    )
    near, far = last - 1, np.maximum(last - 2, 0)
    d[last] = np.where(
        two, rise[last - 1], _end(ahead[near], ahead[far], rise[near], rise[far])
    )
    return d


def _end(h0: Array, h1: Array, m0: Array, m1: Array) -> Array:
    """Return one-sided three-point slopes that keep the shape."""
    with np.errstate(divide="ignore", invalid="ignore"):
        d = ((2 * h0 + h1) * m0 - h0 * m1) / (h0 + h1)
    d = np.where(np.sign(d) != np.sign(m0), 0.0, d)
    steep = (np.sign(m0) != np.sign(m1)) & (np.abs(d) > 3 * np.abs(m0))
    return np.where(steep, 3 * m0, d)
