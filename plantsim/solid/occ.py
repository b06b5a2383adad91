"""Kernel "occ": every limb a ruled loft through circles, all fused in the OCC kernel.

Smooth lofts mesh well alone and lose pieces in booleans; ruled ones have short faces with
tight bounding boxes and join reliably.
"""

import numpy as np

from plantsim.arrays import Array
from plantsim.solid import gmsh_model
from plantsim.solid.sweep import Solid, Tube

TURN = 0.25  # largest turn of the axis between two circles [rad]
TAPER = 0.01  # largest relative error of the radius between two circles
SAG = 0.1  # largest distance of the axis from the chord between two circles, in radii
DOME = np.radians([30.0, 60.0])  # latitudes of the circles that round a tip


def build(solid: Solid, *, turn: float = 0.0) -> float:
    """Make the solid the model of the open gmsh session; return its volume [m^3].

    `turn` [rad] rotates every circle's seam, limb by limb by another amount: another try
    where faces met badly.
    """
    volumes = [
        gmsh_model.ruled_loft(_rings(tube, turn * (1 + i)))
        for i, tube in enumerate(solid.tubes)
    ]
    return gmsh_model.fuse(volumes)


def sections(tube: Tube) -> Array:
    """Return parameters u of circles close enough to follow the tube's bends and radius."""
    u = [0.0, 1.0]
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
        uneven = turned > TURN or (np.abs(radius / linear - 1) > TAPER).any()
        if b - a > 1e-4 and (uneven or (sag > SAG * radius).any()):
            u.insert(i + 1, (a + b) / 2)
        else:
            i += 1
    return np.array(u)


def frames(tube: Tube, u: Array) -> tuple[Array, Array, Array]:
    """Return points, unit tangents and rotation-minimising normals at u, each (k, 3).

    Source: Wang, Juettler, Zheng, Liu 2008, "Computation of rotation minimizing frames",
    double reflection.
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
    return x, t, np.array(normals)


def _rings(tube: Tube, seam: float) -> list[tuple[Array, float, Array, Array]]:
    u = sections(tube)
    x, t, n = frames(tube, u)
    r = tube.radius(u)
    n = np.cos(seam) * n + np.sin(seam) * np.cross(t, n)
    rings = [(x[i], float(r[i]), t[i], n[i]) for i in range(len(u))]
    if tube.round_tip:
        rings += [
            (x[-1] + r[-1] * np.sin(a) * t[-1], float(r[-1] * np.cos(a)), t[-1], n[-1])
            for a in DOME
        ]
    return rings
