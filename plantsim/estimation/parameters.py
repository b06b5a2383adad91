"""What is estimated: logarithms of moduli by tet, limb or feature, and what is expected.

A chart is linear:  log(theta / theta of the prior) = B x,  x = D^-1 xi,  and before any
touch the entries of xi are independent standard normal numbers. So B says which tets go
together, and D how far they are expected to stray.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import block_diag, bmat, coo_array, csc_array, csr_array, eye_array
from scipy.sparse.linalg import splu

from plantsim.arrays import Array, frozen
from plantsim.elastic.model import ElasticModel
from plantsim.errors import EstimateError

Moduli = Literal["lame", "young"]
REACH = 30.0  # tets over which a smooth field forgets itself
PROBES = 16  # random fields by which its size is set


@dataclass(frozen=True, eq=False)
class Chart:
    """The map from standard normal numbers xi to log-moduli, for one model.

    `columns` @ `mix` is B: columns (2m, q) say which tets go together, mix (q, p) how the
    unknowns x add up to their logarithms.
    """

    theta: Array  # (2m,) mu, then lam of every tet of the prior [Pa]
    columns: Any  # (2m, q) sparse
    mix: Any  # (q, p) sparse
    precision: Any  # (p, p) sparse: D, symmetric and positive definite
    names: tuple[str, ...]  # (q,) "mu[3.1]", ...
    uniform: Array  # (p,) x for which every log-modulus is 1

    @cached_property
    def B(self) -> Any:
        """Map (2m, p) from x to log(theta / theta of the prior)."""
        return csr_array(self.columns @ self.mix)

    @cached_property
    def _factor(self) -> Any:
        return splu(
            self.precision,
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )

    @cached_property
    def _back(self) -> Any:
        return csr_array(self.B.T)

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return self.precision.shape[0]

    def unwhiten(self, xi: Array) -> Array:
        """Return x = D^-1 xi, (p,) or (p, k); D is symmetric, so this is its adjoint."""
        return self._factor.solve(np.asfortranarray(xi, dtype=float))

    def log(self, xi: Array) -> Array:
        """Return the logarithm of theta over the prior's, (2m,) or (2m, k)."""
        return self.B @ self.unwhiten(xi)

    def adjoint(self, y: Array) -> Array:
        """Return the transpose of `log` applied to (2m,) or (2m, k)."""
        return self.unwhiten(self._back @ y)

    def moduli(self, xi: Array) -> Array:
        """Return theta (2m,) [Pa]."""
        return self.theta * np.exp(self.log(xi))

    def start(self, log: float) -> Array:
        """Return xi for which every modulus is exp(log) times the prior's."""
        return self.precision @ (log * self.uniform)


@dataclass(frozen=True, eq=False)
class Parameters:
    """Which tets share a modulus, and how far moduli are expected from the prior's.

    `smooth`: the ratio of one standard deviation between neighbours; None: each by itself.
    `level`: the factor of one standard deviation between plant and prior overall. With
    `moduli="lame"` lam / mu has its own field, `tie` for its ratio between neighbours; with
    "young" Poisson's ratio stays the prior's.
    """

    share: Literal["element", "region", "features"]
    smooth: float | None = 1.02
    level: float = 3.0
    moduli: Moduli = "lame"
    tie: float = 1.005
    given: Array | None = None  # labels (m,), or features (m, k)

    def __post_init__(self) -> None:
        for name in ("smooth", "level", "tie"):
            value = getattr(self, name)
            if value is not None and not 1 < value < np.inf:
                raise EstimateError(
                    f"{name} is {value}; it is a factor: give a number above 1."
                )
        if self.moduli not in ("lame", "young"):
            raise EstimateError(f"moduli is {self.moduli!r}; give 'lame' or 'young'.")

    def chart(self, model: ElasticModel) -> Chart:
        """Return the chart of a model, whose material is the prior."""
        m = len(model.mesh.tets)
        mu, lam, _ = model.material.per_tet(m)
        if self.moduli == "lame" and (lam <= 0).any():
            raise EstimateError(
                f"the prior's lam is not positive at {(lam <= 0).sum()} tets, and has no "
                "logarithm. Give a prior with Poisson's ratio above 0, or moduli='young'."
            )
        G, labels, edges = self._groups(model)
        own, level, uniform = self._field(G.shape[1], edges, self.smooth)
        kinds = ("mu", "lam") if self.moduli == "lame" else ("young",)
        if self.moduli == "young":
            columns, mix, D = bmat([[G], [G]]), level, own
        else:
            ratio, ratio_level, _ = self._field(G.shape[1], edges, self.tie)
            # log mu = s, log lam = s + r
            columns = block_diag([G, G])
            mix = bmat([[level, None], [level, ratio_level]])
            D = block_diag([own, ratio])
            uniform = np.append(uniform, np.zeros(ratio.shape[0]))
        names = tuple(f"{kind}[{label}]" for kind in kinds for label in labels)
        return Chart(
            np.concatenate([mu, lam]),
            csr_array(columns),
            csr_array(mix),
            csc_array(D),
            names,
            uniform,
        )

    def _groups(self, model: ElasticModel) -> tuple[Any, tuple[str, ...], Array]:
        """Return which tets go together (m, g), their labels, and pairs of neighbours."""
        mesh = model.mesh
        m = len(mesh.tets)
        if self.share == "features":
            F = frozen(
                self.given if self.given is not None else (),
                (m, None),
                name="features",
                error=EstimateError,
            )
            names = ("level", *(f"feature {i}" for i in range(F.shape[1])))
            return csr_array(np.column_stack([np.ones(m), F])), names, np.zeros((0, 2))
        if self.share == "element":
            return eye_array(m), tuple(map(str, range(m))), mesh.neighbours
        labels = mesh.region if self.given is None else self.given
        labels = frozen(labels, (m,), np.int64, name="region", error=EstimateError)  # type: ignore[arg-type]
        present, group = np.unique(labels, return_inverse=True)
        G = coo_array((np.ones(m), (np.arange(m), group)), shape=(m, len(present)))
        named = self.given is None
        names = tuple(mesh.region_names[i] if named else str(i) for i in present)
        return G, names, np.zeros((0, 2))

    def _field(self, g: int, edges: Array, ratio: float | None) -> tuple[Any, Any, Array]:
        """Return D of a field on g groups, how it adds up (g, p), and the uniform x."""
        spread = np.log(self.level)
        if self.share == "features":
            # the level, then one coefficient a feature
            step = spread if ratio is None else np.log(ratio)
            scales = np.append(spread, np.full(g - 1, step))
            return _diagonal(1 / scales), eye_array(g), _unit(g, 0)
        if ratio is None:
            return eye_array(g) / spread, eye_array(g), np.ones(g)
        step = np.log(ratio)
        if self.share == "region" or not len(edges):
            # limbs scatter about the level, so that two of them differ by the ratio
            own = eye_array(g) * (np.sqrt(2) / step)
        else:
            own = _smooth(g, edges, step)
        mix = bmat([[eye_array(g), np.ones((g, 1))]])
        return block_diag([own, [[1 / spread]]]), mix, _unit(g + 1, g)


