"""Material: isotropic moduli, one pair for the whole or one pair a tet, and density."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from plantsim.arrays import Array, few, frozen
from plantsim.cards import card
from plantsim.errors import MaterialError


@dataclass(frozen=True, eq=False, repr=False, init=False)
class Material:
    """Isotropic linear elasticity; each entry a scalar or one value a tet.

    Built from Young's modulus [Pa] and Poisson's ratio, or by `Material.lame` from the Lame
    parameters; both are to be had afterwards. Density in kg/m^3. Raises MaterialError for
    moduli that are negative, zero or NaN, and for Poisson's ratio outside (-1, 0.5).
    """

    mu: Array  # () or (m,) [Pa], shear modulus
    lam: Array  # () or (m,) [Pa]
    density: Array  # () or (m,) [kg/m^3]
    strength: Array | None  # () or (m,) [Pa], fibre stress at which it breaks, if known

    def __init__(
        self,
        young: ArrayLike = 6e9,
        poisson: ArrayLike = 0.3,
        density: ArrayLike = 800.0,
        *,
        strength: ArrayLike | None = None,
    ) -> None:
        E, nu = _entry("young", young), _entry("poisson", poisson)
        _check("young", E, E > 0, "above 0 Pa")
        _check("poisson", nu, (nu > -1) & (nu < 0.5), "above -1 and below 0.5")
        _lengths(young=E, poisson=nu)
        # Source: any text on elasticity, e.g. Gould, Introduction to Linear Elasticity,
        # table 4.1
        lam = E * nu / ((1 + nu) * (1 - 2 * nu))
        self._fill(E / (2 * (1 + nu)), lam, density, strength)

    def _fill(
        self,
        mu: ArrayLike,
        lam: ArrayLike,
        density: ArrayLike,
        strength: ArrayLike | None,
    ) -> None:
        bears = None if strength is None else _entry("strength", strength)
        if bears is not None:
            _check("strength", bears, bears > 0, "above 0 Pa")
        object.__setattr__(self, "strength", bears)
        rho = _entry("density", density)
        _check("density", rho, rho >= 0, "0 kg/m^3 or more")
        object.__setattr__(self, "mu", _entry("mu", mu))
        object.__setattr__(self, "lam", _entry("lam", lam))
        object.__setattr__(self, "density", rho)
        _lengths(mu=self.mu, lam=self.lam, density=rho)

    @classmethod
    def lame(
        cls,
        mu: ArrayLike,
        lam: ArrayLike,
        density: ArrayLike = 0.0,
        *,
        strength: ArrayLike | None = None,
    ) -> Self:
        """Return the material with these Lame parameters [Pa].

        Raises MaterialError unless mu > 0 and 3 lam + 2 mu > 0, which is Poisson's ratio in
        (-1, 0.5).
        """
        m, l = _entry("mu", mu), _entry("lam", lam)  # noqa: E741
        _lengths(mu=m, lam=l)
        _check("mu", m, m > 0, "above 0 Pa")
        l, m = np.broadcast_arrays(l, m)  # noqa: E741
        _check(
            "lam", l, 3 * l + 2 * m > 0, "above -2/3 mu, so that Poisson's ratio exceeds -1"
        )
        out = cls.__new__(cls)
        out._fill(mu, lam, density, strength)
        return out

    @property
    def young(self) -> Array:
        """Young's modulus [Pa], () or (m,)."""
        return self.mu * (3 * self.lam + 2 * self.mu) / (self.lam + self.mu)

    @property
    def poisson(self) -> Array:
        """Poisson's ratio, () or (m,)."""
        return self.lam / (2 * (self.lam + self.mu))

    def with_young(self, young: ArrayLike) -> Self:
        """Return the material with another Young's modulus and the same Poisson's ratio."""
        return type(self)(young, self.poisson, self.density, strength=self.strength)

    def with_density(self, density: ArrayLike) -> Self:
        """Return the material with another density."""
        out = type(self).__new__(type(self))
        out._fill(self.mu, self.lam, density, self.strength)
        return out

    def per_tet(self, count: int) -> tuple[Array, Array, Array]:
        """Return mu, lam and density, each (count,); MaterialError if they do not fit."""
        for name in ("mu", "lam", "density", "strength"):
            value = getattr(self, name)
            if value is not None and value.ndim and len(value) != count:
                raise MaterialError(
                    f"{name} has {len(value)} values for {count} tets. Give one value, or "
                    "one a tet."
                )
        mu, lam, rho = (
            np.broadcast_to(v, (count,)) for v in (self.mu, self.lam, self.density)
        )
        return mu, lam, rho

    _repr_html_ = card  # what a notebook shows

    def __repr__(self) -> str:
        def span(x: Array) -> str:
            low, high = float(x.min()), float(x.max())
            return f"{low:.3g}" if low == high else f"{low:.3g} to {high:.3g}"

        return (
            f"Material(young {span(self.young)} Pa, poisson {span(self.poisson)}, "
            f"density {span(self.density)} kg/m^3)"
        )


def _entry(name: str, value: ArrayLike) -> Array:
    shape = (None,) if np.ndim(value) == 1 else ()
    return frozen(value, shape, name=name, error=MaterialError)


def _check(name: str, value: Array, good: Array, want: str) -> None:
    if not np.all(good):
        bad = np.flatnonzero(~np.atleast_1d(good))
        at = f" at {bad.size} tets (first: {few(bad)})" if value.ndim else ""
        raise MaterialError(
            f"{name} is {np.atleast_1d(value)[bad[0]]:.4g}{at}; it must be {want}."
        )


def _lengths(**values: Array) -> None:
    lengths = {name: len(v) for name, v in values.items() if v.ndim}
    if len(set(lengths.values())) > 1:
        raise MaterialError(
            f"lengths differ: {lengths}. Give one value, or one a tet, for each."
        )
