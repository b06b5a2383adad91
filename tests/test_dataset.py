"""Data sets: draws, files, reading, checks; faults are in test_dataset_faults."""

import csv
import json
import os
import re
import time
import types
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import plantsim as ps
from plantsim.cli.app import app
from plantsim.datasets import store
from plantsim.datasets.draw import drawn, limb_field, split_of
from plantsim.datasets.recipe import Kind, Meshing, Touching, example

h5py = pytest.importorskip("h5py")

from plantsim.datasets.checks import SCHEMA, check_dataset  # noqa: E402
from plantsim.datasets.folder import COLUMNS, STAGES  # noqa: E402
from plantsim.datasets.plant import limb_moduli, make_plant  # noqa: E402
from plantsim.datasets.reading import Plant  # noqa: E402
from plantsim.datasets.summary import summarise  # noqa: E402

DOCS = Path(__file__).resolve().parent.parent / "docs"


@pytest.fixture(scope="module")
def recipe() -> ps.Recipe:
    """Trunks alone, order 1, two kinds: a second a plant."""
    kinds = tuple(
        Kind(name, ps.species(name), levels=1) for name in ("strawberry", "maize")
    )
    touch = Touching(touches=3, steps=2, seen=40, max_force=5.0)
    return ps.Recipe(plants=5, species=kinds, mesh=Meshing(order=1), touch=touch)


@pytest.fixture(scope="module")
def made(recipe, tmp_path_factory) -> ps.Dataset:
    """The data set of that recipe, by one worker."""
    pytest.importorskip("distributed")
    return ps.dataset(recipe, tmp_path_factory.mktemp("sets") / "one", workers=1)


def copied(data, tmp_path):
    """Return a copy of a data set's folder, to be spoilt."""
    out = tmp_path / "copy"
    for path in data.folder.rglob("*"):
        to = out / path.relative_to(data.folder)
        if path.is_dir():
            to.mkdir(parents=True, exist_ok=True)
        else:
            to.parent.mkdir(parents=True, exist_ok=True)
            to.write_bytes(path.read_bytes())
    return out


# draws


def test_field_of_moduli_has_the_stated_correlation_and_spread():
    carrier = np.array([-1, 0, 0, 1, 3])  # 2 joints between 2 and 1, 4 between 2 and 4
    joints = np.array(
        [
            [0, 1, 1, 2, 3],
            [1, 0, 2, 1, 2],
            [1, 2, 0, 3, 4],
            [2, 1, 3, 0, 1],
            [3, 2, 4, 1, 0],
        ]
    )
    rng = np.random.default_rng(0)
    count = 40_000
    fields = np.array([limb_field(carrier, 0.6, rng) for _ in range(count)])
    assert np.abs(np.cov(fields.T) - 0.6**joints).max() < 5 * np.sqrt(2 / count)


def test_moduli_of_a_plant_scatter_about_its_own_by_the_spread(recipe):
    kind = Kind("apple", ps.species("apple"), spread=0.3, correlation=0.0, max_limbs=30)
    one = replace(recipe, species=(kind,))
    draw = drawn(one, 0)
    skeleton = ps.weber_penn("apple", 1, max_limbs=60)
    rng = np.random.default_rng(1)
    young = np.array([limb_moduli(skeleton, draw, rng) for _ in range(400)])
    assert 4e9 <= draw.young <= 9e9
    assert np.log(young / draw.young).mean() == pytest.approx(0, abs=0.01)
    assert np.log(young / draw.young).std() == pytest.approx(0.3, rel=0.02)


