"""Kernel "occ": the surface of a solid, joints fused in the OCC kernel, the rest as rings.

Where limbs come near each other, short ruled lofts through circles are fused and meshed by
gmsh; smooth lofts mesh well alone and lose pieces in booleans. The two kinds meet at
circles of equally many points.
"""

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from plantsim.arrays import Array
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
    seams: list[Ring] = []  # rings at which the kinds meet
    cuts = (
        [Stretch(i, 0.0, 1.0, True) for i in range(len(solid.tubes))]
        if whole
        else stretches(solid)
    )
    for i, tube in enumerate(solid.tubes):
        mine = [cut for cut in cuts if cut.tube == i]
        for cut, rings in zip(
            mine, _rings(tube, mine, turn * (1 + i), grow, around), strict=True
        ):
            if cut.joint:
                lofts.append(rings)
                seams += [rings[0]] if cut.start > 0 else []
                seams += [rings[-1]] if cut.end < 1 else []
                continue
            last = "open" if cut.end < 1 else ("apex" if tube.round_tip else "flat")
            first = "flat" if cut.start == 0 else "open"
            parts.append(skin(rings, around, first=first, last=last, even=last == "open"))
    if lofts:
        parts.append(gmsh_model.fused_surface(lofts, seams, around))
    return _joined(parts)


def _rings(
    tube: Tube, cuts: list[Stretch], seam: float, grow: float, around: int
) -> list[list[Ring]]:
    """Return the rings of each stretch of a tube; neighbours share one."""
    spacing = STEP * 2 * np.pi / around
    us = [
        sections(tube, cut.start, cut.end)
        if cut.joint
        else stations(tube, cut.start, cut.end, spacing)
        for cut in cuts
    ]
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


def _joined(parts: list[tuple[Array, Array]]) -> tuple[Array, Array]:
    """Return one surface with coinciding points merged; MeshError unless it is closed."""
    points = np.concatenate([p for p, _ in parts])
    shift = np.cumsum([0] + [len(p) for p, _ in parts[:-1]])
    faces = np.concatenate([f + s for (_, f), s in zip(parts, shift, strict=True)])
    edge = np.linalg.norm(points[faces[:, 0]] - points[faces[:, 1]], axis=1).min()
    pairs = KDTree(points).query_pairs(1e-4 * edge, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs)), pairs.T), shape=(len(points),) * 2)
    count, label = connected_components(graph, directed=False)
    merged = np.empty((count, 3))
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
