"""Sections: a factor of K along a body's cross-sections, for many right-hand sides at once.

Vertices at one number of edges from an end of the body fall into connected pieces, the
sections. A section has neighbours in one section nearer that end and in some farther off,
so sections are a tree, whatever the body is, and its block Cholesky factor, made from the
far ends on, has no entries beyond it:

    L_c L_c^T = K_cc - sum over the children d of c of H_d H_d^T,   H_c = K_pc L_c^-T,

p the parent of c. All blocks are dense, contiguous, and on a plant some tens wide: every
step is one matrix product for all right-hand sides, while a sparse factor with half as many
entries goes through them a few at a time.
Source: level structures, George and Liu 1981, Computer Solution of Large Sparse Positive
Definite Systems, chapter 4; the elimination is that of a block tridiagonal matrix.
"""

from functools import cached_property
from typing import Any

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components, dijkstra

from plantsim.arrays import Array
from plantsim.errors import SolverError
from plantsim.solve.stats import accepted, norm_inf

# Entries an unknown. At 50 and 85 (order 1) a hundred right-hand sides take a quarter of
# SuperLU's time, ten three quarters
THIN = 120
LEAST = 10  # vertices up to which a section is joined to the next
# Right-hand sides at a time: of more BLAS makes the products with threads, which on a busy
# machine wait for one another
WIDE = 100


class Layout:
    """The sections of a body: the same for every K of its pattern."""

    def __init__(self, K: Any) -> None:
        """Cut the body of K (3n, 3n), BSR with blocks 3 x 3, in sections."""
        n = K.shape[0] // 3
        row = np.repeat(np.arange(n), np.diff(K.indptr))
        column = K.indices.astype(np.int64)
        section, parent = _joined(*_sections(row, column, n))
        width = 3 * np.bincount(section)
        self.start = np.concatenate([[0], np.cumsum(width)])
        self.parent = parent
        tall = width + np.where(parent >= 0, width[parent], 0)
        self.offset = np.concatenate([[0], np.cumsum(tall * width)])
        order = np.argsort(section, kind="stable")
        self.order = (3 * order[:, None] + np.arange(3)).ravel()
        # where blocks of K go: a section's own rows, then its parent's
        s, at = section[column], np.empty(n, dtype=np.int64)
        at[order] = 3 * np.arange(n) - self.start[section[order]]
        own = section[row] == s
        self.taken = np.flatnonzero(own | (section[row] == parent[s]))
        s, own = s[self.taken], own[self.taken]
        line = at[row[self.taken]] + np.where(own, 0, width[s])
        first = self.offset[s] + line * width[s] + at[column[self.taken]]
        three = np.arange(3)
        self.place = first[:, None, None] + three[:, None] * width[s][:, None, None] + three

    @property
    def entries(self) -> int:
        """Entries of the factor."""
        return int(self.offset[-1])

    @property
    def thin(self) -> bool:
        """Whether sections are so small that a factor along them is the faster one."""
        return self.entries <= THIN * len(self.order)


def _sections(row: Array, column: Array, n: int) -> tuple[Array, Array]:
    """Return the section of each vertex, and each one's parent or -1; children first."""
    graph = csr_array((np.ones(len(row)), (row, column)), shape=(n, n))
    _, piece = connected_components(graph, directed=False)
    _, some = np.unique(piece, return_index=True)
    far = _levels(graph, some)
    order = np.lexsort((far, piece))  # the farthest of each piece is an end
    last = np.append(np.diff(piece[order]) != 0, True)
    level = _levels(graph, order[last])
    by_level = np.argsort(level, kind="stable")
    first = np.searchsorted(level[by_level], np.arange(level.max() + 2))
    local = np.empty(n, dtype=np.int64)
    local[by_level] = np.arange(n) - first[level[by_level]]
    edges = np.flatnonzero((level[column] >= level[row]) & (row != column))
    edges = edges[np.argsort(level[row[edges]], kind="stable")]
    bounds = np.searchsorted(level[row[edges]], np.arange(level.max() + 2))
    section = np.empty(n, dtype=np.int64)
    parents: list[Array] = []
    made = before = 0  # sections so far, and those before the last level's
    for k in range(int(level.max()), -1, -1):
        here = by_level[first[k] : first[k + 1]]
        e = edges[bounds[k] : bounds[k + 1]]
        i, j = row[e], column[e]
        beyond = level[j] > k
        to = np.where(beyond, len(here) + section[j] * beyond - before * beyond, local[j])
        size = len(here) + made - before
        links = csr_array((np.ones(len(e)), (local[i], to)), shape=(size, size))
        count, label = connected_components(links, directed=False)
        section[here] = made + label[: len(here)]
        parents.append(made + label[len(here) :])
        made, before = made + count, made
    parents.append(np.full(made - before, -1))
    return section, np.concatenate(parents)


