"""Meshes made bad on purpose: every guarantee has to see its own fault."""

import importlib
from dataclasses import replace

import numpy as np
import pytest

import plantsim as ps
from plantsim.mesh.topology import topology
from plantsim.solid import soundness
from plantsim.solid.soundness import check_sound

tetrahedralize = importlib.import_module("plantsim.solid.tetrahedralize")


@pytest.fixture(scope="module")
def solid():
    return ps.sweep(ps.fork(0.3, 0.02))


@pytest.fixture(scope="module")
def plain(fork):
    """The fork with straight edges, whose corners can be moved one by one."""
    return fork.with_order(1)


def grid(*cells):
    """Unit cubes at integer places, each in six tets that match their neighbours'."""
    paths = [(1, 3), (3, 2), (2, 6), (6, 4), (4, 5), (5, 1)]
    corners = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)])
    tets = [np.array(c) + corners[[0, a, b, 7]] for c in cells for a, b in paths]
    points, ids = np.unique(np.reshape(tets, (-1, 3)), axis=0, return_inverse=True)
    return ps.TetMesh(points.astype(float), ids.reshape(-1, 4))


def test_a_sound_mesh_passes(solid, fork):
    assert check_sound(solid, fork) == 0
    assert fork.report["attempts"][-1]["genus"] == 0


def test_topology_of_known_bodies():
    ball = topology(grid((0, 0, 0), (1, 0, 0)))
    assert ball.euler == (2,)
    assert ball.genus == 0
    ring = [(x, y, 0) for x in range(3) for y in range(3) if (x, y) != (1, 1)]
    assert topology(grid(*ring)).euler == (0,)
    assert topology(grid(*ring)).genus == 1
    hollow = [(x, y, z) for x in range(3) for y in range(3) for z in range(3)]
    hollow.remove((1, 1, 1))
    assert topology(grid(*hollow)).euler == (2, 2)
    apart = topology(grid((0, 0, 0), (5, 0, 0)))
    assert apart.body.max() == 1


def test_touching_along_an_edge_or_at_a_vertex_is_seen():
    edge = topology(grid((0, 0, 0), (1, 1, 0)))
    assert edge.body.max() == 1
    assert len(edge.open_edges) == 1
    vertex = topology(grid((0, 0, 0), (1, 1, 1)))
    assert len(vertex.open_edges) == 0
    assert len(vertex.pinched) == 1
    # joined elsewhere, so that only the pinch itself can tell
    path = [(0, 0, 0), (1, 0, 0), (2, 0, 0), (2, 1, 0), (2, 1, 1), (1, 1, 1)]
    pinched = topology(grid(*path))
    assert pinched.body.max() == 0
    assert len(pinched.open_edges) + len(pinched.pinched) > 0


def test_a_flat_tet_is_named(solid, plain):
    for tet in np.flatnonzero(plain.region == 2):
        a, b, c, d = plain.tets[tet]
        points = plain.points.copy()
        centre = points[[b, c, d]].mean(axis=0)
        for share in (0.5, 0.2, 0.1, 0.05, 0.02):
            points[a] = centre + share * (plain.points[a] - centre)
            try:
                bad = replace(plain, points=points)
            except ps.MeshError:
                break  # a neighbour is inverted before this one is flat
            if bad.quality.min() < 0.05:
                with pytest.raises(
                    ps.MeshError, match=r"limb \d: a tet has gamma 0\.0.*wanted"
                ):
                    check_sound(solid, bad)
                return
    pytest.fail("no flat tet was made")


def without(mesh, keep):
    used, tets = np.unique(mesh.tets[keep], return_inverse=True)
    return ps.TetMesh(
        mesh.points[used],
        tets.reshape(len(mesh.tets[keep]), -1),
        mesh.region[keep],
        {},
        mesh.region_names,
    )


def test_a_limb_that_hangs_on_nothing_is_named(solid, plain):
    centre = plain.points[plain.tets].mean(axis=1)
    limb = solid.tubes[2]
    along = (centre - limb.axis(0.0)) @ limb.tangent(0.0)
    gap = (plain.region == 2) & (along > 0.1) & (along < 0.15)
    with pytest.raises(ps.MeshError, match="limb 2: .* share no face"):
        check_sound(solid, without(plain, ~gap))


def test_a_missing_limb_is_named(solid, plain):
    with pytest.raises(ps.MeshError, match="limb 1 is not in the mesh up to its tip"):
        check_sound(solid, without(plain, plain.region != 1))


def test_a_hole_inside_is_seen(solid, plain):
    inner = ~np.isin(plain.tets, plain.surface_vertices).any(axis=1)
    fine = plain
    if not inner.any():  # a coarse mesh has no tet that is inside on all sides
        fine = ps.tetrahedralize(solid, 0.45, order=1)
        inner = ~np.isin(fine.tets, fine.surface_vertices).any(axis=1)
    keep = np.ones(len(fine.tets), dtype=bool)
    keep[np.flatnonzero(inner)[0]] = False
    with pytest.raises(ps.MeshError, match="hollow"):
        check_sound(solid, without(fine, keep))


def test_a_mesh_without_a_foot_is_refused(solid, fork):
    with pytest.raises(ps.MeshError, match="limb 0: no vertex is on the flat foot"):
        check_sound(solid, replace(fork, sets={}))


def test_a_swollen_mesh_is_seen(solid, fork):
    with pytest.raises(ps.MeshError, match=r"volume is \+1\d.* at limb"):
        check_sound(solid, replace(fork, points=fork.points * [1.06, 1.06, 1.0]))


def test_a_coarse_mesh_of_order_1_is_refused_by_size_and_order(
    solid, fork, plain, monkeypatch
):
    wide = [1.06, 1.06, 1.0]
    with pytest.raises(ps.MeshError, match="give a smaller size, or order=2"):
        check_sound(solid, replace(plain, points=plain.points * wide))
    with pytest.raises(ps.MeshError, match="Give a smaller size, or move") as curved:
        check_sound(solid, replace(fork, points=fork.points * wide))
    assert "order=2" not in str(curved.value)

    # whatever the last attempt said, what was asked for stands beside it
    monkeypatch.setattr(soundness, "VOLUME", 1e-9)
    monkeypatch.setattr(tetrahedralize, "LADDER", tetrahedralize.LADDER[:1])
    monkeypatch.setattr(tetrahedralize.wild, "installed", lambda: False)
    with pytest.raises(ps.MeshError, match=r"at order 1 and size 1\.2; .*order=2"):
        ps.tetrahedralize(solid, 1.2, order=1)


def test_folds_inversions_and_orphans_never_get_as_far(fork):
    points = fork.points.copy()
    mid = int(fork.tets[0, 4])
    points[mid] += 5 * (points[fork.tets[0, 2]] - points[mid])
    with pytest.raises(ps.MeshError, match="folded"):
        replace(fork, points=points)
    with pytest.raises(ps.MeshError, match="in no tet"):
        replace(fork, points=np.vstack([fork.points, [9, 9, 9]]))
    with pytest.raises(ps.MeshError, match="inverted"):
        replace(fork, points=fork.points * [1, 1, -1])
