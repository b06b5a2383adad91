"""Maximum a posteriori: derivatives, what it finds, and what it says it does not know."""

from dataclasses import replace

import numpy as np
import pytest

import plantsim as ps
from plantsim.estimation.cases import gather
from plantsim.estimation.output_error import Objective, _first
from plantsim.estimation.posterior import posterior

SKELETON = ps.fork(0.3, 0.02)


@pytest.fixture(scope="module")
def mesh():
    return ps.tetrahedralize(ps.sweep(SKELETON), 1.2, order=1)


@pytest.fixture(scope="module")
def truth(mesh):
    young = np.array([5e9, 8e9, 3e9])[mesh.region]
    return ps.ElasticModel(mesh, ps.Material(young, 0.3, 900.0))


@pytest.fixture(scope="module")
def prior(truth):
    return truth.with_material(ps.Material(6e9, 0.35, 900.0))


@pytest.fixture(scope="module")
def patches(mesh):
    return [
        ps.nearest_vertices(mesh, limb.tip, count=4 + i)
        for i, limb in enumerate(SKELETON.limbs)
    ]


@pytest.fixture(scope="module")
def touches(truth, patches):
    """A touch felt vertex by vertex, a grasp by its wrench, a weight hung on, a look."""
    rng = np.random.default_rng(3)
    noise = {"displacement_noise": 1e-4, "force_noise": 20.0, "rng": rng}
    d = (0.002, 0.003, -0.005)
    half = np.arange(0, len(truth.mesh.points), 2)
    return [
        ps.observe(truth, ps.move(patches[1], d), **noise),
        ps.observe(truth, ps.grasp(patches[2], translation=d), seen=half, **noise),
        ps.observe(truth, ps.force(patches[2], (0, 0, -300.0)), **noise),
        ps.observe(truth, ps.move(patches[2], d), seen=[], feels="total", **noise),
        ps.observe(truth, ps.move(patches[1], d), ps.gravity(), feels="nothing", **noise),
    ]


KINDS = {
    "element": ps.per_element(),
    "young": ps.per_element(moduli="young"),
    "limb": ps.per_limb(),
    "alone": ps.per_limb(smooth=None),
}


@pytest.mark.parametrize("kind", KINDS)
def test_gradient_passes_taylor_s_test(prior, touches, kind):
    chart, cases = KINDS[kind].chart(prior), gather(prior, touches)
    assert len(cases) == 4  # the grasp and the push that follows it are one
    rng = np.random.default_rng(1)
    xi, v = 0.3 * rng.normal(size=(2, chart.size))
    here = Objective(prior, chart, cases, xi)
    slope = here.gradient() @ v
    steps = np.array([1e-2, 5e-3, 2.5e-3])
    rest = [
        abs(Objective(prior, chart, cases, xi + h * v).cost - here.cost - h * slope)
        for h in steps
    ]
    assert np.log2(rest[0] / rest[1]) == pytest.approx(2, abs=0.1)
    assert np.log2(rest[1] / rest[2]) == pytest.approx(2, abs=0.1)


@pytest.mark.parametrize("kind", KINDS)
def test_small_and_applied_hessians_agree_and_are_symmetric(prior, touches, kind):
    chart, cases = KINDS[kind].chart(prior), gather(prior, touches)
    here = Objective(prior, chart, cases, np.zeros(chart.size))
    rng = np.random.default_rng(2)
    a, b = rng.normal(size=(2, chart.size))
    Ha, Hb = here.hessian(a), here.hessian(b)
    assert a @ Hb == pytest.approx(b @ Ha, rel=1e-9)
    assert a @ Ha > 0
    if kind != "element":
        assert np.allclose(here.dense_hessian @ a, Ha, rtol=1e-6, atol=1e-9 * abs(Ha).max())


def test_features_are_parameters_too(truth, prior, patches):
    height = truth.mesh.points[truth.mesh.tets].mean(axis=1)[:, 2:]
    E = 6e9 * np.exp(0.5 + 2 * height[:, 0])
    plant = truth.with_material(ps.Material(E, 0.35, 900.0))
    seen = [ps.observe(plant, ps.move(p, (0, 0.002, -0.003))) for p in patches[1:]]
    found = ps.estimate(
        prior, seen, parameters=ps.features(height, smooth=10.0, moduli="young")
    )
    assert found.material.young == pytest.approx(E, rel=1e-3)
    assert np.log(found.parameters["young[feature 0]"]) == pytest.approx(2, rel=1e-2)


