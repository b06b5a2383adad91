"""Whether fixed vertices hold a mesh: what makes K singular, said in words."""

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from plantsim.arrays import Array
from plantsim.errors import ModelError
from plantsim.mesh.tetmesh import TetMesh


def check_held(mesh: TetMesh, fixed: Array) -> None:
    """Raise ModelError for a piece that is free, or free to turn about what holds it.

    Tets that share a face are one body. A body is held by three vertices that are not in
    line, fixed ones or ones that it shares with a body that is held; so two bodies that
    share an edge or a vertex alone are a hinge.
    """
    piece = mesh.pieces
    count = int(piece.max()) + 1
    loose = np.setdiff1d(np.arange(count), piece[fixed])
    if len(loose):
        size = np.bincount(piece, minlength=count)[loose[0]]
        first = int(np.flatnonzero(piece == loose[0])[0])
        what = (
            "no vertex is fixed"
            if count == 1
            else f"{len(loose)} of {count} disconnected pieces have no fixed vertex (the first "
            f"has {size} vertices, among them {first})"
        )
        raise ModelError(
            f"{what}, so the system is singular. Fix at least three in each piece."
        )
    body = _bodies(mesh)
    bodies = int(body.max()) + 1
    held = np.zeros(len(mesh.points), dtype=bool)
    held[fixed] = True
    members = [np.unique(mesh.tets[body == b]) for b in range(bodies)]
    waiting = list(range(bodies))
    while waiting:
        firm = [
            b for b in waiting if _spans_a_plane(mesh.points[members[b][held[members[b]]]])
        ]
        if not firm:
            b = waiting[0]
            count = int(held[members[b]].sum())
            raise ModelError(
                f"a body of {len(members[b])} vertices (among them {members[b][0]}) is held by "
                f"{count} vertices, fixed or shared with a held body, which leave it free to "
                "turn. Fix at least three that are not in line."
            )
        for b in firm:
            held[members[b]] = True
        waiting = [b for b in waiting if b not in firm]


def _spans_a_plane(x: Array) -> bool:
    if len(x) < 3:
        return False
    spread = np.linalg.svd(x - x.mean(axis=0), compute_uv=False)
    return bool(spread[1] > 1e-9 * max(spread[0], 1e-300))


def _bodies(mesh: TetMesh) -> Array:
    """Return the label (m,) of the face-connected body of each tet."""
    a, b = mesh.neighbours.T
    graph = coo_array((np.ones(len(a)), (a, b)), shape=(len(mesh.tets),) * 2)
    return connected_components(graph, directed=False)[1]