def test_kinds_are_mixed_by_weight_and_ranges_are_filled():
    kinds = (
        Kind("apple", ps.species("apple"), weight=3, times={"scale": [0.5, 1.5]}),
        Kind("maize", ps.species("maize"), weight=1),
    )
    many = [drawn(ps.Recipe(species=kinds), i) for i in range(1500)]
    apples = [d for d in many if d.kind.name == "apple"]
    assert len(apples) / 1500 == pytest.approx(0.75, abs=0.04)
    scale = np.array([d.model.scale for d in apples]) / 3.2
    assert scale.min() > 0.5
    assert scale.max() < 1.5
    assert scale.mean() == pytest.approx(1, abs=0.03)
    assert scale.std() == pytest.approx(1 / np.sqrt(12), rel=0.05)
    assert {d.max_limbs for d in many} == set(range(3, 9))


def test_split_is_by_plant_and_by_share_whatever_the_number_of_plants(recipe):
    names = [split_of(recipe, i) for i in range(4000)]
    for name, share in recipe.split:
        assert names.count(name) / 4000 == pytest.approx(share, abs=0.025)
    assert [split_of(replace(recipe, plants=9), i) for i in range(100)] == names[:100]
    assert [split_of(replace(recipe, seed=8), i) for i in range(100)] != names[:100]
    alone = replace(recipe, split=(("test", 1.0),))
    assert {split_of(alone, i) for i in range(50)} == {"test"}


def test_a_plant_depends_on_its_number_alone_and_its_shape_not_on_the_touches(recipe):
    one = make_plant(recipe, 3)
    other = make_plant(replace(recipe, plants=10_000, timeout=1.0), 3)
    assert store.digest_of(one.arrays, one.facts) == store.digest_of(
        other.arrays, other.facts
    )
    fewer = make_plant(replace(recipe, touch=replace(recipe.touch, touches=0)), 3)
    assert fewer.arrays["touches/force"].shape == (0, 2, 3, 3)
    for name, value in fewer.arrays.items():
        if not name.startswith("touches/"):
            np.testing.assert_array_equal(value, one.arrays[name], err_msg=name)


# files


def test_a_file_has_the_same_bytes_whenever_it_is_written(recipe):
    plant = make_plant(recipe, 0)
    first = store.packed(plant.arrays, plant.facts, lambda: {"grow": 1.0})
    time.sleep(1.1)  # HDF5's own times count in seconds
    assert store.packed(plant.arrays, plant.facts, lambda: {"grow": 1.0}) == first


def test_made_plants_read_back_and_agree_with_the_model(recipe, made):
    assert len(made) == recipe.plants
    assert [p.row["plant"] for p in made] == list(range(5))
    assert sum(len(made.split(s)) for s in ("train", "validation", "test")) == 5
    for plant, close in ((made[0], 1e-9), (made[1], 2e-5)):  # stout; slender, 400 radii
        model, data = plant.model(), plant.arrays()
        np.testing.assert_array_equal(model.fixed_ids, plant.mesh.sets["base"])
        for i, ids in enumerate(data["touches/moved"]):
            for step in range(2):
                # by another way than they were made: a factor of their own, which the first
                # moves of a model get, not compliance
                state = plant.model().solve(ps.move(ids, data["touches/move"][i, step]))
                assert "compliance" not in state.stats.backend
                f, u = state.force[ids], state.displacement[data["touches/seen"]]
                for name, value in (("force", f), ("displacement", u)):
                    off = np.abs(data[f"touches/true_{name}"][i, step] - value).max()
                    assert off <= close * np.abs(value).max(), name
            assert np.degrees(state.max_rotation) <= recipe.touch.max_rotation * 1.001
            assert np.linalg.norm(f.sum(axis=0)) <= 5.0 * 1.001
    assert plant.facts["mass_kg"] == pytest.approx(model.mass)
    assert plant.facts["height_m"] == pytest.approx(plant.skeleton.height)
    seen = plant.observations()
    assert len(seen) == recipe.touch.touches
    assert seen[0].force_noise == 0.02
    np.testing.assert_array_equal(seen[2].force, data["touches/force"][2, -1])
    grown = ps.WeberPenn.from_mapping(json.loads(str(plant.facts["parameters"])))
    assert grown == drawn(recipe, 1).model
    assert json.loads(str(plant.facts["versions"]))["numpy"] == np.__version__
    assert plant.facts["mesher"] in ("occ, HXT", "occ, Delaunay")
    assert "SuperLU" in str(plant.facts["solver"])
    with store.opened(plant.path) as f:
        run = store.run(f)
    assert set(run) == {*STAGES, "cpu"}
    assert all(0 <= run[name] < 600 for name in run)


