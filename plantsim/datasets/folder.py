"""Folder: where the files of a data set are, what of it is there, and its index."""

import csv
import fcntl
import json
import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from plantsim.datasets import store
from plantsim.datasets.recipe import Recipe
from plantsim.errors import DatasetError, FileError
from plantsim.paths import replacing

SHARD = 1000  # plants a folder
TEXTS = ("status", "split", "species", "file", "digest", "kind", "reason")
WHOLES = ("plant", "bytes", "limbs", "tets", "nodes", "touches", "mesh_attempts")
NUMBERS = (
    *("height_m", "volume_m3", "mass_kg", "young_pa", "worst_gamma", "median_gamma"),
    *("sag_m", "sag_rotation_rad", "touch_force_n", "touch_depth_m", "backward_error"),
)
STAGES = ("grow", "mesh", "model", "touch", "write")
SECONDS = tuple(f"seconds_{stage}" for stage in STAGES)
CPU = "seconds_cpu"  # of all stages, whatever else the machine did
COLUMNS = (
    *("plant", "status", "split", "species", "file", "bytes", "digest"),
    *(*WHOLES[2:], *NUMBERS, *SECONDS, CPU, "kind", "reason"),
)
Row = dict[str, Any]


@dataclass(frozen=True)
class Folder:
    """A data set's folder: recipe.json, plants/, failures/, index.csv."""

    path: Path

    @property
    def recipe_file(self) -> Path:
        """The recipe, whole."""
        return self.path / "recipe.json"

    @property
    def index_file(self) -> Path:
        """One row a plant, made or failed."""
        return self.path / "index.csv"

    def plant_file(self, plant: int) -> Path:
        """Return where a plant's file is, or will be."""
        return self.path / "plants" / f"{plant // SHARD:05d}" / f"{plant:08d}.h5"

    def failure_file(self, plant: int) -> Path:
        """Return where it is written down that a plant could not be made."""
        return self.path / "failures" / f"{plant:08d}.json"

    def check(self) -> None:
        """Raise FileError where this is no data set."""
        if not self.recipe_file.is_file():
            raise FileError(
                f"{self.path}: no data set (it has no recipe.json). Name the folder that "
                "`plantsim dataset` wrote to."
            )

    def recipe(self) -> Recipe:
        """Return the recipe of the data set; FileError where this is none."""
        self.check()
        return Recipe.read(self.recipe_file)

    def begin(self, recipe: Recipe) -> None:
        """Make the folder, or see that it belongs to this recipe; drop what was half done.

        More plants than last time are welcome. Raises DatasetError where the folder holds
        something else.
        """
        for name in (".recipe-*.json", ".index-*.csv", ".summary-*.html"):
            for half in self.path.glob(name):
                half.unlink(missing_ok=True)
        if self.recipe_file.exists():
            old = self.recipe()
            if old.fingerprint != recipe.fingerprint:
                raise DatasetError(
                    f"{self.path}: it holds plants of another recipe (fingerprint "
                    f"{old.fingerprint}, yours {recipe.fingerprint}). Give another --out, "
                    "or the recipe it was begun with."
                )
            if old.plants > recipe.plants:
                raise DatasetError(
                    f"{self.path}: it was begun with {old.plants} plants, and the recipe "
                    f"asks for {recipe.plants}. Give as many or more."
                )
        else:
            strange = [p.name for p in self.path.iterdir() if p.name != ".lock"]
            if strange:
                raise DatasetError(
                    f"{self.path}: not empty and no data set (there is {strange[0]}). Give "
                    "another --out."
                )
        # first of all: by it a folder is known that was begun and then killed
        with replacing(self.recipe_file) as temporary:
            temporary.write_text(json.dumps(recipe.plain(), indent=1), encoding="utf-8")
        for name in ("plants", "failures"):
            (self.path / name).mkdir(exist_ok=True)
        for part in (*(self.path / "plants").glob("[0-9]*"), self.path / "failures"):
            for half in part.glob(".[0-9]*-*"):
                half.unlink(missing_ok=True)

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Hold the folder against a second run; the lock goes with the process."""
        try:
            self.path.mkdir(parents=True, exist_ok=True)
        except (FileExistsError, NotADirectoryError):
            raise DatasetError(f"{self.path}: not a folder. Give another --out.") from None
        with (self.path / ".lock").open("w") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                raise DatasetError(
                    f"{self.path}: another run is writing here. Wait for it, or end it."
                ) from None
            yield

    def rows(self) -> list[Row]:
        """Return a row a plant that is there or failed, by number, from what is on disk.

        A row of the index stands where its file has the size it had; other files are
        opened. A file that cannot be read has the status "broken".
        """
        old = {row["plant"]: row for row in self.listed()}
        out: list[Row] = []
        for plant, path in self._files("plants", ".h5"):
            row, size = old.get(plant), path.stat().st_size
            if row is None or row["status"] != "done" or row["bytes"] != size:
                row = self._opened(plant, path)
            out.append(row)
        done = {row["plant"] for row in out if row["status"] == "done"}
        out = [row for row in out if row["plant"] in done]
        out += [
            _failure(plant, path)
            for plant, path in self._files("failures", ".json")
            if plant not in done
        ]
        return sorted(out, key=lambda row: row["plant"])

    def broken(self) -> list[Row]:
        """Return a row for each plant's file that cannot be opened."""
        rows = (self._opened(plant, path) for plant, path in self._files("plants", ".h5"))
        return [row for row in rows if row["status"] == "broken"]

    def write_index(self, rows: Iterable[Row]) -> None:
        """Write the index."""
        ordered = sorted(rows, key=lambda row: row["plant"])
        with (
            replacing(self.index_file) as temporary,
            temporary.open("w", encoding="utf-8", newline="") as f,
        ):
            writer = csv.DictWriter(f, COLUMNS, restval="", extrasaction="ignore")
            writer.writeheader()
            writer.writerows(ordered)

    def write_failure(self, plant: int, row: Row) -> None:
        """Write down that a plant could not be made, and why."""
        path = self.failure_file(plant)
        with replacing(path) as temporary:
            temporary.write_text(json.dumps(row), encoding="utf-8")

    def _files(self, name: str, suffix: str) -> Iterator[tuple[int, Path]]:
        top = self.path / name
        folders = [top] if suffix == ".json" else sorted(top.glob("[0-9]*"))
        for folder in folders:
            for path in sorted(folder.glob(f"[0-9]*{suffix}")):
                if path.stem.isdecimal():
                    yield int(path.stem), path

    def _opened(self, plant: int, path: Path) -> Row:
        try:
            row = row_of(path, self.path)
        except FileError as why:
            return {"plant": plant, "status": "broken", "reason": str(why)}
        if row["plant"] != plant:
            reason = f"{path}: holds plant {row['plant']}. Delete it and run again."
            return {"plant": plant, "status": "broken", "reason": reason}
        return row

    def listed(self) -> list[Row]:
        """Return the rows of the index; none where there is no sound one."""
        out: list[Row] = []
        try:
            with self.index_file.open(encoding="utf-8", newline="") as f:
                whole = (line for line in f if line.endswith("\n"))  # not cut short
                for line in csv.DictReader(whole):
                    row: Row = {name: line[name] for name in TEXTS if line[name]}
                    for name in (*WHOLES, *NUMBERS, *SECONDS, CPU):
                        if line[name]:
                            row[name] = (int if name in WHOLES else float)(line[name])
                    row.setdefault("bytes", 0)
                    out.append(row)
        except (OSError, KeyError, TypeError, ValueError):
            return []
        return out


def row_of(path: Path, top: Path) -> Row:
    """Return the index row of a plant's file; FileError where it is broken."""
    with store.opened(path) as f:
        facts, run, digest = store.facts(f), store.run(f), store.digest(f)
    row = {name: facts[name] for name in COLUMNS if name in facts}
    row |= {f"seconds_{s}": run[s] for s in (*STAGES, "cpu") if s in run}
    if not isinstance(row.get("plant"), int):
        raise FileError(f"{path}: it does not say which plant it is. Delete it.")
    size = os.path.getsize(path)
    file = path.relative_to(top).as_posix()
    return {**row, "status": "done", "file": file, "bytes": size, "digest": digest}


def _failure(plant: int, path: Path) -> Row:
    row: Row = {"plant": plant, "status": "failed", "kind": "unknown", "bytes": 0}
    try:
        said = json.loads(path.read_text(encoding="utf-8"))
        row |= {name: str(said.get(name, "")) for name in ("split", "species", "kind")}
        row["reason"] = str(said.get("reason", ""))
    except (OSError, ValueError, AttributeError) as why:
        row["reason"] = f"its record cannot be read ({why})"
    return row
