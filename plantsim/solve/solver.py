"""The solver protocol: factor once, apply often."""

from typing import Literal, Protocol

from scipy.sparse import bsr_array

from plantsim.arrays import Array
from plantsim.errors import SolverError
from plantsim.solve.direct import Direct
from plantsim.solve.multigrid import Multigrid


class Factor(Protocol):
    """A system ready to be solved for any right-hand side."""

    @property
    def name(self) -> str:
        """Name of the solver: "direct" or "multigrid"."""
        ...

    @property
    def backend(self) -> str:
        """Library routine that does the work."""
        ...

    @property
    def definite(self) -> bool:
        """Whether the system is positive definite, as far as the factor can tell."""
        ...

    def precondition(self, f: Array) -> Array:
        """Return K^-1 f or near it, unchecked and cheap; symmetric in f."""
        ...

    def __call__(self, f: Array) -> tuple[Array, int, Array]:
        """Return the solution for f, (n,) or (n, k), the iterations and the backward error.

        The error is () or (k,), one for each column; the iterations are of the slowest.
        Raises SolverError where a column misses its backward error.
        """
        ...


class Solver(Protocol):
    """Options of a method; a frozen value."""

    def factor(self, K: bsr_array, points: Array) -> Factor:
        """Prepare K (3n, 3n), positive definite, of vertices at points (n, 3) [m]."""
        ...


Choice = Solver | Literal["auto", "direct", "multigrid"]
# Above this many unknowns SuperLU takes longer for a plant than multigrid: at 439,000 they
# take the same time for one solve, at 297,000 SuperLU two thirds (benchmarks/solvers.py)
DIRECT_LIMIT = 400_000


def choose(solver: Choice, unknowns: int) -> Solver:
    """Return the solver of that name; "auto" goes by the number of unknowns."""
    if not isinstance(solver, str):
        return solver
    if solver == "auto":
        return Direct() if unknowns <= DIRECT_LIMIT else Multigrid()
    if solver not in ("direct", "multigrid"):
        raise SolverError(f"solver {solver!r}: give 'auto', 'direct' or 'multigrid'.")
    return Direct() if solver == "direct" else Multigrid()
