"""Shared meshes and the reference data, which live outside the project."""

import os
import signal
from pathlib import Path

import numpy as np
import pytest

import plantsim as ps
from plantsim.datasets.recipe import Kind, Meshing, Touching

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(autouse=True, scope="session")
def _interruptible():
    """Heed interrupts, which whatever runs in the background ignores."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture(scope="session")
def reference() -> Path:
    """Folder of the reference meshes; skips where it is absent."""
    shared = Path(os.environ.get("PLANTSIM_SHARED", ROOT.parent / "shared"))
    folder = shared / "reference_meshes"
    if not folder.is_dir():
        pytest.skip(f"no reference meshes at {folder} (set PLANTSIM_SHARED)")
    return folder


@pytest.fixture(scope="session")
def cantilever() -> ps.TetMesh:
    """A straight limb, 0.3 m long, flat tip; order 2, curved."""
    return ps.tetrahedralize(ps.sweep(ps.straight(0.3, 0.02), tips="flat"))


@pytest.fixture(scope="session")
def fork() -> ps.TetMesh:
    """Three limbs joined; order 2."""
    return ps.tetrahedralize(ps.sweep(ps.fork(0.3, 0.02)), 1.2)


@pytest.fixture
def cube() -> ps.TetMesh:
    """The unit cube in six tets, order 1, the set "base" at z = 0."""
    corners = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)], float)
    paths = [(1, 3), (3, 2), (2, 6), (6, 4), (4, 5), (5, 1)]
    tets = np.array([[0, a, b, 7] for a, b in paths])
    return ps.TetMesh(corners, tets, sets={"base": np.arange(4)})


@pytest.fixture(scope="session")
def recipe() -> ps.Recipe:
    """Crowns of strawberries, order 1, no touches: a tenth of a second a plant."""
    kind = Kind("strawberry", ps.species("strawberry"), levels=1)
    touch = Touching(touches=1, steps=1, seen=20)
    return ps.Recipe(plants=8, species=(kind,), mesh=Meshing(order=1), touch=touch)
