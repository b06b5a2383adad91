"""Kernel "occ": the surface of a solid, joints fused in the OCC kernel, the rest as rings.

Where limbs come near each other, short ruled lofts through circles are fused and meshed by
gmsh; smooth lofts mesh well alone and lose pieces in booleans. The two kinds meet at
circles of equally many points.
"""

import itertools

import numpy as np
from scipy.spatial import KDTree

from plantsim.arrays import Array, pieces
from plantsim.errors import MeshError
from plantsim.solid import gmsh_model
from plantsim.solid.joints import Stretch, stretches
from plantsim.solid.rings import STEP, Ring, dome, frames, sections, skin, stations
from plantsim.solid.sweep import Solid, Tube

EVEN = 0.08  # a joint whose radius changes by less becomes a cylinder


def surface(
    solid: Solid, around: int, grow: float, turn: float = 0.0, whole: bool = False
) -> tuple[Array, Array]:
    """Return points and triangles of the closed surface of a solid.

    `around`: points of a ring; `grow` multiplies every radius, to make up for the polygon.
    `turn` [rad] rotates the rings, limb by limb by another amount: another try where faces
    met badly. `whole` gives all of every limb to the OCC kernel.
    """
    parts: list[tuple[Array, Array]] = []
    lofts: list[list[Ring]] = []
    ground: tuple[Array, float] | None = None
    open_: list[tuple[bool, bool]] = []  # whether a loft meets rings at its start, end
    cuts = (
        [Stretch(i, 0.0, 1.0, True) for i in range(len(solid.tubes))]
        if whole
        else stretches(solid)
    )
    foot = solid.foot[1]
    lean = _lean(solid)
    for i, tube in enumerate(solid.tubes):
        mine = [cut for cut in cuts if cut.tube == i]
        for cut, rings in zip(
            mine,
            _rings(tube, mine, turn * (1 + i), grow, around, 0.0 if i else lean),
            strict=True,
        ):
            if cut.joint:
                if cut.start == 0 and not i and lean:  # to be cut by the ground
                    x, r, t, n = rings[0]
                    rings = [(x - (lean + 0.2) * r * t, r, t, n), *rings]  # noqa: PLW2901
                    ground = solid.foot[0], 2 * r / np.cos(np.arctan(lean))
                lofts.append(rings)
                open_.append((cut.start > 0, cut.end < 1))
                continue
            last = "open" if cut.end < 1 else ("apex" if tube.round_tip else "flat")
            first = "flat" if cut.start == 0 else "open"
            level = foot if cut.start == 0 and not i else None
            parts.append(
                skin(rings, around, first=first, last=last, even=last == "open", foot=level)
            )
    if lofts:
        lofts = _turned_away(lofts, around)
        seams = [
            rings[end]
            for rings, ends in zip(lofts, open_, strict=True)
            for end, here in zip((0, -1), ends, strict=True)
            if here
        ]
        parts.append(gmsh_model.fused_surface(lofts, seams, around, ground))
    return _joined(parts)


def _lean(solid: Solid) -> float:
    """Return how far the foot's rim runs along the trunk, in radii."""
    cosine = min(1.0, float(-solid.foot[1] @ solid.tubes[0].tangent(0.0)))
    return float(np.tan(np.arccos(cosine))) if cosine < 1 - 1e-12 else 0.0


def _rings(
    tube: Tube, cuts: list[Stretch], seam: float, grow: float, around: int, lean: float
) -> list[list[Ring]]:
    """Return the rings of each stretch of a tube; neighbours share one.

    The second ring keeps clear of a first that leans over by `lean` radii.
    """
    spacing = STEP * 2 * np.pi / around
    us = [
        sections(tube, cut.start, cut.end)
        if cut.joint
        else stations(tube, cut.start, cut.end, spacing)
        for cut in cuts
    ]
    if lean and not cuts[0].joint:
        room = (lean + 0.5) * float(tube.radius(0.0))
        inner = us[0][1:-1]
        away = np.linalg.norm(tube.axis(inner) - tube.axis(0.0), axis=1)
        us[0] = np.r_[us[0][0], inner[away > room], us[0][-1]]
    u = np.concatenate([us[0], *(part[1:] for part in us[1:])])
    x, t, n = frames(tube, u, seam)
    r = grow * tube.radius(u)
    at = 0
    for cut, part in zip(cuts, us, strict=True):
        if cut.joint and len(part) == 2:
            _straight(x, t, n, r, at)
        at += len(part) - 1
    out, at = [], 0
    for part in us:
        rows = range(at, at + len(part))
        out.append([(x[k], float(r[k]), t[k], n[k]) for k in rows])
        at += len(part) - 1
    if tube.round_tip:
        out[-1] += dome(out[-1][-1])
    return out


