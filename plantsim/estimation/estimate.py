"""estimate: observations -> Estimate, by the method asked for."""

import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from plantsim.arrays import Array, Random
from plantsim.cards import card
from plantsim.elastic.material import Material
from plantsim.elastic.model import ElasticModel
from plantsim.errors import EstimateError, check_kind, checked_all
from plantsim.estimation import output_error
from plantsim.estimation.cases import gather
from plantsim.estimation.observation import Observation
from plantsim.estimation.output_error import MapStats, Objective, Options, Step
from plantsim.estimation.parameters import Parameters, per_limb
from plantsim.estimation.posterior import Posterior, posterior, quantile
from plantsim.mesh.limbs import mean_by_region


@dataclass(frozen=True, eq=False, repr=False)
class Estimate:
    """A material found from touches, how, and how sure it is."""

    model: ElasticModel  # the prior's, with the material found
    prior: Material
    parameters: dict[
        str, float
    ]  # multiplier of the prior by name: "mu[3.1]", "lam[0]", ...
    stats: Any  # MapStats or force_balance.EstimateStats
    observations: tuple[Observation, ...]
    _objective: Objective | None = None

    @property
    def material(self) -> Material:
        """The material found, one value a tet."""
        return self.model.material

    @cached_property
    def posterior(self) -> Posterior:
        """Laplace's approximation of what is still uncertain, made at first use."""
        if self._objective is None:
            raise EstimateError(
                "force balance knows no uncertainty. Estimate with method='map'."
            )
        return posterior(self._objective)

    def young(self) -> dict[str, float]:
        """Return the mean Young's modulus [Pa] of each limb, by volume."""
        model = self.model
        return mean_by_region(model.mesh, self.material.young, model.blocks.volume)

    @property
    def std(self) -> dict[str, float]:
        """One standard deviation of each limb's Young's modulus, as a share of it."""
        names, _, var = self.posterior.limbs
        return dict(zip(names, map(float, np.sqrt(var)), strict=True))

    @property
    def tet_std(self) -> Array:
        """One standard deviation of each tet's Young's modulus, as a share of it, (m,)."""
        return self.posterior.tet_std

    def interval(self, level: float = 0.9) -> dict[str, tuple[float, float]]:
        """Return the bounds [Pa] that hold each limb's Young's modulus with `level`.

        Of the normal approximation of its logarithm.
        """
        z = quantile(level)
        young, std = self.young(), self.std
        return {
            name: (float(E * np.exp(-z * std[name])), float(E * np.exp(z * std[name])))
            for name, E in young.items()
        }

    @property
    def identified(self) -> dict[str, float]:
        """Share of the prior variance removed, by limb: 0 not seen at all, 1 known.

        Of the logarithm of the limb's Young's modulus.
        """
        names, prior, var = self.posterior.limbs
        return dict(zip(names, map(float, 1 - var / prior), strict=True))

    def sample(self, n: int, rng: Random) -> tuple[Material, ...]:
        """Return materials drawn from the posterior."""
        return tuple(
            _material(theta, self.material.density)
            for theta in self.posterior.sample(n, rng)
        )

    def plot(
        self, out: str | os.PathLike[str] = "estimate.png", *, next_touch: ArrayLike = ()
    ) -> Path:
        """Draw Young's modulus, its uncertainty and what was identified to a PNG.

        Of force balance, which knows no uncertainty, the modulus alone. `next_touch`: ids
        of vertices to touch next, in red. Returns the path.
        """
        # a picture is the only call that goes up, through this one door
        from plantsim.view.figures import figure_material, figure_posterior  # noqa: PLC0415

        mesh = self.model.mesh
        young = np.broadcast_to(self.material.young / 1e9, (len(mesh.tets),))
        if self._objective is None:
            return figure_material(mesh, young, out, marks=next_touch)
        prior, now = (s * young for s in self.posterior.tets)
        return figure_posterior(
            mesh, young, now, out, prior_std=prior, next_touch=next_touch
        )

    _repr_html_ = card  # what a notebook shows

    def __repr__(self) -> str:
        s = self.stats
        if isinstance(s, MapStats):
            how = (
                f"map: {s.parameters:,} parameters from {s.readings:,} readings of "
                f"{s.cases} touches, {s.iterations} iterations in {s.seconds:.2g} s, rms "
                f"of misfit over noise {np.sqrt(2 * s.misfit / s.readings):.2g}"
            )
        else:
            how = (
                f"{s.method} by {s.solver}: {s.parameters:,} parameters from {s.rows:,} "
                f"equations in {s.seconds:.2g} s, misfit {s.misfit:.2g} N"
            )
        return f"Estimate({how}; {self.material!r})"


