import meshio
import numpy as np
import pytest

import plantsim as ps
from plantsim.mesh.closed import closed_surface


@pytest.fixture(scope="module")
def skin():
    mesh = ps.tetrahedralize(ps.sweep(ps.straight(0.2, 0.02), tips="flat"), order=1)
    _, faces = np.unique(mesh.surface, return_inverse=True)
    return mesh.points[mesh.surface_vertices], faces.reshape(-1, 3), mesh.volume


def write(path, points, faces):
    meshio.write(path, meshio.Mesh(points, [("triangle", faces)]))
    return path


@pytest.mark.parametrize("name", ["plant.stl", "PLANT.STL", "plant.obj", "plant.ply"])
def test_closed_surfaces_are_filled(tmp_path, skin, name):
    points, faces, volume = skin
    path = write(tmp_path / name.lower(), points, faces).rename(tmp_path / name)
    mesh = ps.tetrahedralize(path)
    assert mesh.order == 2
    assert mesh.volume == pytest.approx(volume, rel=1e-4)
    assert mesh.pieces.max() == 0
    assert (mesh.points[mesh.sets["base"], 2] < 1e-9).all()
    assert len(mesh.sets["base"]) > 7
    bent = ps.ElasticModel(mesh, ps.Material()).solve(ps.gravity((9.8, 0, 0)))
    assert bent.displacement[:, 0].max() > 0


def test_binary_stl_and_polygons(tmp_path, skin):
    points, faces, volume = skin
    path = tmp_path / "plant.stl"
    meshio.write(path, meshio.Mesh(points, [("triangle", faces)]), binary=True)
    assert ps.tetrahedralize(path, order=1).volume == pytest.approx(volume, rel=1e-4)
    box = tmp_path / "box.obj"
    corners = [(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]
    sides = ["1 2 4 3", "5 7 8 6", "1 5 6 2", "3 4 8 7", "1 3 7 5", "2 6 8 4"]
    lines = [f"v {x} {y} {z}" for x, y, z in corners] + [f"f {s}" for s in sides]
    box.write_text("# a box\n" + "\n".join(lines) + "\n")
    mesh = ps.tetrahedralize(box, order=1)
    assert mesh.volume == pytest.approx(1.0)
    assert len(mesh.sets["base"]) == 4


def test_nearly_closed_surfaces_are_mended(skin):
    points, faces, _ = skin
    rng = np.random.default_rng(0)
    soup = points[faces].reshape(-1, 3) + rng.uniform(-1e-9, 1e-9, (faces.size, 3))
    apart = np.arange(faces.size).reshape(-1, 3)
    apart[::3] = apart[::3, ::-1]  # a third of them inside out
    p, f, mended = closed_surface(soup, apart)
    assert len(p) == len(points)
    assert len(f) == len(faces)
    assert mended["turned"] > 0
    p, f, mended = closed_surface(points, np.vstack([faces[1:], faces[5:6]]))
    assert mended["holes"] == 1
    x = p[f]
    volume = np.einsum("ij,ij->i", np.cross(x[:, 0], x[:, 1]), x[:, 2]).sum() / 6
    assert volume == pytest.approx(skin[2], rel=0.02)


def test_open_surfaces_are_refused_with_their_holes(tmp_path):
    a = np.arange(40) * np.pi / 20
    ring = np.column_stack([np.cos(a), np.sin(a), 0 * a])
    points = np.vstack([ring, ring + [0, 0, 1]])
    i, j = np.arange(40), (np.arange(40) + 1) % 40
    faces = np.vstack([np.stack([i, j, i + 40], 1), np.stack([j, j + 40, i + 40], 1)])
    path = write(tmp_path / "pipe.stl", points, faces)
    with pytest.raises(ps.MeshError, match=r"pipe\.stl: the surface is open: 2 holes"):
        ps.tetrahedralize(path)
    doubled = np.vstack([faces, [[1, 40, 60]]])
    with pytest.raises(ps.MeshError, match="three triangles or more"):
        closed_surface(points, doubled)
    path = write(tmp_path / "flat.ply", points[:3], np.array([[0, 1, 2]]))
    with pytest.raises(ps.MeshError):
        ps.tetrahedralize(path)


@pytest.mark.parametrize("suffix", [".stl", ".obj", ".ply", ".STL", ".Obj"])
def test_scripts_in_the_guise_of_a_surface_are_not_run(tmp_path, suffix):
    path = tmp_path / f"plant{suffix}"
    for text in (
        'SystemCall "touch MARK";\n',
        'solid\nSystemCall "touch MARK";\n',
        'ply\nSystemCall "touch MARK";\n',
        'v 0 0 0\nSystemCall "touch MARK";\n',
        "solid\nfacet\n" + 'SystemCall "touch MARK";\n',
        "#\nv 0 0 0\nf 1 1 1\n",
    ):
        path.write_text(text.replace("MARK", str(tmp_path / "ran")))
        with pytest.raises(ps.PlantsimError):
            ps.tetrahedralize(path)
    assert not (tmp_path / "ran").exists()
