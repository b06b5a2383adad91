"""Tubes as rings of points: the part of a plant's surface that needs no kernel."""

import math

import numpy as np

from plantsim.arrays import Array
from plantsim.solid.sweep import Tube

STEP = 1.5  # spacing of rings [edge lengths around the limb]
TINY = 1e-30  # squared: no second reflection
TURN = 0.25  # largest turn of the axis between two rings [rad]
# A loft at a joint may follow its limb less closely: it is short, and each circle more is
# 10 ms
LOFT_TURN = 0.4  # [rad]
TAPER = 0.01  # largest relative error of the radius between two circles of a loft
SAG = 0.25  # largest distance of the axis from the chord between two circles [radii]
DOME = np.radians([45.0])  # latitudes of the rings that round a tip
Ring = tuple[Array, float, Array, Array]  # centre, radius, axis, first direction


def stations(tube: Tube, start: float, end: float, spacing: float) -> Array:
    """Return u from start to end for rings `spacing` radii apart, closer where it bends."""
    u = np.unique(np.r_[np.linspace(start, end, 60), tube.stations])
    u = u[(u >= start) & (u <= end)]
    x, r, t = tube.axis(u), tube.radius(u), tube.tangent(u)
    ds = np.linalg.norm(np.diff(x, axis=0), axis=1)
    turn = np.arccos(np.clip((t[1:] * t[:-1]).sum(axis=1), -1, 1))
    count = np.r_[
        0, np.cumsum(np.maximum(ds / (spacing * (r[1:] + r[:-1]) / 2), turn / TURN))
    ]
    n = max(1, round(count[-1]))
    return np.interp(np.linspace(0, count[-1], n + 1), count, u)


def sections(tube: Tube, start: float, end: float) -> Array:
    """Return u of circles whose ruled loft follows the tube's bends and radius."""
    u = [start, end]
    i = 0
    while i < len(u) - 1:
        a, b = u[i], u[i + 1]
        inner = np.linspace(a, b, 9)
        tangent = tube.tangent(inner)
        turned = np.arccos(np.clip((tangent[1:] * tangent[:-1]).sum(axis=1), -1, 1)).sum()
        radius = tube.radius(inner)
        linear = np.interp(inner, [a, b], radius[[0, -1]])
        along = (inner - a)[:, None] / (b - a)
        ends = tube.axis(np.array([a, b]))
        sag = np.linalg.norm(
            tube.axis(inner) - ends[0] - along * (ends[1] - ends[0]), axis=1
        )
        uneven = turned > LOFT_TURN or (np.abs(radius / linear - 1) > TAPER).any()
        if b - a > 1e-4 and (uneven or (sag > SAG * radius).any()):
            u.insert(i + 1, (a + b) / 2)
        else:
            i += 1
    return np.array(u)


def frames(tube: Tube, u: Array, seam: float = 0.0) -> tuple[Array, Array, Array]:
    """Return points, unit tangents and rotation-minimising normals at u, each (k, 3).

    `seam` [rad] turns every normal about its tangent. Source: Wang, Juettler, Zheng, Liu
    2008, Computation of rotation minimizing frames, double reflection.
    """
    x, t = tube.axis(u), tube.tangent(u)
    n = square(t[0])
    v1 = np.diff(x, axis=0)
    c1 = (v1**2).sum(axis=1)
    s = t[:-1] - (2 / c1 * (v1 * t[:-1]).sum(axis=1))[:, None] * v1
    v2 = t[1:] - s
    c2 = (v2**2).sum(axis=1)
    # both reflections and the rest of a step, as one matrix for each
    flat = np.where(c2 > TINY, 2 / np.maximum(c2, TINY), 0)
    one = np.eye(3)
    turns = one - flat[:, None, None] * v2[:, :, None] * v2[:, None]
    turns = turns @ (one - (2 / c1)[:, None, None] * v1[:, :, None] * v1[:, None])
    turns = (one - t[1:, :, None] * t[1:, None]) @ turns
    out = [n]
    for turn in turns:
        n = turn @ n
        n = n / math.sqrt(n @ n)
        out.append(n)
    N = np.array(out)
    return x, t, np.cos(seam) * N + np.sin(seam) * np.cross(t, N)


