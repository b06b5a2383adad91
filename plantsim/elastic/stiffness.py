"""Unit-parameter stiffness blocks of tets, and K on a cached pattern.

The definition is `elasticity`, a scikit-fem form. Both of its blocks for a tet (mu = 1, lam
= 0 and mu = 0, lam = 1) follow from one tensor of the tet's scalar shape functions,

    H[a, i, b, j] = integral of  d_i phi_a  d_j phi_b,

which is the lam block itself; the mu block is  delta_ij H[a, k, b, k] + H[a, j, b, i]. H
is symmetric, so pairs a <= b are kept, c (c + 1) / 2 of 3 x 3. On a tet with straight edges
H is a constant of the element, from scikit-fem's Basis on the reference tet, times the
gradients of the barycentric coordinates; on a curved one it is the Basis' own sum.
"""

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from scipy.sparse import csr_array
from skfem import Basis, BilinearForm, ElementTetP1, ElementTetP2, MeshTet, MeshTet2
from skfem.helpers import ddot, eye, sym_grad, trace

from plantsim.arrays import Array
from plantsim.elastic.pattern import PART, Pattern
from plantsim.mesh.tetmesh import EDGES, TetMesh

CHUNK = 20_000  # tets at a time: scikit-fem's Basis holds every gradient at every point


@BilinearForm
def elasticity(u: Any, v: Any, w: Any) -> Any:
    """Return 2 mu eps(u) : eps(v) + lam div u div v, with fields `mu` and `lam` in w."""
    strain = sym_grad(u)
    return ddot(2 * w.mu * strain + eye(w.lam * trace(strain), 3), sym_grad(v))


@dataclass(frozen=True, eq=False)
class Blocks:
    """What elasticity needs of each tet, whatever its moduli; c = 4 or 10 shape functions.

    Memory with the pattern and K's indices: 1.3 kB a tet at order 1, 8.6 kB at order 2.
    """

    pattern: Pattern
    # (m p, 3, 3) [m]: H of every pair of every tet, in the pattern's order, where the sums
    # of K run along memory; [i, j] with i of the pair's first vertex
    pairs: Array
    gradient: Array  # (m, c, 3) mean gradient of each shape function [1/m]
    weight: Array  # (m, c) integral of each shape function [m^3]
    volume: Array  # (m,) [m^3]

    def tensor(self, part: slice = slice(None)) -> Array:
        """Return H of some tets whole, (m, c, 3, c, 3) [m]: 7.2 kB a tet at order 2."""
        at = self.pattern.where[part]
        c = self.gradient.shape[1]
        one, other = np.triu_indices(c)
        pairs = self.pairs[at]
        pairs = np.where(
            self.pattern.swapped[part][:, :, None, None], pairs.swapaxes(2, 3), pairs
        )
        H = np.empty((len(at), c, c, 3, 3))
        H[:, one, other] = pairs
        H[:, other, one] = pairs.swapaxes(2, 3)
        return H.transpose(0, 1, 3, 2, 4).copy()

    def forces(self, tets: Array, u: Array) -> tuple[Array, Array]:
        """Return nodal forces (m, c, 3) of each tet for mu = 1, for lam = 1; u (n, 3)."""
        m, c = tets.shape
        mu, lam = np.empty((2, m, c, 3))
        for start in range(0, m, CHUNK):
            part = slice(start, start + CHUNK)
            H, ue = self.tensor(part), u[tets[part]]
            flat = H.reshape(-1, 3 * c, 3 * c)
            lam[part] = (flat @ ue.reshape(-1, 3 * c, 1)).reshape(-1, c, 3)
            mu[part] = np.einsum("eajbi,ebj->eai", H, ue, optimize=True)
            mu[part] += np.einsum("eakbk->eab", H) @ ue
        return mu, lam

    def work(self, tets: Array, u: Array, v: Array) -> tuple[Array, Array]:
        """Return v . K u of each tet for mu = 1, for lam = 1, (m,) [m^3]; u, v (n, 3).

        With v an adjoint field, the negative derivatives by each modulus.
        """
        if self.gradient.shape[1] == 4:  # the strain is the same all over a tet
            Du, Dv = (self.gradient.transpose(0, 2, 1) @ x[tets] for x in (u, v))
            shear = np.einsum("eij,eij->e", Du + Du.transpose(0, 2, 1), Dv)
            spread = np.einsum("eii->e", Du) * np.einsum("eii->e", Dv)
            return self.volume * shear, self.volume * spread
        mu, lam = self.forces(tets, u)
        ve = v[tets]
        return np.einsum("eai,eai->e", mu, ve), np.einsum("eai,eai->e", lam, ve)

    def stiffness(self, mu: Array, lam: Array) -> csr_array:
        """Return K (3n, 3n) for moduli (m,) [Pa]."""
        # the block of a pair (a, b) is  lam H + mu (H^T + tr H I),  that of (b, a) its
        # transpose
        flat, tet = self.pairs.reshape(-1, 9), self.pattern.tet
        both = np.empty((len(self.pattern.start) - 1, 2, 3, 3))
        for blocks, pairs, sums in self.pattern.parts():
            sums.data = lam[tet[pairs]]
            K = (sums @ flat[pairs]).reshape(-1, 3, 3)
            sums.data = mu[tet[pairs]]
            shear = (sums @ flat[pairs]).reshape(-1, 3, 3)
            K += shear.swapaxes(1, 2)
            trace_ab = shear[:, 0, 0] + shear[:, 1, 1] + shear[:, 2, 2]
            for i in range(3):
                K[:, i, i] += trace_ab
            both[blocks, 0] = K
            both[blocks, 1] = K.swapaxes(1, 2)
        return self.pattern.matrix(both)


