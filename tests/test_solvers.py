import numpy as np
import pytest
import skfem

import plantsim as ps
from plantsim.solve.rigid import rigid_modes
from plantsim.solve.solver import choose

SOLVERS = ["direct", "multigrid"]


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("order", [1, 2])
def test_solvers_agree_and_report(fork, solver, order):
    mesh = fork.with_order(order)
    ids = np.argsort(mesh.points[:, 2])[-5:]
    load = ps.move(ids, (0.001, 0, -0.002)), ps.gravity()
    known = ps.ElasticModel(mesh, ps.Material(), solver="direct").solve(*load)
    state = ps.ElasticModel(mesh, ps.Material(), solver=solver).solve(*load)
    error = np.linalg.norm(state.displacement - known.displacement)
    assert error <= 1e-5 * np.linalg.norm(known.displacement)
    assert state.stats.solver == solver
    assert state.stats.backward_error <= 1e-12
    assert state.stats.unknowns == 3 * (len(mesh.points) - len(mesh.sets["base"]) - 5)
    assert (state.stats.iterations == 0) == (solver == "direct")
    assert state.stats.factored
    again = ps.ElasticModel(mesh, ps.Material(), solver=solver)
    again.solve(*load)
    assert not again.solve(*load).stats.factored


def test_multigrid_iterations_do_not_grow_with_refinement(reference):
    mesh = ps.read_mesh(reference / "test_tree_03.npz")
    z = np.load(reference / "test_tree_03_solution.npz")
    iterations = []
    for refine in (0, 1):
        m = skfem.MeshTet(
            np.ascontiguousarray(mesh.points.T), np.ascontiguousarray(mesh.tets.T)
        ).refined(refine)
        x = m.p[:, m.t.T]
        inverted = np.linalg.det((x[:, :, 1:] - x[:, :, :1]).transpose(1, 2, 0)) < 0
        tets = m.t.T.copy()
        tets[inverted] = tets[inverted][:, [0, 2, 1, 3]]
        fine = ps.TetMesh(m.p.T, tets)
        fixed = np.flatnonzero(fine.points[:, 2] <= mesh.points[z["fixed"], 2].max())
        model = ps.ElasticModel(
            fine, ps.Material.lame(7, 6), fixed=fixed, solver="multigrid"
        )
        iterations.append(model.solve(ps.move(z["moved"], (0, 0, -0.15))).stats.iterations)
    assert iterations[0] <= 45
    assert iterations[1] <= 1.5 * iterations[0]


def test_multigrid_takes_every_connected_piece_for_itself(fork):
    n = len(fork.points)
    far = fork.points + [7.0, -3.0, 11.0]
    both = ps.TetMesh(
        np.vstack([fork.points, far]),
        np.vstack([fork.tets, fork.tets + n]),
        sets={"base": np.append(fork.sets["base"], fork.sets["base"] + n)},
    )
    one, two = (
        ps.ElasticModel(m, ps.Material(density=900), solver="multigrid").solve(ps.gravity())
        for m in (fork, both)
    )
    assert two.stats.iterations <= one.stats.iterations + 3
    for part in (two.displacement[:n], two.displacement[n:]):
        apart = np.linalg.norm(part - one.displacement)
        assert apart <= 1e-6 * np.linalg.norm(one.displacement)


def test_a_large_second_level_gets_a_third(fork, monkeypatch):
    known = ps.ElasticModel(fork, ps.Material(), solver="direct").solve(ps.gravity())
    monkeypatch.setattr("plantsim.solve.multigrid.COARSE", 20)
    state = ps.ElasticModel(fork, ps.Material(), solver="multigrid").solve(ps.gravity())
    assert "3 levels" in state.stats.backend
    apart = np.linalg.norm(state.displacement - known.displacement)
    assert apart <= 1e-5 * np.linalg.norm(known.displacement)


def test_rigid_modes_are_rigid(fork):
    B = rigid_modes(fork.points)
    K = ps.ElasticModel(fork, ps.Material()).stiffness
    assert np.abs(K @ B).max() <= 1e-10 * np.abs(K.data).max()
    assert np.linalg.matrix_rank(B) == 6


