"""Leaves and fruit as point masses that hang on a skeleton's limbs."""

from dataclasses import dataclass, field
from typing import Self

import numpy as np

from plantsim.arrays import Array, frozen
from plantsim.errors import GeometryError


def _none() -> Array:
    return np.zeros(0)


@dataclass(frozen=True, eq=False)
class Hung:
    """Masses by where they hang: they move with their limbs and go with them."""

    limb: Array = field(default_factory=_none)  # (k,) index of the limb
    fraction: Array = field(
        default_factory=_none
    )  # (k,) of the limb's length, 0 foot .. 1 tip
    offset: Array = field(
        default_factory=_none
    )  # (k, 3) from the axis to the centre of mass [m]
    mass: Array = field(default_factory=_none)  # (k,) [kg]
    kind: tuple[str, ...] = ()  # (k,) "leaf", "fruit"

    def __post_init__(self) -> None:
        n = len(np.atleast_1d(np.asarray(self.limb)))
        offset = np.asarray(self.offset, dtype=float).reshape(-1, 3)
        for name, value, shape, dtype in (
            ("limb", self.limb, (n,), np.int64),
            ("fraction", self.fraction, (n,), float),
            ("offset", offset, (n, 3), float),
            ("mass", self.mass, (n,), float),
        ):
            plain = np.asarray(value, dtype=dtype)
            good = frozen(plain, shape, dtype, name=f"hung {name}", error=GeometryError)
            object.__setattr__(self, name, good)
        object.__setattr__(self, "kind", tuple(self.kind))
        if len(self.kind) != n:
            raise GeometryError(f"hung kind: {len(self.kind)} for {n}. Name each one.")
        if ((self.fraction < 0) | (self.fraction > 1)).any() or (self.mass < 0).any():
            raise GeometryError(
                "hung: fractions must be from 0 to 1 and masses 0 kg or more. Mend them."
            )

    def joined(self, other: Self) -> Self:
        """Return these masses and others."""
        return type(self)(
            np.append(self.limb, other.limb),
            np.append(self.fraction, other.fraction),
            np.vstack([self.offset, other.offset]),
            np.append(self.mass, other.mass),
            self.kind + other.kind,
        )

    def picked(self, limbs: Array, kept: Array) -> Self:
        """Return what hangs on the limbs in a mask, of which `kept` (share) is left."""
        old = self.limb
        fraction = self.fraction / np.maximum(kept[old], 1e-12)
        stays = limbs[old] & (fraction <= 1 + 1e-9)
        new = np.cumsum(limbs) - 1
        return type(self)(
            new[old[stays]],
            np.minimum(fraction[stays], 1.0),
            self.offset[stays],
            self.mass[stays],
            tuple(k for k, s in zip(self.kind, stays, strict=True) if s),
        )


@dataclass(frozen=True, eq=False)
class Masses:
    """Point masses of a plant in space, k of them: what gravity pulls at besides wood."""

    points: Array  # (k, 3) centres of mass [m]
    attachment: Array  # (k, 3) where they hang: on the limb's axis [m]
    mass: Array  # (k,) [kg]
    limb: Array  # (k,) index of the limb
    kind: tuple[str, ...]  # (k,) "leaf", "fruit"

    @property
    def total(self) -> float:
        """Mass [kg] of all."""
        return float(self.mass.sum())

    def __len__(self) -> int:
        return len(self.mass)

    def __repr__(self) -> str:
        return f"Masses({len(self)} hanging, {self.total:.3g} kg)"
