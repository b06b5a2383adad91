"""Direct factors: SuperLU in symmetric mode, or PARDISO where it is installed and pays."""

import importlib
import importlib.util
import threading
import weakref
from contextlib import nullcontext
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.sparse import bsr_array, csc_array, csr_matrix, triu
from scipy.sparse.linalg import splu

from plantsim.arrays import Array
from plantsim.errors import SolverError
from plantsim.solve.half import Half
from plantsim.solve.ordering import SYMMETRIC, Ordering
from plantsim.solve.stats import accepted, norm, norm_inf
from plantsim.solve.threads import shares, together

if TYPE_CHECKING:
    from plantsim.solve.solver import Factor

# From here on PARDISO (extra `fast`) is used: at 396,000 unknowns of a plant it takes as
# much CPU time as SuperLU, and at 524,000 SuperLU broke down (386 s); below, SuperLU is
# ahead, twofold in solves after the factor (benchmarks/solvers.py)
PARDISO_FROM = 400_000
# Right-hand sides at a time. Six take half of the time of six alone. With twelve BLAS
# starts threads, which gain nothing; on a busy machine thirty took six times as long
STRIP = 6
# Entries of L + U an unknown from which on two threads solve faster than one. With fewer
# SuperLU calls BLAS for so little that the threads wait for each other at its door: at 34
# of 27,000 unknowns two took 1.8 times as long as one for the same, at 65 as long, at 85
# two thirds (order 2). There one thread at a time solves
DENSE = 75
# How far compliance by half solves may be from that by a whole one: on slender plants the
# two are some 1e-10 apart
FORWARD = 1e-6
ALONE = threading.Lock()


def has_pardiso() -> bool:
    """Return whether pypardiso (extra `fast`) is installed."""
    return importlib.util.find_spec("pypardiso") is not None


@dataclass(frozen=True)
class Direct:
    """A sparse factor: SuperLU without pivoting, ordered by minimum degree on A + A^T.

    A plant is nearly one-dimensional, so the fill stays small up to some 400,000 unknowns.
    From there on PARDISO is used instead where pypardiso is installed. `tolerance`: the
    largest backward error that is accepted.
    """

    tolerance: float = 1e-10

    def factor(
        self, K: bsr_array, points: Array, like: "Factor | None" = None
    ) -> "DirectFactor":
        """Return the factor of K; SolverError if K is singular.

        `like`: a factor of a matrix of the same pattern, whose ordering will do.
        """
        csr: Any = K.tocsr()
        if csr.shape[0] >= PARDISO_FROM and has_pardiso():
            return DirectFactor(csr, _Pardiso(csr), self.tolerance, backend="MKL PARDISO")
        known = like.ordering if isinstance(like, DirectFactor) else None
        try:
            if known is not None and known.fits(csr):
                return DirectFactor(csr, known.factor(csr), self.tolerance, known=known)
            # columns of a plant have little in common: one at a time is 15 % faster
            lu = splu(_csc(csr), panel_size=1, **SYMMETRIC)
        except (RuntimeError, MemoryError) as why:
            raise SolverError(
                f"direct: no factor of {csr.shape[0]:,} unknowns ({why}). If singular, "
                "hold more vertices; if out of memory, use solver='multigrid'."
            ) from None
        return DirectFactor(csr, lu, self.tolerance)


def _csc(K: Any) -> Any:
    """Return a symmetric CSR matrix as CSC, whose arrays are the same."""
    return csc_array((K.data, K.indices, K.indptr), shape=K.shape)