def square(t: Array) -> Array:
    """Return unit vectors square to unit vectors t, (..., 3), any."""
    n = np.cross(t, np.eye(3)[np.abs(t).argmin(axis=-1)])
    return n / np.linalg.norm(n, axis=-1, keepdims=True)


def dome(ring: Ring) -> list[Ring]:
    """Return the rings that round a tip beyond its last ring."""
    x, r, t, n = ring
    return [(x + r * np.sin(a) * t, r * float(np.cos(a)), t, n) for a in DOME]


def skin(
    rings: list[Ring],
    count: int,
    *,
    first: str,
    last: str,
    even: bool,
    foot: Array | None = None,
) -> tuple[Array, Array]:
    """Return points and outward triangles of a tube through rings of `count` points.

    Rings are turned by half a step in turn, the first not at all; with `even` the last is
    not either, so that it meets another kernel's ring. `first` and `last`: "open", "flat"
    (closed by a fan) or "apex" (closed by a point one radius ahead of the tip). `foot` is
    the normal of the plane that the first ring is slid onto, along the tube.
    """
    step = 2 * np.pi / count
    turned = [(i % 2) / 2 for i in range(len(rings))]
    if even:
        turned[-1] = 0.0
    x, r, t, n = (np.array([ring[i] for ring in rings]) for i in range(4))
    a = (np.arange(count) + np.array(turned)[:, None]) * step
    b = np.cross(t, n)[:, None]
    spoke = np.cos(a)[:, :, None] * n[:, None] + np.sin(a)[:, :, None] * b
    spoke *= r[:, None, None]
    if foot is not None:
        spoke[0] -= (spoke[0] @ foot / (t[0] @ foot))[:, None] * t[0]
    points = [(x[:, None] + spoke).reshape(-1, 3)]
    j = np.arange(count)
    k = (j + 1) % count
    low = count * np.arange(len(rings) - 1)[:, None]
    aj, ak, bj, bk = (low + v for v in (j, k, count + j, count + k))
    # the lower ring is ahead by half a step, or not
    ahead = (np.array(turned[:-1]) > np.array(turned[1:]))[:, None]
    faces = [
        tuple(v.ravel() for v in (aj, np.where(ahead, bk, ak), bj)),
        tuple(
            v.ravel()
            for v in (
                np.where(ahead, aj, ak),
                np.where(ahead, ak, bk),
                np.where(ahead, bk, bj),
            )
        ),
    ]
    total = len(rings) * count
    for end, kind in ((0, first), (-1, last)):
        if kind == "open":
            continue
        centre, r, t, _ = rings[end]
        # the apex lies on the sphere of the tip: the dome's last ring is at latitude DOME
        ahead = r / np.cos(DOME[-1]) * (1 - np.sin(DOME[-1])) if kind == "apex" else 0.0
        points.append((centre + ahead * t)[None])
        ring = (len(rings) - 1) * count if end else 0
        hub = np.full(count, total)
        total += 1
        faces.append((hub, ring + j, ring + k) if end else (hub, ring + k, ring + j))
    return np.concatenate(points), np.concatenate([np.stack(f, axis=1) for f in faces])


def whole(
    tube: Tube,
    count: int,
    grow: float,
    spacing: float,
    seam: float = 0.0,
    foot: Array | None = None,
) -> tuple[Array, Array]:
    """Return points and triangles of a whole tube, closed at both ends.

    Rings of `count` points, `spacing` radii apart, turned by `seam` [rad]; `grow`
    multiplies every radius. `foot` is the normal of the plane that the start is slid onto.
    """
    u = stations(tube, 0.0, 1.0, spacing)
    x, t, n = frames(tube, u, seam)
    r = grow * tube.radius(u)
    rings = [(x[k], float(r[k]), t[k], n[k]) for k in range(len(u))]
    if tube.round_tip:
        rings += dome(rings[-1])
    last = "apex" if tube.round_tip else "flat"
    return skin(rings, count, first="flat", last=last, even=False, foot=foot)
