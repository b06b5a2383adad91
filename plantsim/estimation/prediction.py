"""Prediction of touches not made yet, with uncertainty; and the score of an estimate."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from plantsim.arrays import Array
from plantsim.elastic.loads import Move, ids_in
from plantsim.elastic.model import ElasticModel
from plantsim.errors import EstimateError
from plantsim.estimation.cases import Case, check_free
from plantsim.estimation.estimate import Estimate
from plantsim.estimation.large_response import respond
from plantsim.estimation.observation import Observation, as_move


@dataclass(frozen=True, eq=False, repr=False)
class Prediction:
    """What a touch will show and feel like, each with one standard deviation."""

    moved: Array  # (k,) ids
    displacement: Array  # (n, 3) [m]
    force: Array  # (k, 3) [N]
    displacement_std: Array  # (n, 3) [m]
    force_std: Array  # (k, 3) [N]
    total_std: Array  # (3,) [N], of the sum of the forces

    def __repr__(self) -> str:
        total = np.linalg.norm(self.force.sum(axis=0))
        return (
            f"Prediction({len(self.moved)} vertices; {total:.3g} N in all, within "
            f"{np.linalg.norm(self.total_std):.2g}; displacements within "
            f"{1000 * self.displacement_std.max():.2g} mm)"
        )


@dataclass(frozen=True)
class Score:
    """Errors over touches, as in the paper's Table I: means over the touches."""

    visual: float  # [cm], mean over vertices
    tactile: float  # [N], sum over contact vertices
    visual_relative: float  # over the mean motion of the vertices
    tactile_relative: float  # over the sum of the forces


def touch_case(model: ElasticModel, move: Move) -> tuple[Case, Array]:
    """Return a load case without readings, and the order of its sorted vertices."""
    ids = ids_in(model.mesh, move.ids, "touch")
    check_free(model, ids)
    order = np.argsort(ids)
    goal = np.broadcast_to(move.displacement, (len(ids), 3))[order]
    return Case(ids[order], goal.ravel(), np.zeros_like(model.mesh.points)), order


def predict(found: Estimate, touches: Any) -> tuple[Prediction, ...]:
    """Return what each touch (`ps.move`, `ps.grasp`) will show and feel like.

    Means are those of the material found. Standard deviations are linear in the posterior:
    exact for few parameters, from 200 draws (5 % off) for many. They leave out the noise of
    the sensors. Raises EstimateError for an estimate by force balance, which knows none.
    """
    posterior = found.posterior
    logs = posterior.objective.chart.log(posterior.root())
    out = []
    for move in _moves(found.model, touches):
        case, order = touch_case(found.model, move)
        response = respond(found.model, [case])
        du, df = response.change_of(0, logs)
        back = np.argsort(order)
        u, std = response.field(0), np.zeros_like(found.model.mesh.points)
        u[case.moved] = case.goal.reshape(-1, 3)
        std[response.free] = _size(du).reshape(-1, 3)
        std[case.moved] = 0.0
        out.append(
            Prediction(
                case.moved[back],
                u,
                response.force[0].reshape(-1, 3)[back],
                std,
                _size(df).reshape(-1, 3)[back],
                _size(df.reshape(-1, 3, df.shape[1]).sum(axis=0)),
            )
        )
    return tuple(out)


def score(
    found: Estimate | ElasticModel,
    truth: ElasticModel | Observation | Iterable[Observation],
    touches: Any = None,
) -> Score:
    """Return how far an estimate (or any model) is off on touches it has not seen.

    `truth`: a model, with `touches`; or observations, whose seen vertices and felt forces
    are compared. Means over the touches of the paper's visual error (mean over vertices of
    the distance) and tactile error (sum over contact vertices).
    """
    model = found.model if isinstance(found, Estimate) else found
    rows = []
    if isinstance(truth, ElasticModel):
        if touches is None:
            raise EstimateError("score against a model needs touches. Give some.")
        for move in _moves(model, touches):
            ours, theirs = model.solve(move), truth.solve(move)
            at = theirs.moved
            rows.append(
                _errors(
                    ours.displacement,
                    theirs.displacement,
                    ours.force[at],
                    theirs.force[at],
                )
            )
    else:
        seen = [truth] if isinstance(truth, Observation) else list(truth)
        for one in seen:
            if one.force is None or not len(one.seen) or len(one.loaded):
                raise EstimateError(
                    "score needs observations of moved vertices alone, with their forces "
                    "and some vertices seen. Leave out the others."
                )
            ours = model.solve(Move(one.moved, one.move))
            rows.append(
                _errors(
                    ours.displacement[one.seen],
                    one.displacement,
                    ours.force[one.moved],
                    one.force,
                )
            )
    if not rows:
        raise EstimateError("no touches to score by. Give at least one.")
    return Score(*map(float, np.mean(rows, axis=0)))


def _errors(u: Array, true_u: Array, f: Array, true_f: Array) -> tuple[float, ...]:
    visual = _length(u - true_u).mean()
    tactile = _length(f - true_f).sum()
    return (
        100 * visual,
        tactile,
        visual / max(_length(true_u).mean(), 1e-300),
        tactile / max(_length(true_f).sum(), 1e-300),
    )


def _length(x: Array) -> Array:
    return np.linalg.norm(x, axis=1)


def _size(x: Array) -> Array:
    return np.sqrt(np.einsum("...i,...i", x, x))


def _moves(model: ElasticModel, touches: Any) -> Sequence[Move]:
    many = touches if isinstance(touches, (list, tuple)) else [touches]
    if not many:
        raise EstimateError("no touches. Give at least one.")
    return [as_move(touch, model) for touch in many]
