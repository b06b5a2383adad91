"""States and surfaces in the files of other programs: what is written comes back."""

import meshio
import numpy as np
import pytest

import plantsim as ps

trimesh = pytest.importorskip("trimesh")


@pytest.fixture(scope="module", params=[1, 2])
def state(request, fork):
    mesh = fork if request.param == 2 else fork.with_order(1)
    young = np.array([6e9, 8e9, 4e9])[np.asarray(mesh.region)]
    model = ps.ElasticModel(mesh, ps.Material(young, 0.3, 900.0))
    tip = ps.nearest_vertices(mesh, mesh.points[mesh.points[:, 2].argmax()], count=4)
    return model.solve(ps.move(tip, (0.01, 0.0, -0.02)), ps.gravity())


def test_vtu_holds_the_whole_state_with_units(state, tmp_path):
    mesh = state.model.mesh
    raw = meshio.read(ps.write_state(state, tmp_path / "a.vtu"))
    assert np.array_equal(raw.points, mesh.points)
    assert np.array_equal(raw.cells[0].data, mesh.tets)
    assert np.array_equal(raw.point_data["displacement [m]"], state.displacement)
    assert np.array_equal(raw.point_data["force [N]"], state.force)
    cells = {name: values[0] for name, values in raw.cell_data.items()}
    assert np.array_equal(cells["young [Pa]"], state.model.material.young)
    assert np.array_equal(cells["stress [Pa]"].reshape(-1, 3, 3), state.stress)
    assert np.array_equal(cells["von_mises [Pa]"], state.von_mises)
    assert np.array_equal(cells["region"], mesh.region)
    back = ps.read_mesh(tmp_path / "a.vtu")
    assert np.array_equal(np.sort(back.sets["base"]), np.sort(mesh.sets["base"]))


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".stl", ".glb"])
def test_the_deformed_surface_comes_back(state, tmp_path, suffix):
    mesh = state.model.mesh
    path = ps.write_state(state, tmp_path / f"a{suffix}", scale=2.0)
    back = trimesh.load(path, force="mesh", process=False)
    bent = mesh.points + 2.0 * state.displacement
    points = np.asarray(back.vertices)
    if suffix == ".glb":  # y up by its standard
        points = points[:, [0, 2, 1]] * [1, -1, 1]
    ours = bent[mesh.triangles]
    assert points[back.faces] == pytest.approx(ours, abs=2e-7)
    back.merge_vertices()
    assert back.is_watertight
    assert back.is_winding_consistent
    a, b, c = ours.transpose(1, 0, 2)
    volume = np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6
    assert back.volume == pytest.approx(volume, rel=1e-4)
    assert volume > 0


@pytest.mark.parametrize("suffix", [".ply", ".glb"])
def test_colours_of_vertices_come_back(state, tmp_path, suffix):
    mesh = state.model.mesh
    rgb = np.random.default_rng(1).integers(0, 256, mesh.points.shape)
    path = ps.write_surface(mesh, tmp_path / f"a{suffix}", colours=rgb)
    back = trimesh.load(path, force="mesh", process=False)
    assert np.array_equal(back.visual.vertex_colors[:, :3], rgb[mesh.surface_vertices])
    with pytest.raises(ps.FileError, match="no colours"):
        ps.write_surface(mesh, tmp_path / "a.stl", colours=rgb)


def test_write_mesh_takes_surfaces_too(cube, tmp_path):
    back = trimesh.load(ps.write_mesh(cube, tmp_path / "a.stl"), force="mesh")
    assert back.volume == pytest.approx(1.0)
    with pytest.raises(ps.FileError, match="suffix"):
        ps.read_mesh(tmp_path / "a.stl")


def test_a_sequence_plays_in_vtk(cube, tmp_path):
    model = ps.ElasticModel(cube, ps.Material(1e6, 0.3))
    states = [model.solve(ps.move([7], (0.0, 0.0, -0.1 * k))) for k in range(3)]
    path = ps.write_states(states, tmp_path / "a & b.pvd", times=[0.0, 0.5, 2.0])
    pyvista = pytest.importorskip("pyvista")
    reader = pyvista.PVDReader(path)
    assert reader.time_values == [0.0, 0.5, 2.0]
    for k, t in enumerate(reader.time_values):
        reader.set_active_time_value(t)
        grid = reader.read()[0]
        assert np.array_equal(grid.points, cube.points)
        assert np.array_equal(grid["displacement [m]"], states[k].displacement)
    with pytest.raises(ps.FileError, match="ascending"):
        ps.write_states(states, tmp_path / "b.pvd", times=[0, 2, 1])
    with pytest.raises(ps.FileError, match="0 states"):
        ps.write_states([], tmp_path / "b.pvd")
