"""Parameters of a user's script, and gmsh's own tutorials."""

import importlib.metadata
from pathlib import Path

import numpy as np
import pytest

import plantsim as ps
from plantsim.solid.parameters import with_parameters

SCRIPT = """
SetFactory("OpenCASCADE");
// L = 7; in a comment
Include "sizes.inc";
DefineConstant[ R = {0.1, Min 0, Choices{0.1="thin", 0.2="thick"}, Name "In/Radius"},
  what = "stem", N = 1 ];
L = 1; T = L / 2; /* L = 9; */
L = L + 0;
If(L > 100)
  hidden = 3;
EndIf
Box(1) = {0, 0, 0, R, R, N * L};
Physical Volume(Str(what)) = {1};
Physical Surface("base") = {5};
Mesh.MeshSizeMax = coarse;
"""


@pytest.fixture
def script(tmp_path):
    (tmp_path / "sizes.inc").write_text("coarse = 0.1;\n")
    path = tmp_path / "rod.geo"
    path.write_text(SCRIPT)
    return path


def test_parameters_take_the_place_of_the_scripts_own(script):
    before = sorted(p.name for p in script.parent.iterdir())
    plain = ps.tetrahedralize(script, order=1)
    assert plain.volume == pytest.approx(0.01)
    mesh = ps.tetrahedralize(
        script, order=1, parameters={"L": 2.0, "R": 0.2, "what": "Blatt 7"}
    )
    assert mesh.volume == pytest.approx(2 * 0.2**2)
    assert mesh.region_names == ("Blatt 7",)
    assert (mesh.points[mesh.sets["base"], 2] == 0).all()
    twice = ps.tetrahedralize(script, order=1, parameters={"N": np.float64(3)})
    assert twice.volume == pytest.approx(0.03)
    assert sorted(p.name for p in script.parent.iterdir()) == before


@pytest.mark.parametrize(
    ("parameters", "says"),
    [
        ({"Q": 1.0}, "no parameter 'Q'.*R, what, N, L, T"),
        ({"hidden": "x"}, "number|no parameter"),
        ({"coarse": 1.0}, "no parameter 'coarse'"),
        ({"L": "2; SystemCall 'x'"}, "finite number|give a number"),
        ({"L": float("nan")}, "finite number"),
        ({"L": True}, "finite number"),
        ({"L": None}, "finite number"),
        ({"what": 'a"; SystemCall "touch x"; b = "'}, "without quotes"),
        ({"what": "%n%n"}, "conversion"),
        ({"what": "a\nb"}, "printable"),
        ({"what": 3}, "finite string"),
        ({'L = 1; SystemCall "x"; M': 1.0}, "no parameter"),
    ],
)
def test_parameters_are_checked(script, parameters, says):
    with pytest.raises(ps.FileError, match=says):
        ps.tetrahedralize(script, parameters=parameters)


def test_parameters_are_for_scripts(tmp_path, script):
    with pytest.raises(ps.MeshError, match="are for files"):
        ps.tetrahedralize(ps.sweep(ps.straight()), parameters={"L": 1.0})
    with pytest.raises(ps.FileError, match="only .geo"):
        step = tmp_path / "a.step"
        step.write_text("x")
        ps.tetrahedralize(step, parameters={"L": 1.0})
    assert "coarse" in (script.parent / "sizes.inc").read_text()
    assert f'"{script.parent.resolve()}/sizes.inc"' in with_parameters(script, {})


def tutorials():
    try:
        files = importlib.metadata.files("gmsh") or []
    except importlib.metadata.PackageNotFoundError:
        return {}
    found = [f.locate() for f in files if "tutorials" in f.parts and f.suffix == ".geo"]
    return {Path(str(f)).stem: Path(str(f)) for f in found if len(Path(str(f)).stem) < 4}


TUTORIALS = tutorials()
SOLID = {2, 3, 5, 13, 14, 15, 16, 18, 19, 20}  # the ones with volumes that pass the check
SAYS = {
    8: "t8.geo: the script uses System",
    9: "t9.geo: the script uses Plugin",
    21: "t21.geo: the script uses Plugin",
    4: "string over",
}


@pytest.mark.skipif(not TUTORIALS, reason="this gmsh came without its tutorials")
@pytest.mark.slow
@pytest.mark.parametrize("number", range(1, 22))
def test_gmshs_own_tutorials_mesh_or_say_why_not(number, tmp_path):
    path = TUTORIALS[f"t{number}"]
    if number not in SOLID:
        with pytest.raises(ps.PlantsimError, match=SAYS.get(number, "no tetrahedra")):
            ps.tetrahedralize(path, order=1, timeout=120)
        return
    mesh = ps.tetrahedralize(path, order=1, timeout=120)
    assert mesh.volume > 0
    back = ps.read_mesh(ps.write_mesh(mesh, tmp_path / "back.msh"))
    assert back.region_names == mesh.region_names
    assert set(back.sets) == set(mesh.sets)
    if number == 2:
        assert "My surface" in mesh.sets
    if number == 3:
        assert mesh.report["left_out"]["Prism 6"] > 0


@pytest.mark.skipif(not TUTORIALS, reason="this gmsh came without its tutorials")
def test_a_tutorial_takes_parameters():
    coarse, fine = (
        ps.tetrahedralize(TUTORIALS["t5"], order=1, parameters={"lcar1": lc})
        for lc in (0.1, 0.06)
    )
    assert len(fine.tets) > 1.5 * len(coarse.tets)
