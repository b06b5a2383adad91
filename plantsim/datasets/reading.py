"""Data sets read back, plant by plant: nothing is loaded before it is asked for."""

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, overload

import numpy as np

from plantsim.arrays import Array
from plantsim.datasets import store
from plantsim.datasets.folder import Folder, Row
from plantsim.datasets.recipe import SPLITS, Recipe
from plantsim.elastic.material import Material
from plantsim.elastic.model import ElasticModel
from plantsim.errors import DatasetError, FileError
from plantsim.estimation.observation import Observation
from plantsim.mesh.tetmesh import TetMesh
from plantsim.plant.skeleton import Skeleton


@dataclass(frozen=True, eq=False, repr=False)
class Plant:
    """One plant of a data set; `plant["touches/force"]` reads one array of its file."""

    path: Path
    row: Row = field(default_factory=dict)  # of the index

    def __getitem__(self, name: str) -> Array:
        """Return one array, read-only; FileError where the file is broken."""
        with store.opened(self.path) as f:
            return store.read_array(f, name)

    @cached_property
    def facts(self) -> dict[str, Any]:
        """Numbers and texts: species, split, height_m, mass_kg, seed, versions, ..."""
        with store.opened(self.path) as f:
            return store.facts(f)

    def arrays(self, *names: str) -> dict[str, Array]:
        """Return arrays by name, all where none is named; the file is opened once."""
        with store.opened(self.path) as f:
            return {name: store.read_array(f, name) for name in names or store.names(f)}

    @cached_property
    def skeleton(self) -> Skeleton:
        """The plant's skeleton."""
        parts = ("points", "radius", "parent", "limb", "level")
        data = self.arrays(*(f"skeleton/{name}" for name in parts))
        return _built(self.path, lambda: Skeleton(*data.values()))

    @cached_property
    def mesh(self) -> TetMesh:
        """The plant's mesh, limbs as regions, the foot as the set "base"."""
        parts = ("points", "tets", "region", "base", "region_names")
        points, tets, region, base, names = self.arrays(
            *(f"mesh/{name}" for name in parts)
        ).values()
        words = tuple(bytes(n).decode("utf-8", errors="replace") for n in names.ravel())
        return _built(
            self.path, lambda: TetMesh(points, tets, region, {"base": base}, words)
        )

    @cached_property
    def material(self) -> Material:
        """The true moduli, one value a tet."""
        parts = ("young", "poisson", "density")
        data = self.arrays(*(f"material/{name}" for name in parts))
        region = self["mesh/region"]
        return _built(self.path, lambda: Material(*(v[region] for v in data.values())))

    def model(self) -> ElasticModel:
        """Return the plant as it is in truth, held at its foot."""
        return ElasticModel(self.mesh, self.material, fixed="base")

    def observations(self, step: int = -1) -> tuple[Observation, ...]:
        """Return one observation a touch, at a step of it: the deepest."""
        parts = ("moved", "move", "force", "seen", "displacement", "noise")
        d = self.arrays(*(f"touches/{name}" for name in parts))
        moved, move, force, seen, displacement, noise = d.values()
        return _built(
            self.path,
            lambda: tuple(
                Observation(
                    moved[i],
                    move[i, step],
                    force[i, step],
                    seen,
                    displacement[i, step],
                    float(noise[0]),
                    float(noise[1]),
                )
                for i in range(len(moved))
            ),
        )

    def __repr__(self) -> str:
        words = ", ".join(
            f"{n} {self.row[n]}" for n in ("species", "split") if n in self.row
        )
        return f"Plant({self.path.name}: {words})"


@dataclass(frozen=True, eq=False, repr=False)
class Dataset(Sequence[Plant]):
    """The plants of a data set that are there, in the order of their numbers; lazy."""

    folder: Path
    rows: tuple[Row, ...]  # of the plants that are there
    failures: tuple[Row, ...] = ()

    @cached_property
    def recipe(self) -> Recipe:
        """What the data set was made by."""
        return Folder(self.folder).recipe()

    def split(self, name: str) -> "Dataset":
        """Return the plants of one split: "train", "validation" or "test"."""
        if name not in SPLITS:
            raise DatasetError(f"split {name!r}; give one of {', '.join(SPLITS)}.")
        return self.where(lambda row: row["split"] == name)

    def where(self, good: Callable[[Row], bool]) -> "Dataset":
        """Return the plants whose row of the index is good."""
        kept = [tuple(filter(good, rows)) for rows in (self.rows, self.failures)]
        return Dataset(self.folder, *kept)

    def column(self, name: str) -> Array:
        """Return one column of the index, a value a plant."""
        missing = [row["plant"] for row in self.rows if name not in row]
        if missing:
            known = ", ".join(sorted(self.rows[0]))
            raise DatasetError(f"no column {name!r} in the index; there are: {known}.")
        return np.array([row[name] for row in self.rows])

    def __len__(self) -> int:
        return len(self.rows)

    @overload
    def __getitem__(self, index: int) -> Plant: ...
    @overload
    def __getitem__(self, index: slice) -> "Dataset": ...
    def __getitem__(self, index: int | slice) -> "Plant | Dataset":
        if isinstance(index, slice):
            return Dataset(self.folder, self.rows[index], self.failures)
        row = self.rows[index]
        return Plant(Folder(self.folder).plant_file(row["plant"]), row)

    def __iter__(self) -> Iterator[Plant]:
        return (self[i] for i in range(len(self)))

    def __repr__(self) -> str:
        counts = {name: 0 for name in SPLITS}
        for row in self.rows:
            counts[row["split"]] = counts.get(row["split"], 0) + 1
        words = ", ".join(f"{n} {name}" for name, n in counts.items())
        return (
            f"Dataset({len(self.rows)} plants ({words}), {len(self.failures)} failed, in "
            f"{self.folder})"
        )


def open_dataset(folder: str | os.PathLike[str]) -> Dataset:
    """Return the data set in a folder, whether it is finished or not.

    Iterating gives plants one by one, whose arrays are read when they are asked for:

        for plant in ps.open_dataset("plants").split("train"):
            plant["touches/force"]      # (touches, steps, vertices, 3) [N]

    Raises FileError where there is no data set. Nothing in its files is run or unpickled.
    """
    home = Folder(Path(folder))
    home.check()
    rows = home.rows()
    done = tuple(row for row in rows if row["status"] == "done")
    return Dataset(home.path, done, tuple(r for r in rows if r["status"] == "failed"))


def _built(path: Path, build: Callable[[], Any]) -> Any:
    """Return a value of a file's arrays; whatever is wrong with them is one FileError."""
    try:
        return build()
    except (ValueError, IndexError, TypeError) as why:
        raise FileError(f"{path}: {why}") from None
