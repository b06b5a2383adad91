"""Files of others never run code: what stands behind the check of a script's words."""

import os
import subprocess
import sys
import zipfile

import numpy as np
import pytest

import plantsim as ps
from plantsim.solid import fence, foreign, gmsh_model

GEO = 'SetFactory("OpenCASCADE");\nL = 1; what = "stem";\nBox(1) = {0, 0, 0, 1, 1, L};\n'
# without this gmsh stops at the first syntax error; a script may set it
ON = "General.AbortOnError = 0;\n"
RUN = 'SystemCall "touch MARK";\n\n\n'

# each of these once ran its command, or read a file that nobody had looked at
TRICKS = {
    "a letter that is none to gmsh": (ON + "a\xe9" + RUN).encode("latin-1"),
    "the same in UTF-8": (ON + "a\xe9" + RUN).encode(),
    "a micro sign": (ON + "x = 1;\nb\xb5" + RUN).encode("latin-1"),
    "a space that is none to gmsh": (ON + "x = 1;\xa0" + RUN).encode("latin-1"),
    "a name that is read in two ways": 'Include "\xfc.inc";\n\n'.encode(),
    "a name in latin-1": 'Include "\xfc.inc";\n\n'.encode("latin-1"),
    "an include that a test hides": b"If(0)\n E\" EndIf Include 'evil.inc'; \"\nEndIf\n",
    "an include of a variable": b'If(0)\n E" EndIf Include evil; "\nEndIf\n',
    "an include in brackets": b"If(0)\n E\" EndIf Include('evil.inc'); \"\nEndIf\n",
    "an include after a comment": b"If(0)\n E\" EndIf Merge/**/'evil.inc'; \"\nEndIf\n",
    "a merge in a comment of a macro": b'Macro f /*\nMerge "evil.inc"; Return\n*/\nCall f;',
    "a call in a comment of a loop": b"For i In {1:2} /*\n"
    + RUN.encode()
    + b"*/\nEndFor\n",
}


@pytest.mark.parametrize("name", TRICKS)
def test_tricks_of_letters_and_lines_are_refused(tmp_path, name):
    mark = tmp_path / "ran"
    for inc in ("evil.inc", "\xfc.inc"):
        (tmp_path / inc).write_text(RUN.replace("MARK", str(mark)))
    (tmp_path / "\xfc.inc".encode().decode("latin-1")).write_text("x = 1;\n")
    path = tmp_path / "plant.geo"
    path.write_bytes(GEO.encode() + TRICKS[name].replace(b"MARK", str(mark).encode()))
    with pytest.raises(ps.FileError, match=r"plant\.geo"):
        ps.tetrahedralize(path)
    assert not mark.exists()


FENCED = pytest.mark.skipif(
    sys.platform != "linux" or os.uname().machine not in fence.MACHINES,
    reason="the second fence is Linux's",
)


@FENCED
@pytest.mark.parametrize(
    "command",
    [
        'SystemCall "touch MARK";',
        'NonBlockingSystemCall "touch MARK";',
        'OnelabRun("x", "touch MARK");',
        'Include "evil.inc";',
        'Merge "evil.msh";',
        'Field[1] = ExternalProcess; Field[1].CommandLine = "touch MARK; cat";'
        " Background Field = 1;",
        'Save "MARK";',
        'Print "MARK";',
        'CreateDir "MARK";',
        'Printf("x") > "MARK";',
        'General.ErrorFileName = "MARK"; Plugin(NewView).Run; Save View[0] "MARK";',
    ],
)
def test_the_second_fence_holds_alone(tmp_path, monkeypatch, command):
    monkeypatch.setattr(foreign, "check_opened", lambda path: None)
    mark = tmp_path / "ran"
    for name in ("evil.inc", "evil.msh"):
        (tmp_path / name).write_text(RUN.replace("MARK", str(mark)))
    path = tmp_path / "plant.geo"
    path.write_text(ON + GEO + command.replace("MARK", str(mark)) + "\n\n")
    before = sorted(tmp_path.iterdir())
    try:
        ps.tetrahedralize(path, order=1, timeout=60)
    except ps.MeshError as why:
        assert "plant.geo" in str(why)  # noqa: PT017
    assert sorted(tmp_path.iterdir()) == before