def _levels(graph: csr_array, ends: Array) -> Array:
    """Return how many edges each vertex is from the nearest of some."""
    away = dijkstra(graph, unweighted=True, indices=ends, min_only=True)
    return away.astype(np.int64)


def _joined(section: Array, parent: Array) -> tuple[Array, Array]:
    """Return sections and parents with thin ones joined to their parents."""
    size = np.bincount(section).tolist()
    above = parent.tolist()
    into = list(range(len(size)))
    for c, p in enumerate(above):
        if p >= 0 and size[c] + size[p] <= LEAST:
            into[c] = p
            size[p] += size[c]
    for c in range(len(into) - 1, -1, -1):
        into[c] = into[into[c]]
    kept, place = np.unique(into, return_inverse=True)
    up = parent[kept]
    return place[section], np.where(up >= 0, place[up], -1)


class Sections:
    """The factor of one K, positive definite, ready for right-hand sides."""

    name = "direct"
    backend = "LAPACK, block Cholesky along cross-sections"
    definite = True  # or it could not be made
    threads = False  # BLAS has its own

    def __init__(self, K: Any, layout: Layout, tolerance: float = 1e-10) -> None:
        """Factor K, of the pattern of the layout; SolverError if K is not definite."""
        self.K, self.layout, self.tolerance = K, layout, tolerance
        entries = np.zeros(layout.entries)
        entries[layout.place] = K.data[layout.taken]
        start, parent = layout.start.tolist(), layout.parent.tolist()
        offset = layout.offset.tolist()
        panels = [
            entries[offset[c] : offset[c + 1]].reshape(-1, start[c + 1] - start[c])
            for c in range(len(parent))
        ]
        self._steps = []
        for c, panel in enumerate(panels):
            a, b, p = start[c], start[c + 1], parent[c]
            S, below = panel[: b - a], panel[b - a :]
            try:
                half = np.linalg.inv(np.linalg.cholesky(S))
            except np.linalg.LinAlgError:
                raise SolverError(
                    f"direct: K of {K.shape[0]:,} unknowns is not positive definite. If "
                    "singular, hold more vertices."
                ) from None
            across = below @ half.T
            above = slice(0, 0)
            if p >= 0:
                panels[p][: start[p + 1] - start[p]] -= across @ across.T
                above = slice(start[p], start[p + 1])
            self._steps.append((slice(a, b), above, half, across))

    @cached_property
    def size(self) -> float:
        """A norm of K."""
        return norm_inf(self.K)

    def precondition(self, f: Array) -> Array:
        """Return K^-1 f, (n,) or (n, k), unchecked."""
        if f.ndim == 1:
            return self.precondition(f[:, None])[:, 0]
        out = np.empty(f.shape)
        for first in range(0, f.shape[1], WIDE):
            x = f[self.layout.order, first : first + WIDE]
            for own, above, half, across in self._steps:
                x[own] = half @ x[own]
                x[above] -= across @ x[own]
            for own, above, half, across in reversed(self._steps):
                x[own] = half.T @ (x[own] - across.T @ x[above])
            out[self.layout.order, first : first + WIDE] = x
        return out

    def __call__(self, f: Array, *, check: bool = True) -> tuple[Array, int, Array]:
        """Return the solution (n,) or (n, k), 0 iterations and the backward errors."""
        u = self.precondition(f)
        if not check:
            return u, 0, np.full(f.shape[1:], np.nan)
        return u, 0, accepted(self.K, self.size, u, f, self.tolerance)

    def compliance(self, rows: Array) -> None:
        """Return None: whole columns are cheap."""
