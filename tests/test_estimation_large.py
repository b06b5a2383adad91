"""Estimation at large rotation: derivatives, and moduli from touches 0.15 m deep."""

import numpy as np
import pytest

import plantsim as ps
from plantsim.estimation.cases import gather
from plantsim.estimation.large_response import LargeResponse
from plantsim.estimation.output_error import Objective

SKELETON = ps.fork(0.4, 0.012)
YOUNG = {"0": 5e9, "1": 8e9, "2": 3e9}


@pytest.fixture(scope="module")
def truth():
    mesh = ps.tetrahedralize(ps.sweep(SKELETON), 1.4, order=1)
    young = np.array(list(YOUNG.values()))[np.asarray(mesh.region)]
    return ps.ElasticModel(mesh, ps.Material(young, 0.3, 900), kinematics="corotational")


@pytest.fixture(scope="module")
def prior(truth):
    return truth.with_material(ps.Material(6e9, 0.3, 900.0))


@pytest.fixture(scope="module")
def patches(truth):
    return [ps.nearest_vertices(truth.mesh, limb.tip, count=5) for limb in SKELETON.limbs]


@pytest.fixture(scope="module")
def touches(truth, patches):
    """A deep touch twice, a grasp that turns, a weight, a force at the wrist."""
    noise = {"displacement_noise": 1e-3, "force_noise": 5.0}
    rng = np.random.default_rng(3)
    d = (0.1, 0.03, -0.11)
    half = np.arange(0, len(truth.mesh.points), 2)
    grip = ps.grasp(patches[2], translation=(-0.06, 0, -0.03), rotation=(0, -0.5, 0.1))
    return [
        ps.observe(truth, ps.move(patches[1], d), **noise, rng=rng),
        ps.observe(truth, ps.move(patches[1], d), **noise, rng=rng),
        ps.observe(truth, grip, seen=half, **noise, rng=rng),
        ps.observe(truth, ps.force(patches[2], (30.0, 0, -100.0)), **noise, rng=rng),
        ps.observe(
            truth, ps.move(patches[2], (0, 0.1, 0)), ps.gravity(), seen=[],
            feels="total", **noise, rng=rng,
        ),
    ]  # fmt: skip


KINDS = {"element": ps.per_element(), "limb": ps.per_limb()}


@pytest.mark.parametrize("kind", KINDS)
def test_gradient_passes_taylor_s_test(prior, touches, kind):
    chart, cases = KINDS[kind].chart(prior), gather(prior, touches)
    assert len(cases) == 4  # the same touch twice is one equilibrium
    rng = np.random.default_rng(1)
    xi, v = 0.3 * rng.normal(size=(2, chart.size))
    here = Objective(prior, chart, cases, xi)
    assert isinstance(here.response, LargeResponse)
    slope = here.gradient() @ v
    steps = np.array([1e-2, 5e-3, 2.5e-3])
    rest = [
        abs(
            Objective(prior, chart, cases, xi + h * v, here.response).cost
            - here.cost
            - h * slope
        )
        for h in steps
    ]
    assert np.log2(rest[0] / rest[1]) == pytest.approx(2, abs=0.1)
    assert np.log2(rest[1] / rest[2]) == pytest.approx(2, abs=0.1)


@pytest.mark.parametrize("kind", KINDS)
def test_changes_are_those_of_the_equilibria_and_pull_is_their_transpose(
    prior, touches, kind
):
    chart, cases = KINDS[kind].chart(prior), gather(prior, touches)
    rng = np.random.default_rng(2)
    v = rng.normal(size=chart.size)
    here = Objective(prior, chart, cases, np.zeros(chart.size))
    du, df = here.response.change(chart.log(v))
    h = 1e-3
    ahead, behind = (
        Objective(prior, chart, cases, s * h * v, here.response).response for s in (1, -1)
    )
    numeric = (ahead.u - behind.u) / (2 * h)
    assert np.abs(du - numeric).max() < 1e-3 * np.abs(numeric).max()
    for f, a, b in zip(df, ahead.force, behind.force, strict=True):
        assert np.abs(f - (a - b) / (2 * h)).max(initial=0) < 1e-3 * np.abs(a).max(
            initial=1
        )
    by_u = rng.normal(size=du.shape)
    by_f = [rng.normal(size=f.shape) for f in df]
    back = chart.adjoint(here.response.pull(by_u, by_f)) @ v
    ahead_too = np.vdot(by_u, du) + sum(f @ g for f, g in zip(df, by_f, strict=True))
    assert back == pytest.approx(ahead_too, rel=1e-8)
    each = [here.response.change_of(t, chart.log(v)[:, None]) for t in range(len(cases))]
    assert np.allclose(np.hstack([u for u, _ in each]), du, atol=1e-9 * np.abs(du).max())


def test_touches_at_large_rotation_give_the_limbs_within_their_intervals(prior, touches):
    found = ps.estimate(prior, touches)
    for name, E in YOUNG.items():
        low, high = found.interval(0.999)[name]
        assert low < E < high
        assert found.std[name] < 0.1
    rms = np.sqrt(2 * found.stats.misfit / found.stats.readings)
    assert rms == pytest.approx(1, abs=0.1)


def test_exact_touches_give_the_exact_limbs_and_a_linear_model_does_not(
    truth, prior, patches
):
    seen = [ps.observe(truth, ps.move(p, (0.072, 0.04, -0.088))) for p in patches[1:]]
    found = ps.estimate(prior, seen)
    assert found.young() == pytest.approx(YOUNG, rel=1e-3)
    straight = ps.ElasticModel(prior.mesh, prior.material)
    linear = ps.estimate(straight, [_noisy(one) for one in seen])
    off = [abs(E / YOUNG[name] - 1) for name, E in linear.young().items()]
    assert max(off) > 0.3


def _noisy(seen):
    """Return the touch with the noise that a linear fit is to think it has."""
    return ps.Observation(
        moved=seen.moved, move=seen.move, force=seen.force, seen=seen.seen,
        displacement=seen.displacement, force_noise=1.0, displacement_noise=1e-3,
    )  # fmt: skip


def test_predictions_and_the_next_touch_know_large_rotation(truth, prior, touches, patches):
    found = ps.estimate(prior, touches)
    touch = ps.move(patches[1], (0.0, 0.12, -0.05))
    told = ps.predict(found, touch)[0]
    state = truth.solve(touch)
    off = np.abs(told.displacement - state.displacement)
    assert (off <= 5 * told.displacement_std + 1e-5).all()
    total = (told.force - state.force[state.moved]).sum(axis=0)
    assert (np.abs(total) <= 5 * told.total_std).all()
    proposal = ps.next_touch(
        found, candidates=[patches[1][:1][0], patches[2][0]], depth=0.1
    )
    assert (proposal.gain > 0).all()
