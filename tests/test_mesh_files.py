import shutil
import zipfile

import meshio
import numpy as np
import pytest

import plantsim as ps
from plantsim.paths import replacing

MSH = [("4.1", True), ("4.1", False), ("2.2", True), ("2.2", False)]


@pytest.fixture
def labelled(cube):
    """The cube with two regions and sets that overlap, out of order."""
    region = (cube.points[cube.tets].mean(axis=1)[:, 0] > 0.5).astype(int)
    order = np.argsort(region, kind="stable")
    mesh = ps.TetMesh(cube.points, cube.tets[order], region[order], {}, ("left", "right"))
    return mesh.with_sets(base=[0, 1, 2, 3], corner=[3, 7], all=np.arange(8))


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize(("version", "binary"), MSH)
def test_msh_round_trip(tmp_path, labelled, order, version, binary):
    mesh = labelled.with_order(order)
    path = ps.write_mesh(mesh, tmp_path / "a.msh", version=version, binary=binary)
    back = ps.read_mesh(path)
    assert np.array_equal(back.points, mesh.points)
    assert np.array_equal(back.tets, mesh.tets)
    assert np.array_equal(back.region, mesh.region)
    assert back.region_names == mesh.region_names
    assert set(back.sets) == set(mesh.sets)
    for name, ids in mesh.sets.items():
        assert np.array_equal(np.sort(back.sets[name]), np.sort(ids))


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize(("version", "binary"), MSH)
def test_gmsh_opens_what_we_write(tmp_path, labelled, order, version, binary):
    from plantsim.solid import gmsh_model

    mesh = labelled.with_order(order)
    path = ps.write_mesh(mesh, tmp_path / "a.msh", version=version, binary=binary)
    with gmsh_model.session() as gmsh:
        gmsh.open(str(path))
        groups = {
            gmsh.model.getPhysicalName(d, t): len(
                gmsh.model.mesh.getNodesForPhysicalGroup(d, t)[0]
            )
            for d, t in gmsh.model.getPhysicalGroups()
        }
        kind = 4 if order == 1 else 11
        tets = gmsh.model.mesh.getElementsByType(kind)[0]
        volume = gmsh.model.mesh.getElementQualities(tets, "volume").sum()
    assert groups["base"] == len(mesh.sets["base"])
    assert groups["corner"] == len(mesh.sets["corner"])
    assert {"left", "right"} <= set(groups)
    assert volume == pytest.approx(1)


@pytest.mark.parametrize("order", [1, 2])
def test_npz_and_vtu_round_trips(tmp_path, labelled, order):
    mesh = labelled.with_order(order)
    for suffix in (".npz", ".vtu"):
        back = ps.read_mesh(ps.write_mesh(mesh, tmp_path / f"a{suffix}"))
        assert np.array_equal(back.points, mesh.points)
        assert np.array_equal(back.tets, mesh.tets)
        assert np.array_equal(back.region, mesh.region)
        assert np.array_equal(np.sort(back.sets["corner"]), np.sort(mesh.sets["corner"]))
        if suffix == ".npz":
            assert back.region_names == mesh.region_names


def test_vtu_keeps_data(tmp_path, cube):
    path = ps.write_mesh(
        cube,
        tmp_path / "a.vtu",
        point_data={"u": cube.points},
        cell_data={"E": np.arange(6.0)},
    )
    raw = meshio.read(path)
    assert np.array_equal(raw.point_data["u"], cube.points)
    assert np.array_equal(raw.cell_data["E"][0], np.arange(6.0))
    with pytest.raises(ps.FileError, match="one row each"):
        ps.write_mesh(cube, tmp_path / "b.vtu", point_data={"u": np.zeros(3)})
    with pytest.raises(ps.FileError, match=r"\.vtu"):
        ps.write_mesh(cube, tmp_path / "b.msh", point_data={"u": cube.points})
    assert not list(tmp_path.glob("*b.*"))


def refuse(path, says, error=ps.FileError):
    with pytest.raises(error, match=says):
        ps.read_mesh(path)


def test_a_script_in_the_guise_of_a_mesh_is_not_run(tmp_path):
    mark = tmp_path / "ran"
    path = tmp_path / "plant.msh"
    path.write_text(f'SystemCall "touch {mark}";\n')
    refuse(path, "MeshFormat.*nothing was run")
    assert not mark.exists()


def test_a_pickle_in_an_npz_is_not_loaded(tmp_path):
    class Bomb:
        def __reduce__(self):
            return (open, (str(tmp_path / "ran"), "w"))

    path = tmp_path / "plant.npz"
    np.savez(path, points=np.array([Bomb()], dtype=object), tets=np.zeros((1, 4), int))
    refuse(path, "pickle")
    assert not (tmp_path / "ran").exists()


