"""Deformed: what displacements do to a model, by either kinematics."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import csr_array

from plantsim.arrays import Array
from plantsim.elastic.corotational import Turned

if TYPE_CHECKING:
    from plantsim.elastic.model import ElasticModel


@dataclass(frozen=True, eq=False)
class Small:
    """Linear elasticity: the strain is the symmetric part of the gradient."""

    model: "ElasticModel"
    displacement: Array  # (n, 3) [m]

    @cached_property
    def energy(self) -> float:
        """Strain energy [J], u . K u / 2."""
        u = self.displacement.ravel()
        return float(u @ (self.model.stiffness @ u) / 2)

    @cached_property
    def gradient(self) -> Array:
        """Mean displacement gradient of each tet, (m, 3, 3)."""
        u = self.displacement[self.model.mesh.tets]
        return np.einsum("eaj,eai->eij", self.model.blocks.gradient, u)

    @cached_property
    def strain(self) -> Array:
        """Mean infinitesimal strain of each tet, (m, 3, 3)."""
        return (self.gradient + self.gradient.transpose(0, 2, 1)) / 2

    @property
    def stress(self) -> Array:
        """Mean stress of each tet, (m, 3, 3) [Pa]."""
        mu, lam, _ = self.model.material.per_tet(len(self.strain))
        spherical = lam * np.trace(self.strain, axis1=1, axis2=2)
        return 2 * mu[:, None, None] * self.strain + spherical[:, None, None] * np.eye(3)

    @property
    def tet_forces(self) -> Array:
        """Nodal forces of each tet, (m, c, 3) [N]."""
        mu, lam, _ = self.model.material.per_tet(len(self.model.mesh.tets))
        shear, bulk = self.unit_forces()
        return mu[:, None, None] * shear + lam[:, None, None] * bulk

    @property
    def forces(self) -> Array:
        """Nodal forces, (n, 3) [N]."""
        return (self.model.stiffness @ self.displacement.ravel()).reshape(-1, 3)

    @property
    def noise(self) -> tuple[float, float]:
        """Size of what rounding does to the forces [N] and to the energy [J]."""
        eps = float(np.finfo(float).eps)
        size = float(np.linalg.norm(self.displacement))
        return eps * self.model.size * size, eps * abs(self.energy)

    def unit_forces(self) -> tuple[Array, Array]:
        """Return nodal forces (m, c, 3) of each tet for mu = 1, for lam = 1."""
        u, tets, blocks = self.displacement, self.model.mesh.tets, self.model.blocks
        if self.model.mesh.order == 2:
            return blocks.forces(tets, u)
        # straight edges and linear shape functions: one constant gradient
        G, v = blocks.gradient, blocks.volume
        grad = u[tets].transpose(0, 2, 1) @ G
        strain = (grad + grad.transpose(0, 2, 1)) * v[:, None, None]
        mu = G @ strain  # which is symmetric
        lam = (v * np.trace(grad, axis1=1, axis2=2))[:, None, None] * G
        return mu, lam

    def tangent(self, *, positive: bool = False) -> csr_array:
        """Return K, which is positive wherever the mesh is held."""
        return self.model.stiffness


Deformed = Small | Turned
