"""Corotational elasticity: strain measured after the rotation of each point is taken out.

With F = I + grad u, its nearest rotation R and the stretch S = R^T F, the energy density is

    mu |S - I|^2 + lam / 2 tr(S - I)^2,

which is linear elasticity's where nothing turns. Forces are its exact gradient,

    P = R (2 mu (S - I) + lam tr(S - I) I),

since the derivative of R does no work; so they are linear in mu and lam for a known u. One
point a tet at order 1, four at order 2, curved or not (docs/large_rotations.md says why).
Sources: Chao, Pinkall, Sanan, Schroeder 2010 (the energy); Smith, de Goes, Kim 2019,
Analytic Eigensystems for Isotropic Distortion Energies (the derivative of R).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array

from plantsim.arrays import Array
from plantsim.elastic.pattern import Pattern
from plantsim.elastic.polar import cofactors, rotations
from plantsim.elastic.stiffness import point_gradients
from plantsim.elastic.tangent import PART, many_points, one_point, summed
from plantsim.mesh.tetmesh import TetMesh

CHUNK = 16_384  # points at a time, in the tangent
LEAST = 1e-3  # smallest sum of two stretches, where a tet is inverted


@dataclass(frozen=True, eq=False)
class Points:
    """Where strain is measured: gradients of the shape functions, and weights."""

    mesh: TetMesh
    pattern: Pattern
    # (m, c, 3q) [1/m]: of shape function a at point p along axis j in [a, 3p + j]
    gradient: Array
    weight: Array  # (m, q) [m^3]

    @cached_property
    def sums(self) -> csr_array:
        """Sums over the tets at each vertex, (n, m c)."""
        tets = self.mesh.tets
        order = np.argsort(tets.ravel(), kind="stable").astype(np.int32)
        count = np.bincount(tets.ravel(), minlength=len(self.mesh.points))
        start = np.append(0, np.cumsum(count)).astype(np.int32)
        shape = (len(count), tets.size)
        return csr_array((np.ones(tets.size), order, start), shape=shape)

    @cached_property
    def products(self) -> Array:
        """Integrals of grad phi_a . grad phi_b for pairs a <= b, (m, p) [m]."""
        one, other = np.triu_indices(self.gradient.shape[1])
        weighed = self.gradient * np.repeat(self.weight, 3, axis=1)[:, None]
        return (weighed @ self.gradient.transpose(0, 2, 1))[:, one, other]

    @classmethod
    def of(cls, mesh: TetMesh, pattern: Pattern) -> "Points":
        """Return the points of a mesh."""
        return cls(mesh, pattern, *point_gradients(mesh))

    def gradients(self, u: Array) -> Array:
        """Return grad u at every point, (m q, 3, 3), of displacements u (n, 3) [m]."""
        m, q = self.weight.shape
        H = u[self.mesh.tets].transpose(0, 2, 1) @ self.gradient  # (m, 3, 3q)
        return H.reshape(m, 3, q, 3).transpose(0, 2, 1, 3).reshape(-1, 3, 3)

    def integral(self, P: Array) -> Array:
        """Return the nodal forces (m, c, 3) of stresses P (m q, 3, 3)."""
        m, q = self.weight.shape
        P = P * self.weight.reshape(-1, 1, 1)
        P = P.reshape(m, q, 3, 3).transpose(0, 1, 3, 2).reshape(m, 3 * q, 3)
        return self.gradient @ P

    def at(self, u: Array, mu: Array, lam: Array) -> "Turned":
        """Return what displacements u (n, 3) [m] do with moduli (m,) [Pa]."""
        return Turned(self, self.gradients(u), mu, lam)


@dataclass(frozen=True, eq=False)
class Turned:
    """Deformation at every point of a mesh; k = m q points, those of a tet in a row."""

    points: Points
    H: Array  # grad u, (k, 3, 3)
    mu: Array  # (m,) [Pa]
    lam: Array  # (m,) [Pa]

    @cached_property
    def F(self) -> Array:
        """I + grad u, (k, 3, 3)."""
        return self.H + np.eye(3)

    @cached_property
    def rotation(self) -> Array:
        """R, (k, 3, 3)."""
        return rotations(self.F)

    @cached_property
    def stretch(self) -> Array:
        """Biot strain S - I of each point, (k, 3, 3), in rest axes.

        As (F^T F - I) (S + I)^-1, so that small strains keep their digits.
        """
        turned = self.H.transpose(0, 2, 1)
        green = self.H + turned + turned @ self.H
        S = self.rotation.transpose(0, 2, 1) @ self.F
        S = (S + S.transpose(0, 2, 1)) / 2 + np.eye(3)
        inverse, det = cofactors(np.ascontiguousarray(S.transpose(1, 2, 0)))
        E = green @ (inverse / det).transpose(2, 0, 1)
        # where a tet is inverted S + I may have no inverse
        lost = ~(det > 0.1)
        if lost.any():
            E[lost] = S[lost] - 2 * np.eye(3)
        return (E + E.transpose(0, 2, 1)) / 2

    @cached_property
    def noise(self) -> tuple[float, float]:
        """Size of what rounding does to the forces [N] and to the energy [J]."""
        points = self.points
        m, q = points.weight.shape
        size = np.sqrt(np.einsum("kij,kij->k", self.H, self.H)).reshape(m, q)
        stress = np.finfo(float).eps * (2 * self.mu + self.lam)[:, None] * size
        steep = np.sqrt((points.gradient**2).reshape(m, -1, q, 3).sum(axis=(1, 3)))
        strain = np.sqrt(np.einsum("kij,kij->k", self.stretch, self.stretch))
        force = np.linalg.norm(stress * points.weight * steep)
        energy = np.linalg.norm(stress * points.weight * strain.reshape(m, q))
        return float(force), float(energy)

    @cached_property
    def trace(self) -> Array:
        """Trace of the strain, (k,)."""
        E = self.stretch
        return E[:, 0, 0] + E[:, 1, 1] + E[:, 2, 2]

    @cached_property
    def energy(self) -> float:
        """Strain energy [J]."""
        w = self.points.weight
        square = np.einsum("kij,kij->k", self.stretch, self.stretch).reshape(w.shape)
        bulk = self.trace.reshape(w.shape) ** 2
        return float(((self.mu[:, None] * square + self.lam[:, None] * bulk / 2) * w).sum())

    @cached_property
    def tet_forces(self) -> Array:
        """Nodal forces of each tet, (m, c, 3) [N]."""
        return self.points.integral(self.rotation @ self._biot)

    @cached_property
    def forces(self) -> Array:
        """Nodal forces, (n, 3) [N]."""
        return self.points.sums @ self.tet_forces.reshape(-1, 3)

    def unit_forces(self) -> tuple[Array, Array]:
        """Return nodal forces (m, c, 3) of each tet for mu = 1, for lam = 1."""
        R = self.rotation
        return (
            self.points.integral(2 * R @ self.stretch),
            self.points.integral(self.trace[:, None, None] * R),
        )

    @property
    def gradient(self) -> Array:
        """Mean displacement gradient of each tet, (m, 3, 3)."""
        return self._mean(self.H)

    @property
    def strain(self) -> Array:
        """Mean Biot strain of each tet, (m, 3, 3), in rest axes."""
        return self._mean(self.stretch)

    @property
    def stress(self) -> Array:
        """Mean stress of each tet, (m, 3, 3) [Pa], in the axes of the room."""
        R = self.rotation
        return self._mean(R @ self._biot @ R.transpose(0, 2, 1))

    @property
    def _biot(self) -> Array:
        """2 mu (S - I) + lam tr(S - I) I, (k, 3, 3) [Pa]."""
        shear, bulk = self._each(self.mu), self._each(self.lam) * self.trace
        T = 2 * shear[:, None, None] * self.stretch
        T[:, [0, 1, 2], [0, 1, 2]] += bulk[:, None]
        return T

    def _mean(self, values: Array) -> Array:
        w = self.points.weight
        sums = (values.reshape(*w.shape, 3, 3) * w[:, :, None, None]).sum(axis=1)
        return sums / w.sum(axis=1)[:, None, None]

    def tangent(self, *, positive: bool = False) -> csr_array:
        """Return d forces / d u, (3n, 3n) [N/m], symmetric.

        `positive`: without the negative eigenvalues of the points' own Hessians, so that it
        is positive definite wherever the mesh is held.
        """
        points = self.points
        m, q = points.weight.shape
        c = points.mesh.tets.shape[1]
        pairs = np.empty((m, c * (c + 1) // 2, 3, 3))
        step = PART if q == 1 else max(CHUNK // q, 1)
        for first in range(0, m, step):
            tets = slice(first, min(first + step, m))
            pairs[tets] = self._pairs(tets, positive)
        return summed(points.pattern, pairs.reshape(-1, 9))

    def _pairs(self, tets: slice, positive: bool) -> Array:
        """Return the tangent of some tets for pairs a <= b of vertices, (m, p, 3, 3)."""
        points = self.points
        q = points.weight.shape[1]
        at = slice(tets.start * q, tets.stop * q)
        D, w = points.gradient[tets], points.weight[tets]
        mu, lam = self.mu[tets], self.lam[tets]
        M = self._turning(at, self._each(mu), self._each(lam)).transpose(2, 0, 1)
        M = _positive(M) if positive else np.ascontiguousarray(M)
        R = self.rotation[at]
        if q == 1:
            turned = R.transpose(0, 2, 1)
            g = np.ascontiguousarray((D[:, 1:] @ turned).transpose(1, 2, 0))
            M = np.ascontiguousarray((R @ M @ turned).transpose(1, 2, 0))
            return one_point(g, M, w[:, 0], mu, lam)
        return many_points(D, w, R, M, points.products[tets], (mu, lam))

    def _turning(self, at: slice, mu: Array, lam: Array) -> Array:
        """Return stiffness against turning, (3, 3, k): mu I + beta (tr S I - S)^-1."""
        E = self.stretch[at]
        tr = self.trace[at]
        A = -E  # tr S I - S = (2 + tr E) I - E
        A[:, [0, 1, 2], [0, 1, 2]] += (2 + tr)[:, None]
        beta = lam * tr - 2 * mu
        # sums of two stretches; none is near 0 unless a tet is inverted
        if np.abs(E).max(initial=0.0) > 0.4:
            bad = np.abs(E).max(axis=(1, 2)) > 0.4
            size, V = np.linalg.eigh(A[bad])
            size = np.maximum(size, LEAST)
            A[bad] = (V * size[:, None, :]) @ V.transpose(0, 2, 1)
        C, det = cofactors(np.ascontiguousarray(A.transpose(1, 2, 0)))
        C *= beta / det
        for i in range(3):
            C[i, i] += mu
        return C

    def _each(self, per_tet: Array) -> Array:
        return np.repeat(per_tet, self.points.weight.shape[1])


def _positive(M: Array) -> Array:
    """Return symmetric matrices (k, 3, 3) with negative eigenvalues set to zero."""
    a = M[:, 0, 0]
    b = a * M[:, 1, 1] - M[:, 0, 1] ** 2
    bad = (a < 0) | (b < 0) | (np.linalg.det(M) < 0)
    out = M.copy()
    size, V = np.linalg.eigh(M[bad])
    out[bad] = (V * np.maximum(size, 0)[:, None, :]) @ V.transpose(0, 2, 1)
    return out
