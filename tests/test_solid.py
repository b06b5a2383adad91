import contextlib
import os
import threading

import numpy as np
import pytest

import plantsim as ps
from plantsim.plant.skeleton import Polyline
from plantsim.solid.geo_script import check_script


def arc(radius, thickness, angle=np.pi / 2):
    a = np.linspace(0, angle, 15)
    points = radius * np.column_stack([1 - np.cos(a), 0 * a, np.sin(a)])
    return ps.Skeleton.from_limbs([Polyline(points, np.full(15, thickness))])


def test_tube_is_the_spline_through_its_nodes():
    tube = ps.sweep(arc(1.0, 0.05), tips="flat").tubes[0]
    assert tube.length == pytest.approx(np.pi / 2, rel=1e-4)
    assert tube.volume == pytest.approx(np.pi * 0.05**2 * np.pi / 2, rel=1e-3)
    u, distance = tube.nearest(np.array([1.0, 0.0, 1.0]) * (1 - 0.5**0.5) * [1, 0, 0])
    assert 0 <= u <= 1
    assert distance > 0


def test_a_limb_thicker_than_its_bend_is_refused():
    ps.sweep(arc(0.1, 0.08))
    with pytest.raises(
        ps.GeometryError, match=r"limb 0: radius 0\.11 m.*bends.*[Tt]hin it"
    ):
        ps.sweep(arc(0.1, 0.11))


def test_the_axis_stays_by_its_nodes():
    # evenly spaced or not, a gentle limb is followed
    for spacing in (np.linspace(0, 1, 9), np.array([0, 0.02, 0.04, 0.5, 0.52, 1.0])):
        points = np.column_stack([0.1 * np.sin(2 * spacing), 0 * spacing, spacing])
        tube = ps.sweep(
            ps.Skeleton.from_limbs([Polyline(points, np.full(len(points), 0.01))])
        ).tubes[0]
        x = tube.axis(np.linspace(0, 1, 200))
        assert np.abs(x[:, 0] - 0.1 * np.sin(2 * x[:, 2])).max() < 0.005
    # a kink between two close nodes would throw a plain spline a metre out
    kink = [[0, 0, 0], [0, 0, 0.9], [0, 0.001, 0.901], [0, 0, 1]]
    try:
        tube = ps.sweep(ps.Skeleton.from_limbs([Polyline(kink, np.full(4, 5e-4))])).tubes[0]
        assert tube.length < 1.1
    except ps.GeometryError as why:
        assert "limb 0" in str(why)  # noqa: PT017
    hairpin = [[0, 0, 0], [0, 0, 1], [0.05, 0, 1], [0.05, 0, 0]]
    with pytest.raises(ps.GeometryError, match="limb 0"):
        ps.sweep(ps.Skeleton.from_limbs([Polyline(hairpin, np.full(4, 0.04))]))


def test_joints_are_checked():
    trunk = Polyline([[0, 0, 0], [0, 0, 1]], [0.05, 0.05])
    for start, radius, says in (
        (
            [0.2, 0, 0.5],
            0.02,
            r"starts 0.2 m off the axis of limb 0 .* as at \(0, 0, 0\.5\)",
        ),
        ([0, 0, 0.5], 0.06, "at most"),
    ):
        limb = Polyline([start, [1, 0, 1]], [radius, radius], 0)
        with pytest.raises(ps.GeometryError, match=says):
            ps.sweep(ps.Skeleton.from_limbs([trunk, limb]))
    stub = Polyline([[0, 0, 0.5], [0.03, 0, 0.5]], [0.02, 0.02], 0)
    with pytest.raises(ps.GeometryError, match="limb 1 never leaves its parent"):
        ps.sweep(ps.Skeleton.from_limbs([trunk, stub]))
    with pytest.raises(ps.GeometryError, match="'round' or 'flat'"):
        ps.sweep(ps.straight(), tips="sharp")  # type: ignore[arg-type]


