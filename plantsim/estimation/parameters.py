"""What is estimated: multipliers of the prior's Lame parameters, by tet or by limb."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.sparse import csr_array

from plantsim.arrays import Array
from plantsim.elastic.model import ElasticModel
from plantsim.errors import EstimateError


@dataclass(frozen=True)
class Parameters:
    """Which tets share a multiplier, and how far multipliers are expected from 1."""

    share: Literal["element", "limb"]
    spread: float = 1.0  # one standard deviation of a multiplier, before any touch

    def __post_init__(self) -> None:
        if not 0 < self.spread < np.inf:
            raise EstimateError(f"spread is {self.spread}; give a positive number.")

    def linear(self, model: ElasticModel) -> "Linear":
        """Return theta = A x for a model, whose material is the prior."""
        m = len(model.mesh.tets)
        mu, lam, _ = model.material.per_tet(m)
        if (lam < 0).any():
            raise EstimateError(
                f"the prior's lam is negative at {(lam < 0).sum()} tets, and theta >= 0 is "
                "asked for. Give a prior with Poisson's ratio 0 or more."
            )
        # a prior of lam = 0 has no scale of its own; the shear modulus lends its
        scale = np.concatenate([mu, np.where(lam > 0, lam, mu)])
        prior = np.concatenate([np.ones(m), (lam > 0).astype(float)])
        if self.share == "element":
            group, count = np.arange(m), m
            labels: tuple[str, ...] = tuple(str(i) for i in range(m))
        else:
            present, group = np.unique(np.asarray(model.mesh.region), return_inverse=True)
            count = len(present)
            labels = tuple(model.mesh.region_names[i] for i in present)
        columns = np.concatenate([group, count + group])
        A = csr_array((scale, (np.arange(2 * m), columns)), shape=(2 * m, 2 * count))
        x0 = np.zeros(2 * count)
        x0[columns] = prior
        names = tuple(f"{kind}[{label}]" for kind in ("mu", "lam") for label in labels)
        return Linear(A, x0, np.full(2 * count, self.spread), names)


@dataclass(frozen=True, eq=False)
class Linear:
    """The map theta = A x with the prior mean and standard deviation of x."""

    A: csr_array  # (2m, p) [Pa]
    mean: Array  # (p,)
    std: Array  # (p,)
    names: tuple[str, ...]  # "mu[3.1]", ...


def per_element(*, spread: float = 1.0) -> Parameters:
    """Return parameters: mu and lam of every tet, as multipliers of the prior.

    `spread`: one standard deviation of a multiplier about 1 before any touch.
    """
    return Parameters("element", spread)


def per_limb(*, spread: float = 1.0) -> Parameters:
    """Return parameters: mu and lam of every limb (region), as multipliers of the prior.

    `spread`: one standard deviation of a multiplier about 1 before any touch.
    """
    return Parameters("limb", spread)
