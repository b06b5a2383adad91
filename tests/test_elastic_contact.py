import numpy as np
import pytest

import plantsim as ps
from plantsim.elastic.contact import Columns


@pytest.fixture
def model(fork):
    return ps.ElasticModel(fork.with_order(1), ps.Material(density=900))


@pytest.fixture
def ids(model):
    return np.argsort(model.mesh.points[:, 2])[-4:]


def far(a, b):
    return np.linalg.norm(a - b) / np.linalg.norm(b)


def test_many_displacements_at_once_are_each_alone(model, ids):
    contact = model.contact(ids)
    d = np.random.default_rng(0).normal(size=(5, 4, 3)) * 1e-3
    force, field = contact.force(d), contact.displacement(d)
    surface = contact.surface_displacement(d)
    assert force.shape == (5, 4, 3)
    assert field.shape == (5, len(model.mesh.points), 3)
    for t in range(5):
        assert far(force[t], contact.force(d[t])) < 1e-12
        assert far(field[t], contact.displacement(d[t])) < 1e-12
        assert (field[t][ids] == contact.displacement(d[t])[ids]).all()
    assert far(surface, field[:, model.mesh.surface_vertices]) < 1e-12
    alike = contact.displacement((0, 0, -1e-3))
    assert far(alike, contact.displacement(np.tile([0, 0, -1e-3], (4, 1)))) < 1e-12


def test_contact_solve_is_the_models(model, ids):
    d = np.random.default_rng(2).normal(size=(4, 3)) * 1e-3
    state, known = model.contact(ids).solve(d), model.solve(ps.move(ids, d))
    assert far(state.displacement, known.displacement) < 1e-9
    assert far(state.force, known.force) < 1e-9
    assert state.stats.backward_error < 1e-12
    assert "compliance of 4 vertices" in state.stats.backend
    assert (state.displacement[ids] == d).all()


def test_single_precision_is_close(model, ids):
    d = (0, 1e-3, 0)
    single, double = model.contact(ids, dtype=np.float32), model.contact(ids)
    assert single.force(d).dtype == np.float32
    assert single.displacement(d).dtype == np.float32
    assert far(single.displacement(d), double.displacement(d)) < 1e-5
    assert far(single.solve(d).displacement, double.solve(d).displacement) < 1e-5
    with pytest.raises(ps.ModelError, match="float16"):
        model.contact(ids, dtype=np.float16)


def test_columns_are_kept_within_their_memory(model, ids):
    columns = Columns(model, limit=3 * 9 * 8 * len(model.mesh.points))
    first = columns.of(ids[:3])
    assert columns.missing(ids) == 1
    columns.of(ids[:1])  # now the latest used
    assert far(columns.of(ids[1:]), Columns(model).of(ids[1:])) < 1e-9
    assert len(columns._kept) == 3
    assert columns.missing(ids[:1]) == 1
    assert far(columns.of(ids[:3]), first) < 1e-9


def test_other_moved_vertices_need_no_factor(model, ids):
    loads = ps.gravity(), ps.force([100], (0.1, 0.2, 0.3))
    model.solve(ps.move(ids[:2], (0, 0, -1e-3)), *loads)
    move = ps.move(ids[2:], (1e-3, 0, -1e-3))
    state = model.solve(move, *loads)
    assert not state.stats.factored
    assert "compliance of 2 vertices" in state.stats.backend
    fresh = ps.ElasticModel(model.mesh, model.material).solve(move, *loads)
    assert fresh.stats.factored
    assert far(state.displacement, fresh.displacement) < 1e-9
    assert far(state.force, fresh.force) < 1e-9
    assert state.stats.unknowns == fresh.stats.unknowns
    assert state.stats.backward_error < 1e-12


def test_a_block_of_right_hand_sides_is_each_alone(model):
    free, _ = model.base_factor()
    f = np.random.default_rng(0).normal(size=(3 * len(free), 5))
    for solver in ("direct", "multigrid"):
        twin = ps.ElasticModel(model.mesh, model.material, solver=solver)
        _, factor = twin.base_factor()
        u, _, error = factor(f)
        assert u.shape == f.shape
        assert error.shape == (5,)
        assert (error <= 1e-12).all()
        assert far(u[:, 2], factor(f[:, 2].copy())[0]) < 1e-6


@pytest.mark.parametrize(
    ("d", "says"),
    [
        (np.zeros((3, 3)), "one row a contact vertex"),
        (np.zeros(4), "wanted"),
        ((0, np.nan, 0), "NaN"),
    ],
)
def test_bad_displacements_are_refused(model, ids, d, says):
    with pytest.raises(ps.ModelError, match=says):
        model.contact(ids).force(d)
    with pytest.raises(ps.ModelError, match=says):
        model.contact(ids).displacement(d)
    with pytest.raises(ps.ModelError, match="one displacement"):
        model.contact(ids).solve(np.zeros((2, 4, 3)))


def test_a_field_by_multigrid_solves_for_no_column_twice(model, ids, monkeypatch):
    from plantsim.solve.multigrid import MultigridFactor

    twin = ps.ElasticModel(model.mesh, model.material, solver="multigrid")
    right, solved = MultigridFactor._one, []
    monkeypatch.setattr(
        MultigridFactor, "_one", lambda self, f: solved.append(1) or right(self, f)
    )
    contact = twin.contact(ids)
    contact.displacement((0, 0, -1e-3))
    assert len(solved) == 3 * len(ids)
    assert far(contact.stiffness, model.contact(ids).stiffness) < 1e-6
