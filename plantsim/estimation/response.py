"""Response: displacements and contact forces of load cases, and their derivatives.

Of a linear model here, of a corotational one in `large_response`.

With K factored once, base fixed, and unit columns E of the moved components,

    Y = K^-1 E,   S = E^T Y,   f = S^-1 (d - (K^-1 b)_C),   u = K^-1 b + Y f,

and for a change v of the log-moduli, with x = K^-1 (W(u) diag(theta) v),

    df = S^-1 x_C,   du = -(x - Y df).

The transposes cost one back-solve too. All load cases share K: all are solved at once.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
import scipy.linalg
from scipy.sparse import csr_array

from plantsim.arrays import Array
from plantsim.elastic.model import ElasticModel
from plantsim.errors import EstimateError, SolverError
from plantsim.estimation.cases import Case
from plantsim.solve.stats import norm

ACCEPTED = 1e-8  # backward error of an equilibrium
MANY = 96  # columns that are solved for at a time


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

    @abstractmethod
    def change(self, log: Array) -> tuple[Array, list[Array]]:
        """Return du (free, cases) [m] and df of each case for a change of log-moduli."""

    @abstractmethod
    def pull(self, by_u: Array, by_f: Sequence[Array]) -> Array:
        """Return the transpose of `change` of (free, cases) and one (3k,) a case."""

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
    def fields(self) -> Array:
        """Displacements (n, 3, cases) [m] of all vertices."""
        return np.stack([self.field(t) for t in range(len(self.cases))], axis=2)

    @cached_property
    def W(self) -> Any:
        """Change of forces with the log-moduli, case after case, (cases free, 2m)."""
        mesh = self.model.mesh
        m, c = mesh.tets.shape
        mu, lam, _ = self.model.material.per_tet(m)
        T, nf = len(self.cases), 3 * len(self.free)
        order, indices, indptr = self._pattern
        data = np.empty((T, len(order)))
        both = np.empty((2, m, 3 * c))
        for t in range(T):
            unit_mu, unit_lam = self.model.deformed(self.fields[:, :, t]).unit_forces()
            np.multiply(unit_mu.reshape(m, -1), mu[:, None], out=both[0])
            np.multiply(unit_lam.reshape(m, -1), lam[:, None], out=both[1])
            data[t] = both.reshape(-1)[order]
        step = len(order)
        starts = (indptr[:-1] + step * np.arange(T)[:, None]).ravel()
        return csr_array(
            (data.ravel(), np.tile(indices, T), np.append(starts, T * step)),
            shape=(T * nf, 2 * m),
        )

    @cached_property
    def _pattern(self) -> tuple[Array, Array, Array]:
        if self._like is not None:
            return self._like
        return _pattern(self.model.mesh.tets, self._place, 3 * len(self.free))

    @cached_property
    def _transposed(self) -> Any:
        return self.W.T

    def _dense(self, t: int, columns: Any) -> Array:
        """Return the forces of case t by many changes, (free, q)."""
        nf = 3 * len(self.free)
        loads = self.W[t * nf : (t + 1) * nf] @ columns
        return loads.toarray(order="F") if hasattr(loads, "toarray") else loads


class LinearResponse(Response):
    """Of a linear model: one factor, base fixed, serves all cases."""

    def __init__(
        self, model: ElasticModel, cases: Sequence[Case], like: Response | None = None
    ) -> None:
        """Factor K and solve for every case."""
        super().__init__(model, cases, like)
        _, self._factor = model.base_factor()
        self._columns = self._compliance()
        self._inverse = [
            self._positive(Y[at]) if len(at) else np.zeros((0, 0))
            for Y, at in zip(self._columns, self._at, strict=True)
        ]
        loads = np.stack([case.load[self.free].ravel() for case in cases], axis=1)
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
        for start in range(0, len(at), MANY):
            part = at[start : start + MANY]
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
        T = len(self.cases)
        x = self.solve((self.W @ log).reshape(T, -1).T)
        df = []
        for t, at in enumerate(self._at):
            f = self._inverse[t] @ x[at, t]
            df.append(f)
            if len(at):
                x[:, t] -= self._columns[t] @ f
        return np.negative(x, out=x), df

    def pull(self, by_u: Array, by_f: Sequence[Array]) -> Array:
        """Return the transpose of `change` of (free, cases) and one (3k,) a case."""
        r = np.asfortranarray(-by_u)
        for t, at in enumerate(self._at):
            if len(at):
                r[at, t] += self._inverse[t] @ (self._columns[t].T @ by_u[:, t] + by_f[t])
        return self._transposed @ self.solve(r).T.ravel()

    def change_of(self, t: int, columns: Any) -> tuple[Array, Array]:
        """Return du (free, q) and df (3k, q) of case t for many changes, sparse (2m, q)."""
        x = self.solve(self._dense(t, columns))
        at = self._at[t]
        df = self._inverse[t] @ x[at]
        return self._columns[t] @ df - x, df


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
