"""Conjugate gradients on the factor of a matrix nearby."""

from typing import Any

import numpy as np

from plantsim.arrays import Array
from plantsim.solve.solver import Factor
from plantsim.solve.stats import norm


def refined(
    K: Any, factor: Factor, f: Array, limit: int, *, tolerance: float = 1e-3
) -> Array | None:
    """Return K^-1 f to a relative `tolerance` in the factor's norm, by CG that it precedes.

    None where K is not positive definite along the way, or `limit` steps do not do.
    """
    x, r = np.zeros_like(f), f
    z = factor.precondition(r)
    p, old = z, float(np.einsum("i,i->", r, z))
    first = old
    if not first > 0:
        return x if not norm(f) > 0 else None
    for _ in range(limit):
        q = K @ p
        curvature = float(np.einsum("i,i->", p, q))
        if not curvature > 0:
            return None
        x = x + old / curvature * p
        r = r - old / curvature * q
        z = factor.precondition(r)
        new = float(np.einsum("i,i->", r, z))
        if new <= tolerance**2 * first:
            return x
        p, old = z + new / old * p, new
    return None
