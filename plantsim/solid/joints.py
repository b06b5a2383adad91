"""Where limbs come near each other: the stretches that a boolean kernel has to join.

Everywhere else a limb's surface is a plain tube and can be written down as rings.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.distance import cdist

from plantsim.arrays import Array
from plantsim.solid.sweep import Solid, Tube

NEAR = 1.15  # axes closer than this share of the sum of their radii count as near
PAD = 0.75  # added at either end of a near stretch [radii]
GAP = 2.5  # shorter free stretches are not worth a tube of their own [radii]


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
    for i, (tube, near) in enumerate(zip(solid.tubes, _near(solid), strict=True)):
        cuts = _intervals(tube, near)
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
    """Mask of each tube's stations that are near the axis of another tube."""
    axis = [t.axis(t.stations) for t in solid.tubes]
    radius = [t.radius(t.stations) for t in solid.tubes]
    near = [np.zeros(len(r), dtype=bool) for r in radius]
    low = np.array(
        [(x - NEAR * r[:, None]).min(axis=0) for x, r in zip(axis, radius, strict=True)]
    )
    high = np.array(
        [(x + NEAR * r[:, None]).max(axis=0) for x, r in zip(axis, radius, strict=True)]
    )
    meet = ((low[:, None] <= high[None]) & (low[None] <= high[:, None])).all(axis=2)
    for i, j in np.argwhere(np.triu(meet, 1)):
        # only stations within the other's box can be near it
        a, b = (
            np.flatnonzero(
                (
                    (axis[p] + NEAR * radius[p][:, None] >= low[q])
                    & (axis[p] - NEAR * radius[p][:, None] <= high[q])
                ).all(axis=1)
            )
            for p, q in ((i, j), (j, i))
        )
        if len(a) and len(b):
            close = cdist(axis[i][a], axis[j][b]) < NEAR * (
                radius[i][a][:, None] + radius[j][b][None]
            )
            near[i][a[close.any(axis=1)]] = True
            near[j][b[close.any(axis=0)]] = True
    return near


def _intervals(tube: Tube, near: Array) -> list[tuple[float, float]]:
    """Return near stretches (u from, u to), padded, merged, snapped to the ends."""
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
        start = 0.0 if a < GAP * r[0] else float(np.interp(a, s, u))
        end = 1.0 if b > s[-1] - GAP * r[-1] else float(np.interp(b, s, u))
        out.append((start, end))
    return out
