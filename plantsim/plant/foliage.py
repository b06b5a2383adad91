"""Where leaves and fruit hang, and what they weigh."""

import tomllib
from functools import cache
from importlib import resources
from typing import TYPE_CHECKING, Any

import numpy as np

from plantsim.arrays import Array, Random, generator, repeated
from plantsim.errors import GeometryError
from plantsim.plant.hung import Hung

if TYPE_CHECKING:
    from plantsim.plant.skeleton import Skeleton

SAME = {"apple_spindle": "apple"}  # another training of the same plant
PHYLLOTAXIS = np.radians(137.507764)


@cache
def _table() -> dict[str, Any]:
    file = resources.files("plantsim.plant").joinpath("foliage.toml")
    return tomllib.loads(file.read_text(encoding="utf-8"))


def known(species: str, what: str) -> dict[str, Any]:
    """Return the numbers for a species' leaves or fruit; errors list what there is."""
    entry = _table().get(SAME.get(species, species), {}).get(what)
    if entry is None:
        there = sorted([k for k, v in _table().items() if what in v])
        raise GeometryError(
            f"no {what} is known for {species!r}; there are: {', '.join(there)}. Give "
            "mass, stalk and spacing (leaves) or count (fruit) yourself."
        )
    return entry


def leaves(
    skeleton: "Skeleton",
    species: str | None,
    mass: float | None,
    spacing: float | None,
    stalk: float | None,
    rng: Random,
) -> Hung:
    """Return leaves evenly along the outermost limbs, round them by the golden angle."""
    entry = known(species, "leaf") if species else {}
    kilo = _number("mass", mass, entry)
    gap, petiole = _number("spacing", spacing, entry), _number("stalk", stalk, entry, 0.0)
    assert skeleton.level is not None
    levels = entry.get("levels", [int(skeleton.level.max()), int(skeleton.level.max()) - 1])
    rows = np.flatnonzero(np.isin(skeleton.level, levels) & (skeleton.carrier >= 0))
    rows = np.arange(len(skeleton.first)) if not len(rows) else rows
    length = skeleton.arc[skeleton.last[rows]]
    number = np.maximum(1, np.floor(0.85 * length / gap)).astype(int)
    row, k = repeated(number)
    limb = rows[row]
    fraction = 1.0 - 0.85 * k / number[row]
    turn = generator(rng).uniform(0, 2 * np.pi, len(rows))
    angle = np.repeat(turn, number) + PHYLLOTAXIS * k
    out = _across(skeleton, limb, fraction, angle)
    return Hung(
        limb, fraction, petiole * out, np.full(len(limb), kilo), ("leaf",) * len(limb)
    )


def fruit(
    skeleton: "Skeleton",
    species: str | None,
    count: int | None,
    mass: float | None,
    stalk: float | None,
    rng: Random,
) -> Hung:
    """Return fruit at random places of the bearing limbs, straight below them."""
    entry = known(species, "fruit") if species else {}
    kilo, number = _number("mass", mass, entry), int(_number("count", count, entry))
    reach = _number("stalk", stalk, entry, 0.0)
    assert skeleton.level is not None
    deepest = int(skeleton.level.max())
    levels = [min(k, deepest) for k in entry.get("levels", [deepest])]
    rows = np.flatnonzero(np.isin(skeleton.level, levels))
    rows = rows[:: int(entry.get("every", 1))]
    draw = generator(rng)
    length = skeleton.arc[skeleton.last[rows]]
    limb = np.sort(draw.choice(rows, number, p=length / length.sum()))
    low, high = entry.get("low", 0.3), entry.get("high", 0.95)
    fraction = draw.uniform(low, high, number)
    offset = np.tile([0.0, 0.0, -reach], (number, 1))
    return Hung(limb, fraction, offset, np.full(number, kilo), ("fruit",) * number)


def _across(skeleton: "Skeleton", limb: Array, fraction: Array, angle: Array) -> Array:
    """Return unit vectors across limbs at angles about them."""
    axes = skeleton.splines
    way = axes.velocity(*axes.locate(limb, fraction * axes.arc[axes.last[limb]]))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    flat = np.where(np.abs(way[:, 2:]) < 0.9, [[0.0, 0, 1]], [[1.0, 0, 0]])
    u = np.cross(way, flat)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    return np.cos(angle)[:, None] * u + np.sin(angle)[:, None] * np.cross(way, u)


def _number(
    name: str, given: float | None, entry: dict[str, Any], default: float | None = None
) -> float:
    value = entry.get(name, default) if given is None else given
    if value is None:
        raise GeometryError(f"{name} is not given. Name a species, or give {name}.")
    if not (np.isfinite(value) and value >= 0 and (value > 0 or name == "stalk")):
        raise GeometryError(f"{name} is {value}; give a positive number.")
    return float(value)