def blocks(mesh: TetMesh, pattern: Pattern | None = None) -> Blocks:
    """Return the blocks of a mesh, from scikit-fem's Basis."""
    pattern = pattern or Pattern.of(mesh.tets, len(mesh.points))
    if mesh.order == 1:
        return _linear(mesh, pattern)
    m, c = mesh.tets.shape
    pairs = np.empty((pattern.where.size, 3, 3))
    gradient, weight, volume = np.empty((m, c, 3)), np.empty((m, c)), np.empty(m)
    bent = mesh.bent
    for kind, make in ((~bent, _straight), (bent, _curved)):
        chosen = np.flatnonzero(kind)
        for start in range(0, len(chosen), CHUNK):
            part = chosen[start : start + CHUNK]
            H, gradient[part], weight[part], volume[part] = make(
                mesh.points, mesh.tets[part]
            )
            turned = pattern.swapped[part]
            H[turned] = H[turned].swapaxes(1, 2)
            pairs[pattern.where[part].ravel()] = H.reshape(-1, 3, 3)
    return Blocks(pattern, pairs, gradient, weight, volume)


def _linear(mesh: TetMesh, pattern: Pattern) -> Blocks:
    """Return the blocks at order 1, where H is the volume times two gradients."""
    m = len(mesh.tets)
    G, volume = np.empty((m, 4, 3)), np.empty(m)
    for start in range(0, m, CHUNK):
        part = slice(start, start + CHUNK)
        basis: Any = scalar_basis(mesh.points, mesh.tets[part], False)
        gradient, _, dx = _fields(basis)
        G[part], volume[part] = gradient[:, :, :, 0], dx[:, 0]
    # straight into the pattern's order
    one, other = np.triu_indices(4)
    at = 4 * np.arange(m)[:, None]
    first, second = np.empty((2, pattern.where.size), dtype=np.int32)
    first[pattern.where] = at + np.where(pattern.swapped, other, one)
    second[pattern.where] = at + np.where(pattern.swapped, one, other)
    scaled = (G * volume[:, None, None]).reshape(-1, 3)
    plain = G.reshape(-1, 3)
    pairs = np.empty((pattern.where.size, 3, 3))
    for start in range(0, len(pairs), PART):
        part = slice(start, start + PART)
        left, right = scaled.take(first[part], axis=0), plain.take(second[part], axis=0)
        out = pairs[part]
        for i in range(3):  # three times as fast as one product of (s, 3, 1) and (s, 1, 3)
            np.multiply(left[:, i : i + 1], right, out=out[:, i])
    return Blocks(pattern, pairs, G, np.repeat(volume[:, None] / 4, 4, axis=1), volume)


@cache
def _constants(order: int) -> tuple[Array, Array, Array, Array]:
    """Return integrals over the reference tet, over its volume.

    Of d_k phi_a d_l phi_b for pairs a <= b, (p, 9); of d_k phi_a, (c, 3); of phi_a, (c,);
    of phi_a phi_b for the pairs, (p,).
    """
    points = np.vstack([np.zeros(3), np.eye(3)])
    if order == 2:
        points = np.vstack([points, points[EDGES].mean(axis=1)])
    basis: Any = scalar_basis(points, np.arange(len(points))[None], False, exact_mass=True)
    G, N, dx = _fields(basis)
    one, other = np.triu_indices(len(points))
    w = dx[0] / dx.sum()
    H = np.einsum("akq,blq,q->abkl", G[0], G[0], w)[one, other].reshape(-1, 9)
    mass = np.einsum("aq,bq,q->ab", N[0], N[0], w)[one, other]
    return H, G[0] @ w, N[0] @ w, mass


def _straight(points: Array, tets: Array) -> tuple[Array, Array, Array, Array]:
    H, first, zeroth, _ = _constants(1 if tets.shape[1] == 4 else 2)
    # barycentric coordinates are the order-1 shape functions; all but the first are the
    # reference coordinates
    basis: Any = scalar_basis(points, tets[:, :4], False)
    G, _, dx = _fields(basis)
    volume = dx.sum(axis=1)
    D = G[:, 1:, :, 0]
    T = (volume[:, None, None, None, None] * D[:, :, None, :, None]) * D[:, None, :, None]
    pairs = (H @ T.reshape(-1, 9, 9)).reshape(len(tets), -1, 3, 3)
    return pairs, first @ D, volume[:, None] * zeroth, volume


