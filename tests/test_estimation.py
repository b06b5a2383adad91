import numpy as np
import pytest

import plantsim as ps

PAPER = {"method": "force-balance"}
ALONE = ps.per_limb(smooth=None)  # limbs that know nothing of each other


@pytest.fixture(scope="module")
def truth(fork):
    young = np.array([5e9, 8e9, 3e9])[fork.region]
    return ps.ElasticModel(fork, ps.Material(young, 0.3))


@pytest.fixture(scope="module")
def touches(truth):
    mesh = truth.mesh
    tips = [limb.tip for limb in ps.fork(0.3, 0.02).limbs[1:]]
    near = [np.argsort(np.linalg.norm(mesh.points - tip, axis=1))[:5] for tip in tips]
    return [ps.observe(truth, ps.move(ids, (0.002, 0.003, -0.005))) for ids in near]


def test_force_matrix_is_linear_elasticity(truth):
    u = np.random.default_rng(0).normal(size=truth.mesh.points.shape)
    mu, lam, _ = truth.material.per_tet(len(truth.mesh.tets))
    W = ps.force_matrix(truth, u)
    f = truth.stiffness @ u.ravel()
    assert np.linalg.norm(W @ np.concatenate([mu, lam]) - f) < 1e-12 * np.linalg.norm(f)
    with pytest.raises(ps.EstimateError, match="shape"):
        ps.force_matrix(truth, u[1:])