@pytest.mark.parametrize(("lean", "joint"), [(15, 0.5), (40, 0.5), (40, 0.03), (60, 0.5)])
def test_the_foot_of_a_leaning_trunk_is_level(lean, joint):
    way = np.array([np.sin(np.radians(lean)), 0, np.cos(np.radians(lean))])
    trunk = Polyline([0 * way, way / 2, way], [0.05, 0.045, 0.04])
    start = way * joint  # low down, the joint itself is cut by the ground
    limb = Polyline([start, start + [0.1, 0.4, 0.2]], [0.02, 0.02], 0)
    solid = ps.sweep(ps.Skeleton.from_limbs([trunk, limb]))
    mesh = ps.tetrahedralize(solid)
    base = mesh.points[mesh.sets["base"]]
    if lean < 45:
        assert np.abs(base[:, 2]).max() < 1e-12
        assert mesh.points[:, 2].min() > -1e-12
        # an ellipse, longer the way the trunk leans
        long, wide = np.ptp(base[:, 0]), np.ptp(base[:, 1])
        assert long / wide == pytest.approx(1 / np.cos(np.radians(lean)), rel=0.04)
    else:
        assert np.abs(base @ way).max() < 1e-12
    assert mesh.volume == pytest.approx(solid.volume, rel=0.015)


def test_a_solid_is_changed_by_making_another():
    solid = ps.sweep(ps.fork(0.3, 0.02))
    assert solid.check() == ()
    flat = solid.with_tips("flat")
    assert [t.round_tip for t in flat.tubes] == [True, False, False]  # limb 0 carries two
    dome = 2 / 3 * np.pi * solid.tubes[1].radii[-1] ** 3
    assert solid.volume - flat.volume == pytest.approx(2 * dome)
    thin = solid.with_radius(0.5)
    assert thin.tubes[2].radii == pytest.approx(0.5 * solid.tubes[2].radii)
    one = solid.with_radius(0.5, "2")
    assert (one.tubes[1].radii == solid.tubes[1].radii).all()
    with pytest.raises(ps.GeometryError, match="limb 1 is .* Make it at most"):
        solid.with_radius(3, "1")
    with pytest.raises(ps.GeometryError, match="no limb 'x'.*0, 1, 2"):
        solid.with_radius(2, "x")
    with pytest.raises(ps.GeometryError, match="'round' or 'flat'"):
        solid.with_tips("sharp")
    bent = type(solid)((type(solid.tubes[0])("a", -1, arc(0.1, 0.11).points, [0.11] * 15),))
    assert "limb a: radius 0.11 m where it bends" in bent.check()[0]


@pytest.mark.parametrize("order", [1, 2])
def test_straight_limb_mesh(order):
    solid = ps.sweep(ps.straight(0.4, 0.02), tips="flat")
    mesh = ps.tetrahedralize(solid, order=order)
    assert mesh.order == order
    assert mesh.points[:, 2].max() == pytest.approx(0.4, abs=1e-12)
    assert mesh.points[:, 2].min() == pytest.approx(0.0, abs=1e-12)
    assert (mesh.points[mesh.sets["base"], 2] == 0).all()
    assert len(mesh.sets["base"]) == (mesh.points[:, 2] < 1e-9).sum()
    if order == 2:
        assert mesh.curved
        assert mesh.volume == pytest.approx(solid.volume, rel=0.01)


def test_round_tip_reaches_beyond_its_last_point():
    mesh = ps.tetrahedralize(ps.sweep(ps.straight(0.4, 0.02)), order=1)
    # the apex stands one radius ahead, of a radius grown to make up for the polygon
    assert 0.41 < mesh.points[:, 2].max() <= 0.422


def test_fork_regions_are_its_limbs(fork):
    skeleton = ps.fork(0.3, 0.02)
    assert fork.region_names == ("0", "1", "2")
    assert fork.pieces.max() == 0
    centre = fork.points[fork.tets[:, :4]].mean(axis=1)
    for limb in skeleton.limbs:
        way = (limb.points[1] - limb.points[0]) / limb.length
        s = (centre - limb.points[0]) @ way
        off = np.linalg.norm(centre - limb.points[0] - s[:, None] * way, axis=1)
        # well along the limb and well inside it, a tet is the limb's own
        core = (off < 0.8 * limb.base_radius) & (s > 4 * 0.02) & (s < limb.length)
        if limb.index == 0:
            core = (off < 0.02) & (centre[:, 2] < 0.28)
        assert core.sum() > 20
        assert (fork.region[core] == limb.index).all()
    assert (np.diff(fork.region) >= 0).all()


def test_fork_volume_is_the_union(fork):
    # three cylinders less what is buried; the joint's overlap is a few percent
    assert fork.volume == pytest.approx(ps.sweep(ps.fork(0.3, 0.02)).volume, rel=0.03)