def test_noise_is_of_the_stated_size(recipe):
    touch = replace(recipe.touch, touches=40, seen=100)
    arrays = make_plant(replace(recipe, touch=touch), 1).arrays
    for name, size in (("force", 0.02), ("displacement", 1e-3)):
        error = arrays[f"touches/{name}"] - arrays[f"touches/true_{name}"]
        assert error.std() == pytest.approx(size, rel=4 / np.sqrt(2 * error.size))
        assert abs(error.mean()) < 4 * size / np.sqrt(error.size)


def test_patches_are_on_one_side_and_pushed_inwards(recipe):
    arrays = make_plant(recipe, 1).arrays
    mesh = ps.TetMesh(arrays["mesh/points"], arrays["mesh/tets"])
    for ids, moves in zip(arrays["touches/moved"], arrays["touches/move"], strict=True):
        way = moves[-1, 0] / np.linalg.norm(moves[-1, 0])
        normal = mesh.normals[np.searchsorted(mesh.surface_vertices, ids[0])]
        assert way @ normal < -0.5
        assert np.ptp(moves[-1], axis=0) == pytest.approx(0, abs=1e-12)


def test_the_same_numbers_by_two_workers_and_nothing_done_twice(recipe, made, tmp_path):
    two = ps.dataset(recipe, tmp_path / "two", workers=2)
    for a, b in zip(made, two, strict=True):
        assert a.row["digest"] == b.row["digest"]
        one, other = a.arrays(), b.arrays()
        for name, value in one.items():
            np.testing.assert_array_equal(value, other[name], err_msg=name)
    before = {p: os.stat(p).st_mtime_ns for p in two.folder.rglob("*.h5")}
    steps = []
    more = ps.dataset(replace(recipe, plants=6), tmp_path / "two", tell=steps.append)
    assert [s.made for s in steps] == [0, 1]
    assert len(more) == 6
    assert {p: os.stat(p).st_mtime_ns for p in before} == before
    with pytest.raises(ps.DatasetError, match="another recipe"):
        ps.dataset(replace(recipe, seed=1), tmp_path / "two")
    with pytest.raises(ps.DatasetError, match="begun with 6 plants"):
        ps.dataset(recipe, tmp_path / "two")


