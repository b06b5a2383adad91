"""The same plant gives the same mesh, whatever the process did before."""

import subprocess
import sys
import tomllib

import numpy as np
import pytest

import plantsim as ps
from benchmarks.littered import littered
from plantsim.datasets.draw import GROWTH, drawn, stream
from plantsim.datasets.recipe import Recipe, example
from plantsim.solid import heap

pytestmark = pytest.mark.skipif(heap.glibc() is None, reason="needs glibc 2.33 or later")


def tomato() -> ps.Solid:
    """Plant 12 of the example, on which HXT of gmsh 4.15.2 gave four meshes or crashed."""
    recipe = Recipe.from_mapping(tomllib.loads(example()))
    plant = drawn(recipe, 12)
    thinnest = plant.kind.min_radius or None
    rng = stream(recipe, 12, GROWTH)
    growth = {"min_radius": thinnest, "max_limbs": plant.max_limbs}
    return ps.sweep(ps.weber_penn(plant.model, rng, plant.kind.levels, **growth))


def test_same_mesh_on_a_littered_heap():
    solid = tomato()
    first = ps.tetrahedralize(solid, 1.25)
    for seed in range(3):
        with littered(seed):
            again = ps.tetrahedralize(solid, 1.25)
        assert np.array_equal(again.points, first.points)
        assert np.array_equal(again.tets, first.tets)


def test_no_hole_is_left():
    """What is asked for inside lies beyond everything that was there."""
    libc = heap.glibc()
    assert libc is not None
    with littered(0), heap.fresh_heap() as begin:
        end = libc.sbrk(0) - libc.mallinfo2().keepcost
        begin()
        inside = [libc.malloc(size) for size in (24, 72, 500, 5000, 16000)]
    assert min(inside) > end - 64
    for place in inside:
        libc.free(place)


FILLED = """
import ctypes, mmap
from pathlib import Path
from plantsim.solid import heap

def held():
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * mmap.PAGESIZE / 2**20

libc = heap.glibc()
with heap.fresh_heap():
    pass  # from here on, what is asked for comes from the heap
large = [libc.malloc(2**20) for _ in range(64)]
last = libc.malloc(2**20)
for place in large:
    ctypes.memset(place, 1, 2**20)
    libc.free(place)
libc.malloc_trim(0)
before = held()
with heap.fresh_heap() as begin:
    begin()
    assert held() < before + 8, (before, held())
"""


def test_filling_a_large_hole_takes_no_memory():
    """In a process without other holes."""
    subprocess.run([sys.executable, "-c", FILLED], check=True, timeout=60)
