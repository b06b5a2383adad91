"""Where to touch next: the touch whose readings leave the least uncertainty.

With Z a root of the posterior's covariance and J the derivative of a touch's readings, in
units of their noise, the covariance after it is Z (I + R)^-1 Z^T, R = (J Z)^T (J Z). The
gain is D-optimal, log det(I + R) / 2, or A-optimal, the share of the summed variance of
some quantities that goes.
Source: Chaloner and Verdinelli 1995, Stat. Sci. 10, Bayesian experimental design.
"""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from plantsim.arrays import Array, frozen
from plantsim.elastic.loads import Move
from plantsim.errors import EstimateError
from plantsim.estimation.cases import EXACT
from plantsim.estimation.estimate import Estimate
from plantsim.estimation.large_response import respond
from plantsim.estimation.observation import Observation, as_move
from plantsim.estimation.posterior import limb_rows
from plantsim.estimation.prediction import touch_case
from plantsim.estimation.response import Response

DRAWS = 60  # posterior draws by which candidates are ranked, for many parameters


@dataclass(frozen=True, eq=False, repr=False)
class Proposal:
    """The touch to make next, and what each candidate would bring."""

    touch: Move
    index: int  # of the candidate
    gain: Array  # (c,) expected gain of each candidate, before its cost
    criterion: str

    def __repr__(self) -> str:
        return (
            f"Proposal(candidate {self.index} of {len(self.gain)}, {self.criterion} gain "
            f"{self.gain[self.index]:.3g}; the others {self.gain.min():.3g} to "
            f"{self.gain.max():.3g})"
        )


def next_touch(
    found: Estimate,
    candidates: Any,
    depth: float = 0.01,
    cost: ArrayLike | None = None,
    *,
    direction: ArrayLike = (0.0, 0.0, -1.0),
    criterion: Literal["A", "D"] | Move = "A",
    seen: ArrayLike | str | None = None,
    displacement_noise: float | None = None,
    force_noise: float | None = None,
) -> Proposal:
    """Return the candidate that is expected to teach most, and the gain of each.

    `candidates`: vertex ids, each pushed alone by `depth` [m] along `direction`; or touches
    (`ps.move`, `ps.grasp`). `cost` (c,): what each costs, such as the robot's time; the
    best gain for its cost wins. `criterion`: "A", the share of the variance of the limbs'
    log Young's moduli that goes; "D", nats of information on all parameters; or a
    `ps.move(...)` whose contact forces are what one wants to know. `seen` (all where None)
    and noise [m, N] are those of the touch to come; by default the noise of the
    observations so far.
    """
    model = found.model
    moves = _candidates(found, candidates, depth, direction)
    price = np.ones(len(moves)) if cost is None else np.asarray(cost, dtype=float)
    if price.shape != (len(moves),) or not (price > 0).all():
        raise EstimateError(
            f"cost: shape {price.shape} for {len(moves)} candidates; give one number above "
            "0 for each."
        )
    posterior = found.posterior
    logs = posterior.objective.chart.log(posterior.root(DRAWS))
    if isinstance(criterion, Move):
        target = _changes(found, criterion, logs)[2]
    elif criterion == "A":
        target = limb_rows(model)[1] @ logs
    elif criterion == "D":
        target = None
    else:
        raise EstimateError(f"criterion is {criterion!r}; give 'A', 'D' or a ps.move().")
    at = np.arange(len(model.mesh.points)) if seen is None else model.vertices(seen, "seen")
    if displacement_noise is None:
        displacement_noise = _noise(found.observations, "displacement")
    if force_noise is None:
        force_noise = _noise(found.observations, "force")
    gain = np.empty(len(moves))
    for i, move in enumerate(moves):
        response, du, df = _changes(found, move, logs)
        visible = (response.rows(np.intersect1d(at, response.free))).ravel()
        JZ = np.vstack(
            [
                du[visible] / (displacement_noise or EXACT * _rms(response.u)),
                df / (force_noise or EXACT * _rms(response.force[0])),
            ]
        )
        R = np.eye(logs.shape[1]) + JZ.T @ JZ
        if target is None:
            gain[i] = 0.5 * np.linalg.slogdet(R)[1]
        else:
            after = np.vdot(target, np.linalg.solve(R, target.T).T)
            gain[i] = 1 - after / np.vdot(target, target)
    best = int(np.argmax(gain / price))
    name = "quantity" if isinstance(criterion, Move) else f"{criterion}-optimal"
    return Proposal(moves[best], best, gain, name)


def _changes(found: Estimate, move: Move, logs: Array) -> tuple[Response, Array, Array]:
    response = respond(found.model, [touch_case(found.model, move)[0]])
    return response, *response.change_of(0, logs)


def _candidates(
    found: Estimate, candidates: Any, depth: float, direction: ArrayLike
) -> list[Move]:
    if isinstance(candidates, (list, tuple)) and not all(
        isinstance(c, (int, np.integer)) for c in candidates
    ):
        moves = [as_move(touch, found.model) for touch in candidates]
    else:
        way = frozen(direction, (3,), name="direction", error=EstimateError)
        size = float(np.linalg.norm(way))
        if not (size and 0 < depth < np.inf):
            raise EstimateError(
                f"depth {depth} m along {direction}; give a positive depth and a way."
            )
        ids = found.model.vertices(candidates, "candidates")
        moves = [Move(np.array([v]), way * depth / size) for v in ids]
    if not moves:
        raise EstimateError("no candidates. Give at least one.")
    return moves


def _noise(observations: tuple[Observation, ...], name: str) -> float:
    """Return the median noise of the readings so far, 0 where there are none."""
    parts = [
        seen.noise_of(name).ravel()
        for seen in observations
        if getattr(seen, name) is not None
    ]
    values = np.concatenate([np.zeros(0), *parts])
    return float(np.median(values)) if len(values) else 0.0


def _rms(x: Array) -> float:
    return float(np.sqrt(np.mean(x**2)))
