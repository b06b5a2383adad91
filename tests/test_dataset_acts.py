"""Nothing is lost: runs killed at any act on a file, no room for the index."""

import contextlib
import errno
import gc
import sys
import weakref
from dataclasses import replace

import pytest

import plantsim as ps
from plantsim.datasets.folder import Folder

pytest.importorskip("h5py")
pytest.importorskip("distributed")

from plantsim.datasets.checks import check_dataset


class Killed(BaseException):
    """Stands for SIGKILL: from here on the process does nothing to the disk."""


class Axe:
    """Kills this process, as far as a folder can tell, at its nth act on files there."""

    ACTS = ("open", "os.mkdir", "os.rename", "os.remove", "os.chmod", "os.listdir")

    def __init__(self):
        self.folder, self.acts, self.last = None, 0, 0
        sys.addaudithook(self)

    def __call__(self, event, arguments):
        if self.folder is None or event not in self.ACTS:
            return
        if str(self.folder) in map(str, arguments[:2]) or any(
            str(a).startswith(f"{self.folder}/") for a in arguments[:2]
        ):
            self.acts += 1
            if self.acts > self.last:
                raise Killed

    @contextlib.contextmanager
    def at(self, folder, last):
        self.folder, self.acts, self.last = folder, 0, last
        try:
            yield
        finally:
            self.folder = None


@pytest.fixture
def here(recipe, monkeypatch):
    """Make plants in this process: in no cluster, and from arrays that are there."""
    from plantsim.datasets import child, generate, plant

    made = {i: plant.make_plant(recipe, i) for i in range(3)}
    written = []

    def all_here(client, plain, plants, folder, threads, tell):
        for i in plants:
            answer = child.make({"recipe": plain, "plant": i, "folder": str(folder)})
            if "failure" in answer:
                row = {"plant": i, "status": "failed", "kind": "error", "bytes": 0}
                row |= {"split": "train", "reason": answer["failure"]}
                Folder(folder).write_failure(i, row)
                answer = {"row": row}
            if "halt" in answer:
                raise ps.DatasetError(answer["halt"])
            tell(answer["row"])
            written.append(i)
        return []

    def taken(_, i):
        if i == 1:
            raise ps.MeshError("no mesh.")
        return made[i]

    monkeypatch.setattr(plant, "make_plant", taken)
    for name, stub in (
        ("connected", lambda *_: contextlib.nullcontext()),
        ("check_workers", lambda *_: 1),
        ("make_all", all_here),
    ):
        monkeypatch.setattr(generate.cluster, name, stub)
    monkeypatch.setattr(generate, "INDEX_EVERY", 0.0)
    return replace(recipe, plants=3), written


def test_killed_at_every_single_act_on_a_file_the_next_run_finishes(here, tmp_path):
    recipe, written = here
    axe, last = Axe(), 0
    while True:
        out = tmp_path / f"{last:04d}"
        killed = False
        with axe.at(out, last):
            try:
                ps.dataset(recipe, out)
            except Killed:
                killed = True
        there = {p: p.stat().st_mtime_ns for p in out.glob("plants/*/[0-9]*.h5")}
        noted = len(list(out.glob("failures/[0-9]*.json")))
        written.clear()
        again = ps.dataset(recipe, out)
        assert (len(again), [row["plant"] for row in again.failures]) == (2, [1]), last
        assert len(written) == 3 - len(there) - noted, last  # nothing is done twice
        assert {p: p.stat().st_mtime_ns for p in there} == there
        report = check_dataset(out)
        assert report.sound, (last, report.problems)
        assert not [p for p in out.rglob(".*") if p.name != ".lock"]  # nothing half-done
        if not killed:
            break
        last += 1
    assert last > 30


def test_a_disk_too_full_for_the_index_stops_the_run_with_a_sentence(
    here, tmp_path, monkeypatch
):
    recipe, _ = here

    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Folder, "write_index", full)
    with pytest.raises(ps.DatasetError, match=r"No space left.*same command goes on"):
        ps.dataset(recipe, tmp_path / "out")
    monkeypatch.undo()
    assert len(ps.open_dataset(tmp_path / "out")) == 1  # which was made before that


def test_nothing_of_a_plant_stays_in_the_process_that_made_it(
    recipe, tmp_path, monkeypatch
):
    from plantsim.datasets import child, plant

    (tmp_path / "plants").mkdir()
    made = []

    def noted(*given, **more):
        model = ps.ElasticModel(*given, **more)
        made.append(weakref.ref(model))
        return model

    monkeypatch.setattr(plant, "ElasticModel", noted)
    gc.disable()  # as it is in effect, between few and large objects
    try:
        for i in range(2):
            request = {"recipe": recipe.plain(), "plant": i, "folder": str(tmp_path)}
            assert child.make(request)["row"]["status"] == "done"
            assert len(made) == i + 1
            assert made[i]() is None
    finally:
        gc.enable()
