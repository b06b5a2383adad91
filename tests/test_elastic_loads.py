import numpy as np
import pytest

import plantsim as ps


def made(mesh, order, solver="direct"):
    return ps.ElasticModel(mesh.with_order(order), ps.Material(density=900), solver=solver)


@pytest.fixture(params=[1, 2])
def model(request, fork):
    return made(fork, request.param)


def balanced(state):
    """Return whether forces and moments vanish to 1e-9 of what acts."""
    x, f = state.model.mesh.points, state.force
    size = np.abs(f).sum()
    moment = np.cross(x, f).sum(axis=0)
    return (
        np.abs(f.sum(axis=0)).max() < 1e-9 * size
        and np.abs(moment).max() < 1e-9 * size * np.ptp(x, axis=0).max()
    )


@pytest.mark.parametrize("solver", ["direct", "multigrid"])
@pytest.mark.parametrize("order", [1, 2])
def test_every_load_balances(fork, order, solver):
    model = made(fork, order, solver)
    x = model.mesh.points
    tips = np.argsort(x[:, 2])[-8:]
    up = np.flatnonzero(x[:, 2] > 0.1)
    loads = [
        ps.move(tips[:2], (0, 0, -1e-3)),
        ps.hold(tips[2:4], free=(0, 0, 1), displacement=(1e-3, 0, 0)),
        ps.force(tips[4:], (1.0, 0, 0.3)),
        ps.grasp(tips[4:], translation=(1e-3, 0, 0), rotation=(0, 0, 0.02)),
        ps.traction(up, (0, 20.0, 0)),
        ps.traction(up, 100.0),
        ps.hang([[0, 0.1, 0.5], [0, -0.1, 0.5]], [0.2, 0.1]),
        ps.gravity(),
    ]
    for load in loads:
        assert balanced(model.solve(load)), load
    assert balanced(model.solve(*loads))
    # by a contact, and by the compliance of vertices not met before or known already
    tips = tips[:3]
    for dtype in (np.float64, np.float32):
        assert balanced(model.contact(tips, dtype=dtype).solve((0, 0, -1e-3)))
    again = model.solve(ps.move(tips, (0, 1e-3, 0)), *loads[4:])
    assert "compliance" in again.stats.backend
    assert balanced(again)


def test_every_load_at_once_with_fruit_balances():
    skeleton = ps.fork(0.3, 0.02).with_fruit(count=6, mass=0.2, stalk=0.05, rng=3)
    mesh = ps.tetrahedralize(ps.sweep(skeleton), 1.2)
    tips = np.argsort(mesh.points[:, 2])[-12:]
    loads = [
        ps.move(tips[:2], (0, 0, -1e-3)),
        ps.hold(tips[2:4], free=(0, 0, 1), displacement=(1e-3, 0, 0)),
        ps.grasp(tips[4:8], translation=(1e-3, 0, 0), rotation=(0, 0, 0.02)),
        ps.force(tips[8:], (1.0, 0, 0.3)),
        ps.traction(mesh.surface_vertices, 100.0),
        ps.hang(mesh.points[tips[8]], 0.1),
        ps.gravity(masses=skeleton.masses),
    ]
    for solver in ("direct", "multigrid"):
        state = made(mesh, 2, solver).solve(*loads)
        assert state.stats.solver == solver
        assert balanced(state)


def test_loads_add_up(model):
    a, b = ps.gravity(), ps.hang([0, 0.1, 0.5], 0.2)
    both = model.solve(a, b).displacement
    apart = model.solve(a).displacement + model.solve(b).displacement
    assert np.linalg.norm(both - apart) < 1e-9 * np.linalg.norm(both)
    f = ps.hang([0, 0.1, 0.5], 0.2).parts(model.mesh)[0]
    assert f.force.sum(axis=0) == pytest.approx([0, 0, -0.2 * 9.80665])


def test_traction_is_stress_times_area(cantilever):
    for mesh in (cantilever, cantilever.with_order(1)):
        tip = np.flatnonzero(mesh.points[:, 2] > 0.3 - 1e-9)
        (even,) = ps.traction(tip, (1.0, 2.0, 3.0)).parts(mesh)
        (inward,) = ps.traction(tip, 5.0).parts(mesh)
        (named,) = ps.traction("tip", 5.0).parts(mesh.with_sets(tip=tip))
        assert (named.force == inward.force).all()
        x = mesh.points[mesh.surface[:, :3]]
        area = np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1) / 2
        flat = area[(x[:, :, 2] > 0.3 - 1e-9).all(axis=1)].sum()
        round_ = even.force.sum(axis=0) / [1.0, 2.0, 3.0]
        known = np.pi * 0.02**2 if mesh.order == 2 else flat
        assert round_ == pytest.approx(known, rel=1e-2 if mesh.order == 2 else 1e-12)
        assert inward.force.sum(axis=0) == pytest.approx([0, 0, -5 * round_[0]], abs=1e-12)


def test_pressure_all_round_pushes_nowhere(fork):
    (load,) = ps.traction(np.arange(len(fork.points)), 2.0).parts(fork)
    assert np.abs(load.force.sum(axis=0)).max() < 1e-12
    assert np.abs(np.cross(fork.points[load.ids], load.force).sum(axis=0)).max() < 1e-13
    outward = fork.normals
    assert (load.force * outward).sum() < 0
    assert np.linalg.norm(outward, axis=1) == pytest.approx(1)


def test_held_vertices_slide_without_friction(model):
    x = model.mesh.points
    ids = np.argsort(x[:, 2])[-6:]
    way = np.array([0.6, 0.0, 0.8])
    state = model.solve(ps.hold(ids, free=way, displacement=(0, 1e-3, 0)), ps.gravity())
    along = state.displacement[ids] @ way
    across = state.displacement[ids] - along[:, None] * way
    assert np.abs(across - [0, 1e-3, 0]).max() < 1e-12
    assert np.abs(along).max() > 1e-9
    weight = model.nodal_mass[ids, None] * [0, 0, -9.80665]
    reaction = state.force[ids] - weight
    assert np.abs(reaction @ way).max() < 1e-9 * np.abs(reaction).max()
    # held in all directions is moved
    both = [model.solve(a(ids, displacement=(0, 0, 1e-3))) for a in (ps.hold, ps.move)]
    apart = np.linalg.norm(both[0].displacement - both[1].displacement)
    assert apart < 1e-9 * np.linalg.norm(both[1].displacement)


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda m: ps.traction([100, 101], 1.0), "no face of the surface"),
        (lambda m: ps.traction("tip", 1.0), "no set 'tip'"),
        (lambda m: ps.hold([100], free=np.eye(3)), "at most two"),
        (lambda m: ps.hold([100], free=[[1, 0, 0], [2, 0, 0]]), "rank 1"),
        (lambda m: ps.hold([100], free=[0, 0, 0]), "rank 0"),
        (lambda m: ps.hold([0]), "both fixed"),
        (lambda m: ps.hang([0, 0, 0], -1), "-1 kg"),
        (lambda m: ps.hang([0, 0], 1), "shape"),
    ],
)
def test_bad_loads_are_refused(model, make, says):
    with pytest.raises(ps.ModelError, match=says):
        model.solve(make(model.mesh))


def test_twice_held_is_refused(model):
    with pytest.raises(ps.ModelError, match="moved twice"):
        model.solve(ps.move([100], (0, 0, 1)), ps.hold([100]))
