"""Checks of a data set: counts, schema, finite values, quality, and that nothing rotted."""

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from plantsim.arrays import Array
from plantsim.datasets import store
from plantsim.datasets.draw import split_of
from plantsim.datasets.folder import Folder
from plantsim.datasets.reading import Plant
from plantsim.datasets.recipe import Recipe
from plantsim.errors import PlantsimError

# name -> (kind of numbers, shape); a letter is a size that must agree wherever it stands
SCHEMA: dict[str, tuple[str, tuple[str | int, ...]]] = {
    "skeleton/points": ("f", ("nodes", 3)),
    "skeleton/radius": ("f", ("nodes",)),
    "skeleton/parent": ("i", ("nodes",)),
    "skeleton/limb": ("i", ("nodes",)),
    "skeleton/level": ("i", ("limbs",)),
    "mesh/points": ("f", ("vertices", 3)),
    "mesh/tets": ("i", ("tets", "columns")),
    "mesh/region": ("i", ("tets",)),
    "mesh/region_names": ("S", ("limbs",)),
    "mesh/base": ("i", ("base",)),
    "material/young": ("f", ("limbs",)),
    "material/poisson": ("f", ("limbs",)),
    "material/density": ("f", ("limbs",)),
    "touches/moved": ("i", ("touches", "patch")),
    "touches/move": ("f", ("touches", "steps", "patch", 3)),
    "touches/force": ("f", ("touches", "steps", "patch", 3)),
    "touches/true_force": ("f", ("touches", "steps", "patch", 3)),
    "touches/seen": ("i", ("seen",)),
    "touches/displacement": ("f", ("touches", "steps", "seen", 3)),
    "touches/true_displacement": ("f", ("touches", "steps", "seen", 3)),
    "touches/noise": ("f", (2,)),
}


@dataclass(frozen=True)
class Report:
    """What a check found."""

    plants: int  # of the recipe
    done: int
    failed: int
    missing: int
    problems: tuple[str, ...]
    worst_gamma: float

    @property
    def sound(self) -> bool:
        """Whether every plant is there or has its failure on record, and all is well."""
        return not (self.problems or self.missing)


def check_dataset(
    folder: str | os.PathLike[str], tell: Callable[[int, int], None] | None = None
) -> Report:
    """Return what a thorough look at every file of a data set finds.

    `tell` is called with how many files were looked at, and how many there are.
    """
    home = Folder(Path(folder))
    recipe = home.recipe()
    broken = home.broken()
    problems = [str(row["reason"]) for row in broken]
    rows = home.rows()
    done = [row["plant"] for row in rows if row["status"] == "done"]
    failed = [row["plant"] for row in rows if row["status"] == "failed"]
    extra = [p for p in (*done, *failed) if p >= recipe.plants]
    if extra:
        problems.append(f"{len(extra)} plants beyond the recipe's {recipe.plants}.")
    worst = np.inf
    for i, plant in enumerate(done):
        try:
            gamma, found = _plant(recipe, plant, home.plant_file(plant))
            worst = min(worst, gamma)
            problems += found
        except PlantsimError as why:
            problems.append(str(why))
        if tell is not None:
            tell(i + 1, len(done))
    listed = {(r["plant"], r["status"]) for r in home.listed()}
    if listed != {(row["plant"], row["status"]) for row in rows}:
        problems.append("index.csv does not list what is there. Run the command again.")
    missing = recipe.plants - len(done) - len(failed)
    return Report(
        recipe.plants, len(done), len(failed), missing, tuple(problems), float(worst)
    )


def _plant(recipe: Recipe, plant: int, path: Path) -> tuple[float, list[str]]:
    """Return the worst gamma of a plant, and what is wrong with its file."""
    arrays, facts = store.read(path)
    with store.opened(path) as f:
        said = store.digest(f)
    problems = list(_schema(arrays))
    if problems:
        return np.inf, [f"{path}: {words}" for words in problems]
    if said != store.digest_of(arrays, facts):
        problems.append("its digest does not fit what it holds: it was changed or rotted.")
    if facts.get("fingerprint") != recipe.fingerprint:
        problems.append(f"it is of another recipe ({facts.get('fingerprint')}).")
    if facts.get("split") != split_of(recipe, plant):
        problems.append(f"its split is {facts.get('split')}; the recipe says otherwise.")
    wanted = (recipe.touch.touches, recipe.touch.steps)
    if arrays["touches/move"].shape[:2] != wanted:
        problems.append(f"touches and steps are {arrays['touches/move'].shape[:2]}.")
    problems += _values(arrays)
    one = Plant(path)
    gamma = float(one.mesh.quality.min())
    if gamma < recipe.mesh.worst:
        problems.append(f"worst gamma {gamma:.3f}; the recipe wants {recipe.mesh.worst}.")
    if one.mesh.pieces.max():
        problems.append("its mesh is in pieces.")
    if not problems:
        one.observations()  # these check themselves
        _ = (one.skeleton, one.material)
    return gamma, [f"{path}: {words}" for words in problems]


def _schema(arrays: dict[str, Array]) -> Iterator[str]:
    """Yield what of the schema does not hold."""
    sizes: dict[str, int] = {}
    for name, (kind, shape) in SCHEMA.items():
        value = arrays.get(name)
        if value is None:
            yield f"{name} is missing."
            continue
        good = value.dtype.kind == kind and value.ndim == len(shape)
        for want, size in zip(shape, value.shape, strict=False):
            known = want if isinstance(want, int) else sizes.setdefault(want, size)
            good = good and known == size
        if not good:
            yield f"{name} is {value.dtype.kind}{value.shape}, wanted {kind}{shape}."
    for name in sorted(set(arrays) - set(SCHEMA)):
        yield f"{name} is not of the schema."


def _values(arrays: dict[str, Array]) -> Iterator[str]:
    """Yield which arrays hold what they must not: NaN, infinity, ids out of range."""
    for name, value in arrays.items():
        if value.dtype.kind == "f" and not np.isfinite(value).all():
            yield f"{name} has {int((~np.isfinite(value)).sum())} NaN or infinite values."
    count, limbs = len(arrays["mesh/points"]), len(arrays["material/young"])
    for name, limit in (
        ("mesh/tets", count),
        ("mesh/base", count),
        ("touches/moved", count),
        ("touches/seen", count),
        ("mesh/region", limbs),
        ("skeleton/limb", limbs),
    ):
        ids = arrays[name]
        if ids.size and not 0 <= ids.min() <= ids.max() < limit:
            yield f"{name} runs from {ids.min()} to {ids.max()}; wanted 0 to {limit - 1}."