def test_a_plant_meshes_soundly():
    skeleton = ps.weber_penn(rng=3, levels=2).pruned(min_radius=0.03, max_limbs=10)
    solid = ps.sweep(skeleton)
    mesh = ps.tetrahedralize(solid, 1.2)
    assert mesh.report is not None
    assert mesh.quality.min() >= 0.05
    assert mesh.pieces.max() == 0
    assert set(np.unique(mesh.region)) == set(range(len(skeleton.limbs)))
    assert mesh.volume == pytest.approx(solid.volume, rel=0.05)
    assert mesh.report["attempts"][-1]["seconds"]["fill"] > 0


def test_same_solid_same_mesh():
    a, b = (ps.tetrahedralize(ps.sweep(ps.fork()), 1.2) for _ in range(2))
    assert a.points.tobytes() == b.points.tobytes()
    assert a.tets.tobytes() == b.tets.tobytes()


def test_bad_options():
    solid = ps.sweep(ps.straight())
    for kwargs in ({"order": 3}, {"kernel": "blender"}, {"size": 0.0}, {"size": np.nan}):
        with pytest.raises(ps.MeshError):
            ps.tetrahedralize(solid, **kwargs)


def test_gmsh_is_left_as_it_was_found():
    from plantsim.solid import gmsh_model

    with gmsh_model.session(), pytest.raises(ps.MeshError, match="in use"):
        ps.tetrahedralize(ps.sweep(ps.straight()))
    assert not gmsh_model.gmsh.isInitialized()
    seen = []

    def work():
        try:
            ps.tetrahedralize(ps.sweep(ps.straight()))
        except ps.MeshError as why:
            seen.append(str(why))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert "main thread" in seen[0]
    assert not gmsh_model.gmsh.isInitialized()


GEO = """
SetFactory("OpenCASCADE");
L = 1; // length /* not a comment */
Cylinder(1) = {0, 0, 0, 0, 0, L, 0.05};
Physical Volume("stem", 7) = {1};
Physical Surface("base", 8) = {3};
Mesh.MeshSizeMax = 0.05;
"""


def test_geo_file(tmp_path):
    path = tmp_path / "plant.geo"
    path.write_text(GEO)
    mesh = ps.tetrahedralize(path)
    assert mesh.order == 2
    assert mesh.region_names == ("stem",)
    assert np.ptp(mesh.points[mesh.sets["base"], 2]) < 1e-9
    assert mesh.volume == pytest.approx(np.pi * 0.05**2, rel=0.01)
    coarse = ps.tetrahedralize(str(path), 2.0, order=1)
    assert coarse.order == 1
    assert len(coarse.tets) < len(mesh.tets)
    ps.ElasticModel(mesh, ps.Material()).solve(ps.gravity())


def test_step_file(tmp_path):
    from plantsim.solid import gmsh_model

    with gmsh_model.session() as gmsh:
        gmsh.model.occ.addBox(0, 0, 0, 1, 1, 1)
        gmsh.model.occ.synchronize()
        gmsh.write(str(tmp_path / "box.step"))
        gmsh.write(str(tmp_path / "box.brep"))
    (tmp_path / "box.brep").rename(tmp_path / "BOX.BREP")
    for name in ("box.step", "BOX.BREP"):
        mesh = ps.tetrahedralize(tmp_path / name, order=1)
        assert mesh.volume in (pytest.approx(1.0), pytest.approx(1e-9))