def test_force_matrix_is_the_difference_of_forces(truth):
    # the energy's second difference: d/d theta of the force, which is d energy / d u
    rng = np.random.default_rng(1)
    u, v = rng.normal(size=(2, *truth.mesh.points.shape))
    m = len(truth.mesh.tets)
    mu, lam, _ = truth.material.per_tet(m)
    theta = np.concatenate([mu, lam])
    W = ps.force_matrix(truth, u)

    def energy(theta, u):
        model = truth.with_material(ps.Material.lame(theta[:m], theta[m:]))
        return 0.5 * u.ravel() @ (model.stiffness @ u.ravel())

    for j in (3, m // 2, m + 3, m + m // 2):
        more = theta.copy()
        more[j] *= 1.5
        slopes = [(energy(t, u + v) - energy(t, u - v)) / 2 for t in (more, theta)]
        push = v.ravel() @ W[:, [j]].toarray().ravel()
        size = np.linalg.norm(v) * np.linalg.norm(W[:, [j]].toarray())
        assert (slopes[0] - slopes[1]) / (more[j] - theta[j]) == pytest.approx(
            push, abs=1e-5 * size
        )


def test_exact_touches_give_the_exact_limbs(truth, touches):
    prior = truth.with_material(ps.Material(6e9, 0.35))
    found = ps.estimate(prior, touches, rows="balance", **PAPER)
    assert found.young() == pytest.approx({"0": 5e9, "1": 8e9, "2": 3e9}, rel=1e-4)
    assert found.material.poisson == pytest.approx(
        np.full(len(truth.mesh.tets), 0.3), abs=1e-4
    )
    assert found.stats.status == "optimal"
    assert found.stats.misfit < 1e-6
    assert found.parameters["mu[1]"] == pytest.approx(8 / 6 * 1.35 / 1.3, rel=1e-4)
    assert found.prior is prior.material


def test_contact_rows_find_what_was_touched(truth, touches):
    prior = truth.with_material(ps.Material(6e9, 0.3))
    young = ps.estimate(prior, touches, parameters=ALONE, **PAPER).young()
    assert young["1"] == pytest.approx(8e9, rel=1e-3)
    assert young["2"] == pytest.approx(3e9, rel=1e-3)
    assert young["0"] == pytest.approx(6e9, rel=1e-3)  # never touched: the prior


def test_per_element_fits_the_forces_within_bounds(truth, touches):
    prior = truth.with_material(ps.Material(6e9, 0.3))
    found = ps.estimate(prior, touches, parameters=ps.per_element(), **PAPER)
    force = np.sqrt(np.mean(np.concatenate([t.force for t in touches]) ** 2))
    assert found.stats.misfit < 1e-3 * force
    assert found.stats.parameters == 2 * len(truth.mesh.tets) + 2  # two levels
    assert len(found.parameters) == 2 * len(truth.mesh.tets)
    assert found.material.mu.min() > 0
    assert found.material.lam.min() > 0


def test_noise_in_force_pulls_towards_the_prior(truth, touches):
    ids = touches[0].moved
    prior = truth.with_material(ps.Material(6e9, 0.3))
    errors = []
    for noise in (0.01, 1e5):
        seen = ps.observe(truth, ps.move(ids, (0.002, 0, 0)), force_noise=noise, rng=5)
        assert seen.force_noise == noise
        found = ps.estimate(prior, [seen], parameters=ALONE, **PAPER)
        errors.append(abs(found.young()["1"] / 6e9 - 1))
    assert errors[0] > 0.2
    assert errors[1] < 0.05


def test_noise_is_drawn_entry_by_entry(truth, touches):
    move = ps.move(touches[0].moved, (0.002, 0, 0))
    clean = ps.observe(truth, move)
    by_f = 0.02 * np.abs(clean.force)
    by_u = np.linspace(0, 1e-3, len(clean.seen))
    off = []
    for seed in range(200):
        seen = ps.observe(truth, move, force_noise=by_f, displacement_noise=by_u, rng=seed)
        off.append(((seen.force - clean.force) / by_f, seen.displacement[1:]))
    assert np.array_equal(seen.noise_of("force"), by_f)
    assert np.array_equal(seen.noise_of("displacement"), np.tile(by_u[:, None], 3))
    force, u = (np.array(part) for part in zip(*off, strict=True))
    assert force.std(axis=0) == pytest.approx(np.ones(by_f.shape), rel=0.25)
    spread = (u - clean.displacement[1:]).std(axis=(0, 2)) / by_u[1:]
    assert spread == pytest.approx(np.ones(len(by_u) - 1), rel=0.25)
    with pytest.raises(ps.EstimateError, match="shape"):
        ps.observe(truth, move, force_noise=by_f[1:], rng=0)
    grip = ps.grasp(touches[0].moved, translation=(0.002, 0, 0))
    with pytest.raises(ps.EstimateError, match="wrench"):
        ps.observe(truth, grip, force_noise=by_f, rng=0)


def test_any_cvxpy_solver_by_name(truth, touches):
    prior = truth.with_material(ps.Material(6e9, 0.3))
    a = ps.estimate(prior, touches, solver="CLARABEL", **PAPER).young()["1"]
    b = ps.estimate(prior, touches, solver="OSQP", **PAPER).young()["1"]
    assert a == pytest.approx(b, rel=0.02)
    with pytest.raises(ps.EstimateError, match="CLARABEL"):
        ps.estimate(prior, touches, solver="NONE", **PAPER)


@pytest.mark.parametrize("status", ["optimal_inaccurate", "infeasible", "unbounded"])
def test_no_optimum_is_an_error(truth, touches, status, monkeypatch):
    import cvxpy

    monkeypatch.setattr(cvxpy.Problem, "status", property(lambda _: status))
    with pytest.raises(ps.EstimateError, match=f"ended '{status}'. Try another solver"):
        ps.estimate(truth, touches, **PAPER)


def test_unseen_neighbours_are_named(truth, touches):
    ids = touches[0].moved
    seen = ps.observe(truth, ps.move(ids, (0.002, 0, 0)), seen=ids)
    with pytest.raises(ps.EstimateError, match="Observe more vertices"):
        ps.estimate(truth, [seen], **PAPER)


def test_observation_simulates_noise(truth, touches):
    ids = touches[0].moved
    seen = ps.observe(truth, ps.move(ids, (0, 0, 0.001)), displacement_noise=1e-3, rng=1)
    exact = ps.observe(truth, ps.move(ids, (0, 0, 0.001)))
    off = seen.displacement - exact.displacement
    assert off.std() == pytest.approx(1e-3, rel=0.05)
    assert np.array_equal(seen.move, exact.move)
    assert np.array_equal(seen.force, exact.force)


def test_observations_round_trip(tmp_path, touches):
    path = ps.write_observations(touches, tmp_path / "touches.npz")
    back = ps.read_observations(path)
    assert len(back) == len(touches)
    for a, b in zip(touches, back, strict=True):
        for name in ("moved", "move", "force", "seen", "displacement"):
            assert np.array_equal(getattr(a, name), getattr(b, name))


def test_foreign_observations_are_refused(tmp_path, touches):
    class Bomb:
        def __reduce__(self):
            return (open, (str(tmp_path / "ran"), "w"))

    np.savez(tmp_path / "bomb.npz", format=np.array([Bomb()], dtype=object))
    np.savez(tmp_path / "other.npz", points=np.zeros(3))
    (tmp_path / "cut.npz").write_bytes(
        ps.write_observations(touches, tmp_path / "a.npz").read_bytes()[:2000]
    )
    for name in ("bomb", "other", "cut"):
        with pytest.raises(ps.FileError, match="not a file of observations"):
            ps.read_observations(tmp_path / f"{name}.npz")
    assert not (tmp_path / "ran").exists()
    with pytest.raises(ps.FileError, match=r"\.npz"):
        ps.write_observations(touches, tmp_path / "a.csv")


GOOD = {
    "moved": [1, 2],
    "move": np.zeros((2, 3)),
    "force": np.zeros((2, 3)),
    "seen": [1],
    "displacement": np.zeros((1, 3)),
}


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"moved": [1, 1]}, "repeated"),
        ({"moved": [-1, 1]}, "negative"),
        (
            {"moved": [], "move": np.zeros((0, 3)), "force": np.zeros((0, 3))},
            "at least one",
        ),
        ({"force": np.zeros((3, 3))}, "shape"),
        ({"displacement": np.full((1, 3), np.nan)}, "NaN"),
        ({"force_noise": -1}, "force_noise is -1"),
        ({"force_noise": None}, "one number"),
        ({"force_noise": np.zeros((1, 3))}, "shape"),
        ({"displacement_noise": np.full((1, 3), -1.0)}, "0 or more"),
    ],
)
def test_bad_observations_are_refused(change, says):
    ps.Observation(**GOOD)
    with pytest.raises(ps.EstimateError, match=says):
        ps.Observation(**(GOOD | change))