def _unit(count: int, at: int) -> Array:
    out = np.zeros(count)
    out[at] = 1.0
    return out


def _diagonal(values: Array) -> csr_array:
    i = np.arange(len(values))
    return csr_array((values, (i, i)))


def _smooth(g: int, edges: Array, step: float) -> Any:
    """Return D of a field on a graph whose neighbours differ by `step` in the root mean.

    D is a multiple of 1 / REACH^2 + Laplacian, so the precision D^2 is that of a Matern
    field. Source: Lindgren, Rue, Lindstrom 2011, J. R. Statist. Soc. B 73, alpha = 2.
    """
    i, j = edges.T
    k = np.arange(len(edges))
    difference = coo_array(
        (np.repeat([1.0, -1.0], len(edges)), (np.tile(k, 2), np.append(i, j))),
        shape=(len(edges), g),
    ).tocsr()
    D = csc_array(difference.T @ difference + eye_array(g) / REACH**2)
    lu = splu(
        D,
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )
    fields = lu.solve(np.random.default_rng(0).normal(size=(g, PROBES)))
    found = np.sqrt(np.mean((difference @ fields) ** 2))
    return D * (found / step)


def per_element(
    *,
    smooth: float = 1.02,
    level: float = 3.0,
    moduli: Moduli = "lame",
    tie: float = 1.005,
) -> Parameters:
    """Return parameters: the moduli of every tet, alike in neighbouring tets.

    `smooth`: ratio of the moduli of neighbouring tets, one standard deviation. `level`:
    factor by which the prior may be off overall. `moduli`: "lame", mu and lam, their ratio
    varying by `tie` between neighbours; or "young", Poisson's ratio staying the prior's.
    """
    return Parameters("element", smooth, level, moduli, tie)


def per_limb(
    *,
    smooth: float | None = 1.5,
    level: float = 3.0,
    moduli: Moduli = "lame",
    tie: float = 1.1,
) -> Parameters:
    """Return parameters: the moduli of every limb, that is, region of the mesh.

    `smooth`: ratio of the moduli of two limbs, one standard deviation, about a level that
    all share; None: limbs know nothing of each other, each within `level` of the prior.
    The rest as of `per_element`.
    """
    return Parameters("region", smooth, level, moduli, tie)


def per_region(
    region: ArrayLike,
    *,
    smooth: float | None = 1.5,
    level: float = 3.0,
    moduli: Moduli = "lame",
    tie: float = 1.1,
) -> Parameters:
    """Return parameters: the moduli of tets with the same label in `region` (m,) int.

    The rest as of `per_limb`.
    """
    labels = frozen(region, (None,), np.int64, name="region", error=EstimateError)
    return Parameters("region", smooth, level, moduli, tie, labels)


def features(
    values: ArrayLike,
    *,
    smooth: float = 2.0,
    level: float = 3.0,
    moduli: Moduli = "lame",
    tie: float = 1.2,
) -> Parameters:
    """Return parameters: log-moduli linear in features (m, k) of a tet, and a level.

    Features may be centroids, or the logarithm of the limb's radius. `smooth`: factor by
    which moduli change with one unit of a feature, one standard deviation. With
    `method="force-balance"` it is the moduli themselves that are linear.
    """
    F = frozen(values, (None, None), name="features", error=EstimateError)
    return Parameters("features", smooth, level, moduli, tie, F)
