"""The command line as a user meets it: exit codes, one sentence, files."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest

import plantsim as ps
from plantsim import doctor
from plantsim.view import probe
from plantsim.view.probe import why_not_drawn


def run(*args, cwd=None):
    return subprocess.run(
        [sys.executable, "-m", "plantsim", *map(str, args)],
        capture_output=True,
        text=True,
        timeout=300,
        cwd=cwd,
        check=False,
    )


def refused(*args, says):
    done = run(*args)
    assert done.returncode == 1, done
    assert done.stdout == ""
    assert done.stderr.startswith("plantsim: ")
    assert done.stderr.count("\n") == 1, done.stderr
    assert says in done.stderr
    assert "Traceback" not in done.stderr


@pytest.fixture
def beam(tmp_path):
    mesh = ps.tetrahedralize(ps.sweep(ps.straight(0.2, 0.02), tips="flat"), order=1)
    tip = np.flatnonzero(mesh.points[:, 2] > 0.2 - 1e-9)
    return ps.write_mesh(mesh.with_sets(tip=tip), tmp_path / "beam.msh")


def test_mesh_describes_and_converts(beam, tmp_path):
    done = run("mesh", beam, "--order", 2, "--out", tmp_path / "beam.vtu")
    assert done.returncode == 0, done.stderr
    assert "order 2" in done.stdout
    assert "set tip:" in done.stdout
    assert ps.read_mesh(tmp_path / "beam.vtu").order == 2


def test_mesh_of_a_skeleton_and_of_a_script(tmp_path):
    skeleton = ps.write_skeleton(ps.fork(), tmp_path / "fork.json")
    pictures = [] if why_not_drawn() else ["--picture", tmp_path / "a.png"]
    quality = tmp_path / "q.png"
    done = run(
        *("mesh", skeleton, "--size", 1.5, "--tips", "flat", "--order", 1),
        *("--quality", quality, "--out", tmp_path / "a.msh", *pictures),
    )
    assert done.returncode == 0, done.stderr
    assert "edge/radius" in done.stdout
    assert "attempt 1, Delaunay: surface " in done.stdout
    assert "set tips:" in done.stdout
    for path in (quality, *pictures[1:]):
        assert path.read_bytes().startswith(b"\x89PNG")
    assert ps.read_mesh(tmp_path / "a.msh").region_names == ("0", "1", "2")
    script = tmp_path / "box.geo"
    script.write_text('SetFactory("OpenCASCADE"); L = 1; Box(1) = {0, 0, 0, 1, 1, L};\n')
    done = run("mesh", script, "--set", "L=2", "--order", 1)
    assert "2 m^3" in done.stdout, done.stderr
    refused("mesh", script, "--set", "L", says="NAME=VALUE")
    refused("mesh", script, "--set", "M=1", says="no parameter 'M'")
    refused("mesh", tmp_path / "a.msh", "--set", "L=1", says="is a mesh already")


def test_push_tells_the_force_and_writes_the_state(beam, tmp_path):
    done = run(
        "push", beam, "--moved", "tip", "--by=0,0,-0.001", "--out", tmp_path / "a.vtu"
    )
    assert done.returncode == 0, done.stderr
    force = float(done.stdout.split("force on the moved vertices in all:")[1].split()[2])
    # a stocky bar in compression: E A d / L, within order 1's error and the facets'
    assert force == pytest.approx(-6e9 * np.pi * 0.02**2 * 0.001 / 0.2, rel=0.2)
    assert (tmp_path / "a.vtu").stat().st_size > 0


def test_bad_input_is_one_sentence(beam, tmp_path):
    refused("mesh", tmp_path / "none.msh", says="no such file")
    script = tmp_path / "evil.msh"
    script.write_text(f'SystemCall "touch {tmp_path / "ran"}";')
    refused("mesh", script, says="nothing was run")
    geo = tmp_path / "evil.geo"
    geo.write_text(f'SystemCall "touch {tmp_path / "ran"}";')
    refused("mesh", geo, says="SystemCall")
    assert not (tmp_path / "ran").exists()
    np.savez(tmp_path / "pickled.npz", points=np.array([{}], dtype=object))
    refused("mesh", tmp_path / "pickled.npz", says="run code")
    refused("push", beam, "--moved", "999999", says="out of range")
    refused("push", beam, "--moved", "0", says="both fixed and moved")
    refused("push", beam, "--moved", "leaf", says="no set 'leaf'")
    refused("push", beam, "--moved", "tip", "--by=1,2", says="3 numbers")
    refused("push", beam, "--moved", "tip", "--young=-1", says="young is -1")
    refused("push", beam, "--moved", "tip", "--young=nan", says="NaN")
    refused("push", beam, "--moved", "tip", "--poisson=0.5", says="poisson is 0.5")
    refused("push", beam, "--moved", "tip", "--out", tmp_path / "a.xyz", says="suffix")
    assert not list(tmp_path.glob("*.xyz"))
    done = run("push", beam, "--moved", "tip", "--out", "/proc/a.vtu")
    assert done.returncode == 1
    assert done.stderr.startswith("plantsim: /proc")
    assert done.stderr.count("\n") == 1
    refused("demo", "--out", beam, says="beam.msh")
    refused("mesh", beam, "--size", "0.5", says="mesh already")


def test_a_species_given_for_a_mesh_is_told_how_to_grow():
    refused("view", "apple", says="plantsim view --species apple")


def test_json_for_machines(beam, tmp_path):
    done = run("mesh", beam, "--out", tmp_path / "b.vtu", "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    mesh = ps.read_mesh(beam)
    assert found["tets"] == sum(found["regions"].values()) == len(mesh.tets)
    assert found["sets"]["tip"] == len(mesh.sets["tip"])
    assert found["files"] == [str(tmp_path / "b.vtu")]
    pushed = json.loads(run("push", beam, "--moved", "tip", "--json").stdout)
    # a moved vertex does work: energy = force . motion / 2, moved 1 cm down together
    assert pushed["energy"] == pytest.approx(-pushed["force"][2] * 0.01 / 2, rel=1e-9)
    wrong = run("push", beam, "--moved", "leaf", "--json")
    assert wrong.returncode == 1
    assert json.loads(wrong.stdout)["kind"] == "ModelError"
    assert wrong.stderr.count("\n") == 1


def test_help_shows_examples():
    from plantsim.cli.app import app

    names = [
        command.name or command.callback.__name__ for command in app.registered_commands
    ]
    assert {"demo", "grow", "mesh", "push", "doctor"} <= set(names)
    for command in app.registered_commands:
        name = command.name or command.callback.__name__
        assert f"Example: plantsim {name}" in command.callback.__doc__
        assert "json" in command.callback.__annotations__, name
    done = run("push", "--help")
    assert done.returncode == 0
    assert "Example: plantsim push" in done.stdout
    assert "--json" in done.stdout


def test_the_shell_completes():
    words = {"COMP_WORDS": "plantsim grow ap", "COMP_CWORD": "2"}
    done = subprocess.run(
        [
            sys.executable,
            "-c",
            "import sys; sys.argv = ['plantsim']; from plantsim.cli import main; main()",
        ],
        env=os.environ | words | {"_PLANTSIM_COMPLETE": "complete_bash"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert {"apple", "apple_spindle"} <= set(done.stdout.split()), done


def test_the_example_of_each_command_parses():
    """What --help shows is accepted by the parser, option by option."""
    import re
    import shlex

    import typer

    from plantsim.cli.app import app

    group = typer.main.get_command(app)
    for name, command in group.commands.items():
        text = " ".join(command.callback.__doc__.split("Example: ")[1].split())
        for line in re.split(r", then |\. ", text):
            words = shlex.split(line)
            assert words[:2] == ["plantsim", name], line
            command.make_context(name, words[2:], resilient_parsing=False)


def test_pictures_are_refused_before_the_work(beam, tmp_path):
    refused("grow", "apple", "--picture", tmp_path / "a.bmp", says=".svg")
    refused("grow", "apple", "--out", tmp_path / "a.bmp", says=".swc")
    refused("push", beam, "--moved", "tip", "--picture", tmp_path / "a.svg", says=".png")


def test_version_and_wrong_usage():
    assert run("--version").stdout.strip() == ps.__version__
    assert run("sing").returncode == 2


def test_demo_makes_its_files(tmp_path):
    done = run("demo", "--seed", 7, "--out", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    for word in ("grow", "52.5 s", "~10 s", "0.025 s", "Young of a limb"):
        assert word in done.stdout
    mesh = ps.read_mesh(tmp_path / "out" / "plant.msh")
    assert mesh.order == 2
    assert "base" in mesh.sets
    assert len(ps.read_observations(tmp_path / "out" / "touches.npz")) == 5
    assert (tmp_path / "out" / "pushed.vtu").exists()
    drawn = probe.why_not_drawn() is None
    for name in ("pushed.png", "stiffness.png"):
        assert (tmp_path / "out" / name).exists() == drawn


def test_doctor_finds_this_machine_well(monkeypatch, capsys):
    assert run("doctor").returncode == 0
    assert doctor.missing_packages() == []


def test_doctor_names_what_is_missing(monkeypatch):
    monkeypatch.setattr(doctor, "loads", lambda library: library != "libGLU.so.1")
    assert doctor.missing_packages() == ["libglu1-mesa"]
    sick = [check for check in doctor.examine() if check.mend and check.needed]
    assert [check.name for check in sick] == ["libGLU.so.1"]
    assert sick[0].mend == "apt-get install libglu1-mesa"


def test_no_picture_where_none_can_be_drawn(monkeypatch, tmp_path, cube):
    state = ps.ElasticModel(cube, ps.Material()).solve(ps.gravity())
    probe.why_not_drawn.cache_clear()
    monkeypatch.setattr(probe, "loads", lambda library: False)
    monkeypatch.delenv("DISPLAY", raising=False)
    with pytest.raises(ps.DependencyError, match="libegl1"):
        ps.figure_deformation(state, tmp_path / "a.png")
    probe.why_not_drawn.cache_clear()
    monkeypatch.undo()
    monkeypatch.setattr(probe, "_DRAW", "import os; os.kill(os.getpid(), 11)")
    with pytest.raises(ps.DependencyError, match="trial picture failed .exit -11"):
        ps.figure_deformation(state, tmp_path / "a.png")
    probe.why_not_drawn.cache_clear()
    assert not list(tmp_path.iterdir())


def test_pictures(tmp_path, fork):
    if probe.why_not_drawn():
        pytest.skip(probe.why_not_drawn())
    import matplotlib.image

    ids = np.argsort(fork.points[:, 2])[-5:]
    state = ps.ElasticModel(fork, ps.Material()).solve(ps.move(ids, (0.01, 0, -0.01)))
    picture = matplotlib.image.imread(ps.figure_deformation(state, tmp_path / "a.png"))
    red = (picture[:, :, 0] > 0.4) & (picture[:, :, 1] < 0.3)
    grey = (np.ptp(picture[:, :, :3], axis=2) < 0.05) & (
        np.abs(picture[:, :, 0] - 0.5) < 0.2
    )
    black = picture[:, :, :3].max(axis=2) < 0.2
    assert red.sum() > 50
    assert grey.sum() > 1000
    assert black.sum() > 100
    assert (picture[:3, :, :3] == 1).all()  # a white margin: nothing is cut off
    field = np.arange(3.0)[fork.region]
    picture = matplotlib.image.imread(ps.figure_material(fork, field, tmp_path / "b.png"))
    assert (
        len(np.unique((picture[::5, ::5, :3] * 8).astype(int).reshape(-1, 3), axis=0)) > 8
    )
    with pytest.raises(ps.ModelError, match="one value a tet"):
        ps.figure_material(fork, field[1:], tmp_path / "b.png")


def test_touch_and_estimate_find_the_modulus_again(beam, tmp_path):
    touches = tmp_path / "touches.npz"
    done = run(
        "touch", beam, "--moved", "tip", "--by=0,0.001,-0.001", "--young", "8e9",
        "--displacement-noise", "1e-5", "--force-noise", "5", "--out", touches,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert len(ps.read_observations(touches)) == 1
    out = tmp_path / "found.vtu"
    done = run("estimate", beam, touches, "--young", "5e9", "--out", out)
    assert done.returncode == 0, done.stderr
    found = json.loads(run("estimate", beam, touches, "--young", "5e9", "--json").stdout)
    (limb,) = found["limbs"]
    assert limb["estimate"] == pytest.approx(8, rel=0.02)
    assert limb["low"] < limb["estimate"] < limb["high"]
    assert 0.9 < limb["seen"] <= 1
    assert out.stat().st_size > 0
    refused("estimate", beam, touches, "--parameters", "twig", says="limb or element")
    refused("estimate", beam, beam, says=".msh suffix")
    refused("touch", beam, "--moved", "tip", "--out", "a.csv", says=".npz")
