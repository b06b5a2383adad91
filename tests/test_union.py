import sys

import numpy as np
import pytest
from scipy.spatial.distance import cdist

import plantsim as ps
from plantsim.elastic.analytic import cantilever_tip
from plantsim.plant.skeleton import Polyline
from plantsim.solid.crossings import crossings
from plantsim.solid.tetrahedralize import grow

for package in ("manifold3d", "mmgpy"):
    pytest.importorskip(package, reason="the extra `fast` is not installed")


def plant():
    """A bent trunk with five limbs on two levels."""
    z = np.linspace(0, 1, 7)
    trunk = np.column_stack([0.08 * z**2, 0 * z, z])
    limbs = [Polyline(trunk, np.linspace(0.04, 0.015, 7))]
    for node, way, radius in (
        (2, (0.8, 0.2, 0.5), 0.018),
        (3, (-0.6, 0.6, 0.6), 0.02),
        (5, (0.1, -0.8, 0.6), 0.012),
    ):
        steps = np.array([[0.0], [0.2], [0.4], [0.6]])
        limbs.append(
            Polyline(trunk[node] + steps * way, radius * np.array([1, 0.9, 0.7, 0.5]), 0)
        )
    for parent, way, radius in ((1, (0.2, 0.8, 0.3), 0.006), (2, (-0.8, 0, 0), 0.005)):
        start = limbs[parent].points[2]
        limbs.append(
            Polyline([start, start + 0.3 * np.array(way)], [radius, 0.6 * radius], parent)
        )
    return ps.sweep(ps.Skeleton.from_limbs(limbs))


@pytest.fixture(scope="module")
def both():
    solid = plant()
    return solid, {k: ps.tetrahedralize(solid, kernel=k) for k in ("occ", "union")}


def tips(solid, mesh):
    """Own weight, sideways: displacement of the vertex nearest to each limb's tip."""
    model = ps.ElasticModel(mesh, ps.Material(1e9, 0.3, 800.0))
    u = model.solve(ps.gravity((3.0, 0, -9.0))).displacement
    near = [np.linalg.norm(mesh.points - t.axis(1.0), axis=1).argmin() for t in solid.tubes]
    return np.linalg.norm(u[near], axis=1)


def test_the_kernels_agree(both):
    solid, meshes = both
    assert meshes["union"].volume == pytest.approx(meshes["occ"].volume, rel=0.02)
    a, b = (tips(solid, meshes[k]) for k in ("occ", "union"))
    assert np.abs(b / a - 1).max() < 0.02, b / a
    assert (b / a != 1).all()


@pytest.mark.parametrize("species", ["pepper", "quaking_aspen", "weeping_willow"])
def test_the_kernels_agree_on_plants(species):
    solid = ps.sweep(ps.weber_penn(species, rng=5).pruned(max_limbs=5))
    one, other = (ps.tetrahedralize(solid, kernel=k) for k in ("occ", "union"))
    assert other.volume == pytest.approx(one.volume, rel=0.02)
    assert tips(solid, other) == pytest.approx(tips(solid, one), rel=0.02)


def test_a_foot_among_joints_stays_flat():
    # a stalk as short as it is thick, full of joints: mmg once rounded its foot off
    solid = ps.sweep(ps.weber_penn("strawberry", rng=5000).pruned(max_limbs=6))
    mesh = ps.tetrahedralize(solid, kernel="union", order=1)
    assert len(mesh.sets["base"]) >= 7
    assert mesh.points[:, 2].min() > -1e-12
    reach = np.linalg.norm(mesh.points[mesh.sets["base"], :2], axis=1).max()
    # of order 1 rings are larger, to make up for their polygon
    assert reach == pytest.approx(grow(7, 1) * solid.tubes[0].radii[0], rel=0.01)


def test_union_mesh_is_sound(both):
    mesh = both[1]["union"]
    assert mesh.quality.min() >= 0.05
    assert mesh.pieces.max() == 0
    assert mesh.report is not None
    assert mesh.report["kernel"] == "union"
    assert mesh.report["attempts"][-1]["seconds"]["joints"] > 0
    assert np.abs(mesh.points[mesh.sets["base"], 2]).max() < 1e-5
    assert len(mesh.sets["base"]) >= 7


