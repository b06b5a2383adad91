"""Recipe -> data set: what is missing in a folder is made, and nothing else."""

import contextlib
import os
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from plantsim.datasets import cluster
from plantsim.datasets.folder import Folder, Row
from plantsim.datasets.reading import Dataset, open_dataset
from plantsim.datasets.recipe import Recipe
from plantsim.errors import DatasetError

INDEX_EVERY = 60.0  # s between two writings of the index, and at least 50 times their cost


@dataclass(frozen=True)
class Progress:
    """How far a run is."""

    plants: int  # of the recipe
    done: int  # on disk, older runs included
    failed: int
    made: int  # by this run, failures included
    seconds: float  # of this run
    row: Row | None = None  # of the plant that is new

    @property
    def per_minute(self) -> float:
        """Plants a minute, of this run."""
        return 60 * self.made / self.seconds if self.seconds > 0 else 0.0

    @property
    def left(self) -> float:
        """Seconds to go at this rate; infinite before the first plant."""
        rest = self.plants - self.done - self.failed
        return rest * self.seconds / self.made if self.made else float("inf")


def dataset(
    recipe: Recipe | str | os.PathLike[str],
    out: str | os.PathLike[str] = "plants",
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    retry: bool = False,
    tell: Callable[[Progress], None] | None = None,
) -> Dataset:
    """Make the plants of a recipe in a folder, and return them as `ps.open_dataset` does.

    A folder that was begun with the same recipe is finished: what is there stays. Plants
    that could not be made are listed with the reason in `index.csv`, and tried again only
    with `retry`. `workers`: local processes, one a CPU where None; or `scheduler`: the
    address of a Dask cluster, whose workers must see the folder by the same path. In a
    script, call it behind `if __name__ == "__main__":`, as all spawned processes need it.

    Raises DatasetError where the folder holds something else, the disk is full, or the
    cluster is gone; a later call then goes on.
    """
    if not isinstance(recipe, Recipe):
        recipe = Recipe.read(recipe)
    if workers is None:
        workers = len(os.sched_getaffinity(0))
    if not 1 <= workers <= 10_000:
        raise DatasetError(f"{workers} workers; give 1 or more.")
    folder = Folder(Path(out).resolve())
    with _disk_errors_told(folder), folder.locked():
        folder.begin(recipe)
        rows = {row["plant"]: row for row in folder.rows()}
        for row in list(rows.values()):
            if row["status"] == "failed" and retry:
                folder.failure_file(row["plant"]).unlink()
                del rows[row["plant"]]
        log = _Log(folder, rows, recipe.plants, tell)
        log.tell()
        missing = [p for p in range(recipe.plants) if p not in rows]
        try:
            if missing:
                _make(recipe, missing, folder, scheduler, workers, log)
        except BaseException:
            with contextlib.suppress(OSError):  # it is made anew from what is there
                folder.write_index(folder.rows())
            raise
        log.write()
    return open_dataset(folder.path)


@contextlib.contextmanager
def _disk_errors_told(folder: Folder) -> Iterator[None]:
    try:
        yield
    except OSError as why:
        raise DatasetError(
            f"{why.filename or folder.path}: {why.strerror or why}. Make room or mend "
            "that; the same command goes on from there."
        ) from None


def _make(
    recipe: Recipe,
    missing: list[int],
    folder: Folder,
    scheduler: str | None,
    workers: int,
    log: "_Log",
) -> None:
    workers = min(workers, len(missing))
    try:
        with cluster.connected(scheduler, workers) as client:
            threads = cluster.check_workers(client, folder.path, folder.recipe_file.name)
            plain: dict[str, Any] = recipe.plain()
            lost = cluster.make_all(
                client, plain, iter(missing), folder.path, threads, log.add
            )
            if scheduler is not None:
                with contextlib.suppress(Exception):  # idle processes, of no consequence
                    cluster.release(client)
    except DatasetError as why:
        done, total = len(log.rows), recipe.plants
        raise DatasetError(
            f"{str(why).rstrip('.')}: {done} of {total} plants are settled; the same "
            "command goes on from there."
        ) from None
    if lost:
        raise DatasetError(
            f"{len(lost)} plants were lost with their workers ({lost[0]}). Run the same "
            "command again."
        )


class _Log:
    """The rows of a run: told one by one, and written to the index now and then."""

    def __init__(
        self,
        folder: Folder,
        rows: dict[int, Row],
        plants: int,
        tell: Callable[[Progress], None] | None,
    ) -> None:
        self.folder, self.rows, self.plants = folder, rows, plants
        self._tell, self._made = tell, 0
        self._began = self._written = time.monotonic()
        self._cost = 0.0
        self._failed = sum(row["status"] == "failed" for row in rows.values())

    def add(self, row: Row) -> None:
        """Take the row of a new plant."""
        self.rows[row["plant"]] = row
        self._made += 1
        self._failed += row["status"] == "failed"
        if time.monotonic() - self._written > max(INDEX_EVERY, 50 * self._cost):
            self.write()
        self.tell(row)

    def tell(self, row: Row | None = None) -> None:
        """Say how far the run is."""
        if self._tell is not None:
            done = len(self.rows) - self._failed
            seconds = time.monotonic() - self._began
            self._tell(Progress(self.plants, done, self._failed, self._made, seconds, row))

    def write(self) -> None:
        """Write the index."""
        began = time.monotonic()
        self.folder.write_index(self.rows.values())
        self._written = time.monotonic()
        self._cost = self._written - began