@pytest.mark.parametrize(("pardiso", "limit"), [(False, 400_000), (True, 10**6)])
def test_auto_goes_by_size(monkeypatch, pardiso, limit):
    monkeypatch.setattr("plantsim.solve.solver.has_pardiso", lambda: pardiso)
    assert isinstance(choose("auto", 1000), ps.Direct)
    assert isinstance(choose("auto", limit), ps.Direct)
    assert isinstance(choose("auto", limit + 1), ps.Multigrid)
    assert choose(ps.Multigrid(tolerance=1e-8), 10).tolerance == 1e-8  # type: ignore[union-attr]


def test_a_solve_that_falls_short_raises(fork):
    model = ps.ElasticModel(fork, ps.Material(), solver=ps.Multigrid(max_iterations=3))
    with pytest.raises(ps.SolverError, match="after 3 iterations.*solver='direct'"):
        model.solve(ps.gravity())
    model = ps.ElasticModel(fork, ps.Material(), solver=ps.Direct(tolerance=1e-30))
    with pytest.raises(ps.SolverError, match="backward error"):
        model.solve(ps.gravity())


def test_pardiso_agrees_where_it_is_installed(fork, monkeypatch):
    pytest.importorskip("pypardiso")
    from plantsim.solve import direct

    known = ps.ElasticModel(fork, ps.Material(), solver="direct").solve(ps.gravity())
    monkeypatch.setattr(direct, "PARDISO_FROM", 0)
    state = ps.ElasticModel(fork, ps.Material(), solver="direct").solve(ps.gravity())
    assert state.stats.backend == "MKL PARDISO"
    error = np.linalg.norm(state.displacement - known.displacement)
    assert error < 1e-6 * np.linalg.norm(known.displacement)


@pytest.mark.parametrize("order", [1, 2])
def test_half_solves_give_the_compliance(fork, order):
    model = ps.ElasticModel(fork.with_order(order), ps.Material(), solver="direct")
    free, factor = model.base_factor()
    rng = np.random.default_rng(0)
    for count in (1, 7, 80):
        rows = rng.choice(3 * len(free), count, replace=False)
        unit = np.zeros((3 * len(free), count))
        unit[rows, np.arange(count)] = 1.0
        known = factor(unit)[0][rows]
        S = factor.compliance(rows)
        assert np.linalg.norm(S - known) <= 1e-8 * np.linalg.norm(known)
        assert (S == S.T).all()
        assert np.linalg.eigvalsh(S).min() > 0


def test_compliance_is_vouched_for(fork, monkeypatch):
    from plantsim.solve import half

    model = ps.ElasticModel(fork.with_order(1), ps.Material())
    right = half.Half.between
    monkeypatch.setattr(half.Half, "between", lambda s, rows: 1.001 * right(s, rows))
    with pytest.raises(ps.SolverError, match=r"two ways to the compliance are 1.0e-03"):
        model.contact([50, 60, 70, 80])
    # a factor too large to be copied gives the same by whole solves
    monkeypatch.setattr(half, "MOST", 0)
    whole = ps.ElasticModel(fork.with_order(1), ps.Material()).contact([50, 60, 70, 80])
    monkeypatch.undo()
    known = ps.ElasticModel(fork.with_order(1), ps.Material()).contact([50, 60, 70, 80])
    apart = np.linalg.norm(whole.stiffness - known.stiffness)
    assert apart < 1e-7 * np.linalg.norm(known.stiffness)


def test_a_factor_in_the_order_of_another_is_as_good(fork):
    n = len(fork.points)
    free = np.setdiff1d(np.arange(n), fork.sets["base"])
    soft, stiff = (ps.ElasticModel(fork, ps.Material(E)) for E in (1e9, 3e9))
    one = soft.base_factor()[1]
    K = stiff.pattern.condense(stiff.stiffness, free, free)
    other = ps.Direct().factor(K, fork.points[free], one)
    assert other.known is one.ordering
    f = np.random.default_rng(0).normal(size=(3 * len(free), 2))
    u, _, error = other(f)
    assert (error < 1e-12).all()
    assert np.allclose(3 * u, one(f)[0], atol=1e-9 * np.abs(u).max())
    assert other.definite
    rows = np.arange(30, 42)
    S = one.compliance(rows)
    assert np.allclose(3 * other.compliance(rows), S, atol=1e-8 * np.abs(S).max())
    # another pattern has its own order
    some = free[:-5]
    K = stiff.pattern.condense(stiff.stiffness, some, some)
    assert ps.Direct().factor(K, fork.points[some], one).known is None
