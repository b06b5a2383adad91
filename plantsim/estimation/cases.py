"""Load cases: observations gathered so that each equilibrium is solved for once.

In a linear model proportional touches of the same vertices are one load case: their
readings, each over its own share, are weighed by their precision. The cost changes by a
constant, so the estimate is the same. In a corotational one equal touches are.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from plantsim.arrays import Array, few, vertex_ids
from plantsim.elastic.model import ElasticModel
from plantsim.errors import EstimateError
from plantsim.estimation.observation import Observation, arms, wrench_modes

EXACT = (
    1e-3  # noise of readings said to be exact, over the root mean square of the readings
)
SAME = 1e-9  # relative difference up to which touches are proportional


@dataclass(eq=False)
class Case:
    """One load case: what was done, and what was read, with its precision."""

    moved: Array  # (k,) ids, ascending
    goal: Array  # (3k,) displacement of the moved vertices [m]
    load: Array  # (n, 3) [N]
    # readings over all vertices' components; a precision of 0 where nothing was seen
    displacement: Array = field(default_factory=lambda: np.zeros(0))  # (3n,) [m]
    displacement_weight: Array = field(default_factory=lambda: np.zeros(0))  # [1/m^2]
    # readings of force: feel (j, 3k) of the contact forces
    feel: Array = field(default_factory=lambda: np.zeros((0, 0)))
    force: Array = field(default_factory=lambda: np.zeros(0))  # (j,)
    force_weight: Array = field(default_factory=lambda: np.zeros(0))  # (j,)
    count: int = 1  # observations in it


def gather(model: ElasticModel, observations: Sequence[Observation]) -> tuple[Case, ...]:
    """Return the load cases of observations; EstimateError where the model denies one."""
    cases: list[Case] = []
    linear = model.kinematics == "linear"
    for seen in observations:
        one = _case(model, seen)
        for other in cases:
            share = _share(one, other)
            # at large rotation only the same touch again is the same equilibrium
            if share is not None and (linear or abs(share - 1) <= SAME):
                _merge(other, one, share)
                break
        else:
            cases.append(one)
    read = sum(
        int((case.displacement_weight > 0).sum() + len(case.force)) for case in cases
    )
    if not read:
        raise EstimateError(
            "the observations hold no force, and no displacement of a free vertex. Look, "
            "or feel, at least once."
        )
    return tuple(cases)


def _case(model: ElasticModel, seen: Observation) -> Case:
    n = len(model.mesh.points)
    for name in ("moved", "seen", "loaded"):
        vertex_ids(getattr(seen, name), n, name)
    check_free(model, seen.moved)
    order = np.argsort(seen.moved)
    moved = seen.moved[order]
    load = np.zeros((n, 3))
    load[seen.loaded] = seen.load
    weight, y = np.zeros((n, 3)), np.zeros((n, 3))
    y[seen.seen] = seen.displacement
    weight[seen.seen] = 1 / _noise(seen, "displacement") ** 2
    # these are known anyway
    weight[model.fixed_ids] = weight[moved] = 0
    feels, forces, weights = [], [], []
    if seen.force is not None:
        feels.append(np.eye(3 * len(moved)))
        forces.append(seen.force[order].ravel())
        weights.append(1 / _noise(seen, "force")[order].ravel() ** 2)
    if seen.wrench is not None:
        at = arms(model, moved, seen.move[order])
        modes = wrench_modes(at)[:, : len(seen.wrench)]
        feels.append(modes.T)
        forces.append(seen.wrench)
        weights.append(1 / _noise(seen, "wrench") ** 2)
    none = np.zeros(0)
    return Case(
        moved,
        seen.move[order].ravel(),
        load,
        y.ravel(),
        weight.ravel(),
        np.vstack([np.zeros((0, 3 * len(moved))), *feels]),
        np.concatenate([none, *forces]),
        np.concatenate([none, *weights]),
    )


def check_free(model: ElasticModel, moved: Array) -> None:
    """Raise EstimateError for moved vertices that the model holds fixed."""
    held = np.intersect1d(moved, model.fixed_ids)
    if len(held):
        raise EstimateError(
            f"an observation moves {len(held)} vertices that the model holds fixed (first "
            f"ids: {few(held)}). Take them out of one."
        )


def _noise(seen: Observation, name: str) -> Array:
    """Return standard deviations; of exact readings, a thousandth of what is typical."""
    value = np.asarray(getattr(seen, name))
    noise = seen.noise_of(name)
    parts = np.split(value, 2) if name == "wrench" and value.size == 6 else [value]
    typical = [np.sqrt(np.mean(part**2)) if part.size else 0.0 for part in parts]
    least = EXACT * np.repeat(typical, 3) if len(parts) == 2 else EXACT * typical[0]
    noise = np.where(noise > 0, noise, least)
    if not (noise > 0).all():
        raise EstimateError(
            f"an observation has {name} zero throughout and {name}_noise 0. Give the "
            "noise, or leave the reading out."
        )
    return noise


def _share(one: Case, other: Case) -> float | None:
    """Return how many times `other` the touch `one` is, None if it is not."""
    if not np.array_equal(one.moved, other.moved):
        return None
    share: float | None = None
    for a, b in ((one.goal, other.goal), (one.load, other.load)):
        if not b.any():
            if a.any():
                return None
            continue
        c = float(np.vdot(a, b) / np.vdot(b, b))
        if share is not None and abs(c - share) > SAME * abs(share):
            return None
        if np.abs(a - c * b).max() > SAME * np.abs(b).max() or not c:
            return None
        share = c
    return share


def _merge(other: Case, one: Case, share: float) -> None:
    """Add the readings of `one`, `share` times the touch of `other`, to it."""
    other.displacement, other.displacement_weight = _mean(
        (other.displacement, one.displacement / share),
        (other.displacement_weight, one.displacement_weight * share**2),
    )
    if other.feel.shape == one.feel.shape and np.array_equal(other.feel, one.feel):
        other.force, other.force_weight = _mean(
            (other.force, one.force / share),
            (other.force_weight, one.force_weight * share**2),
        )
    else:
        other.feel = np.vstack([other.feel, one.feel])
        other.force = np.concatenate([other.force, one.force / share])
        other.force_weight = np.concatenate(
            [other.force_weight, one.force_weight * share**2]
        )
    other.count += one.count


def _mean(values: Any, weights: Any) -> tuple[Array, Array]:
    total = weights[0] + weights[1]
    mean = weights[0] * values[0] + weights[1] * values[1]
    return mean / np.where(total > 0, total, 1), total
