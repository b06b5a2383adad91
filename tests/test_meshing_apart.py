"""Meshing by the thousand: time limits, signals, silence, the same bytes each time."""

import hashlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import plantsim as ps
from plantsim.solid import apart, gmsh_model, soundness


def digest(mesh):
    parts = [mesh.points, mesh.tets, np.asarray(mesh.region), *mesh.sets.values()]
    return hashlib.sha256(b"".join(np.ascontiguousarray(p).tobytes() for p in parts))


def children(pid):
    """Return the ids of the living children of a process."""
    out = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            after = stat.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(after[1]) == pid and after[0] != "Z":
            out.append(int(stat.parent.name))
    return out


def test_a_child_gives_the_same_mesh_as_we_do(fork):
    solid = ps.sweep(ps.fork(0.3, 0.02))
    other = ps.tetrahedralize(solid, 1.2, timeout=300)
    assert digest(other).hexdigest() == digest(fork).hexdigest()
    assert other.region_names == fork.region_names
    assert list(other.sets) == list(fork.sets)
    assert other.report["attempts"][0]["seconds"]["fill"] > 0


def test_the_same_bytes_in_a_fresh_process(fork):
    code = (
        "import sys; sys.path.insert(0, sys.argv[1]); import plantsim as ps, "
        "test_meshing_apart as t; print(t.digest(ps.tetrahedralize(ps.sweep("
        "ps.fork(0.3, 0.02)), 1.2)).hexdigest())"
    )
    env = {**os.environ, "PYTHONHASHSEED": "7"}
    done = subprocess.run(
        [sys.executable, "-c", code, str(Path(__file__).parent)],
        capture_output=True,
        text=True,
        check=True,
        env=env,
    )
    assert done.stdout.strip() == digest(fork).hexdigest()


def test_a_stuck_kernel_is_ended():
    began = time.monotonic()
    solid = ps.sweep(ps.straight(2000.0, 0.01))  # a hundred thousand rings
    with pytest.raises(ps.MeshError, match=r"not done after 2 s and was ended.*timeout="):
        ps.tetrahedralize(solid, timeout=2)
    assert time.monotonic() - began < 30
    assert not children(os.getpid())


def test_faults_and_crashes_of_a_child_are_sentences(monkeypatch):
    solid = ps.sweep(ps.fork())
    with pytest.raises(ps.MeshError, match=r"kernel 'x' is not known"):
        apart.tetrahedralized(solid, None, 2, "x", 60)
    monkeypatch.setattr(apart, "_packed", lambda solid: b"no arrays")
    with pytest.raises(ps.MeshError):
        apart.tetrahedralized(solid, None, 2, "occ", 60)
    crash = [
        sys.executable,
        "-c",
        "import os, signal; os.kill(os.getpid(), signal.SIGSEGV)",
    ]
    run = subprocess.run
    monkeypatch.setattr(subprocess, "run", lambda args, **given: run(crash, **given))
    with pytest.raises(ps.MeshError, match=r"kernel crashed \(exit -11\)"):
        apart.tetrahedralized(solid, None, 2, "occ", 60)


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="needs /proc to see processes")
@pytest.mark.parametrize("way", ["timeout=300", ""])
@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGKILL])
def test_a_signal_leaves_nothing_behind(tmp_path, way, sent):
    work, temporary = tmp_path / "work", tmp_path / "tmp"
    work.mkdir()
    temporary.mkdir()
    code = (
        "import plantsim as ps\n"
        f"solid = ps.sweep(ps.{'straight(300.0, 0.01)' if way else 'fork()'})\n"
        "print('go', flush=True)\n"
        f"while True: ps.tetrahedralize(solid, {way})\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code],
        cwd=work,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env={**os.environ, "TMPDIR": str(temporary)},
    )
    assert process.stdout is not None
    assert process.stdout.readline() == b"go\n"
    deadline = time.monotonic() + 60
    while way and not children(process.pid) and time.monotonic() < deadline:
        time.sleep(0.05)
    time.sleep(1.5)
    assert process.poll() is None
    young = children(process.pid)
    assert bool(young) == bool(way)
    process.send_signal(sent)
    _, said = process.communicate(timeout=120)
    assert process.returncode == -sent
    if sent == signal.SIGINT:
        assert said.strip().endswith(b"KeyboardInterrupt")
    while any(Path(f"/proc/{pid}").exists() for pid in young):
        assert time.monotonic() < deadline + 60
        time.sleep(0.1)
    assert not list(work.iterdir())
    assert not list(temporary.iterdir())


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="needs /proc")
def test_memory_does_not_climb():
    def held():
        return int(Path("/proc/self/statm").read_text().split()[1]) * 4096

    solid, after = ps.sweep(ps.fork()), []
    for _ in range(16):
        ps.tetrahedralize(solid, 1.5, order=1)
        after.append(held())
    # a mesh and what it was made of take some megabytes
    assert max(after[12:]) - max(after[4:8]) < 2e6


def test_no_stray_output(capfd, tmp_path, monkeypatch):
    solid = ps.sweep(ps.whorl())
    ps.tetrahedralize(solid, order=1)
    ps.tetrahedralize(solid, order=1, timeout=300)
    monkeypatch.setattr(soundness, "WORST", 2.0)  # no mesh is so good
    with pytest.raises(ps.MeshError, match="no attempt"):
        ps.tetrahedralize(ps.sweep(ps.fork()), 1.5, order=1)
    assert not gmsh_model.gmsh.isInitialized()
    path = tmp_path / "bad.geo"
    path.write_text('SetFactory("OpenCASCADE"); Box(1) = {0,0,0,1,1,1};\nnonsense here;\n')
    with pytest.raises(ps.MeshError):
        ps.tetrahedralize(path)
    assert capfd.readouterr() == ("", "")


@pytest.mark.skipif(not hasattr(signal, "SIGPIPE"), reason="no such signal on this system")
def test_a_pipe_closed_at_its_other_end_is_an_error_after_meshing_too():
    """Gmsh resets SIGPIPE: the viewer then died of a page that closed, without a word."""
    script = (
        "import os, plantsim as ps\n"
        "ps.tetrahedralize(ps.sweep(ps.straight(0.2, 0.02)), 1.4, order=1)\n"
        "out, into = os.pipe()\n"
        "os.close(out)\n"
        "try:\n"
        "    os.write(into, b'x')\n"
        "except BrokenPipeError:\n"
        "    print('told')\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert done.stdout == "told\n"