@dataclass(frozen=True, eq=False)
class DirectFactor:
    """A factor ready for right-hand sides."""

    K: Any
    lu: Any  # has solve(f)
    tolerance: float
    backend: str = "scipy SuperLU, MMD on A + A^T"
    name: str = field(init=False, default="direct")
    known: Ordering | None = None  # where it was made in another factor's order

    @property
    def threads(self) -> bool:
        """Whether many threads may solve at once: not with PARDISO, which has its own."""
        return not isinstance(self.lu, _Pardiso)

    @cached_property
    def size(self) -> float:
        """A norm of K."""
        return norm_inf(self.K)

    @cached_property
    def ordering(self) -> Ordering | None:
        """For factors of the same pattern; PARDISO has none."""
        if self.known is not None or isinstance(self.lu, _Pardiso):
            return self.known
        return Ordering.of(_csc(self.K), self.lu)

    @property
    def definite(self) -> bool:
        """Whether K is positive definite, by the signs of its pivots (Sylvester)."""
        return self._definite

    @cached_property
    def _definite(self) -> bool:
        if isinstance(self.lu, _Pardiso):
            return True  # its factor would have failed
        return bool((self.lu.U.diagonal() > 0).all())

    def precondition(self, f: Array) -> Array:
        """Return K^-1 f, unchecked."""
        with nullcontext() if self._dense else ALONE:
            return self.lu.solve(f)

    @cached_property
    def _dense(self) -> bool:
        """Whether threads solve faster together than one after another."""
        return self.threads and self.lu.nnz >= DENSE * self.K.shape[0]

    def __call__(self, f: Array, *, check: bool = True) -> tuple[Array, int, Array]:
        """Return the solution (n,) or (n, k), 0 iterations and the backward errors.

        Without `check` the errors are not computed, and are NaN.
        """
        if f.ndim == 1:
            u = self.precondition(f)
        else:
            u = np.empty(f.shape, order="F")
            # as wide as another: ten are five and five, for two threads
            strips = shares(f.shape[1], STRIP)

            def strip(i: int) -> None:
                u[:, strips[i]] = self.precondition(np.asfortranarray(f[:, strips[i]]))

            if self._dense:
                together(strip, len(strips))
            else:
                for i in range(len(strips)):
                    strip(i)
        if not check:
            return u, 0, np.full(f.shape[1:], np.nan)
        return u, 0, accepted(self.K, self.size, u, f, self.tolerance)

    def compliance(self, rows: Array) -> Array | None:
        """Return K^-1 among some unknowns (k,), (k, k), vouched for by one whole solve.

        None where the factor is PARDISO's, pivoted, or too large to be copied.
        """
        if self._half is None:
            return None
        S = self._half.between(rows)
        load = np.zeros(self.K.shape[0])
        load[rows] = np.arange(1, len(rows) + 1)
        whole = self(load)[0][rows]
        apart = norm(np.einsum("ij,j->i", S, load[rows]) - whole) / norm(whole)
        if not apart <= FORWARD:
            raise SolverError(
                f"direct: two ways to the compliance are {apart:.1e} apart, wanted "
                f"{FORWARD:.0e}. The system is nearly singular: hold more vertices, or "
                "check for moduli of very different size."
            )
        return S

    @cached_property
    def _half(self) -> Half | None:
        return None if isinstance(self.lu, _Pardiso) else Half.of(self.lu)


class _Pardiso:
    """PARDISO's symmetric positive definite factor, behind SuperLU's `solve`."""

    def __init__(self, K: Any) -> None:
        pypardiso: Any = importlib.import_module("pypardiso")
        self._upper = csr_matrix(triu(K, format="csr"))
        try:
            self._solver = pypardiso.PyPardisoSolver(mtype=2)
        except (ImportError, OSError) as why:
            raise SolverError(
                f"direct: pypardiso is installed, but its MKL is not found ({why}). "
                "Install mkl beside it, or remove pypardiso."
            ) from None
        weakref.finalize(self, self._solver.free_memory, everything=True)
        try:
            self._solver.factorize(self._upper)
        # PyPardisoError, whose class is not to be had before import
        except Exception as why:
            raise SolverError(
                f"direct: PARDISO gave no factor of {K.shape[0]:,} unknowns ({why}). Hold "
                "more vertices, or use solver='multigrid'."
            ) from None

    def solve(self, f: Array) -> Array:
        return self._solver.solve(self._upper, np.asfortranarray(f)).reshape(f.shape)
