"""The tree model: its formulas, its parameters, and a reference program's trees."""

import json
import os
from pathlib import Path

import numpy as np
import pytest

import plantsim as ps
from plantsim.plant.parameters import WeberPenn
from plantsim.plant.profile import radius_at, shape_ratio

approx = pytest.approx

SHARED = Path(
    os.environ.get("PLANTSIM_SHARED", Path(__file__).parents[1] / ".." / "shared")
)
REFERENCE = SHARED / "reference_species.json"
needs_reference = pytest.mark.skipif(
    not REFERENCE.exists(), reason=f"no {REFERENCE}: set PLANTSIM_SHARED to its folder"
)
SPECIES = ps.species_names()


# ---------------------------------------------------------------- formulas


def test_shape_ratios_are_those_of_the_paper():
    q = np.array([0.0, 0.35, 0.7, 1.0])
    assert shape_ratio(0, q) == approx(0.2 + 0.8 * q)
    assert shape_ratio(1, 0.5) == approx(1.0)
    assert shape_ratio(2, 1.0) == approx(1.0)
    assert shape_ratio(3, q) == approx(np.ones(4))
    assert shape_ratio(4, q) == approx(0.5 + 0.5 * q)
    assert shape_ratio(5, q) == approx([0, 0.5, 1, 0])
    assert shape_ratio(6, q) == approx(1 - 0.8 * q)
    assert shape_ratio(7, q) == approx([0.5, 0.75, 1, 0.5])


def test_pruning_envelope_is_continuous_at_its_peak_and_zero_outside():
    m = WeberPenn(prune_width_peak=0.3, prune_power_low=0.5)
    below, above = shape_ratio(8, 0.7 - 1e-9, m), shape_ratio(8, 0.7 + 1e-9, m)
    assert below == approx(above, abs=1e-4)
    assert shape_ratio(8, np.array([-0.1, 1.1]), m) == approx([0, 0])


@pytest.mark.parametrize(
    ("taper", "tip", "middle"), [(0.0, 1.0, 1.0), (1.0, 0.0, 0.5), (0.5, 0.5, 0.75)]
)
def test_taper_below_two_is_cylinder_to_cone(taper, tip, middle):
    m = WeberPenn(taper=taper, flare=0.0)
    one, long = np.array([1.0]), np.array([20.0])
    assert radius_at(m, 1, one, long, np.array([1.0])) == approx(tip)
    assert radius_at(m, 1, one, long, np.array([0.5])) == approx(middle)


def test_taper_two_ends_in_a_hemisphere_and_three_in_beads():
    size, length = np.array([0.1]), np.array([1.0])
    z = np.linspace(0, 1, 201)
    dome = radius_at(WeberPenn(taper=2.0, flare=0.0), 1, size, length, z)
    assert dome[:160] == approx(0.1)
    left = (1 - z[-15:]) * 1.0
    assert dome[-15:] == approx(np.sqrt(np.maximum(0.01 - (left - 0.1) ** 2, 0)), abs=1e-6)
    beads = radius_at(WeberPenn(taper=3.0, flare=0.0), 1, size, length, z)
    waists = np.flatnonzero((beads[1:-1] < beads[:-2]) & (beads[1:-1] <= beads[2:]))
    assert len(waists) == 4  # five beads of 0.2 m


def test_flare_widens_the_foot_only():
    m = WeberPenn(flare=0.6, taper=0.0)
    z = np.array([0.0, 0.125, 0.5])
    got = radius_at(m, 0, np.ones(3), np.full(3, 30.0), z)
    assert got == approx([1 + 0.6 * 0.99, 1, 1])
    assert radius_at(m, 1, np.ones(1), np.ones(1), np.zeros(1)) == approx(1.0)


def test_child_radius_follows_the_ratio_power_and_the_joint():
    m = WeberPenn(levels=2, ratio_power=1.5, curve_v=0, curve=0, flare=0)
    plant = ps.weber_penn(m, ready=False)
    trunk = plant.limbs[0]
    for limb in plant.limbs[1:]:
        free = trunk.base_radius * (limb.length / trunk.length) ** 1.5
        assert limb.base_radius <= free * (1 + 1e-3)