def test_index_is_made_anew_from_what_is_there(made, tmp_path):
    folder = copied(made, tmp_path)
    index = (folder / "index.csv").read_text()
    assert len(list(csv.DictReader(index.splitlines()))) == 5
    for spoilt in ("", "plant,status\n1,done\n", index[: len(index) // 2]):
        (folder / "index.csv").write_text(spoilt)
        again = ps.open_dataset(folder)
        assert again.rows == made.rows
    (folder / "index.csv").unlink()
    assert len(ps.dataset(made.recipe, folder)) == 5  # nothing to make: no cluster
    assert (folder / "index.csv").read_text() == index


def test_without_a_folder_named_it_is_plants_here(made, tmp_path, monkeypatch):
    copied(made, tmp_path).rename(tmp_path / "plants")
    monkeypatch.chdir(tmp_path)
    found = ps.dataset(made.recipe)
    assert (len(found), found.folder) == (5, tmp_path / "plants")


def test_a_folder_that_holds_something_else_is_left_alone(recipe, tmp_path):
    (tmp_path / "thesis.tex").write_text("mine")
    with pytest.raises(ps.DatasetError, match=r"not empty.*thesis\.tex"):
        ps.dataset(recipe, tmp_path)
    with pytest.raises(ps.DatasetError, match="not a folder"):
        ps.dataset(recipe, tmp_path / "thesis.tex")
    with pytest.raises(ps.FileError, match="no data set"):
        ps.open_dataset(tmp_path)


# reading without trust


def spoil(kind, path):
    """Spoil a plant's file in one way."""
    data = path.read_bytes()
    if kind == "truncated":
        path.write_bytes(data[: len(data) // 2])
    elif kind == "empty":
        path.write_bytes(b"")
    elif kind == "text":
        path.write_bytes(b"not HDF5 at all\n" * 100)
    elif kind == "foreign":
        with h5py.File(path, "w") as f:
            f["x"] = np.zeros(3)
    else:
        with h5py.File(path, "a") as f:
            if kind == "newer":
                f.attrs["schema"] = 99
                return
            del f["mesh/points"]
            if kind == "objects":
                f["mesh/points"] = np.array(["os.system"], dtype=h5py.string_dtype())
            elif kind == "link":
                f["mesh/points"] = h5py.ExternalLink("/etc/hostname", "/x")
            elif kind == "soft":
                f["mesh/points"] = h5py.SoftLink("/mesh/tets")
            elif kind == "elsewhere":
                f["mesh"].create_dataset(
                    "points", (64,), "u1", external=[("/etc/passwd", 0, 64)]
                )
            elif kind == "virtual":
                layout = h5py.VirtualLayout((3,), "f8")
                layout[:] = h5py.VirtualSource("/tmp/other.h5", "x", (3,))
                f["mesh"].create_virtual_dataset("points", layout)
            elif kind == "bomb":
                f["mesh"].create_dataset(
                    "points", (2**40,), "f8", chunks=(2**16,), compression="gzip"
                )


@pytest.mark.parametrize(
    "kind",
    """truncated empty text foreign newer objects link soft elsewhere virtual bomb
    missing""".split(),
)
def test_a_broken_or_foreign_file_gets_one_clear_sentence(made, tmp_path, kind):
    path = tmp_path / "00000001.h5"
    path.write_bytes(made[1].path.read_bytes())
    spoil(kind, path)
    with pytest.raises(ps.FileError, match=r"00000001\.h5") as caught:
        Plant(path)["mesh/points"]
    assert "\n" not in str(caught.value)
    if kind != "missing":  # which only a check against the schema tells
        with pytest.raises(ps.FileError, match=r"00000001\.h5"):
            store.read(path)


def test_arrays_that_make_no_mesh_are_a_sentence(made, tmp_path):
    path = tmp_path / "00000001.h5"
    path.write_bytes(made[1].path.read_bytes())
    with h5py.File(path, "a") as f:
        f["mesh/tets"][0] = 10**6
    with pytest.raises(ps.FileError, match="name vertices outside"):
        _ = Plant(path).mesh


# checks and the summary


def test_check_passes_what_is_sound_and_names_what_is_not(made, tmp_path):
    report = check_dataset(made.folder)
    assert report.sound, report.problems
    assert (report.done, report.failed, report.missing) == (5, 0, 0)
    assert report.worst_gamma >= 0.05
    folder = copied(made, tmp_path)
    files = sorted(folder.rglob("*.h5"))
    with h5py.File(files[0], "a") as f:
        f["touches/force"][0, 0, 0, 0] += 1e-9
    with h5py.File(files[1], "a") as f:
        f["material/young"][0] = np.nan
    with h5py.File(files[2], "a") as f:
        del f["touches/seen"]
        f["touches/seen"] = np.zeros((2, 2))
    files[3].unlink()
    files[4].write_bytes(files[4].read_bytes()[:5000])
    report = check_dataset(folder)
    words = "\n".join(report.problems)
    assert not report.sound
    assert report.missing == 2
    for file, what in (
        ("00000000", "digest"),
        ("00000001", "NaN"),
        ("00000002", "touches/seen"),
        ("00000004", "broken"),
        ("index.csv", "does not list"),
    ):
        assert re.search(f"{file}.*{what}", words), (file, words)


def test_spoilt_plants_are_made_again_with_the_same_numbers(recipe, made, tmp_path):
    folder = copied(made, tmp_path)
    files = sorted(folder.rglob("*.h5"))
    files[2].write_bytes(files[2].read_bytes()[:9000])
    (files[0].parent / ".00000000-half.h5").write_bytes(b"half")
    again = ps.dataset(recipe, folder, workers=1)
    assert [r["digest"] for r in again.rows] == [r["digest"] for r in made.rows]
    assert not list(files[0].parent.glob(".*"))
    assert check_dataset(folder).sound


def test_the_command_checks_and_summarises_and_says_what_is_wrong(made, tmp_path):
    pytest.importorskip("matplotlib")
    runner = CliRunner()
    folder = copied(made, tmp_path)
    good = runner.invoke(app, ["dataset", "--check", str(folder), "--summary", str(folder)])
    assert good.exit_code == 0, good.output
    assert "5 of 5 plants are there, 0 failed, 0 missing" in good.stdout
    assert (folder / "summary.html").exists()
    sorted(folder.rglob("*.h5"))[0].unlink()
    bad = runner.invoke(app, ["dataset", "--check", str(folder)])
    assert bad.exit_code == 1
    assert "4 of 5 plants are there, 0 failed, 1 missing" in bad.stdout
    example = tmp_path / "recipe.toml"
    assert runner.invoke(app, ["dataset", "--example", str(example)]).exit_code == 0
    assert ps.Recipe.read(example).plants == 200
    for options, words in (
        ([], "nothing to do"),
        ([str(example)], "both a recipe and --out"),
        (["--check", str(tmp_path)], "no data set"),
        (["--example", str(example)], "there already"),
        (["no.toml", "--out", str(folder)], "no such file"),
    ):
        refused = runner.invoke(app, ["dataset", *options])
        assert isinstance(refused.exception, ps.PlantsimError), options
        assert words in str(refused.exception)


def test_summary_is_one_page_with_its_pictures(made, tmp_path):
    pytest.importorskip("matplotlib")
    folder = copied(made, tmp_path)
    page = summarise(folder).read_text()
    assert "5 of 5" in page
    assert "maize" in page
    assert page.count("data:image/png;base64,iVBOR") == 2
    words = re.sub(r'data:image/[^"]*', "", page)  # whose base64 may spell anything
    assert "http" not in words  # whole in itself


def test_the_adapter_of_the_docs_feeds_a_training_loop(made):
    block = re.findall(
        r"^```py\n(.*?)^```", (DOCS / "datasets.md").read_text(), re.M | re.S
    )
    assert len(block) == 1
    assert len(list(filter(str.strip, block[0].splitlines()))) <= 12
    torch = types.ModuleType("torch")
    torch.utils = types.SimpleNamespace(data=types.SimpleNamespace(Dataset=object))
    torch.as_tensor = np.array
    scope = {"torch": torch}
    code = block[0].replace("import torch\n", "")
    exec(compile(code, "docs/datasets.md", "exec"), scope)
    touches = scope["Touches"](made.folder, "train")
    assert len(touches) == 3 * len(made.split("train"))
    for i in range(len(touches)):
        item = touches[i]
        assert item["touches/force"].shape == (2, 3, 3)
        assert item["touches/displacement"].shape[0] == 2
    plant = made.split("train")[0]
    np.testing.assert_array_equal(touches[1]["touches/force"], plant["touches/force"][1])


def test_the_schema_page_lists_every_array_and_column():
    page = (DOCS / "datasets.md").read_text()
    for name in (*SCHEMA, *COLUMNS):
        assert f"`{name}`" in page, name
    assert "schema 1" in page
    assert example().count("[[species]]") == len(ps.species_names())
