"""Multigrid: smoothed aggregation with rigid-body modes inside CG (pyamg)."""

import warnings
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import pyamg
import pyamg.krylov
from scipy.sparse import bsr_array, bsr_matrix

from plantsim.arrays import Array
from plantsim.errors import SolverError
from plantsim.solve.ordering import SYMMETRIC
from plantsim.solve.rigid import Rigid, rigid_modes
from plantsim.solve.stats import backward_error, norm_inf

# Aggregates (six unknowns each) up to which the second level is factored. Above, a third is
# made: 31,000 (two million unknowns, order 2) had too much fill for SuperLU, and a third
# level costs iterations on coarser meshes (measured: 96 against 43)
COARSE = 10_000


@dataclass(frozen=True)
class Multigrid:
    """pyamg-preconditioned CG, stopped on the backward error.

    Two levels with a sparse direct coarse solve: the coarse problem of a plant is a small
    beam model and factors at once; three, by a W cycle, from some million unknowns on.
    `strength` is the threshold of strong couplings; 0.08
    took 42 iterations to 1e-12 where 0 took 72 (order 2, 80,000 unknowns). Source: Vanek,
    Mandel, Brezina 1996, smoothed aggregation.
    """

    tolerance: float = 1e-12
    max_iterations: int = 400
    strength: float = 0.08

    def factor(self, K: bsr_array, points: Array, like: Any = None) -> "MultigridFactor":
        """Set up the levels for K (3n, 3n) of vertices at points (n, 3)."""
        matrix = bsr_matrix(
            (K.data, K.indices, K.indptr), shape=K.shape
        )  # what pyamg takes
        matrix.sort_indices()
        smoother = ("block_gauss_seidel", {"sweep": "symmetric", "iterations": 1})
        aggregate: Any = pyamg.smoothed_aggregation_solver  # its stubs know one strength
        levels = aggregate(
            matrix,
            B=rigid_modes(points),
            strength=("symmetric", {"theta": self.strength}),
            presmoother=smoother,
            postsmoother=smoother,
            improve_candidates=None,
            max_levels=3,
            max_coarse=max(10, min(COARSE, len(points) - 1)),  # two levels at least
            coarse_solver=("splu", SYMMETRIC),
        )
        return MultigridFactor(matrix, levels, self.tolerance, self.max_iterations)


@dataclass(frozen=True, eq=False)
class MultigridFactor:
    """The levels, ready to precondition CG."""

    K: bsr_matrix
    levels: Any
    tolerance: float
    max_iterations: int
    size: float = field(init=False)
    name: str = "multigrid"

    def __post_init__(self) -> None:
        object.__setattr__(self, "size", norm_inf(self.K))

    @property
    def backend(self) -> str:
        """The library's routine, and how many levels there are."""
        count = len(self.levels.levels)
        return f"pyamg CG, smoothed aggregation, {count} levels, 6 rigid modes"

    @property
    def definite(self) -> bool:
        """True: CG fails, and says so, where K is not positive definite enough for it."""
        return True

    @property
    def threads(self) -> bool:
        """False: pyamg's levels have room for one right-hand side."""
        return False

    @property
    def preconditioner(self) -> Any:
        """One W cycle as a linear operator; of two levels it is a V cycle."""
        return self.levels.aspreconditioner(cycle="W")

    def precondition(self, f: Array) -> Array:
        """Return one cycle on f."""
        return self.preconditioner @ f

    def __call__(self, f: Array, *, check: bool = True) -> tuple[Array, int, Array]:
        """Return the solution (n,) or (n, k), the CG iterations, the backward errors."""
        if f.ndim == 1:
            return self._one(f)
        parts = [self._one(np.ascontiguousarray(column)) for column in f.T]
        u, iterations, error = zip(*parts, strict=True)
        return np.column_stack(u), max(iterations), np.array(error)

    def compliance(self, rows: Array) -> None:
        """Return None: it would take a solve for each."""

    @cached_property
    def _rigid(self) -> Rigid:
        return Rigid.of(self.K, self.levels.levels[0].B)

    def _one(self, f: Array) -> tuple[Array, int, Array]:
        if not f.any():
            return np.zeros_like(f), 0, np.zeros(())
        residuals: list[float] = []
        # "rr+" stops on |r| <= tol (|K|_F |u| + |f|); |K|_F grows with n, so it is scaled
        # out
        tol = self.tolerance * self.size / float(np.linalg.norm(self.K.data))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the backward error below says it all
            u, _ = pyamg.krylov.cg(
                self.K,
                f,
                tol=0.9 * tol,
                criteria="rr+",
                maxiter=self.max_iterations,
                M=self.preconditioner,
                residuals=residuals,
            )
        iterations = len(residuals) - 1
        u = self._rigid.balanced(u, f)
        error = backward_error(self.K, self.size, u, f)
        if not error <= self.tolerance:
            raise SolverError(
                f"multigrid: backward error {error:.1e} after {iterations} iterations, "
                f"wanted {self.tolerance:.1e}. Use solver='direct', or "
                "Multigrid(max_iterations=...)."
            )
        return u, iterations, error