BAD_SCRIPTS = {
    "shell": 'SystemCall "touch MARK";',
    "old name": 'System "touch MARK";',
    "background": 'NonBlockingSystemCall "touch MARK";',
    "in a macro": 'Macro go\n SystemCall "touch MARK";\nReturn\nCall go;',
    "after a fake comment": 'a = "//"; SystemCall "touch MARK";',
    "after a quote": "a = '/*'; SystemCall 'touch MARK';",
    "onelab": 'OnelabRun("x", "touch MARK");',
    "write": 'Save "MARK";',
    "print": 'Print "MARK";',
    "printf": 'Printf("x") > "MARK";',
    "append": 'Printf("x") >> "MARK";',
    "name": 'S2N("SystemCall") "touch MARK";',
    "exit": "Exit;",
    "include": 'Include "evil.inc";',
    "merge": 'Merge "evil.inc";',
    "merge mesh": 'Merge "evil.msh";',
    "computed": 'Include StrCat("evil", ".inc");',
    "outside": 'Include "../evil.inc";',
    "long string": 'a = "' + "x" * 1100 + '"; SystemCall "touch MARK";',
    "open comment": "/* never closed",
    "nul": 'a = "\0";',
    "field": 'Field[1] = ExternalProcess; Field[1].CommandLine = "touch MARK; cat";',
    "skipped if": "If(0)\n E\" EndIf SystemCall 'touch MARK'; \"\nEndIf",
    "skipped macro": "Macro f\n R' Return SystemCall \"touch MARK\"; '\nReturn",
    "skipped comment": "If(0)\n E//'\n EndIf y='EndIf SystemCall \"touch MARK\"; ';",
    "gz": 'Merge "b`touch MARK`.gz";',
    "upper": 'Merge "evil.BREP";',
    "%s": 'Printf("%s", 1);',
    "%n": 'Printf("%n%n", 1);',
    "wide": 'a = Sprintf("%99999f", 1);',
    "computed format": 'b = "%g"; Printf(b, 1);',
    "question": 'a = GetValue("?", 1);',
    "number of a string": 'a = Str2Num("1"); b = S2N("x");',
    "hidden by a string over lines": 'a = "x\n"; SystemCall "touch MARK"; b = "\n";',
    "in a constant": 'DefineConstant[ a = {1, Name "b"} ]; System "touch MARK";',
    "after a backslash": 'a = "\\"; SystemCall "touch MARK"; b = "\\";',
    "option": 'Solver.Executable0 = "touch MARK";',
    "error file": 'General.ErrorFileName = "MARK"; Error("x") > "MARK";',
    "merge with box": 'MergeWithBoundingBox "evil.inc";',
    "open": 'Open "evil.inc";',
    "shape": 'ShapeFromFile("evil.inc");',
    "absolute": 'Include "/etc/hostname";',
    "link": 'Merge "link.inc";',
    "options of a merged file": 'Merge "mesh.msh";',
    "view": 'Save View[0] "MARK";',
    "plugin": "Plugin(NewView).Run;",
    "list from file": 'a() = ListFromFile("/etc/passwd");',
    "environment": 'a = GetEnv("HOME");',
    "cr": '// x\rSystemCall "touch MARK";',
}


@pytest.mark.parametrize("name", BAD_SCRIPTS)
def test_scripts_that_could_run_code_are_refused(tmp_path, name):
    mark = tmp_path / "ran"
    folder = tmp_path / "in"
    folder.mkdir()
    names = ("in/evil.inc", "in/evil.msh", "evil.inc", "in/evil.BREP")
    for evil in (tmp_path / name for name in names):
        evil.write_text(f'SystemCall "touch {mark}";\n')
    (folder / "link.inc").symlink_to(tmp_path / "evil.inc")
    (folder / "mesh.msh").write_text("$MeshFormat\n4.1 0 8\n$EndMeshFormat\n")
    (folder / "mesh.msh.opt").write_text(f'SystemCall "touch {mark}";\n')
    path = folder / "plant.geo"
    path.write_bytes((GEO + BAD_SCRIPTS[name].replace("MARK", str(mark)) + "\n").encode())
    with pytest.raises(ps.FileError):
        ps.tetrahedralize(path)
    assert not mark.exists()


@pytest.mark.parametrize("suffix", [".Step", ".BREP", ".Iges", ".brep", ".step"])
def test_scripts_in_the_guise_of_cad_are_not_run(tmp_path, suffix):
    path = tmp_path / f"plant{suffix}"
    path.write_text(GEO + f'SystemCall "touch {tmp_path / "ran"}";\n')
    with pytest.raises(ps.PlantsimError):
        ps.tetrahedralize(path)
    assert not (tmp_path / "ran").exists()


@pytest.mark.parametrize("suffix", [".geo", ".step", ".brep", ".STEP"])
def test_options_beside_a_file_are_not_run(tmp_path, suffix):
    # gmsh reads FILE.opt beside any file that it opens, as a script
    path = tmp_path / f"plant{suffix}"
    if suffix == ".geo":
        path.write_text(GEO)
    else:
        from plantsim.solid import gmsh_model

        made = tmp_path / f"made{suffix.lower()}"
        with gmsh_model.session() as gmsh:
            gmsh.model.occ.addBox(0, 0, 0, 1, 1, 1)
            gmsh.model.occ.synchronize()
            gmsh.write(str(made))
        made.rename(path)
    path.with_name(path.name + ".opt").write_text(
        f'SystemCall "touch {tmp_path / "ran"}";\n'
    )
    with contextlib.suppress(ps.FileError):
        ps.tetrahedralize(path, order=1)
    assert not (tmp_path / "ran").exists()
    if suffix != ".STEP":  # opened by another name, without its options
        with pytest.raises(ps.FileError, match=r"\.opt: the script uses SystemCall"):
            ps.tetrahedralize(path, order=1)


