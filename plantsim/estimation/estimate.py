"""estimate: observations -> Estimate, by the method asked for."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from plantsim.arrays import Array
from plantsim.cards import card
from plantsim.elastic.material import Material
from plantsim.elastic.model import ElasticModel
from plantsim.errors import EstimateError
from plantsim.estimation import force_balance
from plantsim.estimation.force_balance import EstimateStats, Rows
from plantsim.estimation.observation import Observation
from plantsim.estimation.parameters import Parameters, per_limb


@dataclass(frozen=True, eq=False, repr=False)
class Estimate:
    """A material found from touches, and how."""

    model: ElasticModel  # the prior's, with the material found
    prior: Material
    parameters: dict[
        str, float
    ]  # multiplier of the prior by name: "mu[3.1]", "lam[0]", ...
    stats: EstimateStats

    @property
    def material(self) -> Material:
        """The material found, one value a tet."""
        return self.model.material

    def young(self) -> dict[str, float]:
        """Return the mean Young's modulus [Pa] of each limb, by volume."""
        mesh = self.model.mesh
        E = np.broadcast_to(self.material.young, (len(mesh.tets),))
        v = self.model.blocks.volume
        region = np.asarray(mesh.region)
        total = np.bincount(region, v, len(mesh.region_names))
        mean = np.bincount(region, v * E, len(mesh.region_names)) / np.maximum(
            total, 1e-300
        )
        return {
            name: float(e)
            for name, e, t in zip(mesh.region_names, mean, total, strict=True)
            if t > 0
        }

    _repr_html_ = card  # what a notebook shows

    def __repr__(self) -> str:
        s = self.stats
        return (
            f"Estimate({s.method} by {s.solver}: {s.parameters:,} parameters from "
            f"{s.rows:,} equations in {s.seconds:.2g} s, misfit {s.misfit:.2g} N; "
            f"{self.material!r})"
        )


def estimate(
    model: ElasticModel,
    observations: Observation | Iterable[Observation],
    *,
    parameters: Parameters | None = None,
    method: Literal["force-balance"] = "force-balance",
    rows: Rows = "contact",
    solver: str = "CLARABEL",
) -> Estimate:
    """Return the material that explains observations; the model's own is the prior mean.

    `parameters`: `per_limb()` (default) or `per_element()`. `method="force-balance"` is the
    paper's convex programme, by any solver that CVXPY has. `rows="contact"` takes the
    equations of the touched vertices, which see the tets around them only. `rows="balance"`
    adds those of every free vertex whose neighbours were seen, which is far better without
    noise and collapses with it.

    Raises EstimateError where nothing was observed, displacements that the method needs
    were not seen, or the solver did not reach an optimum.
    """
    seen = [observations] if isinstance(observations, Observation) else list(observations)
    if not seen:
        raise EstimateError("no observations: give at least one touch.")
    if method != "force-balance":
        raise EstimateError(f"method {method!r} is not known; give 'force-balance'.")
    if rows not in ("contact", "balance"):
        raise EstimateError(f"rows is {rows!r}; give 'contact' or 'balance'.")
    linear = (parameters or per_limb()).linear(model)
    x, stats = force_balance.solve(model, seen, linear, rows, solver)
    theta: Array = linear.A @ x
    mu, lam = np.split(theta, 2)
    found = Material.lame(mu, lam, model.material.density)
    named = dict(zip(linear.names, map(float, x), strict=True))
    return Estimate(model.with_material(found), model.material, named, stats)
