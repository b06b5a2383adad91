"""Response: displacements and contact forces of load cases, and their derivatives.

Of a linear model here, of a corotational one in `large_response`.

With K factored once, base fixed, and unit columns E of the moved components,

    Y = K^-1 E,   S = E^T Y,   f = S^-1 (d - (K^-1 b)_C),   u = K^-1 b + Y f,

and for a change v of the log-moduli, with x = K^-1 (W(u) diag(theta) v),

    df = S^-1 x_C,   du = -(x - Y df).

The transposes cost one back-solve too. All load cases share K. With a sparse factor they
are cut in shares of a few, each carried right through by one thread; sums go from share to
share in order, so the numbers do not depend on how many threads there are.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
import scipy.linalg
from scipy.sparse import csr_array

from plantsim.arrays import Array
from plantsim.elastic.model import ElasticModel
from plantsim.errors import EstimateError, SolverError
from plantsim.estimation.cases import Case
from plantsim.solve.direct import STRIP, Direct
from plantsim.solve.sections import WIDE, Layout, Sections
from plantsim.solve.solver import Factor, choose
from plantsim.solve.stats import norm
from plantsim.solve.threads import shares, together

T = TypeVar("T")
# of du (free, k) [m] and df of k cases, a slice of all, makes what is to be pulled back
Weigh = Callable[[slice, Array, list[Array]], tuple[Array, list[Array]]]
ACCEPTED = 1e-8  # backward error of an equilibrium
MANY = 12  # columns that are solved for at a time by a sparse factor
LARGE = 5_000  # unknowns from which on shares of the cases are worth a thread each


class Response(ABC):
    """Load cases at one material. All arrays are over free components, cases last."""

    model: ElasticModel
    cases: Sequence[Case]
    free: Array  # (f,) ids of the vertices that are not fixed
    u: Array  # (3f, cases) [m]
    force: list[Array]  # (3k,) of each case [N]: contact forces on its moved vertices

    def __init__(
        self, model: ElasticModel, cases: Sequence[Case], like: "Response | None"
    ) -> None:
        """Give the free components numbers; `like` differs in the material alone."""
        self._like = None if like is None else like._pattern
        self.model, self.cases = model, cases
        n = len(model.mesh.points)
        self.free = np.setdiff1d(np.arange(n), model.fixed_ids)
        self._place = np.full(n, -1)
        self._place[self.free] = np.arange(len(self.free))
        self._at = [self.rows(case.moved) for case in cases]
        large = 3 * len(self.free) >= LARGE
        self._shares = shares(len(cases), STRIP, 2 if large else 1)
        self._threads = large

    @abstractmethod
    def change(self, log: Array) -> tuple[Array, list[Array]]:
        """Return du (free, cases) [m] and df of each case for a change of log-moduli."""

    @abstractmethod
    def pull(self, by_u: Array, by_f: Sequence[Array]) -> Array:
        """Return the transpose of `change` of (free, cases) and one (3k,) a case."""

    def around(self, log: Array, weigh: Weigh) -> Array:
        """Return the pull (2m,) of what `weigh` makes of the change of some cases each."""
        return self.pull(*weigh(slice(None), *self.change(log)))

    @abstractmethod
    def change_of(self, t: int, columns: Any) -> tuple[Array, Array]:
        """Return du (free, q) and df (3k, q) of case t for many changes, sparse (2m, q)."""

    def rows(self, ids: Array) -> Array:
        """Return the places of vertices' components among the free ones."""
        return (3 * self._place[ids][:, None] + np.arange(3)).ravel()

    def field(self, t: int) -> Array:
        """Return the displacement (n, 3) [m] of all vertices in case t."""
        u = np.zeros_like(self.model.mesh.points)
        u[self.free] = self.u[:, t].reshape(-1, 3)
        return u

    @cached_property
    def W(self) -> list[Any]:
        """Change of forces with the log-moduli, of each share: (its cases free, 2m)."""
        pattern = self._pattern
        return self._each(lambda i: self._force_matrix(self._shares[i], pattern))

    def _each(self, work: Callable[[int], T]) -> list[T]:
        """Return work(i) of every share i."""
        count = len(self._shares)
        return together(work, count) if self._threads else [work(i) for i in range(count)]

    def _force_matrix(self, share: slice, pattern: tuple[Array, Array, Array]) -> Any:
        mesh = self.model.mesh
        m, c = mesh.tets.shape
        mu, lam, _ = self.model.material.per_tet(m)
        cases = range(len(self.cases))[share]
        order, indices, indptr = pattern
        step, count = len(order), len(cases)
        data = np.empty((count, step))
        both = np.empty((2, m, 3 * c))
        for t, own in zip(cases, data, strict=True):
            unit_mu, unit_lam = self.model.deformed(self.field(t)).unit_forces()
            np.multiply(unit_mu.reshape(m, -1), mu[:, None], out=both[0])
            np.multiply(unit_lam.reshape(m, -1), lam[:, None], out=both[1])
            np.take(both.reshape(-1), order, out=own)
        starts = (indptr[:-1] + step * np.arange(count)[:, None]).ravel()
        return csr_array(
            (data.ravel(), np.tile(indices, count), np.append(starts, count * step)),
            shape=(count * 3 * len(self.free), 2 * m),
        )

    @cached_property
    def _pattern(self) -> tuple[Array, Array, Array]:
        if self._like is not None:
            return self._like
        return _pattern(self.model.mesh.tets, self._place, 3 * len(self.free))

    @cached_property
    def _transposed(self) -> list[Any]:
        return [W.T for W in self.W]

    def _dense(self, t: int, columns: Any) -> Array:
        """Return the forces of case t by many changes, (free, q)."""
        nf = 3 * len(self.free)
        i = next(i for i, share in enumerate(self._shares) if t < share.stop)
        first = (t - self._shares[i].start) * nf
        loads = self.W[i][first : first + nf] @ columns
        return loads.toarray(order="F") if hasattr(loads, "toarray") else loads


