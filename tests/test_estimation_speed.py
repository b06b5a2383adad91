"""What makes an estimate fast leaves its numbers as they are."""

import os
import subprocess
import sys
import threading

import numpy as np
import pytest

import plantsim as ps
from plantsim.estimation import response
from plantsim.estimation.cases import gather
from plantsim.estimation.direction import Memory, conjugate_step, direction_of
from plantsim.estimation.output_error import Objective
from plantsim.solve import sections, threads

SKELETON = ps.fork(0.3, 0.02)


@pytest.fixture(scope="module")
def truth():
    mesh = ps.tetrahedralize(ps.sweep(SKELETON), 1.2, order=1)
    young = np.array([5e9, 8e9, 3e9])[mesh.region]
    return ps.ElasticModel(mesh, ps.Material(young, 0.3, 900.0))


@pytest.fixture(scope="module")
def seen(truth):
    rng = np.random.default_rng(3)
    return [
        ps.observe(truth, t.last, displacement_noise=1e-3, force_noise=20.0, rng=rng)
        for t in ps.sample_touches(truth, 5, rng=2)
    ]


@pytest.fixture
def objective(truth, seen):
    prior = truth.with_material(ps.Material(6e9, 0.35, 900.0))
    chart = ps.per_element().chart(prior)

    def made():
        return Objective(prior, chart, gather(prior, seen), np.zeros(chart.size))

    return made


def numbers(here):
    v = np.random.default_rng(1).normal(size=here.chart.size)
    return here.gradient(), here.hessian(v)


def test_shares_are_made_by_threads_and_the_numbers_are_the_same(objective, monkeypatch):
    monkeypatch.setattr(sections, "THIN", 0)  # those are for the sparse factor alone
    whole = numbers(objective())
    monkeypatch.setattr(response, "LARGE", 0)  # small as it is, cases go in two shares
    used = set()
    force_matrix = response.Response._force_matrix

    def noted(self, share, pattern):
        used.add(threading.current_thread().name)
        return force_matrix(self, share, pattern)

    monkeypatch.setattr(response.Response, "_force_matrix", noted)
    shared = numbers(objective())
    assert all(name.startswith(threads.NAME) for name in used)
    monkeypatch.setattr(
        response, "together", lambda work, count: [work(i) for i in range(count)]
    )
    alone = numbers(objective())
    for a, b, c in zip(whole, shared, alone, strict=True):
        assert np.array_equal(b, c)  # whatever the number of threads
        assert np.allclose(a, b, rtol=1e-9, atol=1e-9 * np.abs(a).max())


def test_work_within_work_is_done_by_the_same_thread():
    def outer(_):
        name = threading.current_thread().name
        return name, threads.together(lambda _: threading.current_thread().name, 3)

    for name, inner in threads.together(outer, 8):
        assert inner == [name] * 3


@pytest.mark.parametrize(("count", "least"), [(0, 1), (1, 2), (4, 2), (10, 2), (13, 1)])
def test_shares_hold_everything_once(count, least):
    runs = threads.shares(count, 6, least)
    assert [i for run in runs for i in range(count)[run]] == list(range(count))
    assert all(run.stop - run.start <= 6 for run in runs)


def test_cg_takes_no_more_iterations_than_there_are_eigenvalues():
    # forty as far apart as those of an estimate, the others 1
    rng = np.random.default_rng(4)
    Q = np.linalg.qr(rng.normal(size=(400, 40)))[0]
    values = np.logspace(1, 9, 40)
    g = rng.normal(size=400) + Q @ (np.sqrt(values) * rng.normal(size=40))

    def product(v):
        return v + Q @ (values * (Q.T @ v))

    step, P, HP = conjugate_step(product, g, np.copy, 41, 1e-300)
    exact = -(g - Q @ (values / (1 + values) * (Q.T @ g)))
    assert len(P) <= 41
    assert np.linalg.norm(step - exact) < 1e-5 * np.linalg.norm(exact)
    assert np.allclose(P @ HP.T, np.eye(len(P)), atol=1e-6)


def test_a_step_remembered_is_found_again_at_once(objective):
    here, memory = objective(), Memory()
    g = here.gradient()
    first, count = direction_of(here, g, memory, 200, 1e-3)
    again, fewer = direction_of(here, g, memory, 200, 1e-3)
    assert fewer < count / 3
    assert g @ again == pytest.approx(g @ first, rel=1e-3)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
def test_threads_work_in_a_forked_process():
    """The parent's threads are not there, though its pool says so."""
    assert threads.together(abs, 4) == [0, 1, 2, 3]
    script = (
        "import os, signal\n"
        "from plantsim.solve.threads import together\n"
        "together(abs, 4)\n"
        "if os.fork() == 0:\n"
        "    signal.alarm(20)\n"
        "    os._exit(together(abs, 4) != [0, 1, 2, 3])\n"
        "raise SystemExit(os.wait()[1])\n"
    )
    subprocess.run([sys.executable, "-c", script], check=True, timeout=60)