def estimate(
    model: ElasticModel,
    observations: Observation | Iterable[Observation],
    *,
    parameters: Parameters | None = None,
    method: Literal["map", "force-balance"] = "map",
    rows: Literal["contact", "balance"] = "contact",
    solver: str = "CLARABEL",
    tolerance: float = 3e-4,
    iterations: int = 40,
    progress: Callable[[Step], Any] | None = None,
) -> Estimate:
    """Return the material that explains observations; the model's own is the prior mean.

    `parameters`: `per_limb()` (default), `per_element()`, `per_region(labels)` or
    `features(F)`.

    `method="map"`: the most probable moduli given the noise and the prior, by Gauss-Newton;
    partial views, missing forces, wrenches, loads and repeated touches are all welcome. It
    stops when a step promises to lower the cost by less than `tolerance` of it, or of half
    the number of readings. `progress` is called with each `Step`.

    `method="force-balance"` is the paper's convex programme, by any `solver` that CVXPY
    has. `rows="contact"` takes the equations of the touched vertices, which see the tets
    around them only. `rows="balance"` adds those of every free vertex whose neighbours were
    seen, which is far better without noise and collapses with it.

    Raises EstimateError where nothing was observed, displacements that the method needs
    were not seen, or no optimum was reached.
    """
    check_kind(model, ElasticModel, "estimate", EstimateError)
    if isinstance(observations, Observation):
        observations = (observations,)
    seen = tuple(checked_all(observations, Observation, "estimate", EstimateError))
    if not seen:
        raise EstimateError("no observations: give at least one touch.")
    if method not in ("map", "force-balance"):
        raise EstimateError(
            f"method {method!r} is not known; give 'map' or 'force-balance'."
        )
    if rows not in ("contact", "balance"):
        raise EstimateError(f"rows is {rows!r}; give 'contact' or 'balance'.")
    chart = (parameters or per_limb()).chart(model)
    if method == "force-balance":
        from plantsim.estimation import force_balance  # noqa: PLC0415  loads CVXPY

        x, stats = force_balance.solve(model, seen, chart, rows, solver)
        theta = chart.theta * np.maximum(1 + chart.B @ x, force_balance.LEAST)
        found = _material(theta, model.material.density)
        named = 1 + chart.mix @ x
        objective = None
    else:
        if not 0 < tolerance < 1 or iterations < 1:
            raise EstimateError(
                f"tolerance {tolerance}, iterations {iterations}; give a share below 1 and "
                "at least one iteration."
            )
        options = Options(tolerance, iterations, progress=progress)
        objective, stats = output_error.solve(model, chart, gather(model, seen), options)
        found = objective.model.material
        named = np.exp(chart.mix @ chart.unwhiten(objective.xi))
    multipliers = dict(zip(chart.names, map(float, named), strict=True))
    final = objective.model if objective is not None else model.with_material(found)
    return Estimate(final, model.material, multipliers, stats, seen, objective)


def _material(theta: Array, density: Array) -> Material:
    mu, lam = np.split(theta, 2)
    return Material.lame(mu, lam, density)
