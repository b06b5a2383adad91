"""Force balance: the paper's convex programme for the Lame parameters.

    minimise  sum_t |W(u_t) theta - f_t|^2 / s_f^2  +  |x - x0|^2 / spread^2
    over x >= 0, theta = A x

It trusts the displacements to be exact; with noise on them it fails, as K amplifies it.
Source: Yao and Hauser, Generating and Estimating Linear FEM Plant Simulation Models.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import cvxpy as cp
import numpy as np
from scipy.sparse import csr_array, issparse, vstack

from plantsim.arrays import Array, few, vertex_ids
from plantsim.elastic.model import ElasticModel
from plantsim.errors import EstimateError
from plantsim.estimation.force_matrix import force_matrix
from plantsim.estimation.observation import Observation
from plantsim.estimation.parameters import Linear

Rows = Literal["contact", "balance"]
LEAST = 1e-6  # smallest multiplier: theta >= 0, and a solid needs mu above 0
DENSE = 2000  # up to so many parameters the rows are first reduced by QR


@dataclass(frozen=True)
class EstimateStats:
    """How an estimate was found."""

    method: str
    solver: str
    status: str
    rows: int  # equations
    parameters: int
    objective: float
    misfit: float  # rms of (W theta - f) over rows [N]
    seconds: float


def solve(
    model: ElasticModel,
    observations: Sequence[Observation],
    linear: Linear,
    rows: Rows,
    solver: str,
) -> tuple[Array, EstimateStats]:
    """Return the multipliers x (p,) of the programme, and how they were found."""
    began = time.perf_counter()
    parts = [_equations(model, seen, linear, rows) for seen in observations]
    B: Any = vstack([b / s for b, _, s in parts])
    g = np.concatenate([f / s for _, f, s in parts])
    count = len(g)
    M, h = _reduced(B, g) if len(linear.mean) <= DENSE else (B, g)
    x = cp.Variable(len(linear.mean))
    prior = cp.sum_squares((x - linear.mean) / linear.std)
    problem = cp.Problem(cp.Minimize(cp.sum_squares(M @ x - h) + prior), [x >= LEAST])
    try:
        problem.solve(solver=solver)
    except cp.SolverError as why:
        raise EstimateError(
            f"force balance: {solver} failed ({why}). Try another solver, of "
            f"{', '.join(cp.installed_solvers())}."
        ) from None
    if problem.status != cp.OPTIMAL or x.value is None:
        raise EstimateError(
            f"force balance: {solver} ended {problem.status!r}. Try another solver, of "
            f"{', '.join(cp.installed_solvers())}."
        )
    found = np.maximum(x.value, LEAST)
    miss = np.concatenate([b @ found - f for b, f, _ in parts])
    stats = EstimateStats(
        "force-balance",
        solver,
        problem.status,
        count,
        len(found),
        float(np.asarray(problem.value)),
        float(np.sqrt(np.mean(miss**2))),
        time.perf_counter() - began,
    )
    return found, stats


def _equations(
    model: ElasticModel, seen: Observation, linear: Linear, rows: Rows
) -> tuple[csr_array, Array, float]:
    """Return W A on the chosen rows, the forces there, and their standard deviation."""
    n = len(model.mesh.points)
    for name in ("moved", "seen"):
        vertex_ids(getattr(seen, name), n, name)
    u, known = np.zeros((n, 3)), np.zeros(n, dtype=bool)
    fixed = np.asarray(model.fixed)
    for ids, values in (
        (seen.seen, seen.displacement),
        (fixed, 0.0),
        (seen.moved, seen.move),  # the gripper knows its own motion best
    ):
        u[ids] = values
        known[ids] = True
    blind = np.zeros(n, dtype=bool)  # vertices of which a neighbour was not seen
    blind[model.mesh.tets[~known[model.mesh.tets].all(axis=1)]] = True
    held = np.intersect1d(seen.moved, fixed)
    if len(held):
        raise EstimateError(
            f"an observation moves {len(held)} vertices that the model holds fixed (first "
            f"ids: {few(held)}). Take them out of one."
        )
    if not seen.force.any():
        raise EstimateError("an observation has no force at all. Leave it out.")
    hidden = seen.moved[blind[seen.moved]]
    if len(hidden):
        raise EstimateError(
            "force balance needs the displacement of every vertex around a touched one; "
            f"around {len(hidden)} of {len(seen.moved)} it was not seen (first ids: "
            f"{few(hidden)}). Observe more vertices."
        )
    at = seen.moved
    if rows == "balance":
        free = np.setdiff1d(np.arange(n), np.union1d(fixed, seen.moved))
        at = np.concatenate([at, free[~blind[free]]])
    f = np.zeros((len(at), 3))
    f[: len(seen.moved)] = seen.force
    W = force_matrix(model, u)[(3 * at[:, None] + np.arange(3)).ravel()]
    typical = float(np.sqrt(np.mean(seen.force**2)))
    noise = seen.force_noise or 1e-6 * typical
    return csr_array(W @ linear.A), f.ravel(), noise


def _reduced(B: Any, g: Array) -> tuple[Array, Array]:
    """Return a small (M, h) with |M x - h|^2 = |B x - g|^2 up to a constant, by QR."""
    dense = B.toarray() if issparse(B) else np.asarray(B)
    R: Any = np.linalg.qr(np.column_stack([dense, g]), mode="r")
    return R[:, :-1], R[:, -1]
