"""Unit-parameter stiffness blocks of tets, and K on a cached pattern.

The definition is `elasticity`, a scikit-fem form. Both of its blocks for a tet (mu = 1, lam
= 0 and mu = 0, lam = 1) follow from one tensor of the tet's scalar shape functions,

    H[a, i, b, j] = integral of  d_i phi_a  d_j phi_b,

which is the lam block itself; the mu block is  delta_ij H[a, k, b, k] + H[a, j, b, i].
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.sparse import bsr_array, csr_array
from skfem import Basis, BilinearForm, ElementTetP1, ElementTetP2, MeshTet, MeshTet2
from skfem.helpers import ddot, eye, sym_grad, trace

from plantsim.arrays import Array
from plantsim.mesh.tetmesh import TetMesh

CHUNK = 20_000  # tets at a time: scikit-fem's Basis holds every gradient at every point


@BilinearForm
def elasticity(u: Any, v: Any, w: Any) -> Any:
    """Return 2 mu eps(u) : eps(v) + lam div u div v, with fields `mu` and `lam` in w."""
    strain = sym_grad(u)
    return ddot(2 * w.mu * strain + eye(w.lam * trace(strain), 3), sym_grad(v))


@dataclass(frozen=True, eq=False)
class Blocks:
    """What elasticity needs of each tet, whatever its moduli; c = 4 or 10 shape functions.

    Memory: 8 (9 c^2 + 4 c + 1) bytes a tet: 1.3 kB at order 1, 7.5 kB at order 2.
    """

    H: Array  # (m, c, 3, c, 3) [m]
    gradient: Array  # (m, c, 3) mean gradient of each shape function [1/m]
    weight: Array  # (m, c) integral of each shape function [m^3]
    volume: Array  # (m,) [m^3]

    def forces(self, tets: Array, u: Array) -> tuple[Array, Array]:
        """Return nodal forces (m, c, 3) of each tet for mu = 1, for lam = 1; u (n, 3)."""
        ue = u[tets]
        m, c = tets.shape
        lam = (self.H.reshape(m, 3 * c, 3 * c) @ ue.reshape(m, 3 * c, 1)).reshape(m, c, 3)
        mu = np.einsum("eajbi,ebj->eai", self.H, ue, optimize=True)
        mu += np.einsum("eakbk->eab", self.H) @ ue
        return mu, lam

    def element(self, mu: Array, lam: Array) -> Array:
        """Return element stiffness (m, c, 3, c, 3) for moduli (m,) [Pa]."""
        K = lam[:, None, None, None, None] * self.H
        scaled = mu[:, None, None, None, None] * self.H
        K += scaled.transpose(0, 1, 4, 3, 2)
        trace_ab = np.einsum("eakbk->eab", scaled)
        for i in range(3):
            K[:, :, i, :, i] += trace_ab
        return K


def blocks(mesh: TetMesh) -> Blocks:
    """Return the blocks of a mesh, from scikit-fem's Basis."""
    m, c = mesh.tets.shape
    H = np.empty((m, 3 * c, 3 * c))
    gradient, weight, volume = np.empty((m, c, 3)), np.empty((m, c)), np.empty(m)
    curved = mesh.curved
    for start in range(0, m, CHUNK):
        part = slice(start, start + CHUNK)
        basis: Any = scalar_basis(mesh.points, mesh.tets[part], curved)
        dx = np.asarray(basis.dx)  # (e, q)
        G = np.stack([basis.basis[a][0].grad for a in range(c)])  # (c, 3, e, q)
        G = G.transpose(2, 0, 1, 3).reshape(len(dx), 3 * c, -1)
        H[part] = (G * dx[:, None]) @ G.transpose(0, 2, 1)
        volume[part] = dx.sum(axis=1)
        gradient[part] = ((G * dx[:, None]).sum(axis=2) / volume[part, None]).reshape(
            -1, c, 3
        )
        for a in range(c):
            weight[part, a] = (np.asarray(basis.basis[a][0]) * dx).sum(axis=1)
    return Blocks(H.reshape(m, c, 3, c, 3), gradient, weight, volume)


def scalar_basis(points: Array, tets: Array, curved: bool) -> Basis:
    """Return scikit-fem's scalar basis; local functions in the order of columns."""
    used, local = np.unique(tets, return_inverse=True)
    local = np.ascontiguousarray(local.reshape(tets.shape).T, dtype=np.int32)
    p = np.ascontiguousarray(points[used].T)
    if curved:
        # products of gradients on curved tets are rational: degree 4 holds them to ~1e-5
        mesh = MeshTet2(p, local, validate=False)
        return Basis(mesh, ElementTetP2(), intorder=4)
    mesh = MeshTet(p, local[:4], validate=False)
    if len(local) == 4:
        return Basis(mesh, ElementTetP1(), intorder=1)
    return Basis(mesh, ElementTetP2(), intorder=2)


@dataclass(frozen=True, eq=False)
class Pattern:
    """Where the 3 x 3 blocks of K are: CSR over vertices, and each tet's entries in it."""

    indptr: Array
    indices: Array
    slot: Array  # (m c c,) position of each vertex pair of each tet

    @classmethod
    def of(cls, tets: Array, count: int) -> "Pattern":
        """Return the pattern of tets (m, c) on `count` vertices."""
        key = (tets[:, :, None] * count + tets[:, None, :]).ravel()
        pairs, slot = np.unique(key, return_inverse=True)
        row, column = np.divmod(pairs, count)
        indptr = np.searchsorted(row, np.arange(count + 1))
        return cls(indptr.astype(np.int32), column.astype(np.int32), slot.astype(np.int32))

    def assemble(self, element: Array) -> bsr_array:
        """Return K (3n, 3n) from element stiffness (m, c, 3, c, 3)."""
        data = np.empty((len(self.indices), 3, 3))
        for i in range(3):
            for j in range(3):
                entries = element[:, :, i, :, j].ravel()
                data[:, i, j] = np.bincount(self.slot, entries, minlength=len(data))
        n = 3 * (len(self.indptr) - 1)
        return bsr_array((data, self.indices, self.indptr), shape=(n, n))

    @cached_property
    def positions(self) -> csr_array:
        """CSR over vertices whose entries count the blocks, from 1."""
        n = len(self.indptr) - 1
        where = np.arange(1, len(self.indices) + 1)
        return csr_array((where, self.indices, self.indptr), shape=(n, n))

    def condense(self, K: bsr_array, rows: Array, columns: Array) -> bsr_array:
        """Return the blocks of K in these vertices' rows and columns."""
        part = self.positions[rows][:, columns]
        shape = (3 * len(rows), 3 * len(columns))
        return bsr_array((K.data[part.data - 1], part.indices, part.indptr), shape=shape)
