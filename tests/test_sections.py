"""A factor along cross-sections gives what a sparse factor gives."""

import numpy as np
import pytest
import skfem

import plantsim as ps
from plantsim.errors import SolverError
from plantsim.solve.direct import Direct
from plantsim.solve.sections import WIDE, Layout, Sections


def stiffness(mesh, fixed):
    model = ps.ElasticModel(mesh, ps.Material(), fixed=fixed)
    free, factor = model.base_factor()
    return model.pattern.condense(model.stiffness, free, free), factor


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("columns", [1, 7, WIDE + 3])
def test_solutions_are_those_of_a_sparse_factor(fork, order, columns):
    K, sparse = stiffness(fork.with_order(order), "base")
    f = np.random.default_rng(3).normal(size=(K.shape[0], columns))
    known = sparse(f)[0]
    u, iterations, error = Sections(K, Layout(K))(f)
    assert iterations == 0
    assert error.shape == (columns,)
    assert (error < 1e-13).all()
    assert np.linalg.norm(u - known) <= 1e-8 * np.linalg.norm(known)
    alone = Sections(K, Layout(K))(f[:, 0])[0]
    assert np.linalg.norm(alone - u[:, 0]) <= 1e-9 * np.linalg.norm(alone)


def test_every_entry_of_k_is_in_a_section_or_between_it_and_its_parent(fork):
    K, _ = stiffness(fork, "base")
    layout = Layout(K)
    section = np.empty(K.shape[0], dtype=int)
    section[layout.order] = np.repeat(np.arange(len(layout.parent)), np.diff(layout.start))
    assert (np.bincount(section[::3]) > 0).all()
    k = K.tocoo()
    a, b = section[k.row], section[k.col]
    assert ((a == b) | (layout.parent[a] == b) | (layout.parent[b] == a)).all()
    root = np.flatnonzero(layout.parent < 0)
    assert len(root) == 1
    assert (layout.parent > np.arange(len(layout.parent)))[:-1].all()


def box(*sides):
    m = skfem.MeshTet.init_tensor(*(np.arange(n + 1.0) for n in sides))
    x, tets = m.p.T.copy(), m.t.T.copy()
    inverted = np.linalg.det(x[tets[:, 1:]] - x[tets[:, :1]]) < 0
    tets[inverted] = tets[inverted][:, [0, 2, 1, 3]]
    return ps.TetMesh(x, tets)


def test_a_body_held_about_its_waist_is_two_trees():
    beam = box(2, 2, 20)
    K, sparse = stiffness(beam, np.flatnonzero(beam.points[:, 2] == 9))
    layout = Layout(K)
    assert (layout.parent < 0).sum() == 2
    f = np.random.default_rng(1).normal(size=(K.shape[0], 4))
    known = sparse(f)[0]
    off = np.linalg.norm(Sections(K, layout)(f)[0] - known) / np.linalg.norm(known)
    assert off < 1e-10


def test_what_is_not_held_is_refused(fork):
    K, _ = stiffness(fork, "base")
    K = K.copy()
    K.data[:] = -K.data
    with pytest.raises(SolverError, match="not positive definite"):
        Sections(K, Layout(K))


def test_thin_and_thick_bodies_are_told_apart():
    for sides, thin in (((2, 2, 40), True), ((12, 12, 12), False)):
        mesh = box(*sides)
        K, sparse = stiffness(mesh, np.flatnonzero(mesh.points[:, 2] == 0))
        layout = Layout(K)
        assert layout.thin == thin
        f = np.ones((K.shape[0], 1))
        np.testing.assert_allclose(Sections(K, layout)(f)[0], sparse(f)[0], rtol=1e-7)


@pytest.mark.parametrize("lam", [1e9, 1e14])
def test_ill_conditioned_bodies_are_solved_as_well_as_by_a_sparse_factor(fork, lam):
    """Blocks with an inverse of their own lost all digits that the sparse factor kept."""
    model = ps.ElasticModel(fork.with_order(1), ps.Material.lame(1e9, lam), fixed="base")
    free, sparse = model.base_factor()
    K = model.pattern.condense(model.stiffness, free, free)
    known = np.random.default_rng(2).normal(size=(K.shape[0], 3))
    f = K @ known

    def off(u):
        return np.linalg.norm(u - known) / np.linalg.norm(known)

    assert off(Sections(K, Layout(K))(f)[0]) <= 10 * off(sparse(f)[0])


def test_an_estimate_keeps_to_the_tolerance_of_the_model_s_solver(fork):
    mesh = fork.with_order(1)
    tip = ps.nearest_vertices(mesh, (0, 0, 9), count=3)
    load = ps.force(tip, (0, 0, -9.0))
    truth = ps.ElasticModel(mesh, ps.Material())
    seen = ps.observe(truth, load, displacement_noise=1e-4, rng=1)
    strict = ps.ElasticModel(mesh, ps.Material(), solver=Direct(1e-30))
    with pytest.raises(SolverError, match=r"wanted 1\.0e-30"):
        ps.estimate(strict, [seen])
