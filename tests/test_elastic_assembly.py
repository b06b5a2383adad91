import numpy as np
import pytest
from scipy.sparse import kron
from scipy.sparse.linalg import norm

import plantsim as ps
from plantsim.elastic.pattern import Pattern
from plantsim.elastic.stiffness import scalar_basis


@pytest.fixture(params=["order 1", "straight order 2", "curved order 2"])
def mesh(request, fork):
    return {
        "order 1": fork.with_order(1),
        "straight order 2": fork.with_order(1).with_order(2),
        "curved order 2": fork,
    }[request.param]


def test_mass_matrix_is_the_form(mesh):
    from skfem.models.poisson import mass

    basis = scalar_basis(mesh.points, mesh.tets, mesh.curved, exact_mass=True)
    M = mass.assemble(basis).tocsr()
    ours = np.empty(M.shape[0], dtype=int)
    for a in range(mesh.tets.shape[1]):
        ours[basis.element_dofs[a]] = mesh.tets[:, a]
    place = np.argsort(ours)
    model = ps.ElasticModel(mesh, ps.Material(density=700))
    known = 700 * kron(M[place][:, place], np.eye(3))
    assert norm(model.mass_matrix - known) <= 1e-12 * norm(known)
    x = np.tile([1.0, 0, 0], len(mesh.points))
    assert x @ model.mass_matrix @ x == pytest.approx(700 * mesh.volume, rel=1e-9)
    K = model.stiffness
    assert (model.mass_matrix.indices == K.indices).all()
    assert (model.mass_matrix.indptr == K.indptr).all()


def test_a_new_material_shares_blocks_and_pattern(mesh):
    rng = np.random.default_rng(0)
    first = ps.ElasticModel(mesh, ps.Material())
    E = rng.uniform(1e9, 9e9, len(mesh.tets))
    other = first.with_material(ps.Material(E, 0.2))
    fresh = ps.ElasticModel(mesh, ps.Material(E, 0.2))
    assert other.blocks is first.blocks
    assert np.shares_memory(other.stiffness.indices, first.stiffness.indices)
    assert norm(other.stiffness - fresh.stiffness) == 0


def test_whole_tensor_gives_the_forces_of_k(mesh):
    rng = np.random.default_rng(1)
    mu, lam = rng.uniform(1, 2, (2, len(mesh.tets)))
    model = ps.ElasticModel(mesh, ps.Material.lame(mu, lam))
    u = rng.normal(size=mesh.points.shape)
    a, b = model.blocks.forces(mesh.tets, u)
    f = np.zeros_like(u)
    np.add.at(f, mesh.tets, mu[:, None, None] * a + lam[:, None, None] * b)
    known = model.stiffness @ u.ravel()
    assert np.abs(f.ravel() - known).max() <= 1e-12 * np.abs(known).max()
    H = model.blocks.tensor()
    c = mesh.tets.shape[1]
    flat = H.reshape(-1, 3 * c, 3 * c)
    assert np.abs(flat - flat.transpose(0, 2, 1)).max() <= 1e-15 * np.abs(flat).max()


def test_pattern_is_every_pair_of_a_tet(mesh):
    p = Pattern.of(mesh.tets, len(mesh.points))
    n = len(mesh.points)
    pairs = np.unique((mesh.tets[:, :, None] * n + mesh.tets[:, None, :]).ravel())
    row, column = np.divmod(pairs, n)
    assert (np.repeat(np.arange(n), np.diff(p.indptr)) == row).all()
    assert (p.indices == column).all()


@pytest.mark.parametrize("order", [1, 2])
def test_work_of_tets_adds_up_to_the_stiffness(fork, order):
    mesh = fork.with_order(order)
    rng = np.random.default_rng(4)
    mu, lam = rng.uniform(1, 2, (2, len(mesh.tets)))
    u, v = rng.normal(size=(2, len(mesh.points), 3))
    model = ps.ElasticModel(mesh, ps.Material.lame(mu, lam))
    by_mu, by_lam = model.blocks.work(mesh.tets, u, v)
    known = v.ravel() @ (model.stiffness @ u.ravel())
    assert mu @ by_mu + lam @ by_lam == pytest.approx(known, rel=1e-10)
    forces = model.blocks.forces(mesh.tets, u)
    for ours, f in zip((by_mu, by_lam), forces, strict=True):
        each = np.einsum("eai,eai->e", f, v[mesh.tets])
        assert np.abs(ours - each).max() < 1e-12 * np.abs(each).max()
