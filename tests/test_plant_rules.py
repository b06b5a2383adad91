"""Rules of the tree model one by one: those that few species use, and tree-gen's own."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import plantsim as ps
from plantsim.plant.parameters import WeberPenn
from plantsim.plant.profile import radius_at, shape_ratio

approx = pytest.approx

TRUNK = {"scale": 10.0, "scale_v": 0.0, "flare": 0.0, "curve": 0.0, "curve_v": 0.0}
TRUNK |= {"attraction_up": 0.0}
TWO = {**TRUNK, "levels": 2, "branches": (1, 24, 0, 0), "base_size": 0.2}


def grow(seed=1, **values):
    return ps.weber_penn(WeberPenn(**values), seed, ready=False)


def ways(plant, level=1):
    """First directions of the limbs of a level, unit vectors."""
    rows = [b.points[1] - b.points[0] for b in plant.limbs if b.level == level]
    return np.array(rows) / np.linalg.norm(rows, axis=1)[:, None]


def offsets(plant):
    """Heights of the branches' feet over the trunk's length."""
    return np.array([b.points[0, 2] for b in plant.limbs[1:]]) / plant.limbs[0].length


# ---------------------------------------------------------------- lengths and counts


@pytest.mark.parametrize("shape", range(9))
def test_branches_have_the_length_of_the_crown_profile(shape):
    """len = len_p * cmax * S((len_p - off) / (len_p - base))."""
    m = WeberPenn(**TWO, shape=shape, length=(1, 0.3, 0, 0), rules="published")
    plant = ps.weber_penn(m, 2, ready=False)
    q = (1 - offsets(plant)) / (1 - 0.2)
    want = 10 * 0.3 * shape_ratio(shape, q, m)
    got = np.array([b.length for b in plant.limbs[1:]])
    assert got == approx(want[want > 1e-4], rel=1e-6)
    assert len(got) >= 22  # nBranches, on the crown alone


@pytest.mark.parametrize(("rules", "share"), [("published", 0.6), ("tree-gen", 0.7)])
def test_twigs_shorten_along_their_branch(rules, share):
    """len = cmax (len_p - 0.6 off); 0.7 by tree-gen."""
    plant = grow(
        **TRUNK, levels=3, branches=(1, 8, 12, 0), length=(1, 0.4, 0.5, 0), rules=rules
    )
    for twig in plant.limbs:
        if twig.level == 2:
            branch = plant.limbs[twig.parent]
            off = np.linalg.norm(twig.points[0] - branch.points[0])
            assert twig.length == approx(0.5 * (branch.length - share * off), rel=1e-6)


def test_branches_carry_children_by_their_length():
    """nBranches (0.2 + 0.8 (len / len_p) / cmax) for the children of branches."""
    plant = grow(
        **TRUNK, levels=3, shape=0, branches=(1, 20, 40, 0), length=(1, 0.4, 0.3, 0)
    )
    born = np.bincount([b.parent for b in plant.limbs if b.level == 2], minlength=21)
    for branch in plant.limbs[1:21]:
        want = 40 * (0.2 + 0.8 * branch.length / 10 / 0.4)
        assert abs(born[branch.index] - want) <= 1


def test_the_deepest_carry_fewer_towards_the_tip():
    """nBranches (1 - 0.5 off / len_p) for the children of twigs and deeper."""
    plant = grow(
        **TRUNK, levels=4, branches=(1, 4, 10, 20), length=(1, 0.4, 0.5, 0.3), shape=3
    )
    born = np.bincount([b.parent for b in plant.limbs if b.level == 3])
    for twig in plant.limbs:
        if twig.level == 2:
            branch = plant.limbs[twig.parent]
            off = np.linalg.norm(twig.points[0] - branch.points[0])
            assert abs(born[twig.index] - 20 * (1 - 0.5 * off / branch.length)) <= 1


def test_bare_feet_by_level_are_tree_gens():
    plant = grow(**{**TWO, "base_size": (0.2, 0.4, 0, 0), "levels": 3,
                    "branches": (1, 10, 30, 0)}, length=(1, 0.5, 0.2, 0))  # fmt: skip
    assert offsets(plant)[:9].min() > 0.2
    for twig in plant.limbs:
        if twig.level == 2:
            branch = plant.limbs[twig.parent]
            assert np.linalg.norm(twig.points[0] - branch.points[0]) > 0.4 * branch.length
    counts = [len(grow(s, **{**TWO, "base_size": (0.2,) * 4}).limbs) - 1 for s in range(60)]
    # nBranches U(0.9, 1.1) over the whole stem, of which 0.8 is left
    assert np.mean(counts) == approx(24, rel=0.06)
    assert np.std(counts) > 0.5


def test_a_fan_stands_at_the_tip():
    plant = grow(**{**TWO, "branches": (1, -6, 0, 0), "base_size": 0.0}, shape=3,
                 rotate=100, rotate_v=0, down_angle=0, down_angle_v=0,
                 rules="published")  # fmt: skip
    assert len(plant.limbs) == 7
    tips = np.array([b.points[0] for b in plant.limbs[1:]])
    assert tips == approx(np.tile([0, 0, 10.0], (6, 1)))
    w = ways(plant)
    spread = np.degrees(np.arccos(np.clip(w @ w.T, -1, 1)))
    assert spread.max() == approx(100, abs=1e-6)
    assert np.linalg.matrix_rank(w, tol=1e-6) == 2  # in one plane


def test_no_trunks_stand_for_one_and_trunks_have_sizes_of_their_own():
    assert len(grow(**TRUNK, levels=1, branches=(0, 5, 0, 0)).limbs) == 1
    clump = grow(levels=1, scale=10, scale_v=3, branches=(4, 0, 0, 0), curve_v=0)
    assert len({round(b.length, 6) for b in clump.limbs}) == 4


# ---------------------------------------------------------------- angles


def test_down_angle_may_change_along_the_parent():
    """D + V (1 - 2 S(conical, q)) for V < 0."""
    values = {**TWO, "down_angle": 60, "down_angle_v": -50, "rules": "published"}
    plant = grow(**values)
    angle = np.degrees(np.arccos(ways(plant)[:, 2]))
    q = (1 - offsets(plant)) / 0.8
    assert angle == approx(60 - 50 * (1 - 2 * shape_ratio(0, q)), abs=1e-5)
    loose = np.degrees(np.arccos(ways(grow(**{**values, "rules": "tree-gen"}))[:, 2]))
    assert 0 < np.abs(loose - angle[: len(loose)]).max() < 30


def test_rotation_turns_on_by_its_angle():
    w = ways(grow(**TWO, rotate=140, rotate_v=0, down_angle=90, down_angle_v=0))
    azimuth = np.degrees(np.unwrap(np.arctan2(w[:, 1], w[:, 0])))
    step = np.abs((np.diff(azimuth) + 180) % 360 - 180)
    assert step == approx(140)


@pytest.mark.parametrize(("dist", "each"), [(1, {2}), (3, {4}), (3.5, {4, 5})])
def test_pairs_and_whorls_stand_at_one_height(dist, each):
    plant = grow(**{**TWO, "branches": (1, 72, 0, 0)}, branch_dist=dist, curve_res=4)
    heights = np.round(offsets(plant), 6)
    _, counts = np.unique(heights, return_counts=True)
    assert set(counts) <= each | {1} if dist == 1 else set(counts) <= each
    if dist > 1:  # evenly round the stem
        w = ways(plant)[heights == heights[0]]
        azimuth = np.sort(np.degrees(np.arctan2(w[:, 1], w[:, 0])) % 360)
        assert np.diff(azimuth) == approx(360 / len(w), abs=1e-6)


def test_a_negative_split_angle_splits_in_the_stems_plane():
    base = {**TRUNK, "levels": 1, "curve_res": 6, "seg_splits": 1, "rules": "tree-gen"}
    flat = grow(**base, split_angle=-60)
    assert len(flat.limbs) > 1
    normal = np.linalg.svd(flat.points - flat.points.mean(axis=0))[1][2]
    assert normal < 1e-6 * flat.height
    first = flat.limbs[1].points
    way = first[-1] - first[0]
    assert np.degrees(np.arccos(way[2] / np.linalg.norm(way))) > 10
    deep = grow(**base, split_angle=60)
    assert np.linalg.svd(deep.points - deep.points.mean(axis=0))[1][2] > 0.01


def test_negative_base_splits_do_nothing():
    plain = grow(**TWO, base_splits=0)
    assert np.array_equal(grow(**TWO, base_splits=-2).points, plain.points)
    forked = grow(**TWO, base_splits=2, split_angle=30)
    assert np.count_nonzero(forked.level == 0) == 3


def test_tropism_turns_towards_its_vector_level_by_level():
    base = {**TRUNK, "levels": 3, "branches": (1, 10, 10, 0), "curve_res": 6}

    def mean(level, tropism):
        plant = grow(**base, tropism=tropism, length=(1, 0.4, 0.5, 0))
        return np.mean([b.tip - b.points[0] for b in plant.limbs if b.level == level], 0)

    assert mean(0, (2, 0, 0))[0] > 1 > abs(mean(0, (0, 0, 0))[0])  # trunks lean
    assert mean(2, (0, 0, 2))[2] > mean(2, (0, 0, 0))[2] > mean(2, (0, 0, -2))[2]
    # up and down is for twigs only
    assert mean(1, (0, 0, 3)) == approx(mean(1, (0, 0, 0)))


def test_bend_v_bends_sideways():
    base = {**TWO, "curve_res": 8, "down_angle": 90, "down_angle_v": 0, "rotate": 90}

    def aside(bend):
        """How far branches leave the upright plane that they start in."""
        out = []
        for b in grow(**base, bend_v=bend, rules="tree-gen").limbs[1:]:
            way = b.points[1] - b.points[0]
            across = np.cross(way, [0, 0, 1.0])
            across /= np.linalg.norm(across)
            out.append(np.abs((b.points - b.points[0]) @ across).max() / b.length)
        return max(out)

    assert aside(0) < 1e-6
    assert aside((0, 120, 0, 0)) > 0.05


# ---------------------------------------------------------------- sizes and radii


def test_z_scale_stretches_heights_alone():
    plain, tall = grow(**TWO), grow(**TWO, z_scale=1.5)
    assert tall.points == approx(plain.points * [1, 1, 1.5], abs=1e-8)
    assert np.array_equal(tall.radius, plain.radius)
    heights = [grow(s, **TWO, z_scale_v=0.3).height / plain.height for s in range(40)]
    assert 0.69 < min(heights) < 0.85
    assert 1.15 < max(heights) < 1.31


@pytest.mark.parametrize("depth", [0.07, 0.3])
def test_lobes_are_a_round_section_as_stiff(depth):
    phi = np.linspace(0, 2 * np.pi, 20_001)[:-1]
    lobed = 1 + depth * np.sin(5 * phi)
    second = (lobed**4 * np.cos(phi) ** 2).mean() * 2 * np.pi / 4  # of area, about y
    m = WeberPenn(lobes=5, lobe_depth=depth, flare=0, taper=0)
    one = np.ones(1)
    assert np.pi / 4 * radius_at(m, 0, one, one, np.zeros(1))[0] ** 4 == approx(second)
    assert radius_at(m, 1, one, one, np.zeros(1)) == approx(1.0)


def test_trunk_scale_and_radius_mod_thicken():
    trunk = grow(**TWO).radius[0]
    assert grow(**TWO, scale0=1.5).radius[0] == approx(1.5 * trunk)
    spread = [grow(s, **TWO, scale0_v=0.2).radius[0] / trunk for s in range(40)]
    assert 0.79 < min(spread) < 0.9
    assert 1.1 < max(spread) < 1.21
    thin = grow(**TWO, radius_mod=(1, 0.5, 1, 1), rules="published")
    full = grow(**TWO, rules="published")
    assert thin.limbs[3].base_radius == approx(0.5 * full.limbs[3].base_radius, abs=1e-8)


@given(
    seed=st.integers(0, 2**31 - 1),
    power=st.floats(0, 3),
    taper=st.floats(0, 1),
    prune=st.sampled_from([0.0, 1.0]),
)
@settings(max_examples=25, deadline=None)
def test_radii_at_forks_are_the_models_ratio_power(seed, power, taper, prune):
    """r = r_p (len / len_p)^RatioPower, at most the parent's at the joint."""
    plant = grow(
        seed, levels=3, branches=(1, 12, 8, 0), ratio_power=power, taper=taper, flare=0,
        length=(1, 0.4, 0.5, 0), prune_ratio=prune, prune_width=0.2, rules="published",
    )  # fmt: skip
    joints = plant.joints
    thick = plant.splines.thickness(joints.interval, joints.t)
    span = plant.arc[plant.last]
    whole = np.array([b.length for b in plant.limbs])
    for limb, joint in zip(joints.limb, thick, strict=True):
        up = plant.carrier[limb]
        free = plant.radius[plant.first[up]] * (span[limb] / whole[up]) ** power
        want = min(free, joint)
        assert plant.radius[plant.first[limb]] == approx(want, rel=0.06, abs=2e-6)