@FENCED
def test_behind_the_fence_there_is_no_way_out(tmp_path):
    code = """
import os, socket, subprocess, sys, threading
from plantsim.solid import fence
assert fence.close()
kept = os.open(sys.argv[1], os.O_RDONLY)
folder = os.path.dirname(sys.argv[1])
tries = {
    "run": lambda: subprocess.run(["true"]),
    "exec": lambda: os.execv("/bin/sh", ["sh", "-c", "exit 7"]),
    "spawn": lambda: os.posix_spawn("/bin/sh", ["sh", "-c", "exit 7"], {}),
    "fork": os.fork,
    "write": lambda: open(sys.argv[1], "a"),
    "create": lambda: open(folder + "/new", "x"),
    "folder": lambda: os.mkdir(folder + "/new"),
    "remove": lambda: os.unlink(sys.argv[1]),
    "rename": lambda: os.rename(sys.argv[1], folder + "/new"),
    "link": lambda: os.symlink(sys.argv[1], folder + "/new"),
    "mode": lambda: os.chmod(sys.argv[1], 0),
    "cut": lambda: os.truncate(sys.argv[1], 0),
    "socket": socket.socket,
    "pair": socket.socketpair,
    "signal": lambda: os.kill(os.getppid(), 0),
}
for name, act in tries.items():
    try:
        act()
    except PermissionError:
        continue
    print("not refused:", name)
assert os.system("exit 0") != 0
seen = []
thread = threading.Thread(target=lambda: seen.append(1))  # what libraries need goes on
thread.start()
thread.join()
assert seen and os.read(kept, 4) == b"data"
print("held")
"""
    kept = tmp_path / "kept"
    kept.write_text("data")
    done = subprocess.run(
        [sys.executable, "-c", code, str(kept)], capture_output=True, text=True, check=False
    )
    assert done.stdout == "held\n", done
    assert kept.read_text() == "data"
    assert list(tmp_path.iterdir()) == [kept]


def test_a_folders_name_is_not_put_into_a_script(tmp_path):
    folder = tmp_path / 'a"; SystemCall "touch ran'
    folder.mkdir()
    (folder / "part.inc").write_text("x = 1;\n")
    path = folder / "plant.geo"
    path.write_text(GEO + 'Include "part.inc";\n')
    assert ps.tetrahedralize(path, order=1).volume == pytest.approx(1)
    with pytest.raises(ps.FileError, match="quotes in its name"):
        ps.tetrahedralize(path, order=1, parameters={"L": 2.0})


def test_parameters_and_folders_beyond_ascii(tmp_path):
    folder = tmp_path / "\u6a39 Bl\xfcte"
    folder.mkdir()
    (folder / "part.inc").write_text("x = 1;\n")
    path = folder / "plant.geo"
    path.write_text(GEO + 'Include "part.inc"; Physical Volume(Str(what)) = {1};\n')
    mesh = ps.tetrahedralize(path, order=1, parameters={"L": 2.0, "what": "\u6a39"})
    assert mesh.volume == pytest.approx(2)
    assert mesh.region_names == ("\u6a39",)


def test_a_mesh_is_read_without_its_options_or_neighbours(tmp_path, cube):
    # read_mesh asks no gmsh, so that neither FILE.opt nor a link to a script runs
    mark = tmp_path / "ran"
    path = ps.write_mesh(cube, tmp_path / "plant.msh")
    (tmp_path / "plant.msh.opt").write_text(RUN.replace("MARK", str(mark)))
    assert len(ps.read_mesh(path).tets) == 6
    (tmp_path / "evil.geo").write_text(RUN.replace("MARK", str(mark)))
    for name in ("link.msh", "LINK.MSH", "link.step", "link.stl", "link.geo", "link.GEO"):
        link = tmp_path / name
        link.symlink_to(tmp_path / "evil.geo")
        with pytest.raises(ps.PlantsimError):
            (ps.read_mesh if "msh" in name.lower() else ps.tetrahedralize)(link)
    for end in ("\r\n", "\n"):
        late = tmp_path / "late.msh"
        late.write_bytes(f'\n{end}SystemCall "touch {mark}";{end}$MeshFormat{end}'.encode())
        with pytest.raises(ps.FileError, match="MeshFormat"):
            ps.read_mesh(late)
    windows = tmp_path / "windows.geo"
    windows.write_bytes(
        (GEO + RUN.replace("MARK", str(mark))).replace("\n", "\r\n").encode()
    )
    with pytest.raises(ps.FileError, match="SystemCall"):
        ps.tetrahedralize(windows)
    assert not mark.exists()


