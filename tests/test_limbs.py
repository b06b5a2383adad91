"""Regions, sets and places on limbs, against limbs that are known."""

import numpy as np
import pytest

import plantsim as ps
from plantsim.plant.skeleton import Polyline


def hook():
    """A trunk with an arc on one side and a straight limb on the other."""
    trunk = Polyline([[0, 0, 0], [0, 0, 0.6], [0, 0, 1.2]], [0.04, 0.035, 0.03])
    a = np.linspace(0, np.pi / 2, 9)
    arc = np.column_stack([0.4 * np.sin(a), 0 * a, 0.5 + 0.4 * (1 - np.cos(a))])
    rod = [[0, 0, 0.8], [0, 0.25, 0.9], [0, 0.5, 1.0]]
    return ps.Skeleton.from_limbs(
        [trunk, Polyline(arc, np.full(9, 0.015), 0), Polyline(rod, [0.02, 0.018, 0.016], 0)]
    )


@pytest.fixture(scope="module")
def solid():
    return ps.sweep(hook())


@pytest.fixture(scope="module")
def mesh(solid):
    return ps.tetrahedralize(solid)


def test_sets_are_the_foot_the_tips_and_the_surface_of_each_limb(solid, mesh):
    assert set(mesh.sets) == {"base", "tips", "limb 0", "limb 1", "limb 2"}
    every = np.unique(np.concatenate([mesh.sets[f"limb {n}"] for n in "012"]))
    assert np.array_equal(every, mesh.surface_vertices)
    for i, tube in enumerate(solid.tubes):
        x = mesh.points[mesh.sets[f"limb {i}"]]
        u = np.linspace(solid.emergence[i], 1, 300)
        away = np.linalg.norm(x[:, None] - tube.axis(u)[None], axis=2) / tube.radius(u)
        # on the tube; at a joint a face may reach down its flank
        assert np.median(away.min(axis=1)) == pytest.approx(1, abs=0.02)
        assert (away.min(axis=1) < 1.02).mean() > 0.9
    tips = mesh.points[mesh.sets["tips"]]
    ends = np.array([t.axis(1.0) for t in solid.tubes])
    last = np.array([t.radii[-1] for t in solid.tubes])
    share = np.linalg.norm(tips[:, None] - ends[None], axis=2) / last
    # on the half spheres; where a curved tet would fold, middles stay a little inside
    assert np.median(share.min(axis=1)) == pytest.approx(1, abs=0.01)
    assert share.min(axis=1) == pytest.approx(1, abs=0.1)
    assert set(share.argmin(axis=1)) == {0, 1, 2}


def test_flat_tips_are_their_discs(solid):
    flat = ps.tetrahedralize(solid.with_tips("flat"), 1.2)
    x = flat.points[flat.sets["tips"]]
    off = np.array([np.abs((x - t.axis(1.0)) @ t.tangent(1.0)) for t in solid.tubes])
    assert off.min(axis=0).max() < 1e-9
    assert [int((off[i] < 1e-9).sum() >= 7) for i in range(3)] == [1, 1, 1]


@pytest.mark.parametrize("order", [1, 2])
def test_sets_survive_files_and_orders(mesh, tmp_path, order):
    mesh = mesh if order == 2 else mesh.with_order(1)
    for name in ("a.msh", "a.vtu", "a.npz", "b.msh"):
        version = "2.2" if name == "b.msh" else "4.1"
        back = ps.read_mesh(ps.write_mesh(mesh, tmp_path / name, version=version))
        assert set(back.sets) == set(mesh.sets)
        for key, ids in mesh.sets.items():
            assert np.array_equal(np.sort(back.sets[key]), np.sort(ids)), (name, key)
        assert np.array_equal(back.region, mesh.region)
        if name != "a.vtu":
            assert back.region_names == mesh.region_names


def test_sets_up_and_down_the_orders(mesh):
    again = mesh.with_order(1).with_order(2)
    for name, ids in mesh.sets.items():
        # an edge along a joint has both ends in a limb whose faces do not touch it
        assert len(again.sets[name]) == pytest.approx(len(ids), rel=0.005)
    on = np.isin(again.sets["limb 1"], again.surface_vertices)
    assert on.all()


def test_at_finds_the_place_on_the_axis(solid, mesh):
    for limb in range(3):
        tube, leaves = solid.tubes[limb], solid.emergence[limb]
        u = np.linspace(leaves, 1, 500)
        s = np.r_[0, np.cumsum(np.linalg.norm(np.diff(tube.axis(u), axis=0), axis=1))]
        ring = 1.5 * tube.radii.max() / s[-1]  # the mesh has a ring so often
        for fraction in (0.0, 0.3, 0.5, 0.8, 1.0):
            ids = mesh.at(limb, fraction)
            assert np.isin(ids, mesh.sets[f"limb {limb}"]).all()
            x = mesh.points[ids]
            near = np.linalg.norm(x[:, None] - tube.axis(u)[None], axis=2).argmin(axis=1)
            assert s[near].mean() / s[-1] == pytest.approx(fraction, abs=ring)
            assert len(ids) >= 4
    assert np.array_equal(mesh.at("0", 0), np.sort(mesh.sets["base"]))
    assert np.array_equal(mesh.at("1", 0.5), mesh.at(1, 0.5))
    assert (mesh.parents == [-1, 0, 0]).all()


def test_at_says_what_is_wrong(mesh):
    with pytest.raises(ps.MeshError, match="no limb 'x'.*0, 1, 2"):
        mesh.at("x", 0.5)
    with pytest.raises(ps.MeshError, match="no limb 7"):
        mesh.at(7, 0.5)
    with pytest.raises(ps.MeshError, match="fraction is 1.5"):
        mesh.at(0, 1.5)


def test_normals_point_away_from_the_axis(solid, mesh):
    tube = solid.tubes[2]
    ids = mesh.at(2, 0.5)
    u, _ = tube.nearest(mesh.points[ids].mean(axis=0))
    out = mesh.points[ids] - tube.axis(u)
    out -= (out @ tube.tangent(u))[:, None] * tube.tangent(u)
    out /= np.linalg.norm(out, axis=1)[:, None]
    normal = mesh.normals[np.searchsorted(mesh.surface_vertices, ids)]
    assert (normal * out).sum(axis=1).min() > 0.95


def test_size_report(solid, mesh):
    report = mesh.size_report()
    assert [row.name for row in report] == ["0", "1", "2"]
    assert sum(row.tets for row in report) == len(mesh.tets)
    for row, tube in zip(report, solid.tubes, strict=True):
        assert row.radius == pytest.approx(tube.radii.mean(), rel=0.1)
        assert row.length == pytest.approx(tube.length, rel=0.15)
        assert 0.6 < row.relative < 1.5  # sizes follow each limb's own radius
    assert len(str(report).splitlines()) == 4
    fine = ps.tetrahedralize(solid, 0.6, order=1).size_report()
    assert all(f.edge < 0.8 * r.edge for f, r in zip(fine, report, strict=True))
