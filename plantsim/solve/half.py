"""Half: compliance among a few unknowns, by the forward half of a factor alone.

With P K P^T = L D L^T and unit columns E,  E^T K^-1 E = Z^T D^-1 Z  with  L Z = P E. Z is
zero off the paths from E to the root of the elimination tree, which on a plant are short:
ten vertices of 5,000 reach a third of the columns, so that this costs a fifth of thirty
whole solves. Source: Gilbert and Peierls 1988; Davis, Direct Methods, chapter 3.
"""

from typing import Any, Self

import numpy as np
from scipy.sparse import csc_array
from scipy.sparse.linalg import spsolve_triangular

from plantsim.arrays import Array

MOST = 40_000_000  # entries of L + U for which a copy of the factor is made: 480 MB

FEW = 60  # unknowns up to which BLAS and its threads gain nothing


class Half:
    """L, D and the elimination tree, out of SuperLU."""

    def __init__(self, lower: Any, pivots: Array, place: Array) -> None:
        self._lower, self._pivots, self._place = lower, pivots, place
        n = lower.shape[0]
        # sorted, a column's first entry is its diagonal, its second its parent
        second = np.minimum(lower.indptr[:-1] + 1, lower.nnz - 1)
        self._parent = np.where(np.diff(lower.indptr) > 1, lower.indices[second], n)

    @classmethod
    def of(cls, lu: Any) -> Self | None:
        """Return the half of a symmetric factor; None if it is too large, or pivoted."""
        if lu.nnz > MOST or not np.array_equal(lu.perm_r, lu.perm_c):
            return None
        lower, pivots = lu.L, lu.U.diagonal()
        lower.sort_indices()
        return cls(lower, pivots, lu.perm_r) if (pivots > 0).all() else None

    def between(self, rows: Array) -> Array:
        """Return K^-1 among some unknowns (k,), (k, k), symmetric."""
        at = self._place[rows]
        reach = self._reach(at)
        part = self._lower[:, reach]
        local = np.zeros(self._lower.shape[0], dtype=np.int32)
        local[reach] = np.arange(len(reach), dtype=np.int32)
        L = csc_array(
            (part.data, local[part.indices], part.indptr), shape=(len(reach),) * 2
        )
        unit = np.zeros((len(reach), len(at)))
        unit[local[at], np.arange(len(at))] = 1.0
        Z = spsolve_triangular(L, unit, unit_diagonal=True, overwrite_A=True)
        Z /= np.sqrt(self._pivots[reach])[:, None]
        # few without BLAS, as in `stats.norm`
        return np.einsum("ij,ik->jk", Z, Z) if len(at) <= FEW else Z.T @ Z

    def _reach(self, at: Array) -> Array:
        """Return the columns on the paths from some to the root, ascending."""
        root = len(self._parent)
        seen = np.zeros(root + 1, dtype=bool)
        seen[root] = True
        for j in at.tolist():
            while not seen[j]:
                seen[j] = True
                j = self._parent[j]  # noqa: PLW2901
        return np.flatnonzero(seen[:root])