def test_exact_touches_give_the_exact_limbs(truth, prior, patches):
    seen = [ps.observe(truth, ps.move(p, (0.002, 0.003, -0.005))) for p in patches[1:]]
    found = ps.estimate(prior, seen)
    assert found.young() == pytest.approx({"0": 5e9, "1": 8e9, "2": 3e9}, rel=1e-3)
    costs = [step.cost for step in found.stats.path]
    assert found.stats.path[-1].gradient < 1e-3 * found.stats.path[0].gradient or (
        costs[-1] < costs[0]
    )
    assert found.stats.status == "converged"


def test_every_kind_of_touch_counts(truth, prior, touches):
    steps = []
    found = ps.estimate(prior, touches, progress=steps.append)
    assert [s.iteration for s in steps] == list(range(found.stats.iterations + 1))
    for name, E in {"0": 5e9, "1": 8e9, "2": 3e9}.items():
        low, high = found.interval(0.999)[name]
        assert low < E < high
        assert found.std[name] < 0.05
        assert found.identified[name] > 0.95
    rms = np.sqrt(2 * found.stats.misfit / found.stats.readings)
    assert rms == pytest.approx(1, abs=0.1)
    # each alone teaches, but for a force whose field was not seen and was known
    for one in touches[:3]:
        alone = ps.estimate(prior, [one])
        assert max(alone.identified.values()) > 0.5


def test_what_was_not_touched_stays_as_uncertain_as_it_was(truth, prior, patches):
    # a push at the fork strains the trunk alone
    base = ps.nearest_vertices(truth.mesh, SKELETON.limbs[0].tip / 4, count=4)
    seen = ps.observe(truth, ps.move(base, (0.002, 0, 0)), force_noise=10.0, rng=1)
    known = ps.estimate(prior, seen, parameters=ps.per_limb(smooth=None)).identified
    assert known["0"] > 0.9
    assert known["1"] < 0.01
    assert known["2"] < 0.01


def test_steps_of_one_touch_are_one_load_case(truth, prior, patches):
    rng = np.random.default_rng(5)
    d = np.array([0.002, 0.003, -0.005])
    shares = np.arange(1, 16) / 15
    noise = {"displacement_noise": 1e-4, "force_noise": 20.0, "rng": rng}
    steps = [ps.observe(truth, ps.move(patches[1], s * d), **noise) for s in shares]
    weight = (shares**2).sum()
    one = replace(
        steps[-1],
        force=sum(s * o.force for s, o in zip(shares, steps, strict=True)) / weight,
        displacement=sum(s * o.displacement for s, o in zip(shares, steps, strict=True))
        / weight,
        force_noise=20.0 / np.sqrt(weight),
        displacement_noise=1e-4 / np.sqrt(weight),
    )
    many, single = ps.estimate(prior, steps), ps.estimate(prior, one)
    assert many.stats.cases == 1
    assert many.material.young == pytest.approx(single.material.young, rel=1e-9)
    assert list(many.std.values()) == pytest.approx(list(single.std.values()), rel=1e-9)


def test_a_level_off_by_eight_is_found_at_once(truth, patches):
    prior = truth.with_material(ps.Material(50e9, 0.3))
    seen = ps.observe(
        truth, ps.move(patches[1], (0, 0, -0.003)), force_noise=5.0, seen=[], rng=2
    )
    found = ps.estimate(prior, seen)
    assert found.stats.path[0].cost < 1e-3 * 0.5 * (found.observations[0].force ** 2).sum()
    assert found.young()["1"] == pytest.approx(8e9, rel=0.5)


def test_low_rank_posterior_is_the_exact_one(prior, touches):
    found = ps.estimate(prior, touches, parameters=ps.per_element())
    here = found._objective
    low = posterior(here)
    assert not low.exact
    p = here.chart.size
    H = np.stack([here.hessian(e) for e in np.eye(p)], axis=1)
    cov = np.linalg.inv(np.eye(p) + (H + H.T) / 2)
    from plantsim.estimation.posterior import limb_rows

    g = here.chart.adjoint(limb_rows(here.model)[1].T.toarray())
    exact = np.sqrt(np.einsum("ij,ij->j", g, cov @ g))
    assert list(found.std.values()) == pytest.approx(exact, rel=0.05)
    draws = low.draw(4000, np.random.default_rng(0))
    assert np.sqrt((g.T @ draws).var(axis=1)) == pytest.approx(exact, rel=0.08)
    assert found.tet_std.shape == (len(prior.mesh.tets),)
    materials = found.sample(3, rng=1)
    assert len(materials) == 3
    assert not np.array_equal(materials[0].mu, materials[1].mu)


