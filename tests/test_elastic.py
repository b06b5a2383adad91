import dataclasses

import numpy as np
import pytest
from scipy.sparse.linalg import norm

import plantsim as ps
from plantsim.elastic.stiffness import blocks, elasticity, scalar_basis


def form_matrix(mesh, mu, lam):
    """Assemble the definition, scikit-fem's form, with degrees of freedom in our order."""
    import skfem

    scalar = scalar_basis(mesh.points, mesh.tets, mesh.curved)
    rule = (scalar.X, scalar.W)
    vector = skfem.Basis(scalar.mesh, skfem.ElementVector(scalar.elem), quadrature=rule)
    constant = skfem.Basis(scalar.mesh, skfem.ElementTetP0(), quadrature=rule)
    K = elasticity.assemble(
        vector, mu=constant.interpolate(mu), lam=constant.interpolate(lam)
    ).tocsr()
    ours = np.empty(K.shape[0], dtype=int)
    c = mesh.tets.shape[1]
    for a in range(c):  # scikit-fem: node by node, component fastest
        for i in range(3):
            ours[vector.element_dofs[3 * a + i]] = 3 * mesh.tets[:, a] + i
    place = np.argsort(ours)
    return K[place][:, place]


@pytest.mark.parametrize("kind", ["order 1", "straight order 2", "curved order 2"])
def test_stiffness_is_the_form(cantilever, kind):
    mesh = {
        "order 1": cantilever.with_order(1),
        "straight order 2": cantilever.with_order(1).with_order(2),
        "curved order 2": cantilever,
    }[kind]
    rng = np.random.default_rng(0)
    mu, lam = rng.uniform(1, 3, (2, len(mesh.tets)))
    model = ps.ElasticModel(mesh, ps.Material.lame(mu, lam))
    K = form_matrix(mesh, mu, lam)
    assert norm(model.stiffness - K) <= 1e-12 * norm(K)


def test_blocks_know_volume_and_rigid_motion(fork):
    b = blocks(fork)
    assert b.volume.sum() == pytest.approx(fork.volume, rel=1e-6)
    assert b.weight.sum(axis=1) == pytest.approx(b.volume)
    spin = np.cross([0.3, -0.2, 0.7], fork.points) + [1, 2, 3]
    mu, lam = b.forces(fork.tets, spin)
    scale = np.abs(b.pairs).max()
    assert np.abs(mu).max() < 1e-12 * scale
    assert np.abs(lam).max() < 1e-12 * scale


def test_stiffness_is_symmetric_and_rigid_motion_free(fork):
    model = ps.ElasticModel(fork, ps.Material())
    K = model.stiffness
    assert norm(K - K.T) <= 1e-14 * norm(K)
    spin = np.cross([0.3, -0.2, 0.7], fork.points) + [1, 2, 3]
    assert np.linalg.norm(K @ spin.ravel()) <= 1e-11 * norm(K) * np.linalg.norm(spin)


@pytest.mark.parametrize("order", [1, 2])
def test_patch(order):
    """A linear field, given on the whole surface, is found inside and strains uniformly."""
    mesh = ps.tetrahedralize(ps.sweep(ps.straight(0.1, 0.02), tips="flat"), order=order)
    gradient = np.outer([1e-3, -2e-3, 3e-3], [0, 0, 1])  # vanishes on the foot, z = 0
    field = mesh.points @ gradient.T
    rest = np.setdiff1d(np.unique(mesh.surface), mesh.sets["base"])
    material = ps.Material(2.0, 0.3)
    state = ps.ElasticModel(mesh, material).solve(ps.move(rest, field[rest]))
    assert np.abs(state.displacement - field).max() < 1e-12
    assert np.abs(state.gradient - gradient).max() < 1e-11
    strain = (gradient + gradient.T) / 2
    stress = 2 * material.mu * strain + material.lam * np.trace(strain) * np.eye(3)
    assert np.abs(state.stress - stress).max() < 1e-11
    energy = (strain * stress).sum() / 2 * mesh.volume
    assert state.energy == pytest.approx(energy, rel=1e-9)


