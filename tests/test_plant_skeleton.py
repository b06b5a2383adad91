import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import plantsim as ps
from plantsim.plant.skeleton import Polyline


def test_straight_and_tapered_are_what_they_say():
    limb = ps.tapered(2.0, 0.03, 0.01, direction=(1, 0, 1)).limbs[0]
    assert limb.length == pytest.approx(2.0)
    assert (limb.base_radius, limb.tip_radius) == (0.03, 0.01)
    assert limb.tip == pytest.approx(np.array([1, 0, 1]) * 2**0.5)


def test_fork_conserves_area_and_names_its_limbs():
    skeleton = ps.fork(1.0, 0.02, branches=3)
    trunk, *branches = skeleton.limbs
    assert sum(b.base_radius**2 for b in branches) == pytest.approx(trunk.base_radius**2)
    assert [limb.name for limb in skeleton.limbs] == ["0", "1", "2", "3"]
    assert all(b.parent == 0 and b.level == 1 for b in branches)
    assert all(b.points[0] == pytest.approx(trunk.tip) for b in branches)


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: ps.straight(0, 0.1), "length is 0"),
        (lambda: ps.straight(1, float("nan")), "radius is nan"),
        (lambda: ps.straight(direction=(0, 0, 0)), "direction"),
        (lambda: ps.fork(branches=0), "at least one"),
        (lambda: ps.fork(branch_radius=0.02), "at most"),
        (
            lambda: ps.Skeleton([[0, 0, 0], [0, 0, 1]], [1, 0], [-1, 0], [0, 0]),
            "no positive",
        ),
        (
            lambda: ps.Skeleton([[0, 0, 0], [0, 0, 1]], [1, 1], [-1, 1], [0, 0]),
            "earlier node",
        ),
        (lambda: ps.Skeleton([[0, 0, 0], [0, 0, 0]], [1, 1], [-1, 0], [0, 0]), "coincide"),
        (lambda: ps.Skeleton([[0, 0, 0], [0, 0, np.nan]], [1, 1], [-1, 0], [0, 0]), "NaN"),
        (lambda: ps.Skeleton([[0, 0, 0], [0, 0, 1]], [1, 1], [-1, 0], [0, 2]), "labels"),
        (lambda: ps.Skeleton.from_limbs([]), "no limbs"),
        (lambda: ps.Skeleton.from_limbs([Polyline(np.eye(3), np.ones(3), 3)]), "parent"),
        (lambda: ps.straight().pruned(min_radius=1.0), "nothing of the trunk"),
        (lambda: ps.weber_penn("triffid"), "quaking_aspen"),
        (lambda: ps.weber_penn(rng=-1), "rng is -1"),
        (lambda: ps.weber_penn(rng=None), "rng is None"),  # type: ignore[arg-type]
    ],
)
def test_bad_skeletons_are_refused_with_a_reason(make, says):
    with pytest.raises(ps.PlantsimError, match=says):
        make()


def test_values_are_frozen():
    skeleton = ps.straight()
    with pytest.raises(ValueError, match="read-only"):
        skeleton.points[0] = 1
    with pytest.raises(AttributeError):
        skeleton.radius = None  # type: ignore[misc]


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.005, 0.1), st.integers(1, 60))
def test_pruned_is_a_connected_tree_within_its_limits(seed, share, most):
    skeleton = ps.weber_penn(rng=seed, levels=2)
    limit = share * skeleton.radius.max()
    pruned = skeleton.pruned(min_radius=limit, max_limbs=most)
    assert len(pruned.limbs) <= most
    assert pruned.radius.min() >= limit * (1 - 1e-12)
    assert (pruned.parent < np.arange(len(pruned.points))).all()
    for limb in pruned.limbs[1:]:  # every limb still starts on its parent
        from plantsim.plant.skeleton import nearest_on_polyline

        parent = pruned.limbs[limb.parent]
        node, arc = nearest_on_polyline(parent.points, limb.points[0])
        assert 0 <= arc <= parent.length * (1 + 1e-9)
        assert node < len(parent.points)


def test_same_seed_same_tree_other_seed_other_tree():
    a, b, c = (ps.weber_penn(rng=seed, levels=2) for seed in (3, 3, 4))
    assert a.points.tobytes() == b.points.tobytes()
    assert a.points.shape != c.points.shape or not np.array_equal(a.points, c.points)


def test_scaled_scales_everything():
    a = ps.fork()
    b = a.scaled(3.0)
    assert b.length == pytest.approx(3 * a.length)
    assert b.radius == pytest.approx(3 * a.radius)
