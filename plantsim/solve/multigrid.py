"""Multigrid: smoothed aggregation with rigid-body modes, two levels, inside CG (pyamg)."""

import warnings
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pyamg
import pyamg.krylov
from scipy.sparse import bsr_array, bsr_matrix

from plantsim.arrays import Array
from plantsim.errors import SolverError
from plantsim.solve.stats import backward_error, norm_inf


@dataclass(frozen=True)
class Multigrid:
    """pyamg-preconditioned CG, stopped on the backward error.

    Two levels with a sparse direct coarse solve: the coarse problem of a plant is a small
    beam model and factors at once. `strength` is the threshold of strong couplings; 0.08
    took 42 iterations to 1e-12 where 0 took 72 (order 2, 80,000 unknowns). Source: Vanek,
    Mandel, Brezina 1996, smoothed aggregation.
    """

    tolerance: float = 1e-12
    max_iterations: int = 400
    strength: float = 0.08

    def factor(self, K: bsr_array, points: Array) -> "MultigridFactor":
        """Set up the two levels for K (3n, 3n) of vertices at points (n, 3)."""
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
            max_levels=2,
            max_coarse=10,
            coarse_solver="splu",
        )
        return MultigridFactor(matrix, levels, self.tolerance, self.max_iterations)


def rigid_modes(points: Array) -> Array:
    """Return the six rigid-body modes (3n, 6) of vertices (n, 3), scaled to order one."""
    x = (points - points.mean(axis=0)) / max(float(np.ptp(points, axis=0).max()), 1e-300)
    modes = np.zeros((len(points), 3, 6))
    modes[:, :, :3] = np.eye(3)
    for i, axis in enumerate(np.eye(3)):
        modes[:, :, 3 + i] = np.cross(axis, x)
    return modes.reshape(-1, 6)


@dataclass(frozen=True, eq=False)
class MultigridFactor:
    """The levels, ready to precondition CG."""

    K: bsr_matrix
    levels: Any
    tolerance: float
    max_iterations: int
    size: float = field(init=False)
    name: str = "multigrid"
    backend: str = "pyamg CG, smoothed aggregation, 2 levels, 6 rigid modes"

    def __post_init__(self) -> None:
        object.__setattr__(self, "size", norm_inf(self.K))

    @property
    def definite(self) -> bool:
        """True: CG fails, and says so, where K is not positive definite enough for it."""
        return True

    @property
    def preconditioner(self) -> Any:
        """One V cycle as a linear operator."""
        return self.levels.aspreconditioner(cycle="V")

    def precondition(self, f: Array) -> Array:
        """Return one V cycle on f."""
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
        error = backward_error(self.K, self.size, u, f)
        if not error <= self.tolerance:
            raise SolverError(
                f"multigrid: backward error {error:.1e} after {iterations} iterations, "
                f"wanted {self.tolerance:.1e}. Use solver='direct', or "
                "Multigrid(max_iterations=...)."
            )
        return u, iterations, error