def _straight(x: Array, t: Array, n: Array, r: Array, i: int) -> None:
    """Make rings i and i + 1 the ends of a cylinder or cone, which joins twice as fast."""
    if abs(r[i + 1] / r[i] - 1) < EVEN:
        r[i : i + 2] = r[i : i + 2].mean()
    way = x[i + 1] - x[i]
    t[i : i + 2] = way / np.linalg.norm(way)
    # the same direction at both ends, square to the axis
    across = n[i] - (n[i] @ t[i]) * t[i]
    n[i : i + 2] = across / np.linalg.norm(across)


def _turned_away(lofts: list[list[Ring]], around: int) -> list[list[Ring]]:
    """Return the lofts turned by whole steps so that their seams keep clear of others.

    A kernel's tube has an edge along it; where that touches another tube, booleans fail.
    """
    low = np.array([np.min([c - 1.1 * r for c, r, _, _ in loft], axis=0) for loft in lofts])
    high = np.array(
        [np.max([c + 1.1 * r for c, r, _, _ in loft], axis=0) for loft in lofts]
    )
    meet = np.all((low[:, None] <= high) & (low <= high[:, None]), axis=2)
    angle = 2 * np.pi / around * np.arange(around)[:, None]
    out = []
    for i, loft in enumerate(lofts):
        others = [lofts[j] for j in np.flatnonzero(meet[i]) if j != i]
        clear = np.full(around, np.inf)
        lines = [_seams(a, b, angle) for a, b in itertools.pairwise(loft)]
        x = np.concatenate(lines, axis=1)
        for other in others:
            for (c, r, _, _), (end, r1, _, _) in itertools.pairwise(other):
                way = end - c
                s: Array = np.clip((x - c) @ way / (way @ way), 0, 1)
                off = np.linalg.norm(x - c - s[:, :, None] * way, axis=2)
                clear = np.minimum(clear, (off / (r + s * (r1 - r))).min(axis=1))
        # a seam that goes into another limb is as good as any that does
        best = int(np.where(clear > 1, clear, 0).argmax())
        out.append([(c, r, t, _turned(t, n, float(angle[best, 0]))) for c, r, t, n in loft])
    return out


def _seams(start: Ring, end: Ring, angle: Array) -> Array:
    """Return points (k, 9, 3) along each of the lines at k angles (k, 1) of a frustum."""
    (c0, r0, t0, n0), (c1, r1, t1, n1) = start, end
    first = c0 + r0 * (np.cos(angle) * n0 + np.sin(angle) * np.cross(t0, n0))
    last = c1 + r1 * (np.cos(angle) * n1 + np.sin(angle) * np.cross(t1, n1))
    return first[:, None] + np.linspace(0, 1, 9)[:, None] * (last - first)[:, None]


def _turned(t: Array, n: Array, angle: float) -> Array:
    return np.cos(angle) * n + np.sin(angle) * np.cross(t, n) if angle else n


def _joined(parts: list[tuple[Array, Array]]) -> tuple[Array, Array]:
    """Return one surface with coinciding points merged; MeshError unless it is closed."""
    points = np.concatenate([p for p, _ in parts])
    shift = np.cumsum([0] + [len(p) for p, _ in parts[:-1]])
    faces = np.concatenate([f + s for (_, f), s in zip(parts, shift, strict=True)])
    edge = np.linalg.norm(points[faces[:, 0]] - points[faces[:, 1]], axis=1).min()
    pairs = KDTree(points).query_pairs(1e-4 * edge, output_type="ndarray")
    label = pieces(len(points), pairs)
    merged = np.empty((label.max() + 1, 3))
    merged[label] = points
    faces = label[faces]
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    used, faces = np.unique(faces, return_inverse=True)
    faces = faces.reshape(-1, 3)
    sides = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    _, times = np.unique(sides @ [len(used), 1], return_counts=True)
    if (times != 2).any():
        raise MeshError(
            f"the surface is open or pinched at {int((times != 2).sum())} edges."
        )
    return merged[used], faces
