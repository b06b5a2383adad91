"""Ordinary exports of gmsh, in all their kinds, mean the same thing."""

import numpy as np
import pytest

import plantsim as ps
from plantsim.solid import gmsh_model

KINDS = [
    {"Mesh.MshFileVersion": version, "Mesh.Binary": binary, "Mesh.ElementOrder": order}
    for version in (2.2, 4.1)
    for binary in (0, 1)
    for order in (1, 2)
]


@pytest.fixture(scope="module")
def export(tmp_path_factory):
    """Two glued boxes, groups wood, leaf and both, a set base; written as told."""
    folder = tmp_path_factory.mktemp("exports")

    def write(name="a.msh", partitions=0, groups=True, **options):
        path = folder / name
        with gmsh_model.session() as gmsh:
            occ = gmsh.model.occ
            occ.fragment(
                [(3, occ.addBox(0, 0, 0, 1, 1, 1))], [(3, occ.addBox(0, 0, 1, 1, 1, 1))]
            )
            occ.synchronize()
            if groups:
                gmsh.model.addPhysicalGroup(3, [1], 5, "wood")
                gmsh.model.addPhysicalGroup(3, [2], 6, "leaf")
                gmsh.model.addPhysicalGroup(3, [1, 2], 7, "both")
                foot = gmsh.model.getEntitiesInBoundingBox(-1, -1, -0.1, 2, 2, 0.1, 2)
                gmsh.model.addPhysicalGroup(2, [foot[0][1]], 5, "base")
            for key, value in options.items():
                gmsh.option.setNumber(key, value)
            gmsh.option.setNumber("Mesh.MeshSizeMax", 0.5)
            gmsh.model.mesh.generate(3)
            if partitions:
                gmsh.model.mesh.partition(partitions)
            gmsh.write(str(path))
        return path

    return write


def check(mesh, order=1):
    assert mesh.order == order
    assert mesh.volume == pytest.approx(2.0)
    assert (mesh.points[mesh.sets["base"], 2] == 0).all()
    assert len(mesh.sets["base"]) == (mesh.points[:, 2] == 0).sum()
    assert mesh.region_names[:2] == ("wood", "leaf")
    high = mesh.points[mesh.tets[:, :4]].mean(axis=1)[:, 2] > 1
    assert (mesh.region == high).all()


@pytest.mark.parametrize("options", KINDS, ids=str)
def test_groups_that_overlap_count_once(export, options):
    check(ps.read_mesh(export(**options)), options["Mesh.ElementOrder"])


@pytest.mark.parametrize("options", KINDS, ids=str)
def test_mixed_elements_keep_the_tets_and_count_the_rest(tmp_path, options, caplog):
    path = tmp_path / "mixed.msh"
    with gmsh_model.session() as gmsh:
        occ = gmsh.model.occ
        occ.addBox(0, 0, 0, 1, 1, 1)
        foot = occ.addRectangle(5, 0, 0, 1, 1)
        made = occ.extrude([(2, foot)], 0, 0, 1, numElements=[2], recombine=True)
        occ.synchronize()
        block = next(tag for dim, tag in made if dim == 3)
        gmsh.model.addPhysicalGroup(3, [1], 5, "wood")
        gmsh.model.addPhysicalGroup(3, [block], 6, "block")
        for key, value in options.items():
            gmsh.option.setNumber(key, value)
        gmsh.option.setNumber("Mesh.MeshSizeMax", 0.5)
        gmsh.model.mesh.generate(3)
        gmsh.write(str(path))
    mesh = ps.read_mesh(path)
    assert mesh.order == options["Mesh.ElementOrder"]
    assert mesh.volume == pytest.approx(1.0)
    assert mesh.region_names[0] == "wood"
    assert (mesh.region == 0).all()
    (count,) = mesh.report["left_out"].values()
    assert count > 10
    assert "left out" in caplog.text


