"""Whether fixed vertices hold a mesh: what makes K singular, said in words."""

from typing import NoReturn

import numpy as np

from plantsim.arrays import Array, pieces
from plantsim.errors import ModelError
from plantsim.mesh.tetmesh import TetMesh


def check_held(mesh: TetMesh, fixed: Array) -> None:
    """Raise ModelError for a piece that is free, or free to turn about what holds it.

    Tets that share a face are one body. A body is held by three vertices that are not in
    line, fixed ones or ones that it shares with a body that is held; so two bodies that
    share an edge or a vertex alone are a hinge.
    """
    body = _bodies(mesh)
    held = np.zeros(len(mesh.points), dtype=bool)
    held[fixed] = True
    if body.max() == 0:
        waiting = [np.arange(len(mesh.points))]
    else:
        waiting = [np.unique(mesh.tets[body == b]) for b in range(int(body.max()) + 1)]
    while waiting:
        firm = [_spans_a_plane(mesh.points[ids[held[ids]]]) for ids in waiting]
        if not any(firm):
            _refuse(mesh, fixed, waiting[0], held)
        for ids, now in zip(waiting, firm, strict=True):
            held[ids] |= now
        waiting = [ids for ids, now in zip(waiting, firm, strict=True) if not now]


def _refuse(mesh: TetMesh, fixed: Array, ids: Array, held: Array) -> NoReturn:
    """Raise ModelError for a body of vertices `ids` that is free to turn, or free."""
    piece = mesh.pieces
    count = int(piece.max()) + 1
    loose = np.setdiff1d(np.arange(count), piece[fixed])
    if len(loose):
        size = np.bincount(piece, minlength=count)[loose[0]]
        first = int(np.flatnonzero(piece == loose[0])[0])
        what = (
            "no vertex is fixed"
            if count == 1
            else f"{len(loose)} of {count} disconnected pieces have no fixed vertex (the "
            f"first has {size} vertices, among them {first})"
        )
        raise ModelError(
            f"{what}, so the system is singular. Fix at least three in each piece."
        )
    raise ModelError(
        f"a body of {len(ids)} vertices (among them {ids[0]}) is held by "
        f"{int(held[ids].sum())} vertices, fixed or shared with a held body, which "
        "leave it free to turn. Fix at least three that are not in line."
    )


def _spans_a_plane(x: Array) -> bool:
    if len(x) < 3:
        return False
    spread = np.linalg.svd(x - x.mean(axis=0), compute_uv=False)
    return bool(spread[1] > 1e-9 * max(spread[0], 1e-300))


def _bodies(mesh: TetMesh) -> Array:
    """Return the label (m,) of the face-connected body of each tet."""
    return pieces(len(mesh.tets), mesh.neighbours)