def test_lame_and_young_agree():
    m = ps.Material(young=[1e9, 6e9], poisson=0.3, density=800)
    again = ps.Material.lame(m.mu, m.lam)
    assert again.young == pytest.approx([1e9, 6e9])
    assert again.poisson == pytest.approx([0.3, 0.3])
    assert m.with_young(2e9).poisson == pytest.approx([0.3, 0.3])
    assert float(m.with_density(1).density) == 1


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: ps.Material(young=-1), "young is -1; it must be above 0 Pa"),
        (lambda: ps.Material(young=0), "young is 0"),
        (lambda: ps.Material(young=np.nan), "NaN"),
        (lambda: ps.Material(young=[1, 2, -3, np.inf]), "infinite"),
        (lambda: ps.Material(young=[1, 2, -3, 4]), "young is -3 at 1 tets .first: 2"),
        (lambda: ps.Material(poisson=0.5), "poisson is 0.5.*below 0.5"),
        (lambda: ps.Material(poisson=-1), "above -1"),
        (lambda: ps.Material(density=-1), "density is -1"),
        (lambda: ps.Material(young=[1, 2], poisson=[0.1, 0.2, 0.3]), "lengths differ"),
        (lambda: ps.Material.lame(-1, 1), "mu is -1"),
        (lambda: ps.Material.lame(1, -1), "lam is -1"),
        (lambda: ps.Material.lame([[1]], 1), "shape"),
    ],
)
def test_bad_materials_are_refused(make, says):
    with pytest.raises(ps.MaterialError, match=says):
        make()


def test_weight_and_reactions_balance(fork):
    model = ps.ElasticModel(fork, ps.Material(density=900))
    state = model.solve(ps.gravity(), ps.force([200, 300], (1.0, 2.0, 0.5)))
    weight = 900 * model.blocks.volume.sum() * 9.80665
    assert model.mass == pytest.approx(900 * fork.volume, rel=1e-4)
    base = state.force[fork.sets["base"]].sum(axis=0)
    carried = model.nodal_mass[fork.sets["base"]].sum() * 9.80665
    assert base == pytest.approx([-1, -2, weight - 0.5 - carried], rel=1e-6, abs=1e-6)
    assert np.abs(state.force.sum(axis=0)).max() < 1e-9 * weight
    moment = np.cross(fork.points, state.force).sum(axis=0)
    assert np.abs(moment).max() < 1e-9 * weight


def test_a_vertex_pushed_down_has_a_downward_force(fork):
    ids = np.flatnonzero(fork.points[:, 2] > fork.points[:, 2].max() - 0.004)
    model = ps.ElasticModel(fork, ps.Material())
    state = model.solve(ps.move(ids, (0, 0, -0.001)))
    assert (state.displacement[ids] == [0, 0, -0.001]).all()
    assert state.force[ids].sum(axis=0)[2] < 0
    free = np.setdiff1d(np.arange(len(fork.points)), np.union1d(ids, fork.sets["base"]))
    assert (state.force[free] == 0).all()
    work = (state.force * state.displacement).sum() / 2
    assert state.energy == pytest.approx(work, rel=1e-6)


def test_linear_in_load_and_inverse_in_modulus(cantilever):
    tip = np.flatnonzero(cantilever.points[:, 2] > 0.3 - 1e-9)
    soft = ps.ElasticModel(cantilever, ps.Material(1e9, 0.3))
    stiff = soft.with_material(ps.Material(2e9, 0.3))
    assert stiff.blocks is soft.blocks
    once = soft.solve(ps.force(tip, (1.0, 0, 0)))
    twice = soft.solve(ps.force(tip, (2.0, 0, 0)))
    half = stiff.solve(ps.force(tip, (1.0, 0, 0)))
    assert twice.displacement == pytest.approx(2 * once.displacement, rel=1e-9, abs=1e-18)
    assert half.displacement == pytest.approx(once.displacement / 2, rel=1e-7, abs=1e-15)