def test_broken_and_foreign_files(tmp_path, cube, capfd):
    refuse(tmp_path / "none.msh", "no such file")
    (tmp_path / "empty.msh").touch()
    refuse(tmp_path / "empty.msh", "empty")
    refuse(tmp_path, "not a file")
    (tmp_path / "a.txt").write_text("x")
    refuse(tmp_path / "a.txt", "read_mesh takes")
    for suffix in (".npz", ".vtu"):
        (tmp_path / f"noise{suffix}").write_bytes(b"\x93noise" * 20)
        refuse(tmp_path / f"noise{suffix}", "cannot be read")
    for version, binary in MSH:
        path = ps.write_mesh(cube, tmp_path / "cut.msh", version=version, binary=binary)
        whole = path.read_bytes()
        path.write_bytes(whole[: len(whole) * 2 // 3])
        with pytest.raises((ps.FileError, ps.MeshError)):
            ps.read_mesh(path)
    (tmp_path / "new.msh").write_text("$MeshFormat\n9.9 0 8\n$EndMeshFormat\n")
    refuse(tmp_path / "new.msh", "cannot be read")
    np.savez(tmp_path / "other.npz", weights=np.zeros(3))
    refuse(tmp_path / "other.npz", "no array points nor tets.*weights")
    with zipfile.ZipFile(tmp_path / "zip.npz", "w") as z:
        z.writestr("points.npy", b"nothing")
        z.writestr("tets.npy", b"nothing")
    with pytest.raises((ps.FileError, ps.MeshError), match="zip.npz"):
        ps.read_mesh(tmp_path / "zip.npz")
    assert capfd.readouterr() == ("", "")


def test_meshes_without_tets_or_with_bad_ones(tmp_path, cube):
    surface = meshio.Mesh(cube.points, [("triangle", cube.surface)])
    meshio.write(tmp_path / "skin.msh", surface, file_format="gmsh22", binary=False)
    refuse(tmp_path / "skin.msh", "no tetrahedra in it .triangle")
    inverted = meshio.Mesh(cube.points, [("tetra", cube.tets[:, [0, 2, 1, 3]])])
    meshio.write(tmp_path / "inverted.msh", inverted, file_format="gmsh22", binary=False)
    refuse(tmp_path / "inverted.msh", r"inverted\.msh: 6 tets", ps.MeshError)
    loose = meshio.Mesh(np.vstack([cube.points, [5, 5, 5]]), [("tetra", cube.tets)])
    meshio.write(tmp_path / "loose.msh", loose, file_format="gmsh22", binary=False)
    refuse(tmp_path / "loose.msh", "1 vertices are in no tet", ps.MeshError)
    assert len(ps.read_mesh(tmp_path / "loose.msh", drop_unused=True).points) == 8
    mixed = meshio.Mesh(
        cube.with_order(2).points,
        [("tetra", cube.tets), ("tetra10", cube.with_order(2).tets)],
    )
    meshio.write(tmp_path / "mixed.msh", mixed, file_format="gmsh22", binary=False)
    refuse(tmp_path / "mixed.msh", "mixed")


def test_unnamed_groups_get_their_numbers(tmp_path, cube):
    tags = np.array([7, 7, 7, 9, 9, 9])
    mesh = meshio.Mesh(
        cube.points,
        [("tetra", cube.tets), ("triangle", cube.surface[:2])],
        cell_data={
            "gmsh:physical": [tags, np.array([4, 4])],
            "gmsh:geometrical": [tags, np.array([4, 4])],
        },
    )
    meshio.write(tmp_path / "a.msh", mesh, file_format="gmsh22", binary=False)
    back = ps.read_mesh(tmp_path / "a.msh")
    assert back.region_names == ("7", "9")
    assert np.array_equal(np.sort(back.sets["surface 4"]), np.unique(cube.surface[:2]))


def test_writing_is_all_or_nothing(tmp_path, cube):
    path = ps.write_mesh(cube, tmp_path / "a.npz")
    before = path.read_bytes()
    with pytest.raises(RuntimeError), replacing(path) as temporary:
        temporary.write_text("half")
        raise RuntimeError
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["a.npz"]
    with pytest.raises(ps.FileError, match="does not exist"):
        ps.write_mesh(cube, tmp_path / "no" / "a.msh")
    with pytest.raises(ps.FileError, match="suffix"):
        ps.write_mesh(cube, tmp_path / "a.xyz")
    with pytest.raises(ps.FileError, match="version"):
        ps.write_mesh(cube, tmp_path / "a.msh", version="4.0")  # type: ignore[arg-type]


def test_reference_npz_is_read(reference, tmp_path):
    shutil.copy(reference / "test_tree_03.npz", tmp_path / "tree.npz")
    assert len(ps.read_mesh(tmp_path / "tree.npz").tets) == 7584