class LinearResponse(Response):
    """Of a linear model: one factor, base fixed, serves all cases."""

    def __init__(
        self, model: ElasticModel, cases: Sequence[Case], like: Response | None = None
    ) -> None:
        """Factor K and solve for every case."""
        super().__init__(model, cases, like)
        self._factor, self._layout = _factor(model, self.free, like)
        self._threads = self._threads and self._factor.threads
        self._many = MANY
        if isinstance(self._factor, Sections):
            self._shares, self._many = shares(len(cases), WIDE), WIDE
        self._columns = self._compliance()
        self._inverse = [
            self._positive(Y[at]) if len(at) else np.zeros((0, 0))
            for Y, at in zip(self._columns, self._at, strict=True)
        ]
        loads = np.stack([case.load[self.free].ravel() for case in cases]).T
        self.u = self.solve(loads, check=True) if loads.any() else np.zeros_like(loads)
        self.force: list[Array] = []
        for t, (case, at) in enumerate(zip(cases, self._at, strict=True)):
            f = self._inverse[t] @ (case.goal - self.u[at, t])
            self.u[:, t] += self._columns[t] @ f
            self.force.append(f)
        self._check(loads)

    def _check(self, loads: Array) -> None:
        """Raise SolverError where an equilibrium misses its backward error."""
        for t, at in enumerate(self._at):
            f = loads[:, t].copy()
            f[at] += self.force[t]
            Ku = (self.model.stiffness @ self.field(t).ravel()).reshape(-1, 3)
            r = Ku[self.free].ravel() - f
            error = norm(r) / max(self.model.size * norm(self.u[:, t]) + norm(f), 1e-300)
            if not error <= ACCEPTED:
                raise SolverError(
                    f"estimate: backward error {error:.1e} of a touch, wanted "
                    f"{ACCEPTED:.0e}. Moduli differ too much, or moved vertices lie too "
                    "close together: smooth the parameters, or move fewer."
                )

    def solve(self, loads: Array, check: bool = False) -> Array:
        """Return K^-1 loads, (free, k)."""
        return self._factor(np.asfortranarray(loads), check=check)[0]

    def _compliance(self) -> list[Array]:
        """Return Y of every case."""
        at = np.unique(np.concatenate(self._at))
        where = [np.searchsorted(at, own) for own in self._at]
        nf = 3 * len(self.free)
        out = [np.empty((nf, len(own)), order="F") for own in self._at]
        for start in range(0, len(at), self._many):
            part = at[start : start + self._many]
            E = np.zeros((nf, len(part)), order="F")
            E[part, np.arange(len(part))] = 1
            Y = self.solve(E)
            for own, w in zip(out, where, strict=True):
                mine = np.flatnonzero((w >= start) & (w < start + len(part)))
                own[:, mine] = Y[:, w[mine] - start]
        return out

    @staticmethod
    def _positive(S: Array) -> Array:
        try:
            cholesky = scipy.linalg.cho_factor((S + S.T) / 2)
        except scipy.linalg.LinAlgError:
            raise EstimateError(
                f"the {len(S) // 3} moved vertices of a touch cannot be told apart "
                "numerically. Leave out those that lie closest together."
            ) from None
        inverse = scipy.linalg.cho_solve(cholesky, np.eye(len(S)))
        return (inverse + inverse.T) / 2

    def change(self, log: Array) -> tuple[Array, list[Array]]:
        """Return du (free, cases) [m] and df of each case for a change of log-moduli."""
        W = self.W
        parts = self._each(lambda i: self._change(i, W[i] @ log))
        df = [f for _, some in parts for f in some]
        return np.concatenate([du.T for du, _ in parts]).T, df

    def pull(self, by_u: Array, by_f: Sequence[Array]) -> Array:
        """Return the transpose of `change` of (free, cases) and one (3k,) a case."""
        back, own = self._transposed, self._shares
        return total(
            self._each(lambda i: back[i] @ self._pull(i, by_u[:, own[i]], by_f[own[i]]))
        )

    def around(self, log: Array, weigh: Weigh) -> Array:
        """Return the pull (2m,) of what `weigh` makes of the change of some cases each."""
        W, back = self.W, self._transposed

        def share(i: int) -> Array:
            by_u, by_f = weigh(self._shares[i], *self._change(i, W[i] @ log))
            return back[i] @ self._pull(i, by_u, by_f)

        return total(self._each(share))

    def _change(self, i: int, loads: Array) -> tuple[Array, list[Array]]:
        """Return du (free, its cases) and df of each case of share i for their loads."""
        x = self.solve(loads.reshape(-1, len(self.u)).T)
        df = []
        for t, xt in zip(range(len(self.cases))[self._shares[i]], x.T, strict=True):
            df.append(np.einsum("ij,j->i", self._inverse[t], xt[self._at[t]]))
            if len(df[-1]):
                xt[:] -= np.einsum("ij,j->i", self._columns[t], df[-1])
        return np.negative(x, out=x), df

    def _pull(self, i: int, by_u: Array, by_f: Sequence[Array]) -> Array:
        """Return the loads (its cases free,) that are the transpose of `_change`."""
        r = np.asfortranarray(-by_u)
        own = range(len(self.cases))[self._shares[i]]
        for t, rt, felt in zip(own, r.T, by_f, strict=True):
            if len(felt):
                f = felt - np.einsum("ij,i->j", self._columns[t], rt)
                rt[self._at[t]] += np.einsum("ij,j->i", self._inverse[t], f)
        return self.solve(r).T.ravel()

    def change_of(self, t: int, columns: Any) -> tuple[Array, Array]:
        """Return du (free, q) and df (3k, q) of case t for many changes, sparse (2m, q)."""
        x = self.solve(self._dense(t, columns))
        at = self._at[t]
        df = self._inverse[t] @ x[at]
        return self._columns[t] @ df - x, df


