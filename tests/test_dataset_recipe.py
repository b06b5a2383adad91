"""Recipes of data sets: what they take, and what they say of what they do not."""

import json
from dataclasses import replace

import pytest

import plantsim as ps
from plantsim.datasets.recipe import Kind, Meshing, Touching, write_example


@pytest.fixture(scope="module")
def recipe() -> ps.Recipe:
    """Trunks alone, of one kind."""
    kind = Kind("strawberry", ps.species("strawberry"), levels=1)
    other = Kind("maize", ps.species("maize"), levels=1)
    touch = Touching(touches=3, steps=2)
    return ps.Recipe(plants=5, species=(kind, other), mesh=Meshing(order=1), touch=touch)


def test_recipe_comes_back_from_its_plain_form_and_from_a_file(tmp_path):
    file = write_example(tmp_path / "recipe.toml")
    read = ps.Recipe.read(file)
    assert len(read.kinds) == len(ps.species_names())
    again = tmp_path / "recipe.json"
    again.write_text(json.dumps(read.plain()))
    assert ps.Recipe.read(again) == read
    assert ps.Recipe.read(again).fingerprint == read.fingerprint
    with pytest.raises(ps.FileError, match="there already"):
        write_example(file)


def test_fingerprint_is_of_all_that_a_plant_depends_on(recipe):
    assert replace(recipe, plants=9, timeout=5).fingerprint == recipe.fingerprint
    for other in (
        replace(recipe, seed=8),
        replace(recipe, mesh=Meshing(order=2)),
        replace(recipe, touch=replace(recipe.touch, depth=0.003)),
        replace(recipe, species=recipe.species[:1]),
    ):
        assert other.fingerprint != recipe.fingerprint


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"plants": 0}, "plants is 0: allowed is a whole number from 1"),
        ({"plants": 2.5}, "plants is 2.5: allowed is a whole number"),
        ({"plant": 3}, "plant is not an entry.*did you mean plants"),
        ({"seed": -1}, "seed is -1: allowed is a whole number from 0"),
        ({"touch": 3}, "touch is 3: allowed is a table"),
        ({"touch": {"depth": [3, 1]}}, r"touch.depth is \[3, 1\]: allowed is a number ab"),
        ({"touch": {"direction": "up"}}, "touch.direction is 'up': allowed is 'normal' or"),
        ({"touch": {"facing": 1}}, "touch.facing is 1: allowed is True or False"),
        ({"mesh": {"kernel": "x"}}, "mesh.kernel is 'x': allowed is 'occ'"),
        ({"mesh": {"order": True}}, "mesh.order is True: allowed is 1 or 2"),
        ({"split": {"train": 0.5}}, "split is .*: allowed is shares that add up to 1"),
        ({"split": {"valid": 1}}, "split.valid is not an entry.*did you mean validation"),
        ({"species": []}, "species is .*: allowed is at least one"),
        ({"species": "apple"}, "species is 'apple': allowed is a list of names"),
        ({"species": ["aple"]}, "species 1: name is 'aple': allowed is one of apple, "),
        ({"species": ["apple", "apple"]}, "species is 'apple': allowed is each name once"),
        ({"species": [{"file": "../no.toml"}]}, "species 1: .*no.toml: no such file"),
        ({"material": {"young": "soft"}}, "young is 'soft': allowed is a number from 1"),
        ({"grow": {"times": {"scal": 1}}}, "times.scal is not an entry.*mean scale"),
        ({"grow": {"times": {"length": [1, 2]}}}, "times.length is .*a list of 4, one a l"),
        ({"grow": {"parameters": {"scale": [-2, 3]}}}, "scale is -2.0.*more than 0 m.*low"),
        ({"grow": {"max_limbs": 2.5}}, "max_limbs is 2.5: allowed is a whole number"),
        ({"timeout": float("nan")}, "timeout is nan: allowed is a number above 0"),
    ],
)
def test_recipe_says_which_entry_is_wrong_and_what_is_allowed(values, words):
    with pytest.raises(ps.DatasetError, match=words):
        ps.Recipe.from_mapping(values)


def test_recipe_file_that_is_none_gets_a_sentence(tmp_path):
    file = tmp_path / "recipe.toml"
    for content in (b"plants = ", b"\xff\xfe", b"plants = 0"):
        file.write_bytes(content)
        with pytest.raises(ps.FileError, match=r"recipe\.toml"):
            ps.Recipe.read(file)


def test_species_of_ones_own_and_a_second_kind_of_one(tmp_path):
    ps.species("apple").with_(scale=1.5).write(tmp_path / "dwarf.toml")
    text = """
    [grow]
    times = { scale = 2 }
    [[species]]
    file = "dwarf.toml"
    [[species]]
    name = "old apple"
    like = "apple"
    times = { scale = [1, 1.5], branches = [1, [0.5, 1], 1, 1] }
    """
    (tmp_path / "recipe.toml").write_text(text)
    dwarf, old = ps.Recipe.read(tmp_path / "recipe.toml").kinds
    assert (dwarf.name, dwarf.varied(lambda s: s.low).scale) == ("dwarf", 3.0)
    assert old.varied(lambda s: s.high).scale == pytest.approx(1.5 * 3.2)
    assert old.varied(lambda s: s.low).branches == (1, 6, 12, 0)
