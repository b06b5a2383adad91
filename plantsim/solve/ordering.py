"""Ordering: that of one SuperLU factor, for the factors of more matrices of its pattern.

Finding it takes a third of the time of a factor of some 15,000 unknowns.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self

import numpy as np
from scipy.sparse import csc_array
from scipy.sparse.linalg import splu

from plantsim.arrays import Array

# SuperLU for symmetric positive definite matrices: no pivots are sought
SYMMETRIC: dict[str, Any] = {
    "permc_spec": "MMD_AT_PLUS_A",
    "diag_pivot_thresh": 0.0,
    "options": {"SymmetricMode": True},
}
NATURAL = {**SYMMETRIC, "permc_spec": "NATURAL"}


@dataclass(frozen=True, eq=False)
class Ordering:
    """Which unknown is eliminated when, and where the entries of K go for it."""

    indptr: Array  # of K
    indices: Array
    first: Array  # (n,) the unknown eliminated first, second, ...
    permuted: csc_array  # K in that order; its data count K's entries

    @classmethod
    def of(cls, K: csc_array, lu: Any) -> Self:
        """Return the ordering of a factor of K, symmetric."""
        first = np.argsort(lu.perm_c)
        count = csc_array((np.arange(K.nnz), K.indices, K.indptr), shape=K.shape)
        permuted = count[first][:, first]
        permuted.sort_indices()
        return cls(K.indptr, K.indices, first, permuted)

    def fits(self, K: Any) -> bool:
        """Return whether K has the pattern that this is of."""
        return np.array_equal(self.indptr, K.indptr) and np.array_equal(
            self.indices, K.indices
        )

    def factor(self, K: Any) -> "Ordered":
        """Return the factor of a matrix of the same pattern."""
        data = K.data[self.permuted.data]
        A = csc_array((data, self.permuted.indices, self.permuted.indptr), shape=K.shape)
        return Ordered(splu(A, panel_size=1, **NATURAL), self.first)


class Ordered:
    """A factor of K in another order, behind what is used of SuperLU."""

    def __init__(self, lu: Any, first: Array) -> None:
        self._lu, self._first = lu, first

    def solve(self, f: Array) -> Array:
        """Return K^-1 f, (n,) or (n, k)."""
        out = np.empty_like(f)
        out[self._first] = self._lu.solve(np.asfortranarray(f[self._first]))
        return out

    @property
    def nnz(self) -> int:
        """Entries of L and U."""
        return self._lu.nnz

    @property
    def L(self) -> Any:
        """The lower factor, unit diagonal, in the order of elimination."""
        return self._lu.L

    @property
    def U(self) -> Any:
        """The upper factor."""
        return self._lu.U

    @cached_property
    def perm_r(self) -> Array:
        """Place of each row of K in the order of elimination."""
        return self._placed(self._lu.perm_r)

    @cached_property
    def perm_c(self) -> Array:
        """Place of each column."""
        return self._placed(self._lu.perm_c)

    def _placed(self, inner: Array) -> Array:
        out = np.empty_like(inner)
        out[self._first] = inner
        return out