@pytest.mark.parametrize("binary", [0, 1])
@pytest.mark.parametrize("extra", ["Mesh.SaveAll", "Mesh.SaveParametric"])
def test_41_with_everything_saved(export, binary, extra):
    check(
        ps.read_mesh(
            export(**{"Mesh.MshFileVersion": 4.1, "Mesh.Binary": binary, extra: 1})
        )
    )


@pytest.mark.parametrize("binary", [0, 1])
def test_41_partitioned(export, binary):
    check(ps.read_mesh(export(partitions=2, **{"Mesh.Binary": binary})))


def test_22_that_lost_its_groups_says_so(export):
    path = export(**{"Mesh.MshFileVersion": 2.2, "Mesh.SaveAll": 1})
    with pytest.raises(ps.FileError, match="SaveAll"):
        ps.read_mesh(path)


def test_no_groups_at_all(export):
    mesh = ps.read_mesh(export(groups=False))
    assert mesh.region_names == ("0",)
    assert not mesh.sets


def test_tetrahedralize_means_the_same(tmp_path):
    path = tmp_path / "a.geo"
    path.write_text(
        'SetFactory("OpenCASCADE"); Box(1) = {0,0,0,1,1,1}; Box(2) = {0,0,1,1,1,1};\n'
        "BooleanFragments{ Volume{1}; Delete; }{ Volume{2}; Delete; }\n"
        'Physical Volume("wood", 5) = {1}; Physical Volume("leaf", 6) = {2};\n'
        'Physical Volume("both", 7) = {1, 2};\n'
        "b() = Surface In BoundingBox {-1, -1, -0.1, 2, 2, 0.1};\n"
        'Physical Surface("base", 5) = b();\n'
    )
    check(ps.tetrahedralize(path, order=1))


@pytest.mark.parametrize("version", ["2.2", "4.1"])
def test_equal_names_of_groups_and_sets(tmp_path, cube, version):
    mesh = cube.with_region([0, 1, 0, 1, 0, 1], ("1", "2")).with_sets(
        **{"1": [3, 4], "2": [5]}
    )
    back = ps.read_mesh(ps.write_mesh(mesh, tmp_path / "a.msh", version=version))
    assert back.region_names == ("1", "2")
    assert np.array_equal(back.region, mesh.region)
    assert np.array_equal(back.tets, mesh.tets)  # in their order, though regions alternate
    assert set(back.sets) == {"1", "2", "base"}
    assert np.array_equal(back.sets["1"], [3, 4])
    assert np.array_equal(back.sets["2"], [5])


def test_odd_names_survive_vtu(tmp_path, cube):
    mesh = cube.with_sets(**{'a"b': [1], "a<b": [2], "a&b": [3]})
    back = ps.read_mesh(ps.write_mesh(mesh, tmp_path / "a.vtu"))
    assert {k: list(v) for k, v in back.sets.items()} == {
        "base": [0, 1, 2, 3],
        'a"b': [1],
        "a<b": [2],
        "a&b": [3],
    }


def test_absurd_labels_are_refused(tmp_path, cube):
    np.savez(tmp_path / "a.npz", points=cube.points, tets=cube.tets, region=[2**40] * 6)
    with pytest.raises(ps.MeshError, match="1099511627776"):
        ps.read_mesh(tmp_path / "a.npz")


def test_repeated_tets_are_refused(cube):
    with pytest.raises(ps.MeshError, match="twice or overlap"):
        ps.TetMesh(cube.points, np.vstack([cube.tets, cube.tets]))


@pytest.mark.parametrize(
    "change",
    [
        {"tets": np.full((2, 4), 0.5)},
        {"tets": np.full((2, 4), -1)},
        {"tets": np.array([["a"] * 4])},
        {"set:base": np.array([0.5])},
        {"set:base": np.array([99])},
    ],
    ids=str,
)
def test_dropping_vertices_of_bad_arrays(tmp_path, cube, change):
    np.savez(tmp_path / "a.npz", **({"points": cube.points, "tets": cube.tets} | change))
    with pytest.raises(ps.MeshError):
        ps.read_mesh(tmp_path / "a.npz", drop_unused=True)
