"""Shapes of single tets: quality of the corners, Jacobians of curved tets."""

import numpy as np

from plantsim.arrays import Array

BLOCK = 500  # tets at a time
EDGES = np.array([[0, 1], [1, 2], [0, 2], [0, 3], [1, 3], [2, 3]])  # VTK: nodes 4 to 9
_CORNERS = np.vstack([np.zeros(3), np.eye(3)])
# The ten nodes, drawn a tenth of the way to the centre, where a curved tet must not be
# folded. At a corner itself det J is zero where two edges lie on one smooth curve of the
# surface, which does no harm: no integration point is there.
INNER = 0.9 * np.vstack([_CORNERS, _CORNERS[EDGES].mean(axis=1)]) + 0.1 / 4


def gamma(x: Array) -> Array:
    """Return 3 inradius / circumradius of tets (..., 4, 3), signed as the volume.

    This is gmsh's quality measure "gamma".
    """
    corners = np.ascontiguousarray(np.moveaxis(x, (-2, -1), (0, 1)))
    u, v, w = corners[1:] - corners[0]
    uv, uw, vw = _cross(u, v), _cross(u, w), _cross(v, w)
    volume = (uv * w).sum(axis=0) / 6
    faces = sum(_norm(n) for n in (uv, uw, vw, uv - uw + vw)) / 2
    sides = [(_norm(a), _norm(b)) for a, b in ((u, v - w), (v, u - w), (w, u - v))]
    p, q, r = (a * b for a, b in sides)
    # 24 V R = sqrt of this product, for the circumradius R
    product = (p + q + r) * (-p + q + r) * (p - q + r) * (p + q - r)
    # where the corners are nearly on one circle the root is noise, but R is half the
    # longest edge at least
    longest = np.max([s for pair in sides for s in pair], axis=0)
    root = np.maximum(np.sqrt(np.maximum(product, 0)), 12 * np.abs(volume) * longest)
    tiny = np.finfo(float).tiny
    return np.sign(volume) * 216 * volume**2 / np.maximum(root * faces, tiny)


def _cross(a: Array, b: Array) -> Array:
    """Return cross products of vectors (3, ...) by components."""
    return np.stack([a[i - 2] * b[i - 1] - a[i - 1] * b[i - 2] for i in range(3)])


def _norm(a: Array) -> Array:
    return np.sqrt((a**2).sum(axis=0))


def jacobians(points: Array, tets: Array, at: Array) -> Array:
    """Return det J (m, k) of quadratic tets at reference points (k, 3)."""
    shape = _gradients(at).transpose(2, 0, 1).reshape(-1, 10)  # (3 k, 10)
    out = np.empty((len(tets), len(at)))
    # by blocks that stay in the cache, and for which BLAS does not wake its threads
    for start in range(0, len(tets), BLOCK):
        block = tets[start : start + BLOCK].T
        x, y, z = (
            (shape @ points[:, axis][block]).reshape(3, len(at), -1) for axis in range(3)
        )
        J = x[0] * (y[1] * z[2] - y[2] * z[1])
        J += x[1] * (y[2] * z[0] - y[0] * z[2])
        J += x[2] * (y[0] * z[1] - y[1] * z[0])
        out[start : start + BLOCK] = J.T
    return out


def _gradients(at: Array) -> Array:
    """Return reference gradients (k, 10, 3) of the quadratic shape functions."""
    grad_l = np.vstack([-np.ones(3), np.eye(3)])
    l = np.column_stack([1 - at.sum(axis=1), at])  # noqa: E741
    corner = (4 * l - 1)[:, :, None] * grad_l
    i, j = EDGES.T
    middle = 4 * (l[:, i, None] * grad_l[j] + l[:, j, None] * grad_l[i])
    return np.concatenate([corner, middle], axis=1)
