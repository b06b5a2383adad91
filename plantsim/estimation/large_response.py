"""Response at large rotation: every case a converged equilibrium, with its own tangent.

With a corotational model's forces f(u, theta), linear in theta, its tangent K at the
equilibrium of a case, C its moved vertices and A the other free ones,

    du_A = -K_AA^-1 w_A,   du_C = 0,   df = w_C + K_CA du_A,

for a change v of the log-moduli, w = W(u) diag(theta) v. The transpose costs one back-solve
too.
"""

import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np

from plantsim.arrays import Array
from plantsim.elastic.equilibrium import Equilibrium
from plantsim.elastic.loads import Force, Load, Move
from plantsim.elastic.model import ElasticModel
from plantsim.elastic.newton import large_equilibrium
from plantsim.errors import SolverError, StoppedWarning
from plantsim.estimation.cases import Case
from plantsim.estimation.response import LinearResponse, Response, total
from plantsim.solve.solver import Factor, choose

TOLERANCE = 1e-9  # residual of an equilibrium, over its forces


class LargeResponse(Response):
    """Of a corotational model; begins at the states of `like`, where that is given."""

    def __init__(
        self, model: ElasticModel, cases: Sequence[Case], like: Response | None = None
    ) -> None:
        """Find the equilibrium of every case; SolverError where there is none."""
        super().__init__(model, cases, like)
        before = like.states if isinstance(like, LargeResponse) else [None] * len(cases)
        self.states = [
            _equilibrium(model, case, start)
            for case, start in zip(cases, before, strict=True)
        ]
        self.u = np.stack([s.displacement[self.free].ravel() for s in self.states], axis=1)
        self.force = [
            (s.force - case.load)[case.moved].ravel()
            for s, case in zip(self.states, cases, strict=True)
        ]
        self._tangents: dict[int, tuple[Array, Factor, Any]] = {}

    def change(self, log: Array) -> tuple[Array, list[Array]]:
        """Return du (free, cases) [m] and df of each case for a change of log-moduli."""
        w = np.concatenate([W @ log for W in self.W]).reshape(len(self.cases), -1)
        du, df = np.zeros_like(self.u), []
        for t in range(len(self.cases)):
            du[:, t : t + 1], f = self._change(t, w[t][:, None])
            df.append(f[:, 0])
        return du, df

    def pull(self, by_u: Array, by_f: Sequence[Array]) -> Array:
        """Return the transpose of `change` of (free, cases) and one (3k,) a case."""
        e = np.zeros_like(by_u)
        for t, at in enumerate(self._at):
            rest, factor, across = self._tangent(t)
            e[rest, t] = -factor(by_u[rest, t] + across @ by_f[t], check=False)[0]
            e[at, t] = by_f[t]
        parts = zip(self._transposed, self._shares, strict=True)
        return total([back @ e[:, own].T.ravel() for back, own in parts])

    def change_of(self, t: int, columns: Any) -> tuple[Array, Array]:
        """Return du (free, q) and df (3k, q) of case t for many changes, sparse (2m, q)."""
        return self._change(t, self._dense(t, columns))

    def _change(self, t: int, w: Array) -> tuple[Array, Array]:
        """Return du (free, q) and df (3k, q) of case t for forces w (free, q)."""
        rest, factor, across = self._tangent(t)
        du = np.zeros_like(w)
        du[rest] = -factor(np.asfortranarray(w[rest]), check=False)[0]
        return du, w[self._at[t]] + across.T @ du[rest]

    def _tangent(self, t: int) -> tuple[Array, Factor, Any]:
        """Return the components A, the factor of K_AA, and K_AC, at the state of case t."""
        if t not in self._tangents:
            state, model, moved = self.states[t], self.model, self.cases[t].moved
            rest = np.setdiff1d(self.free, moved)
            K = state.tangent
            inner: Any = model.pattern.condense(K, rest, rest)
            solver = choose(model.solver, inner.shape[0])
            like = None if state.near is None else state.near.factor
            factor = solver.factor(inner, model.mesh.points[rest], like)
            across: Any = model.pattern.condense(K, rest, moved).tocsr()
            self._tangents[t] = self.rows(rest), factor, across
        return self._tangents[t]


def _equilibrium(model: ElasticModel, case: Case, start: Equilibrium | None) -> Equilibrium:
    loads: list[Load] = []
    if len(case.moved):
        loads.append(Move(case.moved, case.goal.reshape(-1, 3)))
    if case.load.any():
        loads.append(Force(np.arange(len(case.load)), case.load))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", StoppedWarning)
        state = large_equilibrium(model, loads, start, tolerance=TOLERANCE)
    carried = getattr(state.stats, "fraction", 1.0)
    if carried < 1:
        raise SolverError(
            f"estimate: a touch is carried to {carried:.3g} of its load only. Leave it "
            "out, or check the moduli of the prior."
        )
    return state


def respond(
    model: ElasticModel, cases: Sequence[Case], like: Response | None = None
) -> Response:
    """Return the response of a model by its kinematics."""
    kind = LinearResponse if model.kinematics == "linear" else LargeResponse
    return kind(model, cases, like)
