"""Pattern: where the 3 x 3 blocks of K are, and which tets add to each."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import bsr_array, csr_array

from plantsim.arrays import Array

PART = 8192  # blocks of K at a time: some megabytes


@dataclass(frozen=True, eq=False)
class Pattern:
    """CSR over vertices, and the order in which the pairs of tets add up to it.

    A tet with c vertices has p = c (c + 1) / 2 pairs, in the order of
    `np.triu_indices(c)`. Sorted by vertices (lower id first), those of one block of K
    follow each other, from `start` on.
    """

    indptr: Array  # (n + 1,)
    indices: Array  # (blocks,)
    where: Array  # (m, p) place of each pair when sorted
    swapped: Array  # (m, p) bool: the pair's second vertex has the lower id
    tet: Array  # (m p,) tet of each sorted pair
    start: Array  # (halves + 1,) first sorted pair of each block on or above the diagonal
    source: Array  # (blocks,) 2 h for block h of those, 2 h + 1 for its transpose

    @classmethod
    def of(cls, tets: Array, count: int) -> "Pattern":
        """Return the pattern of tets (m, c) on `count` vertices."""
        one, other = np.triu_indices(tets.shape[1])
        tets = tets.astype(np.int32)
        first, second = tets[:, one], tets[:, other]
        low, high = np.minimum(first, second).ravel(), np.maximum(first, second).ravel()
        order = _sorted(low, high, count)
        low, high = low[order], high[order]
        new = np.ones(len(order), dtype=bool)
        new[1:] = (low[1:] != low[:-1]) | (high[1:] != high[:-1])
        start = np.flatnonzero(new)
        low, high = low[start], high[start]
        off = np.flatnonzero(low != high)
        row, column = np.append(low, high[off]), np.append(high, low[off])
        kept = np.append(2 * np.arange(len(low)), 2 * off + 1).astype(np.int32)
        full = _sorted(row, column, count)
        indptr = np.zeros(count + 1, dtype=np.int32)
        np.cumsum(np.bincount(row, minlength=count), out=indptr[1:])
        where = np.empty(len(order), dtype=np.int32)
        where[order] = np.arange(len(order), dtype=np.int32)
        return cls(
            indptr,
            column[full],
            where.reshape(first.shape),
            first > second,
            (order // len(one)).astype(np.int32),
            np.append(start, len(order)).astype(np.int32),
            kept[full],
        )

    def parts(self) -> Iterator[tuple[slice, slice, csr_array]]:
        """Yield sums over pairs, some blocks at a time, so that the work stays in cache.

        Each as: its blocks, its pairs, and a matrix (blocks, pairs) whose data, one a pair,
        is for the caller to fill.
        """
        blocks = len(self.start) - 1
        for first in range(0, blocks, PART):
            last = min(first + PART, blocks)
            start = self.start[first : last + 1] - self.start[first]
            each = np.arange(start[-1], dtype=np.int32)
            sums = csr_array(
                (np.ones(len(each)), each, start), shape=(last - first, len(each))
            )
            yield slice(first, last), slice(self.start[first], self.start[last]), sums

    @cached_property
    def halves(self) -> tuple[csr_array, csr_array]:
        """Sums over pairs in the order of the tets, (blocks, m p): as they are, swapped."""
        order = np.empty(self.where.size, dtype=np.int32)
        order[self.where.ravel()] = np.arange(len(order), dtype=np.int32)
        turned = self.swapped.ravel()[order]
        out = []
        for chosen in (~turned, turned):
            before = np.append(0, np.cumsum(chosen)).astype(np.int32)
            some = order[chosen]
            shape = (len(self.start) - 1, len(order))
            out.append(
                csr_array((np.ones(len(some)), some, before[self.start]), shape=shape)
            )
        return out[0], out[1]

    def matrix(self, both: Array) -> csr_array:
        """Return the matrix (3n, 3n) of blocks (2 halves, 3, 3), each then its mirror."""
        indptr, indices, source = self._scalar
        data = both.reshape(-1, 3).take(source, axis=0).ravel()
        n = len(indptr) - 1
        return csr_array((data, indices, indptr), shape=(n, n))

    @cached_property
    def _rows(self) -> Array:
        """Where each row of each block is among the threes of K's data, (blocks, 3)."""
        count = np.diff(self.indptr)
        first, wide = np.repeat([2 * self.indptr[:-1], count], count, axis=1)
        return (np.arange(len(first)) + first)[:, None] + wide[:, None] * np.arange(3)

    @cached_property
    def _scalar(self) -> tuple[Array, Array, Array]:
        """CSR over components, and each three of its data among the rows of the blocks."""
        rows = self._rows.ravel()
        source = np.empty(len(rows), dtype=np.int32)
        source[rows] = (3 * self.source[:, None] + np.arange(3)).ravel()
        column = np.empty(len(rows), dtype=np.int32)
        column[rows] = np.repeat(3 * self.indices, 3)
        indices = (column[:, None] + np.arange(3, dtype=np.int32)).ravel()
        indptr = np.zeros(3 * len(self.indptr) - 2, dtype=np.int32)
        np.cumsum(np.repeat(3 * np.diff(self.indptr), 3), out=indptr[1:])
        return indptr, indices, source

    @cached_property
    def positions(self) -> csr_array:
        """CSR over vertices whose entries count the blocks, from 1."""
        n = len(self.indptr) - 1
        where = np.arange(1, len(self.indices) + 1)
        return csr_array((where, self.indices, self.indptr), shape=(n, n))

    def condense(self, K: csr_array, rows: Array, columns: Array) -> bsr_array:
        """Return the blocks of K in these vertices' rows and columns."""
        part = self.positions[rows][:, columns]
        shape = (3 * len(rows), 3 * len(columns))
        data = K.data.reshape(-1, 3)[self._rows[part.data - 1]]
        return bsr_array((data, part.indices, part.indptr), shape=shape)


def _sorted(row: Array, column: Array, count: int) -> Array:
    """Return the order by row, then column: two counting sorts, by scipy's CSR to CSC."""
    by_column = _counted(column, count)
    return by_column[_counted(row[by_column], count)]


def _counted(key: Array, count: int) -> Array:
    each = np.arange(len(key) + 1, dtype=np.int32)
    ones = np.ones(len(key), dtype=np.int8)
    return csr_array((ones, key, each), shape=(len(key), count)).tocsc().indices
