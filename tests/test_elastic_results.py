import numpy as np
import pytest

import plantsim as ps
from plantsim.elastic.analytic import cantilever_tip


def test_limb_table_of_a_cantilever(cantilever):
    model = ps.ElasticModel(cantilever, ps.Material())
    tip = np.flatnonzero(cantilever.points[:, 2] > 0.3 - 1e-9)
    state = model.solve(ps.force(tip, (2.0, 0, 5.0)))
    (row,) = state.limbs
    assert row.axial == pytest.approx(5, rel=1e-3)  # the axis is that of the vertices
    assert row.shear == pytest.approx(2, rel=5e-3)
    assert row.bending == pytest.approx(2 * 0.3, rel=1e-3)
    assert abs(row.torsion) < 1e-2 * row.bending
    assert row.tip[0] == pytest.approx(state.displacement[tip, 0].mean(), rel=1e-2)
    # beam theory at the clamp: 4 M / (pi r^3), less the mean over the nearest tets
    assert row.stress == pytest.approx(4 * 0.6 / (np.pi * 0.02**3), rel=0.4)


def test_limb_table_is_beam_theory():
    """All columns at once on a slender limb: pulled, bent and twisted at its end."""
    L, r, young, pull, push, turn = 0.8, 0.02, 6e9, 300.0, 2.0, 1.5
    mesh = ps.tetrahedralize(ps.sweep(ps.straight(L, r), tips="flat"), 0.6)
    model = ps.ElasticModel(mesh, ps.Material(young, 0.3))
    tip = np.flatnonzero(mesh.points[:, 2] > L - 1e-9)
    x, y, _ = mesh.points[tip].T
    couple = turn * np.stack([-y, x, 0 * x], axis=1) / (x**2 + y**2).sum()
    (even,) = ps.traction(tip, (0, 0, 1.0)).parts(mesh)
    axial = ps.force(even.ids, even.force * pull / even.force.sum())
    state = model.solve(axial, ps.force(tip, (push, 0, 0)), ps.force(tip, couple))
    (row,) = state.limbs
    assert row.axial == pytest.approx(pull, rel=1e-3)
    assert row.shear == pytest.approx(push, rel=0.02)  # pull across an axis 1e-4 askew
    assert row.bending == pytest.approx(push * L, rel=1e-3)
    assert abs(row.torsion) == pytest.approx(turn, rel=2e-3)
    known = cantilever_tip(L, r, r, young, 0.3, end_load=push)
    (bent,) = model.solve(ps.force(tip, (push, 0, 0))).limbs  # not twisted: at the rim
    assert bent.tip[0] == pytest.approx(known, rel=0.02)
    # von Mises at the clamp's edge; a tet's mean lies some way in from it
    normal = pull / (np.pi * r**2) + 4 * push * L / (np.pi * r**3)
    shear = 2 * turn / (np.pi * r**3)
    edge = np.hypot(normal, np.sqrt(3) * shear)
    assert row.stress == pytest.approx(edge, rel=0.2)
    assert row.stress == state.von_mises.max()


def test_limb_table_of_a_fork_balances_at_the_joint(fork):
    model = ps.ElasticModel(fork, ps.Material())
    arm = np.linalg.norm(fork.points[:, :2], axis=1)
    tip = arm.argmax()
    state = model.solve(ps.force([tip], (0.0, 0, -3.0)))
    table = state.limbs
    assert len(table) == 3
    assert table["0"].axial == pytest.approx(-3, rel=1e-4)
    assert table["0"].bending == pytest.approx(3 * arm[tip], rel=1e-3)
    where = fork.region[(fork.tets == tip).any(axis=1)][0]
    loaded = table[fork.region_names[where]]
    (idle,) = (r for r in table if r.name not in ("0", loaded.name))
    assert np.hypot(loaded.axial, loaded.shear) == pytest.approx(3, rel=1e-4)
    assert np.hypot(idle.axial, idle.shear) < 1e-4
    assert "bending Nm" in repr(table)
    assert repr(table).count("\n") == 3
    with pytest.raises(ps.ModelError, match="no limb '9'"):
        table["9"]


def test_strain_of_an_even_stretch(cube):
    mesh = cube.with_order(2)
    gradient = np.diag([0, 0, 1e-3])  # which leaves the fixed face in place
    inside = np.flatnonzero(mesh.points[:, 2] > 0)
    fixed = np.flatnonzero(mesh.points[:, 2] == 0)
    model = ps.ElasticModel(mesh, ps.Material(), fixed=fixed)
    state = model.solve(ps.move(inside, (mesh.points @ gradient.T)[inside]))
    assert np.abs(state.strain - gradient).max() < 1e-15


def test_warning_says_how_far_off(fork):
    model = ps.ElasticModel(fork.with_order(1), ps.Material())
    tip = np.argsort(fork.with_order(1).points[:, 2])[-4:]
    assert "14 % off at 5 degrees" in repr(model.solve(ps.move(tip, (0.2, 0, 0))))


def test_plot_writes_a_picture(fork, tmp_path):
    from plantsim.view.probe import why_not_drawn

    if why_not_drawn():
        pytest.skip("no pictures here")
    model = ps.ElasticModel(fork, ps.Material())
    path = model.solve(ps.gravity()).plot(tmp_path / "state.png", scale=10)
    assert path.read_bytes()[:4] == b"\x89PNG"


@pytest.mark.parametrize("solver", ["direct", "multigrid"])
def test_modes_of_a_cantilever(cantilever, solver):
    """Euler-Bernoulli's first frequency, twice for the two axes, a little lowered."""
    model = ps.ElasticModel(cantilever, ps.Material(6e9, 0.3, 800.0), solver=solver)
    found = ps.modes(model, 3)
    inertia, area = np.pi * 0.02**4 / 4, np.pi * 0.02**2
    beam = 1.8751**2 / (2 * np.pi * 0.3**2) * np.sqrt(6e9 * inertia / (800 * area))
    assert found.frequency[:2] == pytest.approx(beam, rel=0.02)
    M, K = model.mass_matrix, model.stiffness
    phi = found.shape.reshape(3, -1)
    assert phi @ (M @ phi.T) == pytest.approx(np.eye(3), abs=1e-6)
    square = np.diag(phi @ (K @ phi.T))
    assert np.sqrt(square) / (2 * np.pi) == pytest.approx(found.frequency, rel=1e-8)
    assert (found.shape[:, cantilever.sets["base"]] == 0).all()
    with pytest.raises(ps.ModelError, match="mass"):
        ps.modes(model.with_material(ps.Material(density=0)), 3)
    with pytest.raises(ps.ModelError, match="ask for 1"):
        ps.modes(model, 0)
