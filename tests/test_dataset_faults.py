"""Nothing is lost: killed workers, schedulers and runs, full disks, plants that crash."""

import csv
import json
import os
import resource
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

import plantsim as ps
from plantsim.datasets import store, warden
from plantsim.datasets.folder import Folder

pytest.importorskip("h5py")
pytest.importorskip("distributed")
import psutil

from plantsim.datasets.checks import check_dataset
from plantsim.datasets.plant import make_plant

ROOT = Path(__file__).resolve().parent.parent
PATIENCE = 240  # s; the machine may be busy

# what befalls plants, by number, in the process that makes them
FAULTS = """
import ctypes, importlib.util, json, os, sys, time
FAULTS = json.loads(os.environ["PLANT_FAULTS"])

class Finder:
    def find_spec(self, name, path=None, target=None):
        if name != "plantsim.datasets.plant":
            return None
        sys.meta_path.remove(self)
        spec = importlib.util.find_spec(name)
        load = spec.loader.exec_module
        def exec_module(module):
            load(module)
            module.make_plant = faulty(module.make_plant)
        spec.loader.exec_module = exec_module
        return spec

def faulty(make_plant):
    def make(recipe, plant):
        fault = FAULTS.get(str(plant))
        time.sleep(FAULTS.get("slow", 0))
        if fault == "crash":
            ctypes.string_at(0)  # a segmentation fault, as gmsh has them
        if fault == "hang":
            ctypes.PyDLL(None).pause()  # in C, without giving up Python's lock
        if fault == "unmeshable":
            from plantsim.solid import wild
            from plantsim.solid.gmsh_model import gmsh
            wild.installed = lambda: False  # the last rung, which does without gmsh
            def broken(*_):
                raise Exception("PLC Error: A segment and a facet intersect")
            whole = gmsh.model.mesh.generate
            gmsh.model.mesh.generate = broken
            try:
                return make_plant(recipe, plant)
            finally:
                gmsh.model.mesh.generate = whole
        return make_plant(recipe, plant)
    return make

sys.meta_path.insert(0, Finder())
"""


class Bench:
    """Runs `plantsim dataset` on a recipe, with faults, in processes of its own."""

    def __init__(self, tmp_path, recipe):
        self.home, self.out = tmp_path, tmp_path / "out"
        (tmp_path / "faults").mkdir()
        (tmp_path / "faults" / "sitecustomize.py").write_text(FAULTS)
        self.write(recipe)

    def write(self, recipe):
        (self.home / "recipe.json").write_text(json.dumps(recipe.plain()))

    def environment(self, **faults):
        paths = [str(self.home / "faults"), str(ROOT), os.environ.get("PYTHONPATH", "")]
        return {
            **os.environ,
            "PYTHONPATH": os.pathsep.join(filter(None, paths)),
            "PLANT_FAULTS": json.dumps(faults),
        }

    def start(self, *options, out=None, limit=None, **faults):
        command = ["-m", "plantsim", "dataset", str(self.home / "recipe.json"), "--out"]
        process = subprocess.Popen(
            [sys.executable, *command, str(out or self.out), *options],
            env=self.environment(**faults),
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        if limit is not None:
            resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (limit, limit))
        return process

    def run(self, *options, **more):
        process = self.start(*options, **more)
        out, err = process.communicate(timeout=PATIENCE)
        return process.returncode, out, err

    def finishes(self, before, *options):
        """Run again to the end, which is sound and redoes none of `before`."""
        code, out, err = self.run(*options)
        assert (code, err) == (0, "")
        assert "8 of 8" in out
        after = self.times()
        assert {path: after[path] for path in before} == before
        assert check_dataset(self.out).sound

    def files(self):
        return sorted(self.out.glob("plants/*/[0-9]*.h5"))

    def wait_for(self, count, process):
        """Wait until some plants are there while the run still goes."""
        until = time.monotonic() + PATIENCE
        while len(self.files()) < count:
            assert process.poll() is None, process.communicate()
            assert time.monotonic() < until
            time.sleep(0.05)

    def times(self):
        return {path: path.stat().st_mtime_ns for path in self.files()}

    def index(self):
        with (self.out / "index.csv").open() as f:
            return list(csv.DictReader(f))


@pytest.fixture
def bench(tmp_path, recipe):
    return Bench(tmp_path, recipe)


def descendants(process):
    return psutil.Process(process.pid).children(recursive=True)


def gone(processes, seconds=60):
    _, alive = psutil.wait_procs(processes, timeout=seconds)
    return not [p for p in alive if p.status() != psutil.STATUS_ZOMBIE]


def makers(process):
    """Return the processes below one that make plants; their parents are Dask's workers."""
    return [p for p in descendants(process) if "plantsim.datasets.child" in p.cmdline()]


