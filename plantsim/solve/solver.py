"""The solver protocol: factor once, apply often."""

from typing import Literal, Protocol

from scipy.sparse import bsr_array

from plantsim.arrays import Array
from plantsim.errors import SolverError
from plantsim.solve.direct import Direct, has_pardiso
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

    @property
    def threads(self) -> bool:
        """Whether many threads may solve at once."""
        ...

    def precondition(self, f: Array) -> Array:
        """Return K^-1 f or near it, unchecked and cheap; symmetric in f."""
        ...

    def __call__(self, f: Array, *, check: bool = True) -> tuple[Array, int, Array]:
        """Return the solution for f, (n,) or (n, k), the iterations and the backward error.

        The error is () or (k,), one for each column; the iterations are of the slowest.
        Raises SolverError where a column misses its backward error. A direct factor leaves
        the errors out without `check`, for the many inner solves of a method whose outer
        ones are checked.
        """
        ...

    def compliance(self, rows: Array) -> Array | None:
        """Return K^-1 among some unknowns (k,), (k, k), symmetric.

        None where it would cost as much as whole columns, which then are the better buy.
        """
        ...


class Solver(Protocol):
    """Options of a method; a frozen value."""

    def factor(self, K: bsr_array, points: Array, like: Factor | None = None) -> Factor:
        """Prepare K (3n, 3n), positive definite, of vertices at points (n, 3) [m].

        `like`: a factor of a matrix of the same pattern, of which some may serve again.
        """
        ...


Choice = Solver | Literal["auto", "direct", "multigrid"]
# What "auto" goes by (measured: benchmarks/solvers.py). At 396,000 unknowns of a plant
# SuperLU takes 7 s of CPU, multigrid 10 for its set-up and one solve, 6 for every other
DIRECT_LIMIT = 400_000
# At 693,000 PARDISO takes 16 s in 5.8 GiB, multigrid 27 s in 3.3; at 2.2 million PARDISO
# found no factor in the memory there was
PARDISO_LIMIT = 1_000_000


def choose(solver: Choice, unknowns: int) -> Solver:
    """Return the solver of that name; "auto" goes by the number of unknowns.

    Direct up to 400,000, or up to a million where pypardiso is installed; else multigrid.
    """
    if not isinstance(solver, str):
        return solver
    if solver == "auto":
        limit = PARDISO_LIMIT if has_pardiso() else DIRECT_LIMIT
        return Direct() if unknowns <= limit else Multigrid()
    if solver not in ("direct", "multigrid"):
        raise SolverError(f"solver {solver!r}: give 'auto', 'direct' or 'multigrid'.")
    return Direct() if solver == "direct" else Multigrid()
