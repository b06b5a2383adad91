"""The proofs of benchmarks/proof.py, in their quick forms."""

import importlib.util
import sys
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).resolve().parent.parent / "benchmarks"


@pytest.fixture(scope="module")
def proof():
    spec = importlib.util.spec_from_file_location("proof", BENCHMARKS / "proof.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["proof"] = module
    spec.loader.exec_module(module)
    return module


def test_blocks_are_exact(proof):
    for row in proof.run(proof.blocks):
        assert abs(row.error) < 1e-9, row


@pytest.mark.parametrize("case", ["torsion_and_moment", "code_aster"])
def test_cantilevers_are_within_one_percent(proof, case):
    for row in proof.run(getattr(proof, case)):
        assert abs(row.error) < (2e-5 if "formula" in row.case else 0.01), row


def test_vibrations(proof):
    found = proof.run(proof.vibrations)
    timoshenko = [r for r in found if "Timoshenko" in r.case]
    assert len(timoshenko) == 3
    for row in timoshenko:
        # the clamp, alike for all three, and no more
        assert 0.001 < row.error < 0.006, row


def test_a_fork_lies_between_two_frames_and_goes_to_both(proof):
    wide, thin = proof.elbow(1.0), proof.elbow(0.5)
    for soft, stiff, ours in (wide, thin):
        assert stiff < ours < soft
    (soft, stiff, ours), (soft2, stiff2, ours2) = wide, thin
    assert 1 - ours2 / soft2 < 0.6 * (1 - ours / soft)
    assert ours2 / stiff2 - 1 < 0.7 * (ours / stiff - 1)


def test_what_a_clamp_adds_is_poissons_effect(proof):
    known, ours = proof.middle("clamped", poisson=0.0)
    assert ours == pytest.approx(known, rel=0.003)
    known, ours = proof.middle("clamped")
    assert -0.02 < ours / known - 1 < -0.005
    known, ours = proof.middle("propped", poisson=0.0)
    assert ours == pytest.approx(known, rel=0.003)


@pytest.mark.parametrize(("order", "cells", "known"), [(1, (8, 16), 2), (2, (3, 6), 3)])
def test_manufactured_solution_converges(proof, order, cells, known):
    _, slope = proof.rate(order, cells)
    assert slope == pytest.approx(known, abs=0.2)


def test_multigrid_on_a_slender_cantilever():
    spec = importlib.util.spec_from_file_location("multigrid", BENCHMARKS / "multigrid.py")
    assert spec is not None
    assert spec.loader is not None
    bench = importlib.util.module_from_spec(spec)
    sys.modules["multigrid"] = bench
    spec.loader.exec_module(bench)
    for order, times in ((1, 2), (2, 1)):
        found = bench.refinements("60:1", *bench.slender(), times=times, order=order)
        assert len(found) == times + 1
        assert 0 < min(found)
        assert max(found) <= 45
        assert max(found) <= 1.5 * found[0]