@pytest.mark.slow
def test_sigkill_to_a_worker_costs_no_plant(bench):
    run = bench.start("--workers", "2", slow=0.5)
    bench.wait_for(1, run)
    makers(run)[0].kill()  # as the kernel does where memory is short: asked again, once
    bench.wait_for(4, run)
    victim = psutil.Process(makers(run)[0].ppid())
    assert victim.pid != run.pid
    below = victim.children(recursive=True)
    victim.kill()
    assert gone([victim, *below])  # what it had begun ends with it
    out, err = run.communicate(timeout=PATIENCE)
    assert (run.returncode, err) == (0, "")
    assert "8 of 8" in out
    assert len(bench.index()) == 8
    assert check_dataset(bench.out).sound


def test_sigkill_to_the_run_leaves_no_process_and_loses_no_plant(bench):
    hung = {"3": "hang"}  # even one that Python cannot reach
    run = bench.start("--workers", "2", slow=0.5, **hung)
    bench.wait_for(2, run)
    below = descendants(run)
    assert below
    run.send_signal(signal.SIGKILL)
    run.communicate()
    assert gone(below)
    before = bench.times()
    assert 2 <= len(before) < 8
    assert len(ps.open_dataset(bench.out)) == len(before)  # though no index was written
    code, out, err = bench.run("--workers", "1")
    assert (code, err) == (0, "")
    assert "8 of 8" in out
    after = bench.times()
    assert len(after) == 8
    assert {path: after[path] for path in before} == before
    assert check_dataset(bench.out).sound


@pytest.mark.slow
def test_interrupt_at_the_keyboard_ends_all_and_the_next_run_goes_on(bench):
    run = bench.start("--workers", "1", slow=0.5)
    bench.wait_for(1, run)
    below = descendants(run)
    os.killpg(run.pid, signal.SIGINT)  # as a terminal does: to all of them
    out, err = run.communicate(timeout=PATIENCE)
    assert (run.returncode, err) == (130, "")
    assert "interrupted. The same command goes on" in out
    assert gone(below)
    assert len(ps.open_dataset(bench.out)) == len(bench.files()) >= 1
    assert {r["status"] for r in bench.index()} == {"done"}


def dask(bench, *command, **faults):
    """Start a process of Dask's own command line."""
    return subprocess.Popen(
        [sys.executable, "-m", "dask", *command],
        env=bench.environment(**faults),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        cwd=bench.home,
    )


def cluster(bench, name, **faults):
    """Start a scheduler and two workers on loopback; return them and its address."""
    file = bench.home / name
    local = ("--host", "127.0.0.1", "--no-dashboard")
    scheduler = dask(
        bench, "scheduler", *local, "--port", "0", "--scheduler-file", str(file)
    )
    until = time.monotonic() + PATIENCE
    while not file.exists() or not file.read_text().endswith("}"):
        assert time.monotonic() < until
        assert scheduler.poll() is None
        time.sleep(0.1)
    address = json.loads(file.read_text())["address"]
    more = ("--nworkers", "2", "--nthreads", "1", "--death-timeout", "60", "--no-dashboard")
    hands = dask(bench, "worker", address, "--host", "127.0.0.1", *more, **faults)
    return scheduler, hands, address


@pytest.mark.slow
def test_a_cluster_of_two_workers_gives_the_same_numbers_though_the_run_was_killed(
    bench, recipe
):
    scheduler, hands, address = cluster(bench, "one.json", slow=0.5)
    try:
        run = bench.start("--scheduler", address)
        bench.wait_for(2, run)
        assert len({p.ppid() for p in makers(hands)}) == 2  # two worker processes
        run.send_signal(signal.SIGKILL)
        run.communicate()
        before = bench.times()
        assert 2 <= len(before) < 8
        bench.finishes(before, "--scheduler", address)
    finally:
        for process in (hands, scheduler):
            process.terminate()
            process.wait(timeout=PATIENCE)
    for row in ps.open_dataset(bench.out).rows:
        alone = make_plant(recipe, row["plant"])
        assert row["digest"] == store.digest_of(alone.arrays, alone.facts)


@pytest.mark.slow
def test_sigkill_to_the_scheduler_of_a_cluster_and_a_second_run_on_a_new_one(bench):
    started = []
    try:
        scheduler, hands, address = cluster(bench, "one.json", slow=0.5)
        started += [scheduler, hands]
        run = bench.start("--scheduler", address)
        bench.wait_for(2, run)
        below = descendants(hands)
        scheduler.kill()
        _, err = run.communicate(timeout=PATIENCE)
        assert run.returncode == 1
        assert err.startswith("plantsim: the Dask scheduler is gone")
        assert err.count("\n") == 1
        hands.terminate()
        hands.wait(timeout=PATIENCE)
        assert gone(below)
        before = bench.times()
        assert 2 <= len(before) < 8
        # the workers may have ended what they had begun: that is not lost either
        assert len(bench.index()) <= len(before) == len(ps.open_dataset(bench.out))
        code, _, err = bench.run("--scheduler", address)  # which nobody answers at now
        assert code == 1
        assert err.startswith(f"plantsim: no Dask scheduler at {address}")
        scheduler, hands, address = cluster(bench, "two.json")
        started += [scheduler, hands]
        bench.finishes(before, "--scheduler", address)
        assert not makers(hands)  # the user's workers are left as they were
    finally:
        for process in started:
            process.kill()