def test_levels_are_prefixes():
    deep = ps.weber_penn("quaking_aspen", 3, levels=3, ready=False)
    flat = ps.weber_penn("quaking_aspen", 3, levels=2, ready=False)
    assert len(flat.limbs) == np.count_nonzero(deep.level < 2)
    assert np.array_equal(flat.points, deep.points[: len(flat.points)])


def test_straight_parameters_give_a_straight_trunk_of_the_right_size():
    m = WeberPenn(scale=10, scale_v=0, levels=1, curve_v=0, flare=0, ratio=0.02)
    trunk = ps.weber_penn(m, ready=False).limbs[0]
    assert trunk.length == approx(10)
    assert trunk.base_radius == approx(0.2)
    assert trunk.tip == approx([0, 0, 10])


def test_curve_turns_by_its_angle_and_curve_back_returns():
    base = {"scale_v": 0, "levels": 1, "curve_v": 0, "curve_res": 20, "flare": 0}
    bent = ps.weber_penn(WeberPenn(curve=90, **base), ready=False).limbs[0]
    way = bent.points[-1] - bent.points[-2]
    assert np.degrees(np.arccos(way[2] / np.linalg.norm(way))) == approx(
        90 * 19 / 20, abs=3
    )
    back = ps.weber_penn(WeberPenn(curve=60, curve_back=-60, **base), ready=False).limbs[0]
    way = back.points[-1] - back.points[-2]
    assert np.degrees(np.arccos(way[2] / np.linalg.norm(way))) < 8


@pytest.mark.parametrize("rules", ["published", "tree-gen"])
def test_negative_curve_v_winds_a_helix(rules):
    m = WeberPenn(
        scale=4, scale_v=0, levels=1, curve_v=-30, curve_res=12, flare=0, rules=rules
    )
    trunk = ps.weber_penn(m, ready=False).limbs[0]
    if rules == "published":  # the stem keeps its length and leans by the angle
        assert trunk.length == approx(4, rel=0.03)
        assert trunk.tip[2] == approx(4 * np.cos(np.radians(30)), rel=0.01)
    else:
        assert trunk.length > 1.1 * trunk.tip[2]
    assert np.hypot(*trunk.tip[:2]) < 0.5  # it winds and comes back


def test_alternate_children_sit_on_opposite_sides():
    m = WeberPenn(
        levels=2, rotate=-90, rotate_v=0, curve_v=0, curve=0, down_angle=90, down_angle_v=0
    )
    plant = ps.weber_penn(m, 5, ready=False)
    ways = np.array([b.points[-1] - b.points[0] for b in plant.limbs[1:]])
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    assert (ways[::2] @ ways[0]).min() > 0.99
    assert (ways[1::2] @ ways[0]).max() < -0.99


def test_whorls_and_opposite_pairs():
    base = {"levels": 2, "scale_v": 0, "curve_res": 4, "branches": [1, 24, 0, 0]}
    whorls = ps.weber_penn(WeberPenn(branch_dist=3, **base), ready=False)
    heights = np.array([b.points[0, 2] for b in whorls.limbs[1:]])
    _, counts = np.unique(np.round(heights, 6), return_counts=True)
    assert set(counts) == {4}
    pairs = ps.weber_penn(WeberPenn(branch_dist=1, curve=0, curve_v=0, **base), ready=False)
    heights = np.array([b.points[0, 2] for b in pairs.limbs[1:]])
    _, counts = np.unique(np.round(heights, 6), return_counts=True)
    assert (counts == 2).mean() > 0.7


def test_splits_diffuse_their_error_and_share_the_children():
    base = {
        "levels": 2,
        "scale_v": 0,
        "curve_res": 8,
        "split_angle": 40,
        "branches": (1, 40, 0, 0),
    }
    one = ps.weber_penn(WeberPenn(**base), ready=False)
    many = ps.weber_penn(WeberPenn(seg_splits=[0.5, 0, 0, 0], **base), ready=False)
    assert np.count_nonzero(one.level == 0) == 1
    assert np.count_nonzero(many.level == 0) > 2
    # a stem and its clones carry nBranches together
    assert np.count_nonzero(many.level == 1) == approx(
        np.count_nonzero(one.level == 1), rel=0.25
    )
    fork = ps.weber_penn(WeberPenn(base_splits=2, **base), ready=False)
    assert np.count_nonzero(fork.level == 0) == 3


