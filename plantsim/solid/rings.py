"""Tubes as rings of points: the part of a plant's surface that needs no kernel."""

import numpy as np

from plantsim.arrays import Array
from plantsim.solid.sweep import Tube

STEP = 1.5  # spacing of rings [edge lengths around the limb]
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
    across = np.eye(3)[np.abs(t[0]).argmin()]
    n = np.cross(t[0], across)
    normals = [n / np.linalg.norm(n)]
    for i in range(len(u) - 1):
        v1 = x[i + 1] - x[i]
        r = normals[i] - 2 / (v1 @ v1) * (v1 @ normals[i]) * v1
        s = t[i] - 2 / (v1 @ v1) * (v1 @ t[i]) * v1
        v2 = t[i + 1] - s
        c = v2 @ v2
        n = r - 2 / c * (v2 @ r) * v2 if c > 1e-30 else r
        n = n - (n @ t[i + 1]) * t[i + 1]
        normals.append(n / np.linalg.norm(n))
    N = np.array(normals)
    return x, t, np.cos(seam) * N + np.sin(seam) * np.cross(t, N)


def dome(ring: Ring) -> list[Ring]:
    """Return the rings that round a tip beyond its last ring."""
    x, r, t, n = ring
    return [(x + r * np.sin(a) * t, r * float(np.cos(a)), t, n) for a in DOME]


def skin(
    rings: list[Ring], count: int, *, first: str, last: str, even: bool
) -> tuple[Array, Array]:
    """Return points and outward triangles of a tube through rings of `count` points.

    Rings are turned by half a step in turn, the first not at all; with `even` the last is
    not either, so that it meets another kernel's ring. `first` and `last`: "open", "flat"
    (closed by a fan) or "apex" (closed by a point one radius ahead of the tip).
    """
    step = 2 * np.pi / count
    turned = [(i % 2) / 2 for i in range(len(rings))]
    if even:
        turned[-1] = 0.0
    points = []
    for (x, r, t, n), half in zip(rings, turned, strict=True):
        a = (np.arange(count) + half) * step
        b = np.cross(t, n)
        points.append(x + r * (np.cos(a)[:, None] * n + np.sin(a)[:, None] * b))
    j = np.arange(count)
    k = (j + 1) % count
    faces = []
    for i in range(len(rings) - 1):
        a, b = i * count, (i + 1) * count
        if turned[i] > turned[i + 1]:  # the lower ring is ahead by half a step
            faces += [(a + j, b + k, b + j), (a + j, a + k, b + k)]
        else:
            faces += [(a + j, a + k, b + j), (a + k, b + k, b + j)]
    total = len(rings) * count
    for end, kind in ((0, first), (-1, last)):
        if kind == "open":
            continue
        x, r, t, _ = rings[end]
        # the apex lies on the sphere of the tip: the dome's last ring is at latitude DOME
        ahead = r / np.cos(DOME[-1]) * (1 - np.sin(DOME[-1])) if kind == "apex" else 0.0
        points.append((x + ahead * t)[None])
        ring = (len(rings) - 1) * count if end else 0
        centre = np.full(count, total)
        total += 1
        faces.append((centre, ring + j, ring + k) if end else (centre, ring + k, ring + j))
    return np.concatenate(points), np.concatenate([np.stack(f, axis=1) for f in faces])


def whole(
    tube: Tube, count: int, grow: float, spacing: float, seam: float = 0.0
) -> tuple[Array, Array]:
    """Return points and triangles of a whole tube, closed at both ends.

    Rings of `count` points, `spacing` radii apart, turned by `seam` [rad]; `grow`
    multiplies every radius.
    """
    u = stations(tube, 0.0, 1.0, spacing)
    x, t, n = frames(tube, u, seam)
    r = grow * tube.radius(u)
    rings = [(x[k], float(r[k]), t[k], n[k]) for k in range(len(u))]
    if tube.round_tip:
        rings += dome(rings[-1])
    last = "apex" if tube.round_tip else "flat"
    return skin(rings, count, first="flat", last=last, even=False)
