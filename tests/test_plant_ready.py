"""What mechanics asks of a skeleton: connected, positive, bendable, clear of itself."""

import json
import os
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import plantsim as ps
from plantsim.plant.bends import worst_bend
from plantsim.plant.collisions import colliding, segment_distance
from plantsim.plant.parameters import WeberPenn
from plantsim.plant.prepare import area_conserving
from plantsim.plant.skeleton import Polyline
from plantsim.solid.sweep import Tube

approx = pytest.approx

SPECIES = ps.species_names()
seeds = st.integers(0, 2**31 - 1)
quiet = settings(
    max_examples=25, deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
models = st.builds(
    WeberPenn,
    shape=st.integers(0, 7),
    scale=st.floats(0.2, 30),
    scale_v=st.just(0.0),
    levels=st.integers(1, 3),
    ratio=st.floats(0.003, 0.06),
    ratio_power=st.floats(0, 2),
    flare=st.floats(0, 1.5),
    base_size=st.floats(0, 0.6),
    base_splits=st.integers(0, 2),
    branches=st.tuples(st.just(1), st.integers(0, 25), st.integers(0, 8), st.just(0)),
    length=st.tuples(st.just(1.0), st.floats(0.1, 0.8), st.floats(0.1, 0.8), st.just(0.0)),
    taper=st.floats(0, 3),
    down_angle=st.floats(0, 120),
    down_angle_v=st.floats(-60, 30),
    rotate=st.floats(-180, 180),
    rotate_v=st.floats(0, 90),
    seg_splits=st.floats(0, 0.3),
    split_angle=st.floats(0, 60),
    curve_res=st.integers(1, 12),
    curve=st.floats(-120, 120),
    curve_v=st.floats(-60, 200),
    attraction_up=st.floats(-3, 3),
)


def connected(plant):
    """Every node leads down to the root, and every limb starts on its parent."""
    parent = plant.parent
    assert parent[0] == -1
    assert (parent[1:] < np.arange(1, len(parent))).all()
    assert (plant.joints.distance < 1e-6 * max(plant.height, 1.0)).all()


@pytest.mark.parametrize("name", SPECIES)
def test_default_skeletons_of_every_species_are_fit_for_a_mesh(name):
    for seed in range(6):
        plant = ps.weber_penn(name, rng=seed)
        assert plant.check() == ()
        assert len(plant.limbs) <= 100
        assert (plant.radius > 0).all()
        connected(plant)
        joints = plant.joints
        thick = plant.splines.thickness(joints.interval, joints.t)
        assert (plant.radius[plant.first[joints.limb]] <= 0.9 * thick).all()
    ps.sweep(plant)  # raises where the sweep would not have it


@pytest.mark.parametrize("name", ["strawberry", "pepper"])
def test_they_really_mesh(name):
    mesh = ps.tetrahedralize(ps.sweep(ps.weber_penn(name, rng=1)), order=1)
    assert mesh.quality.min() > 0.02
    assert len(mesh.region_names) == len(ps.weber_penn(name, rng=1).limbs)


@given(model=models, seed=seeds)
@quiet
def test_whatever_the_parameters_a_ready_skeleton_passes_check(model, seed):
    plant = ps.weber_penn(model, rng=seed)
    assert plant.check() == ()
    assert (plant.radius > 0).all()
    assert len(plant.limbs) <= 100
    connected(plant)


@given(model=models, seed=seeds)
@quiet
def test_whatever_the_parameters_everything_grown_is_a_tree(model, seed):
    plant = ps.weber_penn(model, rng=seed, ready=False)
    assert (plant.radius > 0).all()
    assert np.isfinite(plant.points).all()
    # children begin where their parent is: within a chord of its axis
    joints = plant.joints
    assert (
        joints.distance <= 0.05 * plant.arc[plant.last[plant.carrier[joints.limb]]]
    ).all()
    again = ps.weber_penn(model, rng=seed, ready=False)
    assert np.array_equal(plant.points, again.points)
    assert np.array_equal(plant.radius, again.radius)


@given(seed=seeds, thin=st.floats(0.001, 0.05), most=st.integers(1, 60))
@quiet
def test_pruning_is_connected_idempotent_and_keeps_the_thickest(seed, thin, most):
    full = ps.weber_penn("apple", rng=seed, ready=False)
    plant = full.pruned(min_radius=thin, max_limbs=most)
    assert len(plant.limbs) <= most
    assert plant.radius.min() >= thin * (1 - 1e-9)
    again = plant.pruned(min_radius=thin, max_limbs=most)
    assert np.allclose(again.points, plant.points)
    for limb in plant.limbs[1:]:
        assert 0 <= limb.parent < limb.index
    flat = full.pruned(levels=2)
    assert flat.level.max() == 1


@given(seed=seeds, spacing=st.floats(0.02, 0.3))
@quiet
def test_resampling_keeps_the_axes(seed, spacing):
    plant = ps.weber_penn("apple_spindle", rng=seed, levels=2)
    fine = plant.resampled(spacing)
    assert np.diff(fine.arc)[np.diff(fine.limb) == 0].max() <= spacing * (1 + 1e-6)
    assert len(fine.limbs) == len(plant.limbs)
    connected(fine)
    close = plant.resampled(0.01)
    for a, b in zip(plant.limbs, close.limbs, strict=True):
        assert b.tip == approx(a.tip, abs=0.01)
        assert b.length == approx(a.length, rel=0.02, abs=1e-3)
    assert plant.resampled(100.0).limbs[0].points.shape == (2, 3)


@given(angle=st.floats(20, 170), radius=st.floats(0.005, 0.2), seed=st.integers(0, 10))
@quiet
def test_smoothing_bounds_the_bend_radius(angle, radius, seed):
    rng = np.random.default_rng(seed)
    step = rng.normal(size=(6, 3)) * np.radians(angle) + [0, 0, 1]
    points = np.vstack([np.zeros(3), np.cumsum(0.1 * step, axis=0)])
    rough = ps.Skeleton(points, np.full(7, radius), np.arange(-1, 6), np.zeros(7))
    smooth = rough.smoothed()
    assert worst_bend(smooth.splines).max() < 0.8
    assert smooth.points[0] == approx(points[0])
    assert smooth.points[-1] == approx(points[-1])


def test_smoothing_leaves_easy_limbs_alone():
    plant = ps.weber_penn("cherry", rng=3)
    assert np.array_equal(plant.smoothed().points, plant.points)


def test_check_curvature_is_that_of_the_sweep():
    plant = ps.weber_penn("quaking_aspen", 2, ready=False, levels=2)
    worst = worst_bend(plant.splines)
    for limb in plant.limbs[:20]:
        tube = Tube(limb.name, limb.parent, limb.points, limb.radius)
        u = np.unique(np.r_[tube.stations, tube._knots])
        assert (tube.curvature(u) * tube.radius(u)).max() == approx(
            worst[limb.index], rel=0.1
        )


def test_check_names_every_hindrance():
    tight = ps.Skeleton(
        [[0, 0, 0], [0, 0, 0.1], [0.1, 0, 0.1]], [0.08] * 3, [-1, 0, 1], [0, 0, 0]
    )
    assert "bend radius" in tight.check()[0]
    trunk, r = np.array([[0.0, 0, 0], [0, 0, 0.5], [0, 0, 1]]), [0.02] * 3

    def with_limb(points, radius):
        p = np.vstack([trunk, points])
        parent = [-1, 0, 1, 1, *range(3, 2 + len(points))]
        label = [0] * 3 + [1] * len(points)
        return ps.Skeleton(p, r + [radius] * len(points), parent, label)

    assert with_limb([[0, 0, 0.5], [0.4, 0, 0.6]], 0.01).check() == ()
    assert "off the axis" in with_limb([[0.015, 0, 0.5], [0.4, 0, 0.6]], 0.01).check()[0]
    assert "Thin it" in with_limb([[0, 0, 0.5], [0.4, 0, 0.6]], 0.0199).check()[0]
    assert "ends inside" in with_limb([[0, 0, 0.5], [0.01, 0, 0.5]], 0.005).check()[0]
    hugging = with_limb([[0, 0, 0.5], [0.01, 0, 0.95]], 0.01)
    assert "runs into limb" in " ".join(hugging.check())
    for bad in (tight, hugging):
        assert bad.ready().check() == ()


def crossing():
    p = [[0, 0, 0], [0, 0, 1], [0, 0, 0.3], [0.5, 0, 0.9], [0, 0, 0.9], [0.5, 0, 0.3]]
    return ps.Skeleton(
        p, [0.03, 0.03, 0.012, 0.012, 0.01, 0.01], [-1, 0, 0, 2, 0, 4], [0, 0, 1, 1, 2, 2]
    )


def test_collisions_are_turned_away_or_dropped():
    plant = crossing()
    assert colliding(plant).tolist() == [[1, 2]]
    assert "runs into" in plant.check()[0]
    dropped = plant.without_collisions(tries=0)
    assert len(dropped.limbs) == 2
    assert dropped.limbs[1].base_radius == 0.012  # the thinner went
    assert "dropped" in dropped.note
    turned = plant.without_collisions()
    assert len(turned.limbs) == 3
    assert turned.check() == ()
    assert turned.limbs[1].length == approx(plant.limbs[1].length)


@given(seed=st.integers(0, 10_000), many=st.integers(2, 14), tries=st.integers(0, 3))
@quiet
def test_without_collisions_clears(seed, many, tries):
    """A trunk with limbs every way, some of which cross: none does afterwards."""
    rng = np.random.default_rng(seed)
    trunk = Polyline(np.c_[np.zeros((5, 2)), np.linspace(0, 1, 5)], np.full(5, 0.03))
    limbs = [trunk]
    for _ in range(many):
        foot = np.array([0, 0, rng.uniform(0.1, 0.9)])
        way = np.array([*rng.normal(size=2), rng.uniform(-0.5, 0.5)])
        reach = rng.uniform(0.3, 0.8) * way / np.linalg.norm(way)
        middle = foot + 0.5 * reach + rng.normal(scale=0.05, size=3)
        size = np.full(3, rng.uniform(0.008, 0.02))
        limbs.append(Polyline(np.vstack([foot, middle, foot + reach]), size, 0))
    plant = ps.Skeleton.from_limbs(limbs)
    clear = plant.without_collisions(tries=tries)
    assert len(colliding(clear)) == 0
    assert not [w for w in clear.check() if "runs into" in w]
    connected(clear)
    gone = len(plant.limbs) - len(clear.limbs)
    assert (f"{gone} that ran through others dropped" in clear.note) == (gone > 0)
    if not len(colliding(plant)):
        assert clear is plant


@given(seed=st.integers(0, 10_000))
@quiet
def test_segment_distance_is_the_least_of_many(seed):
    a, b, c, d = np.random.default_rng(seed).normal(size=(4, 1, 3))
    t = np.linspace(0, 1, 60)[:, None]
    p, q = a + t * (b - a), c + t * (d - c)
    many = np.linalg.norm(p[:, None] - q[None], axis=2).min()
    got = segment_distance(a, b, c, d)[0]
    assert got <= many + 1e-12
    assert got >= many - 0.1


@given(seed=seeds, name=st.sampled_from(["cherry", "citrus_young", "quaking_aspen"]))
@settings(quiet, max_examples=8)
def test_areas_add_up_at_forks_when_asked(seed, name):
    full = ps.weber_penn(name, rng=seed, max_limbs=30)
    plant = area_conserving(full)
    assert plant.radius[0] == approx(full.radius[0])
    for limb in plant.limbs:
        here = np.flatnonzero(plant.limb == limb.index)
        loads = {int(n): 0.0 for n in here}
        for child in plant.limbs:
            foot = int(plant.parent[plant.first[child.index]])
            if foot in loads:
                loads[foot] += child.base_radius**2
        for a, b in pairwise(here):
            drop = plant.radius[a] ** 2 - plant.radius[b] ** 2
            assert drop == approx(loads[int(a)], abs=1e-9)


def test_forks_that_conserve_area_pass_check():
    assert ps.weber_penn("cherry", rng=1, forks="area").check() == ()
    with pytest.raises(ps.GeometryError, match="forks"):
        ps.weber_penn("cherry", forks="murray")


def test_note_tells_of_other_trunks():
    model = ps.species("apple").with_(branches=(3, 12, 0, 0), levels=2)
    plant = ps.weber_penn(model, rng=2)
    whole = ps.weber_penn(model, rng=2, ready=False)
    assert plant.check() == ()
    assert plant.note.startswith("1 of 3 trunks kept, the longest, with what it carries")
    assert (
        f"{len(whole.limbs) - len(plant.limbs)} of {len(whole.limbs)} limbs" in plant.note
    )
    assert plant.limbs[0].length == approx(
        max(b.length for b in whole.limbs if b.level == 0), rel=0.05
    )


def test_note_says_what_was_left_out():
    plant = ps.weber_penn("quaking_aspen", rng=7)
    full = ps.weber_penn("quaking_aspen", rng=7, ready=False)
    assert f"of {len(full.limbs)} limbs left out" in plant.note
    assert full.note == ""


def test_ready_limbs_are_those_of_the_whole_plant():
    """What is spared for speed changes no limb that stays."""
    quick = ps.weber_penn("black_tupelo", rng=2)
    slow = ps.weber_penn("black_tupelo", rng=2, ready=False).ready()
    assert [b.level for b in quick.limbs] == [b.level for b in slow.limbs]
    trunk, other = quick.limbs[0], slow.limbs[0]
    assert trunk.points == approx(other.points)


DIGESTS = """
import hashlib, plantsim as ps, numpy as np
for name in ps.species_names():
    h = hashlib.sha256()
    whole = ps.weber_penn(name, rng=5, ready=False, levels=2)
    for p in (ps.weber_penn(name, rng=11), whole):
        for x in (1e6 * p.points, 1e6 * p.radius, p.parent, p.limb, p.level):
            h.update(np.rint(x).astype("<i8").tobytes())
    print(name, h.hexdigest()[:12])
"""


def digests(**env):
    """Digests of plants, to a micrometre, made by another process."""
    run = [sys.executable, "-W", "ignore", "-c", DIGESTS]
    out = subprocess.run(
        run, capture_output=True, text=True, check=True, env={**os.environ, **env}
    )
    return dict(line.split() for line in out.stdout.splitlines())


def test_same_seed_same_skeleton_on_every_machine():
    """The digests of this machine, and as of one without vector units, are those kept."""
    kept = json.loads((Path(__file__).parent / "plant_digests.json").read_text())
    assert digests() == kept
    units = np._core._multiarray_umath  # type: ignore[attr-defined]
    known = [f for f in units.__cpu_dispatch__ if units.__cpu_features__.get(f)]
    plain = {"OPENBLAS_CORETYPE": "Prescott", "OPENBLAS_NUM_THREADS": "2"}
    assert digests(NPY_DISABLE_CPU_FEATURES=" ".join(known), **plain) == kept


def test_seeds_and_generators_are_one():
    a = ps.weber_penn("apple", rng=np.random.default_rng(11))
    assert np.array_equal(a.points, ps.weber_penn("apple", rng=11).points)
    assert not np.array_equal(a.points[:9], ps.weber_penn("apple", rng=12).points[:9])


def test_a_beaded_trunk_is_cut_at_its_first_bead():
    """Beads (taper 3) have no radius at their very start."""
    model = ps.species("quaking_aspen").with_(
        scale=1.0, scale_v=0.0, ratio=0.03, taper=(3.0,) * 4
    )
    plant = ps.weber_penn(model, rng=0, levels=1)
    assert plant.check() == ()
    assert plant.radius.min() >= 5e-4


@pytest.mark.slow
@pytest.mark.parametrize("name", SPECIES)
def test_a_thousand_seeds_pass_check(name):
    bad = [s for s in range(1000) if ps.weber_penn(name, rng=s).check()]
    assert bad == []
