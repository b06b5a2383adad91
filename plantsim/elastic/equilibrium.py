"""Equilibrium: a displaced plant, its forces, and the evidence for them."""

import importlib
import os
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from plantsim.arrays import Array
from plantsim.cards import card
from plantsim.elastic.limb_table import LimbTable, limb_table
from plantsim.solve.stats import SolveStats

if TYPE_CHECKING:
    from plantsim.elastic.model import ElasticModel

LINEAR_LIMIT = np.radians(5.0)  # rotation above which the repr warns of linear theory
# against a corotational model, ten vertices of a reference tree moved 1, 5 and 15 cm
FOUND_OFF = "contact forces were 14 % off at 5 degrees, 84 % at 22, over 200 % at 53"


@dataclass(frozen=True, eq=False, repr=False)
class Equilibrium:
    """Where a model rests under its loads."""

    model: "ElasticModel"
    displacement: Array  # (n, 3) [m]
    # (n, 3) [N]: external force on each vertex, applied, and the reactions where it is held
    # or moved; a vertex pushed down has a downward force
    force: Array
    moved: Array  # (k,) ids of the moved vertices
    stats: SolveStats

    @cached_property
    def energy(self) -> float:
        """Strain energy [J], u . K u / 2."""
        u = self.displacement.ravel()
        return float(u @ (self.model.stiffness @ u) / 2)

    @cached_property
    def gradient(self) -> Array:
        """Mean displacement gradient of each tet, (m, 3, 3), [i, j] = d u_i / d x_j."""
        mesh = self.model.mesh
        return np.einsum(
            "eaj,eai->eij", self.model.blocks.gradient, self.displacement[mesh.tets]
        )

    @cached_property
    def strain(self) -> Array:
        """Mean infinitesimal strain of each tet, (m, 3, 3)."""
        return (self.gradient + self.gradient.transpose(0, 2, 1)) / 2

    @cached_property
    def stress(self) -> Array:
        """Mean Cauchy stress of each tet, (m, 3, 3) [Pa]."""
        strain = self.strain
        mu, lam, _ = self.model.material.per_tet(len(strain))
        spherical = lam * np.trace(strain, axis1=1, axis2=2)
        return 2 * mu[:, None, None] * strain + spherical[:, None, None] * np.eye(3)

    @cached_property
    def von_mises(self) -> Array:
        """Von Mises stress of each tet's mean stress, (m,) [Pa]."""
        s = self.stress
        deviator = s - np.trace(s, axis1=1, axis2=2)[:, None, None] / 3 * np.eye(3)
        return np.sqrt(1.5 * (deviator**2).sum(axis=(1, 2)))

    @cached_property
    def max_rotation(self) -> float:
        """Largest rotation [rad] of a tet, by polar decomposition of I + grad u."""
        u, _, vt = np.linalg.svd(np.eye(3) + self.gradient)
        R = u @ vt
        cosine = (np.trace(R, axis1=1, axis2=2) * np.sign(np.linalg.det(R)) - 1) / 2
        return float(np.arccos(np.clip(cosine, -1, 1)).max())

    @cached_property
    def limbs(self) -> LimbTable:
        """What each limb carries at its base, its largest stress, its tip's motion."""
        return limb_table(self)

    def plot(self, out: str | os.PathLike[str] = "equilibrium.png", **options: Any) -> Path:
        """Draw the plant at rest and deformed to a PNG, and return its path.

        Options as of `ps.figure_deformation`: `scale=`. Raises DependencyError where
        pictures cannot be drawn.
        """
        # the one call that goes up the house, by a door that opens when it is used
        figures = importlib.import_module("plantsim.view.figures")
        return figures.figure_deformation(self, out, **options)

    _repr_html_ = card  # what a notebook shows

    def __repr__(self) -> str:
        length = np.linalg.norm(self.displacement, axis=1)
        far = int(length.argmax())
        mesh = self.model.mesh
        tet = int(np.flatnonzero((mesh.tets == far).any(axis=1))[0])
        assert mesh.region is not None
        s = self.stats
        by = "direct" if s.solver == "direct" else f"multigrid in {s.iterations} iterations"
        turn = np.degrees(self.max_rotation)
        verdict = (
            "linear theory is fine"
            if self.max_rotation <= LINEAR_LIMIT
            else f"over {np.degrees(LINEAR_LIMIT):.0f}, do not trust linear theory "
            f"({FOUND_OFF})"
        )
        return (
            f"Equilibrium({s.unknowns:,} unknowns, {by}, {s.seconds:.2g} s; largest "
            f"motion {1000 * length[far]:.3g} mm at limb "
            f"{mesh.region_names[mesh.region[tet]]}; rotation {turn:.2g} degrees: "
            f"{verdict})"
        )