# ---------------------------------------------------------------- pruning


def outside(m, plant, rows):
    """How far points are outside the envelope, over the tree's size."""
    p = plant.points[rows]
    q = (m.scale - p[:, 2]) / (m.scale * (1 - m.bare[0]))
    return (
        np.hypot(p[:, 0], p[:, 1]) / m.scale - m.prune_width * shape_ratio(8, q, m)
    ).max()


@pytest.mark.parametrize("rules", ["published", "tree-gen"])
def test_a_helix_is_pruned_too(rules):
    m = WeberPenn(scale=6.0, scale_v=0, levels=1, flare=0, curve_v=-40, curve_res=5)
    m = m.with_(base_size=0.5, prune_ratio=1, prune_width=0.3, length=1.3, rules=rules)
    short = 0
    for seed in range(12):
        free = ps.weber_penn(m.with_(prune_ratio=0), seed, ready=False)
        plant = ps.weber_penn(m, seed, ready=False)
        if rules == "published":  # the program fits another helix than it grows
            assert outside(m, plant, plant.last) < 0
        assert plant.length <= free.length + 1e-9
        short += plant.length < 0.99 * free.length
    assert short > 0


def test_half_pruning_is_half_way():
    m = WeberPenn(**{**TRUNK, "curve": 60}, levels=1, prune_ratio=1, prune_width=0.3)
    none, half, full = (
        ps.weber_penn(m.with_(prune_ratio=r), 2, ready=False).limbs[0] for r in (0, 0.5, 1)
    )
    assert full.length < 0.9 * none.length
    assert half.length == approx((none.length + full.length) / 2)
    # its radius too is that of its length
    assert half.base_radius == approx(
        half.length * none.base_radius / none.length, rel=1e-6
    )


def test_an_envelope_that_leaves_no_trunk_says_so():
    with pytest.raises(ps.GeometryError, match=r"prune_width 0\.01.*Widen it"):
        grow(**{**TRUNK, "curve": 90}, levels=1, prune_ratio=1, prune_width=0.01)
