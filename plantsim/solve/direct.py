"""Direct factors: SuperLU in symmetric mode."""

from dataclasses import dataclass, field
from typing import Any

from scipy.sparse import bsr_array, csc_array, csr_array
from scipy.sparse.linalg import splu

from plantsim.arrays import Array
from plantsim.errors import SolverError
from plantsim.solve.stats import backward_error, norm_inf


@dataclass(frozen=True)
class Direct:
    """Sparse LU without pivoting, ordered by minimum degree on A + A^T.

    A plant is nearly one-dimensional, so the fill stays small up to some 400,000 unknowns.
    `tolerance`: the largest backward error that is accepted.
    """

    tolerance: float = 1e-10

    def factor(self, K: bsr_array, points: Array) -> "DirectFactor":
        """Return the factor of K; SolverError if K is singular."""
        csr: Any = K.tocsr()
        # K is symmetric, so its CSR arrays are its CSC arrays
        csc: Any = csc_array((csr.data, csr.indices, csr.indptr), shape=csr.shape)
        try:
            lu = splu(
                csc,
                permc_spec="MMD_AT_PLUS_A",
                diag_pivot_thresh=0.0,
                options={"SymmetricMode": True},
            )
        except (RuntimeError, MemoryError) as why:
            raise SolverError(
                f"direct: no factor of {csc.shape[0]:,} unknowns ({why}). If singular, "
                "hold more vertices; if out of memory, use solver='multigrid'."
            ) from None
        return DirectFactor(csr, lu, self.tolerance)


@dataclass(frozen=True, eq=False)
class DirectFactor:
    """A factor by SuperLU."""

    K: csr_array
    lu: Any
    tolerance: float
    size: float = field(init=False)
    name: str = "direct"
    backend: str = "scipy SuperLU, MMD on A + A^T"

    def __post_init__(self) -> None:
        object.__setattr__(self, "size", norm_inf(self.K))

    def __call__(self, f: Array) -> tuple[Array, int, float]:
        """Return the solution, 0 iterations and the backward error."""
        u = self.lu.solve(f)
        error = backward_error(self.K, self.size, u, f)
        if not error <= self.tolerance:
            raise SolverError(
                f"direct: backward error {error:.1e}, wanted {self.tolerance:.1e}. The "
                "system is nearly singular: hold more vertices, or check for moduli of "
                "very different size."
            )
        return u, 0, error
