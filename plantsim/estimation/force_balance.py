"""Force balance: the paper's convex programme for the Lame parameters.

    minimise  sum_t |(W(u_t) theta - f_t) / s_f|^2  +  |D x|^2
    over theta = theta of the prior (1 + B x) >= 0

It trusts the displacements to be exact; with noise on them it fails, as K amplifies it.
Source: Yao and Hauser, Generating and Estimating Linear FEM Plant Simulation Models.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import cvxpy as cp
import numpy as np
from scipy.sparse import csr_array, diags_array, issparse, vstack

from plantsim.arrays import Array, few, vertex_ids
from plantsim.elastic.model import ElasticModel
from plantsim.errors import EstimateError
from plantsim.estimation.cases import check_free
from plantsim.estimation.force_matrix import force_matrix
from plantsim.estimation.observation import Observation
from plantsim.estimation.parameters import Chart

Rows = Literal["contact", "balance"]
LEAST = 1e-6  # smallest multiplier: theta >= 0, and a solid needs mu above 0
EXACT = 1e-6  # least noise of a force, over the root mean square of the forces
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
    chart: Chart,
    rows: Rows,
    solver: str,
) -> tuple[Array, EstimateStats]:
    """Return x (p,) of the programme, and how it was found."""
    began = time.perf_counter()
    parts = [_equations(model, seen, rows) for seen in observations]
    weights = [1 / s for _, _, s in parts]
    M: Any = vstack(
        [diags_array(w) @ W for w, (W, _, _) in zip(weights, parts, strict=True)]
    )
    f = np.concatenate([f for _, f, _ in parts])
    w = np.concatenate(weights)
    M = M @ diags_array(chart.theta)
    g = w * f - M @ np.ones(len(chart.theta))
    B: Any = csr_array(M @ chart.B)
    N, h = _reduced(B, g) if chart.size <= DENSE else (B, g)
    x = cp.Variable(chart.size)
    # where columns only say which tets go together, one bound each is enough
    bound = chart.mix if chart.columns.nnz == len(chart.theta) else chart.B
    objective = cp.sum_squares(N @ x - h) + cp.sum_squares(chart.precision @ x)
    problem = cp.Problem(cp.Minimize(objective), [bound @ x >= LEAST - 1])
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
    found = np.asarray(x.value)
    miss = (B @ found - g) / w
    stats = EstimateStats(
        "force-balance",
        solver,
        problem.status,
        len(f),
        chart.size,
        float(np.asarray(problem.value)),
        float(np.sqrt(np.mean(miss**2))),
        time.perf_counter() - began,
    )
    return found, stats


def _equations(
    model: ElasticModel, seen: Observation, rows: Rows
) -> tuple[Any, Array, Array]:
    """Return W on the chosen rows, the forces there, and their standard deviations."""
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
    check_free(model, seen.moved)
    if seen.force is None or not seen.force.any():
        raise EstimateError(
            "force balance needs the force on each moved vertex, and an observation has "
            "none. Leave it out, or use method='map'."
        )
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
    f, noise = np.zeros((2, n, 3))
    f[seen.loaded] = seen.load
    f[seen.moved] += seen.force
    typical = np.sqrt(np.mean(seen.force**2))
    noise[seen.moved] = seen.noise_of("force")
    # where nothing was felt the balance is as sure as the forces are on the whole
    mean = np.sqrt(np.mean(noise[seen.moved] ** 2))
    noise[np.setdiff1d(np.arange(n), seen.moved)] = mean
    noise = np.maximum(noise, EXACT * typical)
    W = force_matrix(model, u)[(3 * at[:, None] + np.arange(3)).ravel()]
    return W, f[at].ravel(), noise[at].ravel()


def _reduced(B: Any, g: Array) -> tuple[Array, Array]:
    """Return a small (M, h) with |M x - h|^2 = |B x - g|^2 up to a constant, by QR."""
    dense = B.toarray() if issparse(B) else np.asarray(B)
    R: Any = np.linalg.qr(np.column_stack([dense, g]), mode="r")
    return R[:, :-1], R[:, -1]
