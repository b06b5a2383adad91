"""Skeletons to and from files: exact round trips, and bad files told by the line."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import plantsim as ps

approx = pytest.approx

SUFFIXES = (".json", ".swc", ".csv")


def same(a, b):
    assert [x.name for x in a.limbs] == [x.name for x in b.limbs]
    assert [x.level for x in a.limbs] == [x.level for x in b.limbs]
    assert np.allclose(a.points, b.points, rtol=0, atol=1e-12)
    assert np.allclose(a.radius, b.radius, rtol=1e-14, atol=0)


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("name", ["apple", "weeping_willow", "pepper"])
def test_round_trip(name, suffix, tmp_path):
    plant = ps.weber_penn(name, rng=4)
    file = ps.write_skeleton(plant, tmp_path / f"plant{suffix}")
    back = ps.read_skeleton(file)
    same(plant, back)
    again = ps.write_skeleton(back, tmp_path / f"again{suffix}")
    same(back, ps.read_skeleton(again))
    assert back.check() == ()


@given(seed=st.integers(0, 1000))
@settings(max_examples=15, deadline=None)
def test_json_and_swc_round_trips_are_bitwise(seed, tmp_path_factory):
    folder = tmp_path_factory.mktemp("files")
    plant = ps.weber_penn("citrus_young", rng=seed, ready=False)
    for suffix in (".json", ".swc"):
        back = ps.read_skeleton(ps.write_skeleton(plant, folder / f"p{suffix}"))
        assert np.array_equal(back.points, plant.points)
        assert np.array_equal(back.radius, plant.radius)
        assert np.array_equal(back.parent, plant.parent)
        assert np.array_equal(back.level, plant.level)


def test_json_keeps_the_note_and_what_hangs(tmp_path):
    plant = ps.weber_penn("apple", rng=1).with_leaves("apple").with_fruit("apple")
    back = ps.read_skeleton(ps.write_skeleton(plant, tmp_path / "a.json"))
    assert back.note == plant.note
    assert back.masses.total == approx(plant.masses.total)
    assert np.allclose(back.masses.points, plant.masses.points)


FOREIGN = """# a neuron's file, ids in no order
7 3 0 0 2.0 0.05 3
1 1 0 0 0 0.10 -1
3 3 0 0 1 0.08 1
4 3 0.5 0 1.5 0.03 3
5 3 1.0 0 1.8 0.02 4
"""


def test_foreign_swc_goes_on_to_the_thickest_child(tmp_path):
    file = tmp_path / "n.swc"
    file.write_text(FOREIGN)
    plant = ps.read_skeleton(file)
    assert len(plant.limbs) == 2
    assert plant.limbs[0].tip == approx([0, 0, 2])
    assert plant.limbs[1].points[0] == approx([0, 0, 1])  # from its parent's axis
    assert plant.limbs[1].base_radius == approx(0.03)
    assert plant.ready(min_radius=0.0).check() == ()


QSM = """radius (m), length (m), start_point,,, axis_direction,,, parent, extension, branch
0.10, 1.0, 0, 0, 0, 0, 0, 1, 0, 2, 1
0.08, 1.0, 0, 0, 1, 0, 0, 1, 1, 0, 1
0.03, 0.5, 0, 0, 1, 1, 0, 0, 1, 0, 2
"""


@pytest.mark.parametrize(
    "text",
    [
        QSM,
        "ID,parentID,startX,startY,startZ,endX,endY,endZ,radius\n"
        "10,0,0,0,0,0,0,1,0.1\n11,10,0,0,1,0,0,2,0.08\n12,10,0,0,1,0.5,0,1,0.03\n",
        "radius\tlength\tstart_x\tstart_y\tstart_z\taxis_x\taxis_y\taxis_z\tparent\n"
        "0.1\t1\t0\t0\t0\t0\t0\t1\t-1\n0.08\t1\t0\t0\t1\t0\t0\t1\t0\n"
        "0.03\t0.5\t0\t0\t1\t1\t0\t0\t0\n",
    ],
)
def test_cylinder_tables_of_other_programs(text, tmp_path):
    file = tmp_path / "q.csv"
    file.write_text(text)
    plant = ps.read_skeleton(file)
    assert [x.name for x in plant.limbs] == ["0", "1"]
    assert plant.limbs[0].length == approx(2)
    assert plant.limbs[1].tip == approx([0.5, 0, 1])
    assert plant.limbs[1].base_radius == approx(0.03)


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("a.swc", "1 1 0 0 0 0.1 -1\n2 1 0 0 x 0.1 1\n", "line 2.*expected 7 numbers"),
        ("a.swc", "1 1 0 0 0 0.1 -1\n2 1 0 0 1 0 1\n", "line 2.*more than 0"),
        ("a.swc", "1 1 0 0 0 0.1 -1\n2 1 0 0 1 0.1 9\n", "line 2: parent 9"),
        ("a.swc", "1 1 0 0 0 0.1 -1\n1 1 0 0 1 0.1 1\n", "again"),
        ("a.swc", "1 1 0 0 0 0.1 2\n2 1 0 0 1 0.1 1\n", "circle"),
        ("a.swc", "# nothing\n", "at least 2"),
        ("a.csv", "radius,length\n1,2\n", "line 1.*missing"),
        ("a.csv", QSM + "0.03, zero, 0, 0, 1, 1, 0, 0, 1, 0, 2\n", "line 5.*number"),
        ("a.csv", QSM + "0.03, 1, 0, 0, 1, 1, 0, 0, 77, 0, 2\n", "line 5: parent 77"),
        ("a.csv", QSM + "-1, 1, 0, 0, 1, 1, 0, 0, 1, 0, 2\n", "line 5: radius"),
        ("a.json", '{"format": \n "plantsim skeleton",,}', "line 2"),
        ("a.json", '{"limbs": []}', "line 1.*format"),
        ("a.json", '{"format": "plantsim skeleton", "version": 1, "limbs": []}', "limbs"),
        ("a.obj", "v 0 0 0\n", "suffix"),
    ],
)
def test_bad_files_say_where_and_what_was_expected(name, text, words, tmp_path):
    file = tmp_path / name
    file.write_text(text)
    with pytest.raises(ps.FileError, match=words):
        ps.read_skeleton(file)


def test_a_bad_limb_in_json_gives_its_line(tmp_path):
    plant = ps.fork()
    file = ps.write_skeleton(plant, tmp_path / "a.json")
    lines = file.read_text().splitlines()
    assert len(json.loads(file.read_text())["limbs"]) == 3
    lines[3] = lines[3].replace('"radius": [', '"radius": ["x", ')
    file.write_text("\n".join(lines))
    with pytest.raises(ps.FileError, match="line 4: limb 1"):
        ps.read_skeleton(file)


def test_a_failed_write_leaves_nothing(tmp_path):
    with pytest.raises(ps.FileError, match="suffix"):
        ps.write_skeleton(ps.fork(), tmp_path / "a.txt")
    with pytest.raises(ps.FileError, match="folder"):
        ps.write_skeleton(ps.fork(), tmp_path / "no" / "a.swc")
    assert list(tmp_path.iterdir()) == []
