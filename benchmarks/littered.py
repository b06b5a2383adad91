"""A C heap full of holes and noise, as any earlier work may leave it."""

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from plantsim.solid.heap import glibc


@contextmanager
def littered(seed: int) -> Iterator[None]:
    """Allocate 20,000 blocks of 16 to 30,000 bytes, full of noise, and free every other.

    The rest goes at the end. Does nothing where the C library is not glibc.
    """
    libc = glibc()
    if libc is None:
        yield
        return
    rng = np.random.default_rng(seed)
    sizes = np.exp(rng.uniform(np.log(16), np.log(30_000), 20_000)).astype(int)
    places = [libc.malloc(int(size)) for size in sizes]
    for place, size in zip(places, sizes, strict=True):
        ctypes.memset(place, seed + 1, int(size))
    rng.shuffle(places)
    half = len(places) // 2
    for place in places[:half]:
        libc.free(place)
    try:
        yield
    finally:
        for place in places[half:]:
            libc.free(place)
