"""Equilibrium: a displaced plant, its forces, and the evidence for them."""

import importlib
import os
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_array

from plantsim.arrays import Array
from plantsim.cards import card
from plantsim.elastic.deformed import Deformed
from plantsim.elastic.limb_table import LimbTable, limb_table
from plantsim.elastic.strength import margins
from plantsim.errors import SolverError
from plantsim.solve.stats import SolveStats

if TYPE_CHECKING:
    from plantsim.elastic.model import ElasticModel
    from plantsim.elastic.near import NearContact
    from plantsim.elastic.newton import Near

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
    near: "Near | None" = None  # a corotational model's tangent, to start the next from

    @cached_property
    def deformed(self) -> Deformed:
        """Strain, stress and tangent of the model here."""
        return self.model.deformed(self.displacement)

    @cached_property
    def energy(self) -> float:
        """Strain energy [J]."""
        return self.deformed.energy

    @cached_property
    def gradient(self) -> Array:
        """Mean displacement gradient of each tet, (m, 3, 3), [i, j] = d u_i / d x_j."""
        return self.deformed.gradient

    @cached_property
    def strain(self) -> Array:
        """Mean strain of each tet, (m, 3, 3); of a corotational model in rest axes."""
        return self.deformed.strain

    @cached_property
    def stress(self) -> Array:
        """Mean Cauchy stress of each tet, (m, 3, 3) [Pa], for small strains."""
        return self.deformed.stress

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
    def tangent(self) -> csr_array:
        """Derivative of the forces here, (3n, 3n) [N/m]; of a linear model K."""
        return self.deformed.tangent()

    @cached_property
    def linear(self) -> "ElasticModel":
        """The linear model about this state: K is the tangent, moved vertices are fixed.

        Its displacements and forces are changes from this state; so are its contacts, modes
        and factors.
        """
        held = np.union1d(self.model.fixed_ids, self.moved)
        return self.model.about(self.tangent, held)

    @cached_property
    def stable(self) -> bool:
        """Whether the plant would stay here, that is, the tangent is positive definite.

        Where vertices are held along some directions only, they count as held altogether.
        """
        try:
            return self.linear.base_factor()[1].definite
        except SolverError:
            return False

    @cached_property
    def margin(self) -> dict[str, float]:
        """Strength over the largest fibre stress of each limb by name; below 1 it breaks.

        Tets at fixed and moved vertices are left out. Raises ModelError for a material
        without strength.
        """
        return margins(self)

    def contact(self, ids: ArrayLike | str) -> "NearContact":
        """Return vertices prepared for many small displacements about this state.

        Those among the moved ones are taken hold of; other moved ones stay where they are.
        """
        near = importlib.import_module("plantsim.elastic.near")
        return near.near_contact(self, self.model.vertices(ids, "contact"))

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
        if self.model.kinematics != "linear":
            by = f"Newton in {s.iterations} iterations"
            verdict = "corotational"
            carried = getattr(s, "fraction", 1.0)
            if carried < 1:
                verdict += f", stopped at {carried:.3g} of the load"
        return (
            f"Equilibrium({s.unknowns:,} unknowns, {by}, {s.seconds:.2g} s; largest "
            f"motion {1000 * length[far]:.3g} mm at limb "
            f"{mesh.region_names[mesh.region[tet]]}; rotation {turn:.2g} degrees: "
            f"{verdict})"
        )
