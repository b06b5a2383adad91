import numpy as np
import pytest

import plantsim as ps


@pytest.fixture
def model(fork):
    return ps.ElasticModel(fork.with_order(1), ps.Material())


@pytest.fixture
def patch(model):
    tip = model.mesh.points[model.mesh.points[:, 2].argmax()]
    return ps.nearest_vertices(model.mesh, tip, radius=0.015)


def test_grasp_stiffness_is_the_change_of_wrench(model, patch):
    K = ps.grasp(patch).stiffness(model)
    assert np.abs(K - K.T).max() < 1e-12 * np.abs(K).max()
    assert np.linalg.eigvalsh(K).min() > 0
    for i in range(6):
        step = np.zeros(6)
        step[i] = 1e-6
        grip = ps.grasp(patch, translation=step[:3], rotation=step[3:])
        wrench = grip.wrench(model.solve(grip))
        assert np.linalg.norm(wrench - K @ step) < 1e-5 * np.linalg.norm(wrench)


def test_wrench_balances_the_base_and_does_the_work(model, patch):
    grip = ps.grasp(patch, translation=(1e-4, 0, -2e-4), rotation=(0, 1e-3, 5e-4))
    state = model.solve(grip)
    wrench = grip.wrench(state)
    base = model.mesh.sets["base"]
    x = model.mesh.points[base] - grip.centre(model.mesh)
    assert wrench[:3] == pytest.approx(-state.force[base].sum(axis=0), rel=1e-6, abs=1e-9)
    torque = -np.cross(x, state.force[base]).sum(axis=0)
    assert wrench[3:] == pytest.approx(torque, rel=1e-6, abs=1e-9)
    work = wrench @ [1e-4, 0, -2e-4, 0, 1e-3, 5e-4] / 2
    assert state.energy == pytest.approx(work, rel=2e-3)  # the turn is finite


def test_a_grasped_patch_stays_rigid(model, patch):
    state = model.solve(ps.grasp(patch, rotation=(0, 0, 1.0)))
    before = model.mesh.points[patch]
    after = before + state.displacement[patch]
    apart = [np.linalg.norm(p[:, None] - p, axis=2) for p in (before, after)]
    assert np.abs(apart[0] - apart[1]).max() < 1e-12
    assert after.mean(axis=0) == pytest.approx(before.mean(axis=0))


def test_nearest_vertices(model):
    mesh = model.mesh
    point = mesh.points[mesh.surface_vertices[17]] + 1e-6
    assert ps.nearest_vertices(mesh, point)[0] == mesh.surface_vertices[17]
    found = ps.nearest_vertices(mesh, point, radius=0.03)
    distance = np.linalg.norm(mesh.points[found] - point, axis=1)
    assert (np.diff(distance) >= 0).all()
    assert distance[-1] <= 0.03
    assert np.isin(found, mesh.surface_vertices).all()
    with pytest.raises(ps.ModelError, match="larger radius"):
        ps.nearest_vertices(mesh, (9, 9, 9), radius=0.1)


def test_normals_point_outwards(cantilever):
    for mesh in (cantilever, cantilever.with_order(1)):
        x = mesh.points[mesh.surface_vertices]
        side = (x[:, 2] > 0.05) & (x[:, 2] < 0.25)
        out = x[side] * [1, 1, 0]
        out /= np.linalg.norm(out, axis=1)[:, None]
        assert (mesh.normals[side] * out).sum(axis=1).min() > 0.95


def test_touches_follow_the_papers_protocol(model):
    low = ps.lowest(model.mesh)
    assert len(low) == len(model.mesh.points) // 10
    m = ps.ElasticModel(model.mesh, ps.Material(), fixed=low)
    touches = ps.sample_touches(m, 4, rng=3)
    again = ps.sample_touches(m, 4, rng=3)
    z = m.mesh.points[:, 2]
    for touch, twin in zip(touches, again, strict=True):
        assert (touch.ids == twin.ids).all()
        assert len(touch) == 15
        assert touch.moves.shape == (15, 10, 3)
        assert len(set(touch.ids.tolist())) == 10
        assert (z[touch.ids] >= np.quantile(z, 0.15)).all()
        assert touch.moves[:, 0, 2] == pytest.approx(-0.01 * np.arange(1, 16))
        assert (touch.moves == touch.moves[:, :1]).all()
    forces = [m.solve(load).force[touches[0].ids] for load in touches[0]]
    assert forces[14] == pytest.approx(15 * forces[0], rel=1e-6)


def test_a_finger_pushes_inwards(model):
    (touch,) = ps.sample_touches(
        model, 1, vertices=1, direction="normal", depth=1e-3, steps=2, rng=0
    )
    (at,) = np.flatnonzero(model.mesh.surface_vertices == touch.ids[0])
    assert touch.last.displacement[0] == pytest.approx(-1e-3 * model.mesh.normals[at])


@pytest.mark.parametrize(
    ("act", "says"),
    [
        (lambda m: ps.sample_touches(m, 0, rng=0), "0 shots"),
        (lambda m: ps.sample_touches(m, 1, vertices=10**5, rng=0), "only"),
        (lambda m: ps.sample_touches(m, 1, direction="up", rng=0), "'up'"),
        (lambda m: ps.sample_touches(m, 1, direction=(0, 0, 0), rng=0), "zero"),
        (lambda m: ps.sample_touches(m, 1, rng=-1), "seed"),
        (lambda m: m.solve(ps.grasp([])), "no vertex"),
        (lambda m: ps.grasp([1], rotation=(0, 0)), "shape"),
    ],
)
def test_bad_touches_are_refused(model, act, says):
    with pytest.raises(ps.ModelError, match=says):
        act(model)
