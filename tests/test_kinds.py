"""A value of the wrong kind is refused with what to give instead, or taken as meant."""

import numpy as np
import pytest

import plantsim as ps
from plantsim.errors import PlantsimError


@pytest.fixture(scope="module")
def values():
    skeleton = ps.fork(0.3, 0.02)
    solid = ps.sweep(skeleton)
    mesh = ps.tetrahedralize(solid, 1.4, order=1)
    model = ps.ElasticModel(mesh, ps.Material(6e9, 0.3, 900.0))
    tip = ps.nearest_vertices(mesh, mesh.points[mesh.points[:, 2].argmax()], count=4)
    touch = ps.move(tip, (0.01, 0.0, 0.0))
    state, seen = model.solve(touch), ps.observe(model, touch)
    return {
        "skeleton": skeleton,
        "solid": solid,
        "mesh": mesh,
        "model": model,
        "state": state,
        "touch": seen,
        "contact": model.contact([50]),
        "number": 3.0,
        "nothing": None,
        "name": "x",
    }


# what takes which of them
CALLS = {
    "write_mesh": (lambda v, _: ps.write_mesh(v, "a.msh"), {"mesh"}),
    "write_surface": (lambda v, _: ps.write_surface(v, "a.ply"), {"mesh", "state"}),
    "write_state": (lambda v, _: ps.write_state(v, "a.vtu"), {"state"}),
    "write_states": (lambda v, _: ps.write_states([v], "a.pvd"), {"state"}),
    "write_states of one": (lambda v, _: ps.write_states(v, "a.pvd"), set()),
    "write_skeleton": (lambda v, _: ps.write_skeleton(v, "a.json"), {"skeleton"}),
    "write_observations": (lambda v, _: ps.write_observations([v], "a.npz"), {"touch"}),
    "of one touch": (lambda v, _: ps.write_observations(v, "a.npz"), set()),
    "to a value": (lambda v, all_: ps.write_mesh(all_["mesh"], v), set()),
    "skeleton to a value": (lambda v, all_: ps.write_skeleton(all_["skeleton"], v), set()),
    "read_mesh": (lambda v, _: ps.read_mesh(v), set()),
    "read_skeleton": (lambda v, _: ps.read_skeleton(v), set()),
    "read_observations": (lambda v, _: ps.read_observations(v), set()),
    "figure_deformation": (lambda v, _: ps.figure_deformation(v, "a.png"), {"state"}),
    "figure_material": (lambda v, _: ps.figure_material(v, [1.0], "a.png"), set()),
    "of a field": (lambda v, all_: ps.figure_material(all_["mesh"], v, "a.png"), set()),
    "figure_mesh": (lambda v, _: ps.figure_mesh(v, "a.png"), {"mesh"}),
    "figure_solid": (lambda v, _: ps.figure_solid(v, "a.png"), {"solid"}),
    "figure_touch": (lambda v, all_: ps.figure_touch(all_["mesh"], v, "a.png"), {"touch"}),
    "on a mesh": (lambda v, all_: ps.figure_touch(v, all_["touch"], "a.png"), {"mesh"}),
    "figure_posterior": (lambda v, _: ps.figure_posterior(v, [1.0], [1.0], "a.png"), set()),
    "figure_gallery": (
        lambda v, _: ps.figure_gallery([v], "a.png"),
        {"solid", "mesh", "state"},
    ),
    "gallery of one": (lambda v, _: ps.figure_gallery(v, "a.png"), set()),
    "animate_touch": (lambda v, _: ps.animate_touch([v, v], "a.gif"), {"state"}),
    "film of one": (lambda v, _: ps.animate_touch(v, "a.gif"), set()),
    "figure_quality": (lambda v, _: ps.figure_quality(v, "a.png"), {"mesh"}),
    "figure_skeleton": (lambda v, _: ps.figure_skeleton(v, "a.png"), {"skeleton"}),
    "figure_table_one": (lambda v, _: ps.figure_table_one((0,), v, "a.png"), set()),
    "figure_convergence": (lambda v, _: ps.figure_convergence([1], v, "a.png"), set()),
    "figure_ratios": (lambda v, _: ps.figure_ratios(v, "a.png"), set()),
    "visible_vertices": (lambda v, _: ps.visible_vertices(v, (1, 0, 0)), {"mesh"}),
    "nearest_vertices": (lambda v, _: ps.nearest_vertices(v, (0, 0, 1)), {"mesh"}),
    "sweep": (lambda v, _: ps.sweep(v), {"skeleton"}),
    "tetrahedralize": (lambda v, _: ps.tetrahedralize(v, 1.4, order=1), {"solid"}),
    "ElasticModel": (lambda v, _: ps.ElasticModel(v, ps.Material()), {"mesh"}),
    "observe": (lambda v, _: ps.observe(v, ps.move([50], (0, 0, 0.01))), {"model"}),
    "estimate": (lambda v, all_: ps.estimate(v, all_["touch"]), {"model"}),
    "estimate from": (lambda v, all_: ps.estimate(all_["model"], v), {"touch"}),
}


@pytest.mark.parametrize("name", CALLS)
def test_other_kinds_are_refused_in_words(name, values, tmp_path, monkeypatch):
    call, right = CALLS[name]
    monkeypatch.chdir(tmp_path)
    for kind in values.keys() - right:
        with pytest.raises(PlantsimError) as why:
            call(values[kind], values)
        assert str(why.value).rstrip().endswith("."), why.value
    assert not list(tmp_path.iterdir())


def test_they_say_how_to_get_what_is_wanted(values, tmp_path):
    with pytest.raises(ps.FileError, match=r"ps\.write_state.*state\.model\.mesh"):
        ps.write_mesh(values["state"], tmp_path / "a.msh")
    with pytest.raises(ps.FileError, match=r"ps\.write_mesh.*model\.solve"):
        ps.write_state(values["mesh"], tmp_path / "a.vtu")
    with pytest.raises(ps.ModelError, match=r"ps\.tetrahedralize\(ps\.sweep\(skeleton\)\)"):
        ps.ElasticModel(values["skeleton"], ps.Material())
    with pytest.raises(ps.ModelError, match="figure_deformation"):
        ps.figure_mesh(values["state"], tmp_path / "a.png")
    with pytest.raises(ps.FileError, match="a TetMesh where a file's name is wanted"):
        ps.write_surface(values["mesh"], values["mesh"])


def test_a_state_in_place_of_a_mesh_gives_its_deformed_surface(values, tmp_path):
    trimesh = pytest.importorskip("trimesh")
    state = values["state"]
    path = ps.write_surface(state, tmp_path / "a.ply", scale=3.0)
    same = ps.write_state(state, tmp_path / "b.ply", scale=3.0)
    assert path.read_bytes() == same.read_bytes()
    bent = state.model.mesh.points + 3.0 * state.displacement
    back = trimesh.load(path, force="mesh", process=False)
    assert np.asarray(back.vertices) == pytest.approx(
        bent[state.model.mesh.surface_vertices], abs=1e-6
    )
    with pytest.raises(ps.ModelError, match="Give one of them"):
        ps.write_surface(state, tmp_path / "a.ply", displacement=state.displacement)
