"""Surfaces made Delaunay, so that HXT keeps their triangles without a search."""

import gmsh
import numpy as np
import pytest
from scipy.spatial import Delaunay, KDTree

import plantsim as ps
from plantsim.solid import gmsh_model, union
from plantsim.solid.delaunay import conforming, empty_balls, with_middles
from plantsim.solid.quality import flat_ends
from plantsim.solid.tetrahedralize import AROUND, grow


def keys(triangles, n):
    a, b, c = np.sort(np.asarray(triangles, dtype=np.int64), axis=1).T
    return (a * n + b) * n + c


def known(points, faces):
    """Mask the triangles that Qhull's tetrahedralization has."""
    tets = Delaunay(points).simplices
    sides = np.concatenate([np.delete(tets, i, axis=1) for i in range(4)])
    return np.isin(keys(faces, len(points)), keys(sides, len(points)))


def delaunay(points, faces):
    return ~np.isnan(empty_balls(points, faces, KDTree(points))[:, 3])


def volume(points, faces):
    return np.linalg.det(points[faces]).sum() / 6


@pytest.fixture(scope="module")
def surface():
    """A plant's surface as its union leaves it, all points shaken, which leaves no ties."""
    pytest.importorskip("manifold3d")
    pytest.importorskip("mmgpy")
    solid = ps.sweep(ps.weber_penn("apple", rng=4).pruned(max_limbs=25))
    factor = grow(AROUND, 2)
    skin, _ = union.unite(solid, AROUND, factor, np.zeros(len(solid.tubes)))
    skin, crossed = union.mended(solid, skin, AROUND, factor, 1)
    assert not crossed.any()
    edge = np.linalg.norm(
        skin.points[skin.faces[:, 0]] - skin.points[skin.faces[:, 1]], axis=1
    )
    noise = np.random.default_rng(0).normal(scale=1e-3 * edge.min(), size=skin.points.shape)
    flat = flat_ends(solid, skin.points)
    noise[flat, 2] = 0  # the foot is level
    return skin.points + noise, skin.faces.astype(np.int64), flat


def test_triangles_with_an_empty_ball_are_those_of_qhull(surface):
    points, faces, _ = surface
    expected = known(points, faces)
    assert 5 < (~expected).sum() < 0.01 * len(faces)
    assert np.array_equal(delaunay(points, faces), expected)


def test_a_plants_surface_is_made_delaunay(surface):
    points, faces, flat = surface
    made = conforming(points, faces, flat)
    assert made is not None
    new, ends = made
    everything = with_middles(points, ends)
    assert known(everything, new).all()
    # it is closed, all triangles facing out, with the same genus and nearly the volume
    n = len(everything)
    sides = new[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    once = np.unique(sides @ [n, 1])
    assert len(once) == len(sides) == len(np.intersect1d(once, sides @ [1, n]))
    assert len(new) - len(faces) == 2 * len(ends)
    assert volume(everything, new) == pytest.approx(volume(points, faces), rel=2e-4)
    # few are changed, and the foot is as large as it was
    assert len(ends) < 0.002 * len(points)
    assert np.isin(keys(faces, n), keys(new, n)).mean() > 0.99
    foot = [
        np.linalg.norm(np.cross(*(x[f[:, 1:]] - x[f[:, :1]]).transpose(1, 0, 2)), axis=1)[
            (x[f][:, :, 2] == 0).all(axis=1)
        ].sum()
        for x, f in ((points, faces), (everything, new))
    ]
    assert foot[0] > 0
    assert foot[1] == pytest.approx(foot[0], rel=1e-12)


def test_a_point_in_a_triangles_plane_is_in_every_ball():
    square = np.array([[0.0, 0, 0], [1, 0, 0], [1.1, 1.1, 0], [0, 1, 0], [0.5, 0.5, 1]])
    long, short = np.array([[0, 1, 2], [0, 2, 3]]), np.array([[0, 1, 3], [1, 2, 3]])
    assert not delaunay(square, long).any()
    assert delaunay(square, short).all()


def test_three_in_a_line_have_no_ball():
    points = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0]])
    faces = np.array([[0, 1, 2], [0, 1, 3], [1, 1, 3]])
    assert delaunay(points, faces).tolist() == [False, True, False]


def test_a_wrong_diagonal_is_flipped_and_a_crease_is_split():
    # a pyramid over the square, whose base has the longer diagonal
    points = np.array([[0.0, 0, 0], [1, 0, 0], [1.1, 1.1, 0], [0, 1, 0], [0.5, 0.5, 1]])
    sides = [[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]]
    faces = np.array([[0, 2, 1], [0, 3, 2], *sides])
    new, ends = conforming(points, faces, np.zeros(5, dtype=bool)) or (None, None)
    assert ends is not None
    assert len(ends) == 0
    assert set(map(frozenset, new.tolist())) == {
        frozenset(f) for f in ([0, 1, 3], [1, 2, 3], *sides)
    }


def test_an_edge_too_near_to_others_is_split():
    """A long bar between the corners of two small tetrahedra."""
    bar = np.array([[0.0, -0.3, 0], [0, 0.3, 0], [0, 0, 0.5]])
    bar = np.concatenate([bar, bar + [2, 0, 0]])
    sides = [[0, 1, 3], [1, 4, 3], [1, 2, 4], [2, 5, 4], [2, 0, 5], [0, 3, 5]]
    grain = 0.2 * np.array([[0.0, 0, 0], [1, 0.1, 0], [0, 1, 0.1], [0.1, 0, 1]])
    caps = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]
    points = np.concatenate([bar, grain + [0.9, 0.5, 0], grain + [1.1, -0.1, -0.5]])
    faces = np.array([[0, 2, 1], [3, 4, 5], *sides])
    faces = np.concatenate([faces, np.array(caps) + 6, np.array(caps) + 10])
    assert 0.3 < volume(points, faces) < 0.31
    new, ends = conforming(points, faces, np.zeros(14, dtype=bool)) or (None, None)
    assert ends is not None
    assert len(ends) > 0
    everything = with_middles(points, ends)
    assert delaunay(everything, new).all()
    assert volume(everything, new) == pytest.approx(volume(points, faces))


def test_what_leaves_no_room_is_given_up():
    """Sheets that cross are never Delaunay, however they are split."""
    a = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    both = np.concatenate([a, a + [0.1, 0.11, 0.12]])
    flat = np.zeros(8, dtype=bool)
    assert conforming(both, np.concatenate([faces, faces + 4]), flat) is None


@pytest.mark.parametrize("kernel", ["union", "occ"])
def test_a_plant_is_filled_without_recovering_triangles(kernel, monkeypatch):
    if kernel == "union":
        pytest.importorskip("manifold3d")
        pytest.importorskip("mmgpy")
    told = []
    get = gmsh.logger.get

    def noted():
        told.append(get())
        return told[-1]

    start = gmsh.logger.start

    def loudly():
        gmsh.option.setNumber("General.Verbosity", 99)
        start()

    monkeypatch.setattr(gmsh.logger, "get", noted)
    monkeypatch.setattr(gmsh.logger, "start", loudly)
    solid = ps.sweep(ps.weber_penn("apple", rng=4).pruned(max_limbs=25))
    ps.tetrahedralize(solid, kernel=kernel)
    lines = "\n".join(told[-1])
    assert "Empty mesh finished" in lines
    assert "Recovering" not in lines
    # which it does, and says, where the surface is given as it is
    monkeypatch.setattr(gmsh_model, "conforming", lambda *_: None)
    ps.tetrahedralize(solid, kernel=kernel)
    assert "Recovering" in "\n".join(told[-1])