def _factor(
    model: ElasticModel, free: Array, like: Response | None
) -> tuple[Factor, Layout | None]:
    """Return the factor of K, along sections if those are thin, and the sections."""
    solver = choose(model.solver, 3 * len(free))
    # about a state K may be indefinite
    if not (len(free) and isinstance(solver, Direct)) or model.about_a_state:
        return model.base_factor()[1], None
    K = model.pattern.condense(model.stiffness, free, free)
    known = like._layout if isinstance(like, LinearResponse) else None
    layout = Layout(K) if known is None else known
    if layout.thin:
        return Sections(K, layout, solver.tolerance), layout
    return model.base_factor()[1], layout


def total(parts: Sequence[Array]) -> Array:
    """Return the sum of some arrays, in order."""
    out = parts[0]
    for part in parts[1:]:
        out = out + part
    return out


def _pattern(tets: Array, place: Array, rows: int) -> tuple[Array, Array, Array]:
    """Return the CSR of one case: which entries of (2, m, 3c) in order, columns, starts."""
    m = len(tets)
    at = (3 * place[tets][:, :, None] + np.arange(3)).reshape(m, -1)
    at[np.repeat(place[tets] < 0, 3, axis=1)] = -1
    at = np.concatenate([at, at])
    order = np.argsort(at.ravel(), kind="stable")
    order = order[np.searchsorted(at.ravel()[order], 0) :]
    indptr = np.searchsorted(at.ravel()[order], np.arange(rows + 1))
    return order, (order // at.shape[1]).astype(np.int32), indptr
