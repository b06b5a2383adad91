"""Posterior: what the touches leave uncertain, by Laplace's approximation.

In xi, where the prior is standard normal, the precision is I + A with A the Gauss-Newton
Hessian of the misfit. With A = V diag(lam) V^T,

    covariance = I - V diag(lam / (1 + lam)) V^T :

exact for few parameters; for many, V are the leading eigenvectors, found at random, which
is as good as the first eigenvalue left out is small against 1.
Source: Bui-Thanh, Ghattas, Martin, Stadler 2013, SIAM J. Sci. Comput. 35.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.linalg
from scipy.sparse import csr_array
from scipy.special import ndtri

from plantsim.arrays import Array, Random, generator
from plantsim.elastic.model import ElasticModel
from plantsim.errors import EstimateError
from plantsim.estimation.output_error import Objective

FEW = 200  # columns of a chart up to which the posterior is exact
RANK = 80  # eigenvectors of the misfit's Hessian, for many parameters
MORE = 10  # random directions beyond those
DRAWS = 200  # fields that stand for the prior where it is not summed exactly


@dataclass(frozen=True, eq=False)
class Posterior:
    """A normal distribution of xi about the estimate."""

    objective: Objective
    values: Array  # (r,) eigenvalues of the misfit's Hessian, falling
    vectors: Array  # (p, r)

    @property
    def exact(self) -> bool:
        """Whether no eigenvector was left out."""
        return self.vectors.shape[0] == self.vectors.shape[1]

    @property
    def model(self) -> ElasticModel:
        """The model with the material found."""
        return self.objective.model

    def draw(self, n: int, random: np.random.Generator) -> Array:
        """Return deviations of xi from the estimate, (p, n)."""
        e = random.normal(size=(len(self.vectors), n))
        shrink = 1 / np.sqrt(1 + self.values) - 1
        return e + self.vectors @ (shrink[:, None] * (self.vectors.T @ e))

    def root(self, n: int = DRAWS) -> Array:
        """Return Z (p, r) with Z Z^T the covariance: exact, or from n draws."""
        if self.exact:
            return self.vectors / np.sqrt(1 + self.values)
        return self.draw(n, np.random.default_rng(0)) / np.sqrt(n)

    def variances(self, rows: Any) -> tuple[Array, Array]:
        """Return prior and posterior variances (k,) of rows (k, 2m) @ log-moduli."""
        back = rows.T.toarray() if hasattr(rows, "toarray") else np.asarray(rows).T
        g = self.objective.chart.adjoint(back)
        prior = np.einsum("ij,ij->j", g, g)
        along = (self.vectors.T @ g) ** 2
        if self.exact:  # no difference of what is nearly equal
            return prior, (1 / (1 + self.values)) @ along
        return prior, np.maximum(prior - self.values / (1 + self.values) @ along, 0.0)

    @property
    def tet_std(self) -> Array:
        """Standard deviation (m,) of the logarithm of each tet's Young's modulus."""
        return self.tets[1]

    @cached_property
    def tets(self) -> tuple[Array, Array]:
        """Standard deviations (m,) of the logarithm of each tet's modulus, before and now.

        Exact, at the cost of one solve with the prior a tet, taken a thousand at a time.
        """
        m = len(self.model.mesh.tets)
        mu, lam = young_slopes(self.model)
        out = np.empty((2, m))
        for start in range(0, m, 1000):
            i = np.arange(start, min(start + 1000, m))
            k = np.tile(np.arange(len(i)), 2)
            rows = csr_array(
                (np.append(mu[i], lam[i]), (k, np.append(i, m + i))), shape=(len(i), 2 * m)
            )
            out[:, i] = np.sqrt(self.variances(rows))
        return out[0], out[1]

    @cached_property
    def limbs(self) -> tuple[tuple[str, ...], Array, Array]:
        """Names of limbs, prior and posterior variance of their mean log Young's modulus.

        The mean over a limb is by volume.
        """
        names, rows = limb_rows(self.model)
        return names, *self.variances(rows)

    def sample(self, n: int, rng: Random) -> Array:
        """Return moduli (n, 2m) [Pa] drawn from the posterior."""
        if n < 1:
            raise EstimateError(f"{n} samples; ask for at least 1.")
        xi = self.objective.xi[:, None] + self.draw(n, generator(rng))
        chart = self.objective.chart
        return (chart.theta[:, None] * np.exp(chart.log(xi))).T


def posterior(objective: Objective, rank: int = RANK) -> Posterior:
    """Return the posterior at a minimum; `rank` eigenvectors where parameters are many."""
    p = objective.chart.size
    if objective.chart.columns.shape[1] <= FEW or p <= FEW:
        values, vectors = scipy.linalg.eigh(objective.dense_hessian)
        order = np.argsort(values)[::-1]
        return Posterior(objective, np.maximum(values[order], 0), vectors[:, order])
    # one pass over the range, one to project: Halko, Martinsson, Tropp 2011, SIAM Rev. 53
    omega = np.random.default_rng(0).normal(size=(p, min(rank + MORE, p)))
    Q, _ = np.linalg.qr(_products(objective, omega))
    T = Q.T @ _products(objective, Q)
    values, vectors = scipy.linalg.eigh((T + T.T) / 2)
    order = np.argsort(values)[::-1][:rank]
    return Posterior(objective, np.maximum(values[order], 0), Q @ vectors[:, order])


def _products(objective: Objective, V: Array) -> Array:
    return np.stack([objective.hessian(v) for v in V.T], axis=1)


def young_slopes(model: ElasticModel) -> tuple[Array, Array]:
    """Return d log E / d log mu and d log E / d log lam of every tet, (m,) each.

    E = mu (3 lam + 2 mu) / (lam + mu).
    """
    mu, lam, _ = model.material.per_tet(len(model.mesh.tets))
    by_mu = 1 + 2 * mu / (3 * lam + 2 * mu) - mu / (lam + mu)
    by_lam = 3 * lam / (3 * lam + 2 * mu) - lam / (lam + mu)
    return by_mu, by_lam


def limb_rows(model: ElasticModel) -> tuple[tuple[str, ...], Any]:
    """Return names and rows (l, 2m): mean log Young's modulus of each limb, by volume."""
    mesh = model.mesh
    m = len(mesh.tets)
    present, group = np.unique(np.asarray(mesh.region), return_inverse=True)
    share = model.blocks.volume / np.bincount(group, model.blocks.volume)[group]
    by_mu, by_lam = young_slopes(model)
    rows = csr_array(
        (
            np.append(share * by_mu, share * by_lam),
            (np.tile(group, 2), np.arange(2 * m)),
        ),
        shape=(len(present), 2 * m),
    )
    return tuple(mesh.region_names[i] for i in present), rows


def quantile(level: float) -> float:
    """Return how many standard deviations hold a share `level` of a normal variable."""
    if not 0 < level < 1:
        raise EstimateError(f"level is {level}; give a share above 0 and below 1.")
    return float(ndtri(0.5 + level / 2))