def test_an_archive_that_swells_is_not_unpacked(tmp_path, cube, monkeypatch):
    from plantsim import paths

    monkeypatch.setattr(paths, "MODEST", 2**20)
    good = ps.write_mesh(cube, tmp_path / "good.npz")
    assert len(ps.read_mesh(good).tets) == 6
    for reader in (ps.read_mesh, ps.read_observations):
        bomb = tmp_path / "bomb.npz"
        np.savez_compressed(bomb, points=np.zeros((10**6, 3)), tets=np.zeros((1, 4), int))
        with pytest.raises(ps.FileError, match=r"bomb\.npz: .* unpack to 24,000"):
            reader(bomb)
    lying = tmp_path / "lying.npz"
    header = "{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000, 3), }"
    with zipfile.ZipFile(lying, "w") as z:
        text = header.ljust(117).encode() + b"\n"
        z.writestr(
            "points.npy", b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text
        )
    with pytest.raises(ps.FileError, match="cannot be read"):
        ps.read_mesh(lying)


@pytest.mark.parametrize(
    "kind", ["group", "array", "soft", "raw", "virtual", "bomb", "vlen"]
)
def test_observations_lie_in_their_own_file(tmp_path, kind):
    h5py = pytest.importorskip("h5py")
    seen = ps.Observation(
        moved=[1], move=[[0, 0, 0.01]], force=[[0, 0, 1.0]], force_noise=0.1
    )
    other = ps.write_observations([seen], tmp_path / "other.h5")
    path = ps.write_observations([seen], tmp_path / "a.h5")
    assert len(ps.read_observations(path)) == 1
    with h5py.File(path, "a") as f:
        if kind == "group":
            del f["0"]
            f["0"] = h5py.ExternalLink(str(other), "/0")
        else:
            del f["0/move"]
            if kind == "array":
                f["0/move"] = h5py.ExternalLink(str(other), "/0/move")
            elif kind == "soft":
                f["0/move"] = h5py.SoftLink("/0/force")
            elif kind == "raw":
                f["0"].create_dataset("move", (1, 3), "f8", external=[(str(other), 0, 24)])
            elif kind == "virtual":
                layout = h5py.VirtualLayout((1, 3), "f8")
                layout[:] = h5py.VirtualSource(str(other), "0/move", (1, 3))
                f["0"].create_virtual_dataset("move", layout)
            elif kind == "bomb":
                f["0"].create_dataset(
                    "move", (2**40, 3), "f8", chunks=(2**16, 3), compression="gzip"
                )
            else:
                f["0/move"] = np.array(["__import__('os')"], dtype=h5py.string_dtype())
    with pytest.raises(ps.FileError, match=r"a\.h5"):
        ps.read_observations(path)


def test_kernels_that_print_are_not_heard(capfd):
    """Two tubes through each other: HXT prints what it trips over by plain printf."""
    a = ps.tetrahedralize(ps.sweep(ps.straight(0.2, 0.02), tips="flat"), order=1)
    _, faces = np.unique(a.surface, return_inverse=True)
    faces = faces.reshape(-1, 3)
    points = a.points[a.surface_vertices]
    both = np.vstack([points, points @ [[0, 0, 1], [0, 1, 0], [-1, 0, 0]] + [0.1, 0, 0.1]])
    doubled = np.vstack([faces, faces + len(points)])
    still = np.ones(len(both), dtype=bool)
    for algorithm in (gmsh_model.HXT, gmsh_model.DELAUNAY):
        with pytest.raises(ps.MeshError):
            gmsh_model.fill(both, doubled, still, algorithm)
    os.write(1, b"heard again")
    assert capfd.readouterr() == ("heard again", "")