def test_attraction_raises_and_lowers_twigs():
    def rise(up):
        m = WeberPenn(attraction_up=up, levels=3, curve=0, curve_v=0, scale_v=0)
        plant = ps.weber_penn(m, 1, ready=False)
        return np.mean([b.tip[2] - b.points[0, 2] for b in plant.limbs if b.level == 2])

    assert rise(2.0) > rise(0.0) > rise(-2.0)


def test_pruning_keeps_branches_in_the_envelope():
    m = WeberPenn(levels=2, scale_v=0, prune_ratio=1, prune_width=0.15, base_size=0.2)
    wide = ps.weber_penn(m.with_(prune_ratio=0), 2, ready=False)
    slim = ps.weber_penn(m, 2, ready=False)

    def reach(plant):
        return np.hypot(*plant.points[:, :2].T).max()

    assert reach(slim) <= 0.15 * 13 + 0.05 < reach(wide)
    half = ps.weber_penn(m.with_(prune_ratio=0.5), 2, ready=False)
    assert reach(slim) < reach(half) < reach(wide)


def test_several_trunks_stand_apart_and_one_is_made_ready():
    m = WeberPenn(levels=1, branches=[5, 0, 0, 0])
    clump = ps.weber_penn(m, 1, ready=False)
    feet = np.array([b.points[0] for b in clump.limbs])
    assert len(feet) == 5
    assert [b.name for b in clump.limbs] == ["0", "t2", "t3", "t4", "t5"]
    gaps = np.linalg.norm(feet[:, None] - feet, axis=2)[np.triu_indices(5, 1)]
    assert gaps.min() > 2 * m.ratio * (m.scale + m.scale_v)  # but for the flare
    assert "trunks" in clump.check()[0]
    assert len(clump.ready().limbs) == 1


# ---------------------------------------------------------------- parameters


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"shape": 9}, "shape"),
        ({"scale": -1}, "scale"),
        ({"scale_v": 20}, "scale_v"),
        ({"levels": 0}, "levels"),
        ({"levels": 2.5}, "levels"),
        ({"ratio": 0}, "ratio"),
        ({"base_size": 1.0}, "base_size"),
        ({"length": (1, "a", 0, 0)}, "length"),
        ({"length": (1, 2, 3, 4, 5)}, "length"),
        ({"taper": 4}, "taper"),
        ({"curve_res": (3, 0, 1, 1)}, "curve_res"),
        ({"curve_v": -90}, "curve_v"),
        ({"prune_ratio": 1.5}, "prune_ratio"),
        ({"tropism": (0, 0)}, "tropism"),
        ({"flare": float("nan")}, "flare"),
        ({"rules": "mine"}, "rules"),
        ({"source": 5}, "source"),
        ({"curve_res": (2.5, 3, 3, 1)}, "curve_res"),
        ({"z_scale": 0}, "z_scale"),
        ({"lobes": 2.5}, "lobes"),
        ({"lobe_depth": 1}, "lobe_depth"),
    ],
)
def test_a_wrong_value_is_named_with_what_is_allowed(values, words):
    with pytest.raises(ps.GeometryError, match=rf"^{words} .*allowed is"):
        WeberPenn(**values)


def test_unknown_names_suggest_the_nearest():
    with pytest.raises(ps.GeometryError, match="did you mean ratio_power"):
        WeberPenn.from_mapping({"ratio_powr": 1.2})


def test_wrong_numbers_of_trunks_are_refused_and_right_ones_kept():
    for wrong in ("many", -1, 2.5, True):
        with pytest.raises(ps.GeometryError, match="floor_splits is"):
            WeberPenn.from_mapping({"floor_splits": wrong})
    assert WeberPenn.from_mapping({"floor_splits": 3}).branches[0] == 4
    own = WeberPenn.from_mapping({"floor_splits": 3, "branches": [0, 9, 0, 0]})
    assert own.branches == (4, 9, 0, 0)


