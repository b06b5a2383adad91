"""Simple shapes, leaves and fruit, pictures, the command line."""

import numpy as np
import pytest
from typer.testing import CliRunner

import plantsim as ps
from plantsim.cli.app import app
from plantsim.plant.foliage import known

approx = pytest.approx

CROPS = ("apple", "apple_spindle", "cherry", "citrus_young", "grapevine", "tomato")
CROPS += ("pepper", "maize", "strawberry")
PUBLISHED = ("quaking_aspen", "black_tupelo", "weeping_willow", "california_black_oak")


@pytest.mark.parametrize(
    "plant", [ps.straight(), ps.tapered(), ps.fork(), ps.whorl(), ps.zigzag()]
)
def test_simple_shapes_sweep_and_pass_check(plant):
    assert plant.check() == ()
    ps.sweep(plant)


def test_simple_shapes_have_the_sizes_they_are_given():
    assert ps.zigzag(2.0, bends=3).limbs[0].length == approx(2)
    plant = ps.whorl(2.0, branches=5, at=0.5, branch_length=0.3)
    assert [b.length for b in plant.limbs[1:]] == approx([0.3] * 5)
    assert all(b.points[0] == approx([0, 0, 1]) for b in plant.limbs[1:])
    areas = np.pi * plant.radius[plant.first] ** 2
    assert areas[1:].sum() <= areas[0]
    with pytest.raises(ps.GeometryError, match="too thick"):
        ps.zigzag(0.1, radius=0.05)


def test_the_species_asked_for_are_there():
    assert set(ps.species_names()) == set(CROPS) | set(PUBLISHED)


SIZES = {  # height [m] of single ready plants, round the means of test_plant_crops
    "apple": (2.5, 4.2),
    "apple_spindle": (2.8, 3.7),
    "cherry": (3.0, 4.2),
    "citrus_young": (1.1, 2.0),
    "grapevine": (1.6, 2.9),
    "tomato": (1.7, 2.4),
    "pepper": (0.5, 0.85),
    "maize": (1.9, 2.8),
    "strawberry": (0.1, 0.25),
}


@pytest.mark.parametrize("name", CROPS)
def test_crops_have_plausible_sizes(name):
    low, high = SIZES[name]
    for seed in range(4):
        assert low < ps.weber_penn(name, rng=seed).height < high


@pytest.mark.parametrize("name", CROPS)
def test_leaves_and_fruit_hang_on_their_limbs(name):
    plant = ps.weber_penn(name, rng=2).with_leaves(name).with_fruit(name)
    masses = plant.masses
    count = known(name if name != "apple_spindle" else "apple", "fruit")["count"]
    assert sum(k == "fruit" for k in masses.kind) == count
    assert masses.points.shape == masses.attachment.shape == (len(masses), 3)
    assert (masses.mass > 0).all()
    fruit = np.array([k == "fruit" for k in masses.kind])
    drop = (masses.points - masses.attachment)[fruit]
    assert (drop[:, 2] < 0).all()  # below their twig
    for k in (0, len(masses) - 1):  # attached to the axis
        limb = plant.limbs[masses.limb[k]]
        gap = np.linalg.norm(plant.resampled(0.005).limbs[limb.index].points
                             - masses.attachment[k], axis=1).min()  # fmt: skip
        assert gap < 0.01


def test_masses_move_with_their_limbs_and_go_with_them():
    plant = ps.weber_penn("apple", rng=2).with_leaves("apple").with_fruit("apple")
    fine = plant.resampled(0.05)
    assert fine.masses.total == approx(plant.masses.total)
    assert np.abs(fine.masses.points - plant.masses.points).max() < 0.02
    few = plant.pruned(max_limbs=10)
    assert 0 < len(few.masses) < len(plant.masses)
    assert few.masses.limb.max() < 10
    cut = plant.pruned(min_radius=0.004)
    assert 0 < cut.masses.total < plant.masses.total


def test_masses_of_your_own_and_missing_numbers():
    plant = ps.fork().with_fruit(count=3, mass=0.2, stalk=0.1)
    assert plant.masses.total == approx(0.6)
    assert ps.fork().masses.total == 0
    with pytest.raises(ps.GeometryError, match="mass is not given"):
        ps.fork().with_leaves(spacing=0.1)
    with pytest.raises(ps.GeometryError, match="there are: apple"):
        ps.fork().with_fruit("willow")


def test_pictures(tmp_path):
    pytest.importorskip("matplotlib")
    plant = ps.weber_penn("grapevine", rng=1).with_leaves("grapevine")
    file = plant.plot(tmp_path / "vine.png")
    assert file.read_bytes()[:4] == b"\x89PNG"
    assert plant.plot().axes[0].get_xlabel() == "m"


def test_grow_command(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run = CliRunner()
    done = run.invoke(app, ["grow", "tomato", "--seed", "3", "--out", "t.swc"])
    assert done.exit_code == 0
    assert ps.read_skeleton("t.swc").limbs[0].length > 1.5
    shown = run.invoke(app, ["grow", "--list"])
    assert all(name in shown.output for name in ("apple_spindle", "maize"))
    drawn = run.invoke(app, ["grow", "--list", "--picture", "all.png"])
    assert drawn.exit_code == 0
    assert (tmp_path / "all.png").read_bytes()[:4] == b"\x89PNG"
    assert "Example" in run.invoke(app, ["grow", "--help"]).output
    wrong = run.invoke(app, ["grow", "tomatoo"])
    assert isinstance(wrong.exception, ps.GeometryError)
    ps.species("maize").write("mine.toml")
    assert run.invoke(app, ["grow", "mine.toml", "--whole"]).exit_code == 0
