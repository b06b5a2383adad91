"""Integrals over faces of the surface, flat or curved."""

import numpy as np

from plantsim.arrays import Array
from plantsim.mesh.tetmesh import TetMesh

# Degree 5 on a triangle, seven points. Source: Radon 1948; Stroud, Approximate Calculation
# of Multiple Integrals, T2:5-1.
_A, _B = (6 - np.sqrt(15)) / 21, (6 + np.sqrt(15)) / 21
POINTS = np.array(
    [[1 / 3, 1 / 3]]
    + [p for a in (_A, _B) for p in ([a, a], [1 - 2 * a, a], [a, 1 - 2 * a])]
)
WEIGHTS = np.array(
    [9 / 80] + [(155 - np.sqrt(15)) / 2400] * 3 + [(155 + np.sqrt(15)) / 2400] * 3
)


def faces_within(mesh: TetMesh, ids: Array) -> Array:
    """Return the boundary faces (k, 3 | 6) all of whose vertices are among `ids`."""
    inside = np.zeros(len(mesh.points), dtype=bool)
    inside[ids] = True
    return mesh.surface[inside[mesh.surface].all(axis=1)]


def shape_integrals(mesh: TetMesh, faces: Array) -> tuple[Array, Array]:
    """Return the integrals of each shape function over its face, and times the normal.

    (k, c, 1) and (k, c, 3), both [m^2].
    """
    N, dN = _shapes(faces.shape[1])
    tangents = np.einsum("qac,kai->kqci", dN, mesh.points[faces])
    normal = np.cross(tangents[:, :, 0], tangents[:, :, 1])  # its length: area element
    area = np.linalg.norm(normal, axis=2)
    weighed = N * WEIGHTS[:, None]
    return (area @ weighed)[:, :, None], np.einsum("kqi,qa->kai", normal, weighed)


def _shapes(nodes: int) -> tuple[Array, Array]:
    """Return shape functions (q, c) and their reference gradients (q, c, 2)."""
    r, s = POINTS.T
    l = np.stack([1 - r - s, r, s], axis=1)  # noqa: E741
    dl = np.array([[-1.0, -1], [1, 0], [0, 1]])
    if nodes == 3:
        return l, np.broadcast_to(dl, (len(l), 3, 2))
    one, other = np.array([0, 1, 2]), np.array([1, 2, 0])
    N = np.hstack([l * (2 * l - 1), 4 * l[:, one] * l[:, other]])
    corner = (4 * l - 1)[:, :, None] * dl
    middle = 4 * (l[:, one, None] * dl[other] + l[:, other, None] * dl[one])
    return N, np.concatenate([corner, middle], axis=1)
