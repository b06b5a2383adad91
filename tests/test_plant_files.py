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


STICK = "1 5 0 0 0 1 -1\n2 5 0 0 1 1 1\n3 5 0 0 2 1 2\n"
QSM = """radius (m), length (m), start_point,,, axis_direction,,, parent, extension, branch
0.10, 1.0, 0, 0, 0, 0, 0, 1, 0, 2, 1
0.08, 1.0, 0, 0, 1, 0, 0, 1, 1, 0, 1
0.03, 0.5, 0, 0, 1, 1, 0, 0, 1, 0, 2
"""


# the headings that the programs write, over the same little tree of three cylinders
TREEQSM = (  # save_model_text.m 1.1.0: thirteen headings over seventeen columns
    "radius (m)\tlength (m)\tstart_point\taxis_direction\tparent\textension\tbranch\t"
    "branch_order\tposition_in_branch\tmad\tSurfCov\tadded\tUnmodRadius (m)\n"
    "0.1\t1\t0\t0\t0\t0\t0\t1\t0\t2\t1\t0\t1\t0.01\t0.9\t0\t0.1\n"
    "0.08\t1\t0\t0\t1\t0\t0\t1\t1\t0\t1\t0\t2\t0.01\t0.9\t0\t0.08\n"
    "0.03\t0.5\t0\t0\t1\t1\t0\t0\t1\t0\t2\t1\t1\t0.01\t0.9\t0\t0.03\n"
)
TREEQSM_BARE = (  # before: no headings
    "0.1\t1\t0\t0\t0\t0\t0\t1\t0\t2\t1\t0\t1\t0\t0.1\n"
    "0.03\t1\t0\t0\t1\t0\t0\t1\t1\t0\t1\t0\t2\t0\t0.03\n"
    "0.03\t0.5\t0\t0\t1\t1\t0\t0\t1\t0\t2\t1\t1\t0\t0.03\n"
)
SIMPLEFOREST = (  # and CanoPyHydro, the companion of pyQSM
    "type, ID, parentID, startX, startY, startZ, endX, endY, endZ, radius, volume, "
    "growthVolume, length, growthLength, FittingType,segmentID, parentSegmentID, "
    "segmentMedianRadius, segmentGrowthVolume, segmentGrowthLength, branchOrder, "
    "reverseBranchOrder, reversePipeRadiusBranchorder, reversePipeAreaBranchorder, "
    "branchID, treeID, treeSpecies, translateX, translateY, translatez, gvA, gvB, gvC, "
    "glA, glB, glC\n"
    + "".join(
        f"cylinder,{i},{p},{x},{r},1,1,1,1, MEDIAN,{s},-1,1,1,1,{b},2,3,4,{b},0, none,0,0,0"
        ",1,1,0,1,1,0\n"
        for i, p, x, r, s, b in (
            (0, -1, "0,0,0,0,0,1", 0.1, 0, 0),
            (1, 0, "0,0,1,0,0,2", 0.08, 0, 0),
            (2, 0, "0,0,1,0.5,0,1", 0.03, 1, 1),
        )
    )
)
ARCHI = (  # aRchi and tReeTraits
    "startX,startY,startZ,endX,endY,endZ,cyl_ID,parent_ID,extension_ID,radius_cyl,length,"
    "volume,axis_ID,segment_ID,node_ID,branching_order\n"
    "0,0,0,0,0,1,1,0,2,0.1,1,1,1,1,0,0\n0,0,1,0,0,2,2,1,0,0.08,1,1,1,1,0,0\n"
    "0,0,1,0.5,0,1,3,1,0,0.03,0.5,1,2,3,1,1\n"
)
RTWIG = (  # TreeQSM's structure as a table of R: start.x, BranchOrder
    '"radius","length","start.x","start.y","start.z","axis.x","axis.y","axis.z","parent",'
    '"extension","added","UnmodRadius","branch","BranchOrder","PositionInBranch"\n'
    "0.1,1,0,0,0,0,0,1,0,2,0,0.1,1,0,1\n0.08,1,0,0,1,0,0,1,1,0,0,0.08,1,0,2\n"
    "0.03,0.5,0,0,1,1,0,0,1,0,0,0.03,2,1,1\n"
)