def test_a_rotated_plant_deflects_as_the_rotated_plant(fork):
    angle = 0.7
    R = np.array(
        [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
    )
    turned = ps.TetMesh(fork.points @ R.T, fork.tets, fork.region, fork.sets)
    ids = np.argsort(fork.points[:, 2])[-5:]
    d = np.array([0.001, 0.002, -0.001])
    a = ps.ElasticModel(fork, ps.Material()).solve(ps.move(ids, d))
    b = ps.ElasticModel(turned, ps.Material()).solve(ps.move(ids, R @ d))
    assert np.abs(b.displacement - a.displacement @ R.T).max() < 1e-10
    assert b.energy == pytest.approx(a.energy)
    assert b.von_mises == pytest.approx(a.von_mises, rel=1e-5)


def test_twist_and_rotation_are_seen(cantilever):
    tip = np.flatnonzero(cantilever.points[:, 2] > 0.3 - 1e-9)
    model = ps.ElasticModel(cantilever, ps.Material())
    x = cantilever.points[tip]
    turn = 0.05
    state = model.solve(
        ps.move(tip, np.column_stack([-x[:, 1], x[:, 0], 0 * x[:, 0]]) * turn)
    )
    assert state.max_rotation == pytest.approx(turn, rel=0.1)
    assert "linear theory is fine" in repr(state)
    far = model.solve(ps.move(tip, (0.2, 0, 0)))
    assert "do not trust linear theory" in repr(far)


@pytest.mark.parametrize("curved", [False, True])
def test_contact_is_the_solve(fork, curved):
    mesh = fork if curved else fork.with_order(1)
    model = ps.ElasticModel(mesh, ps.Material())
    ids = np.argsort(mesh.points[:, 2])[-4:]
    d = np.random.default_rng(1).normal(size=(4, 3)) * 1e-3
    contact = model.contact(ids)
    state = model.solve(ps.move(ids, d))
    scale = np.abs(state.force[ids]).max()
    assert np.abs(contact.force(d) - state.force[ids]).max() < 1e-6 * scale
    assert np.abs(contact.displacement(d) - state.displacement).max() < 1e-9
    assert np.linalg.eigvalsh(contact.stiffness).min() > 0
    assert contact.stiffness @ d.ravel() == pytest.approx(contact.force(d).ravel())


@pytest.mark.parametrize(
    ("act", "says"),
    [
        (
            lambda m, k: k.solve(ps.move([0], (0, 0, 1))),
            "both fixed and moved .first ids: 0",
        ),
        (
            lambda m, k: k.solve(ps.move([8], (0, 0, 1)), ps.move([8], (0, 0, 2))),
            "moved twice",
        ),
        (lambda m, k: k.solve(ps.move([10**6], (0, 0, 1))), "out of range .1000000"),
        (lambda m, k: k.solve(ps.move([-1], (0, 0, 1))), "out of range"),
        (lambda m, k: k.solve(ps.move([8, 8], (0, 0, 1))), "repeated"),
        (lambda m, k: k.solve(ps.move([8.5], (0, 0, 1))), "fractional"),
        (lambda m, k: k.solve(ps.move("tip", (0, 0, 1))), "no set 'tip'.*there are: base"),
        (lambda m, k: k.solve(ps.move([8], (0, 0))), "shape"),
        (lambda m, k: k.solve(ps.move([8, 9], np.zeros((3, 3)))), "shape"),
        (lambda m, k: k.solve(ps.force([8], (0, 0, np.nan))), "NaN"),
        (lambda m, k: k.solve("push"), "no load"),
        (lambda m, k: k.contact([0]), "fixed"),
        (lambda m, k: ps.ElasticModel(m, ps.Material(), fixed=[]), "no vertex is fixed"),
        (lambda m, k: ps.ElasticModel(m, ps.Material(), fixed=[0, 1]), "three"),
        (lambda m, k: ps.ElasticModel(m, ps.Material(), fixed="foot"), "no set 'foot'"),
        (lambda m, k: ps.ElasticModel(m, ps.Material(), fixed=[10**9]), "out of range"),
        (lambda m, k: ps.ElasticModel(m, ps.Material(young=[1, 2])), "2 values for"),
        (lambda m, k: ps.ElasticModel(m, ps.Material(), kinematics="finite"), "kinematics"),
        (lambda m, k: ps.ElasticModel(m, ps.Material(), solver="magic"), "'magic'"),
    ],
)
def test_bad_problems_are_refused(fork, act, says):
    mesh = fork.with_order(1)
    model = ps.ElasticModel(mesh, ps.Material())
    free = np.setdiff1d(np.arange(len(mesh.points)), mesh.sets["base"])
    relabel = np.concatenate(
        [mesh.sets["base"], free]
    )  # so that 0..7 are fixed, 8 on are free
    place = np.argsort(relabel)
    mesh = ps.TetMesh(
        mesh.points[relabel], place[mesh.tets], mesh.region, {"base": np.arange(8)}
    )
    model = ps.ElasticModel(mesh, ps.Material())
    with pytest.raises(ps.PlantsimError, match=says):
        act(mesh, model)


def test_a_loose_piece_is_refused(cube):
    two = ps.TetMesh(
        np.vstack([cube.points, cube.points + 5]),
        np.vstack([cube.tets, cube.tets + 8]),
        sets={"base": np.arange(4), "both": [0, 1, 2, 3, 8, 9, 10, 11]},
    )
    with pytest.raises(ps.ModelError, match="1 of 2 disconnected pieces.*among them 8"):
        ps.ElasticModel(two, ps.Material())
    ps.ElasticModel(two, ps.Material(), fixed="both").solve(ps.gravity())


def test_a_piece_held_in_line_is_refused(cube):
    fine = cube.with_order(2)
    line = np.flatnonzero((fine.points[:, 1] == 0) & (fine.points[:, 2] == 0))
    assert len(line) == 3
    with pytest.raises(ps.ModelError, match="not in line"):
        ps.ElasticModel(fine, ps.Material(), fixed=line)


@pytest.mark.parametrize("shared", [1, 2])
def test_bodies_that_share_an_edge_or_a_vertex_are_a_hinge(cube, shared):
    shift = np.array([1, 1, 0]) if shared == 2 else np.array([1, 1, 1])
    points = np.vstack([cube.points, cube.points + shift])
    tets = np.vstack([cube.tets, cube.tets + 8])
    points, where = np.unique(points, axis=0, return_inverse=True)
    hinged = ps.TetMesh(points, where.ravel()[tets])
    assert len(points) == 16 - shared
    assert hinged.pieces.max() == 0
    low = np.flatnonzero((points[:, 2] == 0) & (points[:, :2].max(axis=1) <= 1))
    with pytest.raises(ps.ModelError, match=f"held by {shared} vertices"):
        ps.ElasticModel(hinged, ps.Material(), fixed=low)
    both = np.flatnonzero((points[:, 2] == 0) | (points[:, 2] == 2))
    if shared == 1:
        ps.ElasticModel(hinged, ps.Material(), fixed=both).solve(ps.gravity())


def test_replacing_the_mesh_makes_new_blocks(cube):
    model = ps.ElasticModel(cube, ps.Material())
    model.stiffness  # noqa: B018
    larger = ps.TetMesh(2 * cube.points, cube.tets, sets=cube.sets)
    changed = dataclasses.replace(model, mesh=larger)
    fresh = ps.ElasticModel(larger, ps.Material())
    assert abs(changed.stiffness - fresh.stiffness).max() == 0
    with pytest.raises(ps.ModelError, match="no vertex is fixed"):
        dataclasses.replace(model, fixed=[])


@pytest.mark.parametrize("solver", ["direct", "multigrid"])
def test_everything_moved(cube, solver):
    state = ps.ElasticModel(cube, ps.Material(), solver=solver).solve(
        ps.move([4, 5, 6, 7], (0, 0, 0.01))
    )
    assert state.stats.unknowns == 0
    assert state.force[4:, 2].sum() > 0