def coverage(truth, plants, level=0.9):
    """Return the share of limbs whose modulus is within the interval found, and counts."""
    mesh = truth.mesh
    rng = np.random.default_rng(11)
    tips = [ps.nearest_vertices(mesh, limb.tip, count=4) for limb in SKELETON.limbs]
    prior = truth.with_material(ps.Material(6e9, 0.3))
    chart = ps.per_limb(moduli="young").chart(prior)
    inside = total = 0
    for _ in range(plants):
        # drawn from the prior itself
        mu, lam = np.split(chart.moduli(rng.normal(size=chart.size)), 2)
        plant = truth.with_material(ps.Material.lame(mu, lam))
        ids = tips[rng.integers(1, 3)]
        force = float(plant.contact(ids).force((0, 0, -0.003)).std())
        seen = ps.observe(
            plant,
            ps.move(ids, (0, 0, -0.003)),
            seen=mesh.surface_vertices[::7],
            displacement_noise=3e-4,
            force_noise=0.3 * force,
            rng=rng,
        )
        found = ps.estimate(
            prior, seen, parameters=ps.per_limb(moduli="young"), tolerance=1e-5
        )
        E = ps.Material.lame(mu, lam).young
        for name, (low, high) in found.interval(level).items():
            true = E[np.asarray(mesh.region) == mesh.region_names.index(name)][0]
            inside += low <= true <= high
            total += 1
    return inside / total, total


def test_intervals_cover_what_they_say(truth):
    share, total = coverage(truth, 40)
    # three standard deviations of a binomial share
    assert share == pytest.approx(0.9, abs=3 * np.sqrt(0.09 / total))


@pytest.mark.slow
def test_intervals_of_200_plants_cover_85_to_95_percent(truth):
    share, _ = coverage(truth, 200)
    assert 0.85 <= share <= 0.95


def test_prediction_holds_its_own_uncertainty(truth, prior, patches):
    rng = np.random.default_rng(4)
    seen = ps.observe(
        truth,
        ps.move(patches[1], (0.002, 0, -0.003)),
        displacement_noise=3e-4,
        force_noise=100.0,
        rng=rng,
    )
    found = ps.estimate(prior, seen)
    touch = ps.move(patches[2], (0.002, 0.001, -0.003))
    (told,) = ps.predict(found, touch)
    state = found.model.solve(touch)
    assert told.force == pytest.approx(state.force[state.moved], rel=1e-6)
    assert np.abs(told.displacement - state.displacement).max() < 1e-9
    assert (told.displacement_std[patches[2]] == 0).all()
    # against the forces of materials drawn from the posterior, not linearised
    drawn = np.array(
        [
            truth.with_material(m).contact(patches[2]).force(touch.displacement).sum(axis=0)
            for m in found.sample(200, rng=2)
        ]
    )
    assert told.total_std == pytest.approx(drawn.std(axis=0), rel=0.4)
    better = ps.estimate(prior, [seen, ps.observe(truth, touch, force_noise=1.0, rng=rng)])
    assert (ps.predict(better, touch)[0].total_std < 0.2 * told.total_std).all()


def test_score_is_the_paper_s(truth, prior, patches):
    touch = ps.move(patches[1], (0, 0, -0.003))
    off = ps.score(prior, truth, [touch])
    a, b = prior.solve(touch), truth.solve(touch)
    gap = np.linalg.norm(a.displacement - b.displacement, axis=1).mean()
    assert off.visual == pytest.approx(100 * gap, rel=1e-6)
    f = np.linalg.norm((a.force - b.force)[patches[1]], axis=1).sum()
    assert off.tactile == pytest.approx(f, rel=1e-6)
    seen = ps.observe(truth, touch)
    assert ps.score(prior, seen).tactile_relative == pytest.approx(off.tactile_relative)
    assert ps.score(truth, truth, touch).visual < 1e-9
    found = ps.estimate(prior, seen)
    assert ps.score(found, truth, touch).tactile < 1e-3 * off.tactile
    with pytest.raises(ps.EstimateError, match="needs touches"):
        ps.score(prior, truth)


