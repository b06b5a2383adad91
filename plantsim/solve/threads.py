"""Threads: independent pieces of work at once, where what they call gives up Python's lock.

SuperLU's solves, scipy's sparse products and numpy's loops do. BLAS does too, but has
threads of its own, which spin: pieces keep to einsum, and to right-hand sides so few that
BLAS starts none.
"""

import os
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import TypeVar

T = TypeVar("T")
NAME = "plantsim-solve"


def together(work: Callable[[int], T], count: int) -> list[T]:
    """Return work(0), ..., work(count - 1), made by as many threads as there are cores.

    Within a piece of work its own pieces are made one after another.
    """
    if count < 2 or threading.current_thread().name.startswith(NAME):
        return [work(i) for i in range(count)]
    return list(_pool().map(work, range(count)))


def shares(count: int, most: int, least: int = 1) -> list[slice]:
    """Return 0 ... count - 1 cut in runs of at most `most`, one as long as another.

    `least`: so many runs at least, if there are as many things.

    >>> shares(10, 6)
    [slice(0, 5, None), slice(5, 10, None)]
    """
    runs = max(-(-count // most), min(least, count), 1)
    width = -(-count // runs)
    return [slice(i, min(i + width, count)) for i in range(0, count, max(width, 1))]


@cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(min(4, os.cpu_count() or 1), NAME)


if hasattr(os, "register_at_fork"):  # threads do not live on in a forked process
    os.register_at_fork(after_in_child=_pool.cache_clear)
