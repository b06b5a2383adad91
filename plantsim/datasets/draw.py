"""What a plant of a recipe is: drawn from streams of its own, whoever makes it and when."""

import hashlib
from dataclasses import dataclass

import numpy as np

from plantsim.arrays import Array
from plantsim.datasets.recipe import Kind, Recipe
from plantsim.plant.parameters import WeberPenn

# a stream each, so that more touches do not change the plant
SHAPE, GROWTH, MODULI, TOUCHES, NOISE = range(5)


@dataclass(frozen=True)
class Drawn:
    """The draws of one plant, before it is grown."""

    kind: Kind
    model: WeberPenn
    max_limbs: int
    young: float  # [Pa]
    poisson: float
    density: float  # [kg/m^3]


def stream(recipe: Recipe, plant: int, which: int) -> np.random.Generator:
    """Return a plant's own random numbers for one purpose."""
    seeds = np.random.SeedSequence(recipe.seed, spawn_key=(plant, which))
    return np.random.default_rng(seeds)


def drawn(recipe: Recipe, plant: int) -> Drawn:
    """Return the kind of a plant, its parameters and its moduli."""
    rng = stream(recipe, plant, SHAPE)
    kinds = recipe.kinds
    weight = np.array([kind.weight for kind in kinds])
    kind = kinds[int(rng.choice(len(kinds), p=weight / weight.sum()))]
    model = kind.varied(lambda s: s.draw(rng))
    return Drawn(
        kind,
        model,
        kind.max_limbs.draw_whole(rng),
        kind.young.draw_log(rng),
        kind.poisson.draw(rng),
        kind.density.draw(rng),
    )


def split_of(recipe: Recipe, plant: int) -> str:
    """Return train, validation or test by a hash of seed and number."""
    digest = hashlib.sha256(f"{recipe.seed}:{plant}".encode()).digest()
    place, reached = int.from_bytes(digest[:8], "big") / 2**64, 0.0
    for name, share in recipe.split:
        reached += share
        if place < reached:
            return name
    return next(name for name, share in reversed(recipe.split) if share)


def limb_field(carrier: Array, correlation: float, rng: np.random.Generator) -> Array:
    """Return a standard normal value a limb, (limbs,).

    `carrier` (limbs,): the parent of each, an earlier one, or -1. Two limbs with k joints
    between them have the correlation `correlation` ** k.
    """
    out = rng.normal(size=len(carrier))
    rest = np.sqrt(1 - correlation**2)
    for i, p in enumerate(carrier.tolist()):
        if p >= 0:
            out[i] = correlation * out[p] + rest * out[i]
    return out
