import numpy as np
import pytest

import plantsim as ps
from plantsim.mesh.tetmesh import gamma


def test_cube(cube):
    assert cube.volume == pytest.approx(1.0)
    assert len(cube.surface) == 12
    assert cube.pieces.max() == 0
    normals = np.cross(
        cube.points[cube.surface[:, 1]] - cube.points[cube.surface[:, 0]],
        cube.points[cube.surface[:, 2]] - cube.points[cube.surface[:, 0]],
    )
    outward = cube.points[cube.surface].mean(axis=1) - 0.5
    assert ((normals * outward).sum(axis=1) > 0).all()


def test_gamma_of_the_regular_tet_is_one_and_of_a_flat_one_zero():
    regular = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], float)
    assert abs(gamma(regular)) == pytest.approx(1)
    regular[3] = regular[:3].mean(axis=0)
    assert gamma(regular) == pytest.approx(0, abs=1e-12)


def test_gamma_of_four_corners_on_one_circle_is_zero():
    # 24 V R is the root of zero there, and was taken for a huge quality
    a = np.linspace(0, 2 * np.pi, 50)[:, None] + [0.0, 0.7, 2.3, 4.1]
    flat = np.stack([np.cos(a), np.sin(a), 0 * a], axis=-1)
    flat[:, 3, 2] = np.linspace(0, 1e-12, 50)
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    assert np.abs(gamma(flat @ turn)).max() < 1e-9


def test_order_two_has_the_same_shape_and_sets_gain_middles(cube):
    fine = cube.with_order(2)
    assert fine.order == 2
    assert not fine.curved
    assert fine.volume == pytest.approx(1.0, rel=1e-14)
    assert len(fine.points) == 8 + 19
    assert (fine.points[fine.sets["base"], 2] == 0).all()
    assert len(fine.sets["base"]) == 9
    back = fine.with_order(1)
    assert np.array_equal(back.tets, cube.tets)
    assert np.array_equal(back.points, cube.points)
    assert fine.with_order(2) is fine


def test_curved_volume_is_the_cylinder(cantilever):
    exact = np.pi * 0.02**2 * 0.3
    assert cantilever.volume == pytest.approx(exact, rel=0.01)
    assert cantilever.with_order(1).volume < 0.95 * exact


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda p, t: (p, t[:, [0, 2, 1, 3]]), "6 tets are inverted.*first ids: 0, 1"),
        (lambda p, t: (p * [1, 1, 0], t), "no volume"),
        (lambda p, t: (p, t + 1), "outside 0 to 7"),
        (lambda p, t: (p, t - 1), "outside 0 to 7"),
        (
            lambda p, t: (np.vstack([p, [9, 9, 9]]), t),
            "1 vertices are in no tet.*first ids: 8",
        ),
        (lambda p, t: (p[:, :2], t), "shape"),
        (lambda p, t: (p, t[:, :3]), "order 1 or 2"),
        (lambda p, t: (p, t[:0]), "order 1 or 2"),
        (lambda p, t: (p * np.nan, t), "NaN"),
        (lambda p, t: (p, t + 0.5), "fractional"),
    ],
)
def test_bad_meshes_are_refused(cube, change, says):
    with pytest.raises(ps.MeshError, match=says):
        ps.TetMesh(*change(cube.points, cube.tets))


def test_folded_curved_tets_are_refused(cube):
    fine = cube.with_order(2)
    points = fine.points.copy()
    points[fine.tets[0, 4]] += 3
    with pytest.raises(ps.MeshError, match="folded"):
        ps.TetMesh(points, fine.tets)


def test_bad_regions_and_sets_are_refused(cube):
    with pytest.raises(ps.MeshError, match="region"):
        cube.with_region([-1] * 6)
    with pytest.raises(ps.MeshError, match="out of range"):
        cube.with_sets(tip=[8])
    with pytest.raises(ps.MeshError, match="give 1 or 2"):
        cube.with_order(3)