def test_a_plant_that_crashes_hangs_or_cannot_be_meshed_is_listed_with_the_reason(
    bench, recipe
):
    bench.write(replace(recipe, timeout=15.0))
    code, out, err = bench.run(
        "--workers", "2", **{"1": "crash", "2": "hang", "5": "unmeshable"}
    )
    assert (code, err) == (0, "")
    assert "3 failed" in out
    failed = {int(r["plant"]): r for r in bench.index() if r["status"] == "failed"}
    assert {i: r["kind"] for i, r in failed.items()} == {
        1: "crash",
        2: "timeout",
        5: "error",
    }
    assert "signal 11" in failed[1]["reason"]
    assert "not done after 15 s" in failed[2]["reason"]
    assert "no attempt of 6 gave a sound mesh" in failed[5]["reason"]
    assert {r["species"] for r in failed.values()} == {"strawberry"}
    assert not [
        p
        for p in psutil.process_iter(["cmdline", "environ"])
        if "plantsim.datasets.child" in (p.info["cmdline"] or ())
        and str(bench.home) in (p.info["environ"] or {}).get("PYTHONPATH", "")
    ]  # the one that hung was ended
    before = bench.times()
    assert len(before) == 5
    report = check_dataset(bench.out)
    assert (report.sound, report.failed) == (True, 3)
    began = time.monotonic()
    code, _, _ = bench.run("--workers", "2")
    assert (code, bench.times()) == (0, before)
    assert time.monotonic() - began < 60
    code, out, err = bench.run("--workers", "1", "--retry")
    assert (code, err) == (0, "")
    after = bench.times()
    assert len(after) == 8
    assert {path: after[path] for path in before} == before
    assert {r["status"] for r in bench.index()} == {"done"}
    assert check_dataset(bench.out).sound


def full(bench, err):
    assert err.startswith("plantsim: ")
    assert err.count("\n") == 1
    assert "the same command goes on from there" in err
    assert not list(bench.out.glob("plants/*/.*"))  # nothing half-written
    for plant in ps.open_dataset(bench.out):
        assert store.digest_of(*store.read(plant.path)) == plant.row["digest"]


@pytest.mark.slow
def test_files_that_may_not_grow_stop_the_run_with_a_sentence(bench, recipe):
    # the recipe and the index fit, a plant does not
    code, _, err = bench.run("--workers", "1", limit=9000)
    assert code == 1
    assert "File too large" in err
    full(bench, err)
    assert not bench.files()
    assert not list((bench.out / "failures").iterdir())  # it is not the plants' fault
    code, _, err = bench.run("--workers", "1")
    assert (code, err) == (0, "")
    assert check_dataset(bench.out).sound


@pytest.mark.slow
def test_full_disk_stops_the_run_and_the_next_goes_on_when_there_is_room(bench):
    bench.out.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=96k", "plants", str(bench.out)]
    if os.geteuid() or subprocess.run(mount, capture_output=True, check=False).returncode:
        pytest.skip("mounting a small disk needs root")
    try:
        code, _, err = bench.run("--workers", "2")
        assert code == 1
        assert "No space left on device" in err
        full(bench, err)
        before = bench.times()
        assert 0 < len(before) < 8
        more = ["mount", "-o", "remount,size=8m", str(bench.out)]
        subprocess.run(more, check=True)
        code, _, err = bench.run("--workers", "2")
        assert (code, err) == (0, "")
        after = bench.times()
        assert len(after) == 8
        assert {path: after[path] for path in before} == before
        assert check_dataset(bench.out).sound
    finally:
        subprocess.run(["umount", str(bench.out)], check=True)


def test_two_runs_do_not_write_to_one_folder(bench, recipe):
    with (
        Folder(bench.out).locked(),
        pytest.raises(ps.DatasetError, match="another run is writing here"),
    ):
        ps.dataset(recipe, bench.out, workers=1)


def test_a_process_that_cannot_start_is_no_plants_fault(bench, recipe, monkeypatch):
    monkeypatch.setattr(warden.sys, "executable", "/bin/false")
    bench.out.mkdir()
    with pytest.raises(warden.NotStarted, match="exit code 1"):
        warden.plant_in_child(recipe.plain(), 0, str(bench.out))
    assert not list(bench.out.iterdir())
    monkeypatch.undo()
    (bench.out / "plants").mkdir()
    made = warden.plant_in_child(recipe.plain(), 0, str(bench.out))
    assert made["row"]["status"] == "done"
    warden.end_children()