def test_a_mapping_of_the_program_leaves_out_what_it_leaves_out_there():
    theirs = WeberPenn.from_mapping({"g_scale": 10, "levels": 2})
    assert theirs.bend_v == (0, 50, 0, 0)
    assert theirs.base_size == (0.3, 0.02, 0.02, 0.02)
    assert not theirs.published
    assert WeberPenn.from_mapping({"scale": 10, "levels": 2}).published


PUBLISHED = {  # by two copies: scale, levels, ratio_power, lobes, branches
    "quaking_aspen": (13, 3, 1.2, 5, (50, 30, 10)),
    "black_tupelo": (23, 4, 1.3, 3, (50, 25, 12)),
    "weeping_willow": (15, 4, 2.0, 9, (25, 10, 300)),
    "california_black_oak": (10, 3, 1.3, 5, (40, 120, 0)),
}


@pytest.mark.parametrize("name", PUBLISHED)
def test_published_species_have_the_published_values(name):
    m = ps.species(name)
    found = (m.scale, m.levels, m.ratio_power, m.lobes, m.branches[1:])
    assert found == PUBLISHED[name]
    assert m.published


@pytest.mark.parametrize("name", SPECIES)
def test_toml_round_trip_is_exact(name, tmp_path):
    model = ps.species(name)
    assert WeberPenn.read(model.write(tmp_path / "a.toml")) == model
    assert model.source


def test_bad_toml_says_where(tmp_path):
    file = tmp_path / "bad.toml"
    file.write_text("scale = 3\nratio = = 2\n")
    with pytest.raises(ps.FileError, match="line 2"):
        WeberPenn.read(file)
    file.write_text("shape = 12\n")
    with pytest.raises(ps.FileError, match=r"bad.toml, line 1: shape is 12: allowed is"):
        WeberPenn.read(file)


def test_unknown_species_and_levels_say_what_to_do():
    with pytest.raises(ps.GeometryError, match="quaking_aspen"):
        ps.weber_penn("oak tree")
    with pytest.raises(ps.GeometryError, match="levels"):
        ps.weber_penn("apple", levels=0)


def test_rules_follow_from_the_parameters():
    assert WeberPenn().published
    assert not WeberPenn(base_size=(0.3, 0.02, 0.02, 0.02)).published
    assert not WeberPenn(tropism=(0, 0, 0.5)).published
    assert WeberPenn(tropism=(0, 0, 0.5), rules="published").published


# ---------------------------------------------------------------- the reference program


def reference():
    data = json.loads(REFERENCE.read_text())
    return {k: v for k, v in data.items() if not k.startswith("_")}


def figures(plants, level):
    stems = [[b.length for b in p.limbs if b.level == level] for p in plants]
    return np.mean([len(s) for s in stems]), np.mean([np.mean(s) for s in stems])


def close(ours, theirs):
    mean, scatter = np.mean(theirs), np.std(theirs, ddof=1)
    return abs(ours - mean) <= max(0.1 * mean, scatter)


@needs_reference
@pytest.mark.parametrize("name", ["quaking_aspen", "apple", "acer", "palm", "black_oak"])
def test_counts_lengths_and_height_match_the_reference_program(name):
    entry = reference()[name]
    model = WeberPenn.from_mapping(entry["parameters"])
    plants = [ps.weber_penn(model, rng=seed, ready=False) for seed in range(20)]
    grown = list(entry["grown"].values())
    assert close(np.mean([p.height for p in plants]), [g["height"] for g in grown])
    for level in range(model.levels):
        stems, length = figures(plants, level)
        assert close(stems, [g["levels"][level]["stems"] for g in grown]), level
        assert close(length, [g["levels"][level]["length_mean"] for g in grown]), level


@needs_reference
def test_parameters_of_the_reference_program_also_pass_by_keyword():
    values = reference()["acer"]["parameters"]
    names = {"g_scale": "scale", "g_scale_v": "scale_v"}
    model = WeberPenn(**{names.get(k, k): v for k, v in values.items()})
    assert model == WeberPenn.from_mapping(values)
