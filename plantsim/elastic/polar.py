"""Polar decomposition of many 3 x 3 matrices: the nearest rotation of each."""

import numpy as np

from plantsim.arrays import Array

STEPS = 12  # Newton doubles its digits; it needs 5 for strains below 0.5
SOUND = 0.05  # of det F: below, by singular values


def rotations(F: Array) -> Array:
    """Return the rotation nearest to each matrix, (k, 3, 3), also where it is inverted.

    Newton's iteration R <- (R + R^-T) / 2 (Higham 1986), all matrices at once; where det F
    is small or negative, singular values with the sign of the least one turned, so that
    det R = 1 (Irving, Teran, Fedkiw 2004).
    """
    R = np.ascontiguousarray(F.transpose(1, 2, 0))
    hard = np.zeros(F.shape[0], dtype=bool)
    change = np.zeros_like(R)
    for step in range(STEPS):
        C, det = cofactors(R)
        if step == 0:
            hard = det < SOUND
            if hard.any():
                R[:, :, hard] = np.eye(3)[:, :, None]
                C, det = cofactors(R)
        new = (R + C / det) / 2
        change = np.abs(new - R)
        R = new
        if not change.max(initial=0.0) > 1e-9:  # the next error is its square
            break
    else:
        hard |= (change > 1e-9).any(axis=(0, 1))
    out = np.ascontiguousarray(R.transpose(2, 0, 1))
    if hard.any():
        U, _, Vt = np.linalg.svd(F[hard])
        U[:, :, 2] *= np.sign(np.linalg.det(U @ Vt))[:, None]
        out[hard] = U @ Vt
    return out


def cofactors(A: Array) -> tuple[Array, Array]:
    """Return the cofactors (3, 3, k) and determinants (k,) of matrices (3, 3, k)."""
    C = np.empty_like(A)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        for a in range(3):
            b, c = (a + 1) % 3, (a + 2) % 3
            C[i, a] = A[j, b] * A[k, c] - A[j, c] * A[k, b]
    return C, A[0, 0] * C[0, 0] + A[0, 1] * C[0, 1] + A[0, 2] * C[0, 2]