def test_bad_estimates_are_refused(truth, touches):
    with pytest.raises(ps.EstimateError, match="at least one touch"):
        ps.estimate(truth, [])
    with pytest.raises(ps.EstimateError, match="method 'guess'"):
        ps.estimate(truth, touches, method="guess")  # type: ignore[arg-type]
    with pytest.raises(ps.EstimateError, match="rows is"):
        ps.estimate(truth, touches, rows="all")  # type: ignore[arg-type]
    with pytest.raises(ps.EstimateError, match="level"):
        ps.per_limb(level=1.0)
    auxetic = truth.with_material(ps.Material(6e9, -0.2))
    with pytest.raises(ps.EstimateError, match="not positive"):
        ps.estimate(auxetic, touches)
    held = ps.Observation(
        **(GOOD | {"moved": [truth.fixed[0], 200], "force": np.ones((2, 3))})
    )
    with pytest.raises(ps.EstimateError, match="holds fixed"):
        ps.estimate(truth, held)
    with pytest.raises(ps.EstimateError, match="no force|has none"):
        ps.estimate(truth, ps.Observation(**(GOOD | {"moved": [200, 201]})), **PAPER)
    with pytest.raises(ps.EstimateError, match="rng"):
        ps.observe(truth, ps.move([200], (0, 0, 0.001)), force_noise=1.0)
    with pytest.raises(ps.ModelError, match="out of range"):
        ps.observe(truth, ps.move([200], (0, 0, 0.001)), seen=[10**6])
    far = ps.Observation(**(GOOD | {"moved": [1, 10**7]}))
    with pytest.raises(ps.ModelError, match="out of range"):
        ps.estimate(truth, [far])
