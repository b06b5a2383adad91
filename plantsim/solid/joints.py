"""Where limbs come near each other: the stretches that a boolean kernel has to join.

Everywhere else a limb's surface is a plain tube and can be written down as rings.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.distance import cdist

from plantsim.arrays import Array
from plantsim.solid.rings import square
from plantsim.solid.sweep import Solid, Tube

NEAR = 0.25  # surface closer than this to another tube's counts as near [its radii]
PAD = 0.5  # added at either end of a near stretch [radii]
GAP = 1.2  # shorter free stretches between two others are not worth a tube [radii]
END = 0.4  # shorter free stretches at an end of a limb are not [radii]


@dataclass(frozen=True)
class Stretch:
    """A part of a tube's axis, u from `start` to `end`."""

    tube: int
    start: float
    end: float
    joint: bool  # near another limb


def stretches(solid: Solid) -> list[Stretch]:
    """Return every tube cut into stretches, free or near others, tube by tube."""
    out = []
    upright = float(np.clip(-solid.foot[1] @ solid.tubes[0].tangent(0.0), 0.1, 1))
    for i, (tube, near) in enumerate(zip(solid.tubes, _near(solid), strict=True)):
        # the rim of a foot that leans runs up the trunk
        cuts = _intervals(tube, near, 0.0 if i else 1.5 * float(np.tan(np.arccos(upright))))
        u = 0.0
        for a, b in cuts:
            if a > u:
                out.append(Stretch(i, u, a, False))
            out.append(Stretch(i, a, b, True))
            u = b
        if u < 1:
            out.append(Stretch(i, u, 1.0, False))
    return out


def _near(solid: Solid) -> list[Array]:
    """Mask of each tube's stations at which its surface comes near another tube's."""
    axis = [t.axis(t.stations) for t in solid.tubes]
    radius = [t.radius(t.stations) for t in solid.tubes]
    tangent = [t.tangent(t.stations) for t in solid.tubes]
    near = [np.zeros(len(r), dtype=bool) for r in radius]
    reach = [(1 + NEAR) * r[:, None] for r in radius]
    low = [x - d for x, d in zip(axis, reach, strict=True)]
    high = [x + d for x, d in zip(axis, reach, strict=True)]
    least = np.array([x.min(axis=0) for x in low])
    most = np.array([x.max(axis=0) for x in high])
    meet = ((least[:, None] <= most[None]) & (least[None] <= most[:, None])).all(axis=2)
    for i, j in np.argwhere(np.triu(meet, 1)):
        # only stations within the other's box can be near it
        a, b = (
            np.flatnonzero(((high[p] >= least[q]) & (low[p] <= most[q])).all(axis=1))
            for p, q in ((i, j), (j, i))
        )
        if not (len(a) and len(b)):
            continue
        apart = cdist(axis[i][a], axis[j][b])
        if (apart > (1 + NEAR) * (radius[i][a][:, None] + radius[j][b][None])).all():
            continue
        for p, q, mine, others in ((i, j, a, b), (j, i, b, a)):
            rings = _circles(axis[p][mine], tangent[p][mine], radius[p][mine])
            away = cdist(rings.reshape(-1, 3), axis[q][others])
            away = (away / radius[q][others]).reshape(len(mine), -1, len(others))
            at = away.argmin(axis=2)
            share = np.take_along_axis(away, at[:, :, None], axis=2)[:, :, 0]
            near[p][mine[(share < 1 + NEAR).any(axis=1)]] = True
            # the other has to reach as far as this one is buried in it
            near[q][others[np.unique(at[share < 1 + NEAR])]] = True
    return near


def _circles(x: Array, t: Array, r: Array) -> Array:
    """Return eight points (k, 8, 3) on each of k circles about axis points x."""
    a = np.arange(8) * np.pi / 4
    n = square(t)
    b = np.cross(t, n)
    spoke = np.cos(a)[:, None] * n[:, None] + np.sin(a)[:, None] * b[:, None]
    return x[:, None] + r[:, None, None] * spoke


def _intervals(tube: Tube, near: Array, rim: float) -> list[tuple[float, float]]:
    """Return near stretches (u from, u to), padded, merged, snapped to the ends.

    `rim` [radii] is kept free at the start besides.
    """
    u, r = tube.stations, tube.radius(tube.stations)
    s = np.r_[0, np.cumsum(np.linalg.norm(np.diff(tube.axis(u), axis=0), axis=1))]
    edges = np.flatnonzero(np.diff(np.r_[False, near, False].astype(int)))
    spans: list[list[float]] = []
    for first, last in edges.reshape(-1, 2):
        a = s[first] - PAD * r[first]
        b = s[last - 1] + PAD * r[last - 1]
        if spans and a - spans[-1][1] < GAP * r[first]:
            spans[-1][1] = b
        else:
            spans.append([a, b])
    out = []
    for a, b in spans:
        start = 0.0 if a < (END + rim) * r[0] else float(np.interp(a, s, u))
        end = 1.0 if b > s[-1] - END * r[-1] else float(np.interp(b, s, u))
        out.append((start, end))
    return out