def test_union_labels_are_the_limbs(both):
    solid, meshes = both
    share = {}
    for name, mesh in meshes.items():
        volume = np.bincount(mesh.region, weights=mesh.volumes, minlength=6)
        share[name] = volume / volume.sum()
    assert share["union"] == pytest.approx(share["occ"], rel=0.08)
    mesh = meshes["union"]
    centre = mesh.points[mesh.tets[:, :4]].mean(axis=1)
    corner = mesh.points[mesh.tets[:, :4].ravel()]
    for i, tube in enumerate(solid.tubes):
        u = np.linspace(0.5, 1, 30)
        axis = tube.axis(u)
        d = np.linalg.norm(centre[:, None] - axis[None], axis=2)
        inside = (d < 0.8 * tube.radius(u)).any(axis=1)
        # tets with all corners clear of every other limb
        others = [t for t in solid.tubes if t is not tube]
        v = np.linspace(0, 1, 200)
        for other in others:
            far = cdist(corner, other.axis(v)) > 1.2 * other.radius(v)
            inside &= far.all(axis=1).reshape(-1, 4).all(axis=1)
        assert inside.sum() > 5
        assert (mesh.region[inside] == i).all()


def test_union_cantilever_bends_as_theory_says():
    solid = ps.sweep(ps.straight(1.0, 0.02), tips="flat")
    mesh = ps.tetrahedralize(solid, kernel="union")
    model = ps.ElasticModel(mesh, ps.Material(6e9, 0.3, 800.0))
    end = np.flatnonzero(mesh.points[:, 2] > 1 - 1e-9)
    u = model.solve(ps.force(end, (1.0, 0, 0))).displacement[end, 0].mean()
    assert u == pytest.approx(cantilever_tip(1, 0.02, 0.02, 6e9, 0.3, end_load=1), rel=0.01)


def test_union_is_repeatable_and_has_linear_tets():
    solid = ps.sweep(ps.fork(0.3, 0.02))
    a, b = (ps.tetrahedralize(solid, kernel="union", order=1) for _ in range(2))
    assert a.points.tobytes() == b.points.tobytes()
    assert a.tets.tobytes() == b.tets.tobytes()
    assert a.volume == pytest.approx(solid.volume, rel=0.03)


def test_without_the_extra_the_pip_line_is_given(monkeypatch):
    for package in ("manifold3d", "mmgpy"):
        monkeypatch.setitem(sys.modules, package, None)
        with pytest.raises(ps.DependencyError, match=r"pip install 'plantsim\[fast\]'"):
            ps.tetrahedralize(ps.sweep(ps.fork()), kernel="union")
        monkeypatch.undo()


@pytest.mark.parametrize("kernel", ["occ", "union"])
def test_ftetwild_is_the_last_rung_of_both_ladders(kernel, monkeypatch, tmp_path):
    pytest.importorskip("pytetwild")
    monkeypatch.chdir(tmp_path)
    from plantsim.solid import gmsh_model

    def broken(*_):
        raise ps.MeshError("gmsh: broken for the test")

    monkeypatch.setattr(gmsh_model, "fill", broken)
    solid = ps.sweep(ps.straight(0.3, 0.02))
    mesh = ps.tetrahedralize(solid, kernel=kernel)
    assert mesh.report is not None
    notes = mesh.report["attempts"]
    assert notes[-1]["algorithm"] == "fTetWild"
    assert not list(tmp_path.iterdir())
    assert all("broken for the test" in note["failure"] for note in notes[:-1])
    assert mesh.volume == pytest.approx(solid.volume, rel=0.05)
    assert np.abs(mesh.points[mesh.sets["base"], 2]).max() < 1e-12


def test_crossings_are_found():
    flat = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.0]])
    spike = np.array([[0.2, 0.2, -1], [0.2, 0.2, 1], [2, 2, 1.0]])
    faces = np.array([[0, 1, 2], [3, 4, 5]])
    assert crossings(np.vstack([flat, spike]), faces).all()
    assert not crossings(np.vstack([flat, spike + [0, 0, 3]]), faces).any()
    assert not crossings(np.vstack([flat, spike + [2, 0, 0]]), faces).any()