def _curved(points: Array, tets: Array) -> tuple[Array, Array, Array, Array]:
    basis: Any = scalar_basis(points, tets, True)
    G, N, dx = _fields(basis)
    m, c = tets.shape
    volume = dx.sum(axis=1)
    scaled = G * dx[:, None, None]
    flat = scaled.reshape(m, 3 * c, -1) @ G.reshape(m, 3 * c, -1).transpose(0, 2, 1)
    one, other = np.triu_indices(c)
    pairs = flat.reshape(m, c, 3, c, 3).transpose(0, 1, 3, 2, 4)[:, one, other]
    gradient = scaled.sum(axis=3) / volume[:, None, None]
    return pairs, gradient, (N @ dx[:, :, None])[:, :, 0], volume


def _fields(basis: Any) -> tuple[Array, Array, Array]:
    """Return gradients (e, c, 3, q) and values (e, c, q) of shape functions, weights."""
    dx = np.asarray(basis.dx)
    G = np.stack([f[0].grad for f in basis.basis]).transpose(2, 0, 1, 3)
    N = np.stack([np.broadcast_to(np.asarray(f[0]), dx.shape) for f in basis.basis])
    return np.ascontiguousarray(G), N.transpose(1, 0, 2), dx


def point_gradients(mesh: TetMesh) -> tuple[Array, Array]:
    """Return gradients of shape functions at points, (m, c, 3q) [1/m]; weights (m, q).

    One point a tet at order 1, four at order 2 (degree 2), curved ones alike.
    """
    m, c = mesh.tets.shape
    q = 1 if c == 4 else 4
    gradient, weight = np.empty((m, c, 3 * q)), np.empty((m, q))
    for kind, curved in ((~mesh.bent, False), (mesh.bent, True)):
        chosen = np.flatnonzero(kind)
        for start in range(0, len(chosen), CHUNK):
            part = chosen[start : start + CHUNK]
            basis: Any = scalar_basis(mesh.points, mesh.tets[part], curved, few=True)
            G, _, weight[part] = _fields(basis)
            gradient[part] = G.transpose(0, 1, 3, 2).reshape(len(part), c, 3 * q)
    return gradient, weight


def mass(mesh: TetMesh, pattern: Pattern, density: Array) -> csr_array:
    """Return the consistent mass matrix (3n, 3n) [kg]; density (m,) [kg/m^3]."""
    one, other = np.triu_indices(mesh.tets.shape[1])
    values = np.empty(pattern.where.size)
    for start in range(0, len(mesh.tets), CHUNK):
        part = np.arange(start, min(start + CHUNK, len(mesh.tets)))
        bent = mesh.bent[part]
        M = mesh.volumes[part, None] * _constants(mesh.order)[3]
        if bent.any():
            curved = mesh.tets[part[bent]]
            basis: Any = scalar_basis(mesh.points, curved, True, exact_mass=True)
            _, N, dx = _fields(basis)
            full = (N * dx[:, None]) @ N.transpose(0, 2, 1)
            M[bent] = full[:, one, other]
        values[pattern.where[part]] = M
    total = np.empty((len(pattern.start) - 1, 1))
    for blocks, pairs, sums in pattern.parts():
        total[blocks, 0] = sums @ (density[pattern.tet[pairs]] * values[pairs])
    return pattern.matrix(np.repeat(total, 2, axis=0)[:, :, None] * np.eye(3))


def scalar_basis(
    points: Array,
    tets: Array,
    curved: bool,
    *,
    exact_mass: bool = False,
    few: bool = False,
) -> Basis:
    """Return scikit-fem's scalar basis; local functions in the order of columns.

    `exact_mass`: integrate products of shape functions, not of gradients, exactly. `few`:
    on curved tets the points of straight ones.
    """
    mask = np.zeros(len(points), dtype=bool)
    mask[tets] = True
    used = np.flatnonzero(mask)
    local = (np.cumsum(mask, dtype=np.int32) - 1)[np.ascontiguousarray(tets.T)]
    p = np.ascontiguousarray(points[used].T)
    if curved:
        # products of gradients on curved tets are rational: degree 4 holds them to ~1e-5;
        # shape functions are quadratic and det J is cubic
        mesh = MeshTet2(p, local, validate=False)
        return Basis(mesh, ElementTetP2(), intorder=2 if few else 7 if exact_mass else 4)
    mesh = MeshTet(p, local[:4], validate=False)
    if len(local) == 4:
        return Basis(mesh, ElementTetP1(), intorder=2 if exact_mass else 1)
    return Basis(mesh, ElementTetP2(), intorder=4 if exact_mass else 2)