def test_next_touch_goes_where_nothing_is_known(truth, prior, patches):
    seen = ps.observe(
        truth, ps.move(patches[1], (0, 0, -0.003)), force_noise=20.0, seen=[], rng=1
    )
    found = ps.estimate(prior, seen)
    touches = [ps.move(p, (0, 0, -0.003)) for p in patches[1:]]
    for criterion in ("A", "D"):
        plan = ps.next_touch(found, touches, criterion=criterion, seen=[])
        assert plan.index == 1
        assert plan.gain[1] > plan.gain[0] > 0
    # asked for the force at the limb touched already, or paid for it, it stays there
    near = ps.next_touch(found, touches, seen=[], cost=[1e-3, 1.0])
    assert near.index == 0
    ask = ps.next_touch(found, touches, criterion=touches[1], seen=[])
    assert ask.index == 1
    assert ask.gain[1] > 0.9
    alone = ps.next_touch(found, patches[2], depth=0.005)
    assert alone.touch.ids[0] in patches[2]
    with pytest.raises(ps.EstimateError, match="cost"):
        ps.next_touch(found, touches, cost=[1.0])
    with pytest.raises(ps.EstimateError, match="criterion"):
        ps.next_touch(found, touches, criterion="E")


def test_the_gain_promised_is_the_gain_had(truth, prior, patches):
    noise = {"force_noise": 20.0, "displacement_noise": 1e-3}
    first = ps.observe(truth, ps.move(patches[1], (0, 0, -0.003)), **noise, rng=1)
    found = ps.estimate(prior, first)
    touch = ps.move(patches[2], (0, 0, -0.003))
    plan = ps.next_touch(found, [touch])
    again = ps.estimate(prior, [first, ps.observe(truth, touch, **noise, rng=2)])
    before, after = (sum(s**2 for s in f.std.values()) for f in (found, again))
    assert 1 - after / before == pytest.approx(plan.gain[0], abs=0.05)


def test_bad_map_estimates_are_refused(truth, prior, patches, touches):
    with pytest.raises(ps.EstimateError, match="no force, and no displacement"):
        ps.estimate(prior, ps.Observation(moved=patches[1], move=(0, 0, 0.001)))
    with pytest.raises(ps.EstimateError, match="zero throughout"):
        ps.estimate(
            prior,
            ps.Observation(moved=patches[1], move=(0, 0, 0.001), wrench=np.zeros(3)),
        )
    with pytest.raises(ps.EstimateError, match="knows no uncertainty"):
        exact = ps.observe(truth, ps.move(patches[1], (0, 0, -0.003)))
        _ = ps.estimate(prior, exact, method="force-balance").std
    with pytest.raises(ps.EstimateError, match="not converged after 1 "):
        ps.estimate(prior, touches, iterations=1)
    with pytest.raises(ps.EstimateError, match="level is 2"):
        ps.estimate(prior, touches).interval(2)
    with pytest.raises(ps.EstimateError, match="without a moved vertex"):
        ps.Observation(moved=[], move=np.zeros((0, 3)), force=np.zeros((0, 3)))


def hit(start, end, corners):
    """Return whether a segment crosses any triangle (t, 3, 3): Moller and Trumbore 1997."""
    a, e, f = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    way = end - start
    h = np.cross(way, f)
    det = (e * h).sum(axis=1)
    s = start - a
    u = (s * h).sum(axis=1) / det
    q = np.cross(s, e)
    v, t = q @ way / det, (f * q).sum(axis=1) / det
    return bool(((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0) & (t < 1)).any())


def test_visible_vertices_are_those_that_no_triangle_hides(mesh):
    pytest.importorskip("vtkmodules")
    far = np.array([10.0, 1.0, 0.15])
    seen = ps.visible_vertices(mesh, far)
    on = mesh.surface_vertices
    corners = mesh.points[mesh.triangles]
    start = mesh.points[on] + 1e-5 * (far - mesh.points[on])
    free = [not hit(p, far, corners) for p in start]
    assert np.mean(np.isin(on, seen) == free) > 0.98
    assert 0.3 < np.mean(free) < 0.8
    # a camera that looks away sees nothing; one that looks here, the same
    assert not len(ps.visible_vertices(mesh, ps.Camera(far, 2 * far)))
    assert np.array_equal(ps.visible_vertices(mesh, ps.Camera(far, (0, 0, 0.15))), seen)
    narrow = ps.visible_vertices(mesh, ps.Camera(far, (0, 0, 0), angle=1.0))
    assert 0 < len(narrow) < len(seen)
    with pytest.raises(ps.ModelError, match="angle"):
        ps.Camera(far, far)


