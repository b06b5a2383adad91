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
    first, second, _ = proof.run(proof.vibrations)
    assert abs(first.error) < 0.01
    assert abs(second.error) < 0.01


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
    found = bench.refinements("60:1", *bench.slender())
    assert 0 < max(found) <= 45
    assert max(found) <= 1.5 * found[0]