def test_a_foreign_file_cannot_write_hang_or_crash_us(tmp_path, monkeypatch):
    from plantsim.solid import foreign

    monkeypatch.setattr(
        foreign, "check_opened", lambda path: None
    )  # the second fence alone
    path = tmp_path / "plant.geo"
    path.write_text(GEO + f'Printf("x") > "{tmp_path / "written"}";\n')
    with contextlib.suppress(ps.MeshError):
        ps.tetrahedralize(path, order=1)
    assert not (tmp_path / "written").exists() or not (tmp_path / "written").stat().st_size
    path.write_text("Macro f\n Call f;\nReturn\nFor i In {1:1000000000}\n a = i;\nEndFor\n")
    with pytest.raises(ps.MeshError, match="ended|crashed"):
        ps.tetrahedralize(path, timeout=4)
    path.write_text(GEO + 'Printf("%n%n%n%n", 1);\n')
    with contextlib.suppress(ps.MeshError):
        ps.tetrahedralize(path, order=1)


def test_names_that_are_not_utf8_are_one_sentence(tmp_path):
    path = tmp_path / "plant.geo"
    path.write_bytes(GEO.replace("stem", "Bl\xfcte").encode("latin-1"))
    try:
        assert ps.tetrahedralize(path, order=1).region_names
    except ps.MeshError as why:
        assert "utf-8" in str(why)  # noqa: PT017


def test_hexahedra_are_not_dropped_silently(tmp_path):
    path = tmp_path / "plant.geo"
    box = (
        'SetFactory("OpenCASCADE"); Box(1) = {0,0,0,1,1,1}; Transfinite Curve{:} = 3;'
        "Transfinite Surface{:}; Recombine Surface{:}; Transfinite Volume{1};\n"
    )
    path.write_text(box)
    with pytest.raises(ps.MeshError, match="Hexahedron"):
        ps.tetrahedralize(path)
    path.write_text(box + "Box(2) = {5,0,0,1,1,1}; Mesh.MeshSizeMax = 0.4;\n")
    mesh = ps.tetrahedralize(path, order=1)
    assert mesh.report["left_out"] == {"Hexahedron 8": 8}
    assert mesh.volume == pytest.approx(1)
    assert mesh.points[:, 0].min() == pytest.approx(5)


def test_harmless_words_pass(tmp_path):
    (tmp_path / "part.inc").write_text("r = 0.05;\n")
    path = tmp_path / "plant.geo"
    path.write_text(
        GEO + '// SystemCall "x";\n/* Save */ a = "SystemCall"; Include "part.inc";\n'
    )
    check_script(path)


def test_trusted_scripts_run(tmp_path):
    path = tmp_path / "plant.geo"
    path.write_text(GEO + f'SystemCall "touch {tmp_path / "ran"}";\n')
    ps.tetrahedralize(path, order=1, trust=True)
    assert (tmp_path / "ran").exists()


@pytest.mark.parametrize(
    ("text", "says"),
    [("nonsense here;", "syntax|gmsh"), ("Point(1) = {0, 0, 0};", "no tetrahedra")],
)
def test_broken_geometry_is_one_sentence(tmp_path, text, says, capfd):
    path = tmp_path / "plant.geo"
    path.write_text(text)
    with pytest.raises(ps.PlantsimError, match=says):
        ps.tetrahedralize(path)
    assert capfd.readouterr().out == ""
    with pytest.raises(ps.FileError, match="no such file"):
        ps.tetrahedralize(tmp_path / "none.geo")
    with pytest.raises(ps.FileError, match="read_mesh"):
        ps.tetrahedralize(os.fspath(_touch(tmp_path / "a.msh")))


def _touch(path):
    path.write_text("x")
    return path


def test_a_thin_twig_does_not_claim_its_thick_parent():
    trunk = Polyline([[0, 0, 0], [0, 0, 1]], [0.1, 0.1])
    twig = Polyline([[0, 0, 0.5], [0.5, 0, 0.6]], [0.006, 0.006], 0)
    mesh = ps.tetrahedralize(ps.sweep(ps.Skeleton.from_limbs([trunk, twig])), order=1)
    centre = mesh.points[mesh.tets].mean(axis=1)
    inside = np.hypot(centre[:, 0], centre[:, 1]) < 0.095
    at_joint = np.linalg.norm(centre - [0.1, 0, 0.52], axis=1) < 0.02
    assert (mesh.region[inside & ~at_joint] == 0).all()
    assert (mesh.region[centre[:, 0] > 0.13] == 1).all()