@pytest.mark.parametrize("suffix", [".npz", ".h5"])
def test_all_fields_round_trip(tmp_path, touches, suffix):
    if suffix == ".h5":
        pytest.importorskip("h5py")
    path = ps.write_observations(touches, tmp_path / f"touches{suffix}")
    back = ps.read_observations(path)
    assert len(back) == len(touches)
    for a, b in zip(touches, back, strict=True):
        for name in a.__dataclass_fields__:
            one, other = getattr(a, name), getattr(b, name)
            assert (one is None) == (other is None)
            assert one is None or np.array_equal(one, other)
    whole = path.read_bytes()
    for size in (len(whole) // 3, len(whole) - 100):
        path.write_bytes(whole[:size])
        with pytest.raises(ps.FileError, match="not a file of observations, or cut short"):
            ps.read_observations(path)


def test_hdf5_is_plain(tmp_path, touches):
    h5py = pytest.importorskip("h5py")
    path = ps.write_observations(touches, tmp_path / "touches.h5")
    with h5py.File(path) as file:
        assert file.attrs["format"] == "plantsim observations"
        assert file["0/displacement"].attrs["units"] == "m"
        assert file["0/force"][:] == pytest.approx(touches[0].force)
    with h5py.File(path, "a") as file:
        file.attrs["version"] = 99
    with pytest.raises(ps.FileError, match="later version"):
        ps.read_observations(path)
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["points"] = np.zeros(3)
    with pytest.raises(ps.FileError, match="not a file of observations"):
        ps.read_observations(tmp_path / "other.h5")


def _slabs(mesh, prior, **noise):
    """Forty slabs: a Hessian now and then, CG in between, three touches first."""
    z = mesh.points[mesh.tets].mean(axis=1)[:, 2]
    slab = np.argsort(np.argsort(z)) * 40 // len(z)
    log = 0.3 * np.random.default_rng(4).normal(size=40)[slab]
    stiffer = ps.Material(6e9 * np.exp(log), 0.35, 900.0)
    truth = prior.with_material(stiffer)
    rng = np.random.default_rng(8)
    touches = ps.sample_touches(truth, 8, rng=2)
    seen = [ps.observe(truth, t.last, **noise, rng=rng) for t in touches]
    return slab, truth, seen


def test_a_few_touches_lead_the_way_and_all_decide(mesh, prior):
    slab, _, seen = _slabs(mesh, prior, displacement_noise=1e-3, force_noise=2e4)
    kind = ps.per_region(slab, moduli="young")
    found = ps.estimate(prior, seen, parameters=kind, tolerance=1e-7)
    assert found.stats.cases == 8
    # where all touches begin, after three, most is explained
    path = found.stats.path
    start, begin = (s.iteration for s in path if s.change == 0)
    assert start == 0
    assert 2 < begin
    chart, cases = kind.chart(prior), gather(prior, seen)
    assert _first(prior, chart, cases).cost > 4 * found.stats.cost
    assert path[begin].cost < 1.5 * found.stats.cost
    here = Objective(prior, chart, cases, found._objective.xi)
    assert here.cost == pytest.approx(found.stats.cost, rel=1e-9)
    g, H = here.gradient(), here.dense_hessian + np.eye(chart.size)
    assert g @ np.linalg.solve(H, g) < 1e-6 * here.cost
    assert 2 * here.misfit == pytest.approx(found.stats.readings, rel=0.1)


def test_touches_that_the_model_cannot_explain_do_not_lead(mesh, truth, prior):
    # slabs across a fork of three limbs, noise of a hundredth of what they leave over
    slab, _, _ = _slabs(mesh, prior)
    rng = np.random.default_rng(8)
    seen = [
        ps.observe(truth, t.last, displacement_noise=1e-4, force_noise=20.0, rng=rng)
        for t in ps.sample_touches(truth, 8, rng=2)
    ]
    found = ps.estimate(prior, seen, parameters=ps.per_region(slab, moduli="young"))
    assert 2 * found.stats.misfit > 1e3 * found.stats.readings