@pytest.mark.parametrize(
    "text",
    [
        QSM,
        TREEQSM,
        TREEQSM_BARE,
        TREEQSM_BARE.replace("\t", "   "),
        SIMPLEFOREST,
        ARCHI,
        RTWIG,
        "\ufeff" + QSM.replace(",", ";"),
        "ID,parentID,startX,startY,startZ,endX,endY,endZ,radius\n"
        "10,0,0,0,0,0,0,1,0.1\n11,10,0,0,1,0,0,2,0.08\n12,10,0,0,1,0.5,0,1,0.03\n",
        "radius\tlength\tstart_x\tstart_y\tstart_z\taxis_x\taxis_y\taxis_z\tparent\n"
        "0.1\t1\t0\t0\t0\t0\t0\t1\t-1\n0.08\t1\t0\t0\t1\t0\t0\t1\t0\n"
        "0.03\t0.5\t0\t0\t1\t1\t0\t0\t0\n",
    ],
)
def test_cylinder_tables_of_other_programs(text, tmp_path):
    file = tmp_path / ("q.txt" if "\t" in text else "q.csv")
    file.write_text(text, encoding="utf-8")
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
        ("a.swc", "1,1,0,0,0,0.1,-1\n", "line 1.*expected 7 numbers"),
        ("a.swc", "1 1 0 0 0 1 -1\n2 1 0 0 0 1 1\n", "two nodes apart"),
        ("a.swc", "# limbs start at: 1 99\n" + STICK, "line 1: '99'"),
        ("a.swc", "# limbs start at: 1 2\n" + STICK, "line 1.*of two and more"),
        ("a.csv", QSM + "0.03, 1, 0, 0, 1, 1, 0, 0, 1.5, 0, 2\n", "line 5.*whole number"),
        ("a.csv", QSM + "0.03, 1, 0, 0\n", "line 5.*nothing.*number"),
        ("a.csv", QSM + "0.03, 0, 0, 0, 1, 1, 0, 0, 1, 0, 2\n", "line 5: length 0"),
        ("a.csv", QSM.split("\n", 1)[0], "no cylinders"),
        ("a.csv", ARCHI + ARCHI.splitlines()[3], "line 5: id 3 is that of line 4"),
        ("a.csv", ARCHI.replace("0,0,1,0,0,2,2", "0,0,1,0,0,1,2"), "line 3: starts where"),
        ("a.csv", ARCHI.replace("0,0,0,0,0,1,1,0", "0,0,0,0,0,1,1,2"), "line 2.*circle"),
        ("a.txt", "one two\n", "line 1.*missing"),
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


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('"radius": [', '"radius": ["x", ', "expected points"),
        ('"radius": [0', '"radius": [-0', "radius 0 is -0.*more than 0 m"),
        ('"radius": [0', '"radius": [NaN, 0', r"expected \(k, 3\)"),
        ('"joint": 1', '"joint": 77', "joint 77; expected -1"),
        ('"joint": 1', '"joint": 1.5', "joint 1.5; expected a whole"),
        ('"level": 1', '"level": "a"', "level 'a'; expected a whole"),
        ('"points": [[0.0,', '"points": [[NaN,', "point 0 is .*finite"),
        ('"points"', '"pints"', "no points; expected"),
    ],
)
def test_a_bad_limb_in_json_gives_its_line(old, new, words, tmp_path):
    file = ps.write_skeleton(ps.fork(), tmp_path / "a.json")
    lines = file.read_text().splitlines()
    assert len(json.loads(file.read_text())["limbs"]) == 3
    assert old in lines[3]
    lines[3] = lines[3].replace(old, new)
    file.write_text("\n".join(lines))
    with pytest.raises(ps.FileError, match=f"line 4: limb 1: .*{words}"):
        ps.read_skeleton(file)


def test_hung_that_fits_no_limb_gives_its_line(tmp_path):
    plant = ps.fork().with_fruit(count=1, mass=0.1)
    file = ps.write_skeleton(plant, tmp_path / "a.json")
    text = file.read_text()
    assert '"mass": [0.1]' in text
    file.write_text(text.replace('"mass": [0.1]', '"mass": []'))
    with pytest.raises(ps.FileError, match="line 7: hung: .*expected limb"):
        ps.read_skeleton(file)
    file.write_text(text[: len(text) // 2])
    with pytest.raises(ps.FileError, match="line 4: not JSON"):
        ps.read_skeleton(file)


def test_lone_nodes_are_told(tmp_path):
    file = tmp_path / "a.swc"
    file.write_text("\ufeff" + STICK + "9 1 1 0 0 0.1 -1\n", encoding="utf-8")
    assert ps.read_skeleton(file).note == "1 lone nodes left out"


def test_a_failed_write_leaves_nothing(tmp_path):
    with pytest.raises(ps.FileError, match="suffix"):
        ps.write_skeleton(ps.fork(), tmp_path / "a.txt")
    with pytest.raises(ps.FileError, match="folder"):
        ps.write_skeleton(ps.fork(), tmp_path / "no" / "a.swc")
    assert list(tmp_path.iterdir()) == []
