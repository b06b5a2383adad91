"""A heap without holes, so that code that depends on what was freed is repeatable."""

import ctypes
import mmap
import sys
from collections.abc import Iterator
from contextlib import contextmanager

TRIM_THRESHOLD, TOP_PAD, MMAP_THRESHOLD = -1, -2, -3  # glibc's mallopt
LARGEST = 32 << 20  # bytes; what glibc ever takes from the heap
ALONE = 16 << 10  # bytes; longer arrays come from the system inside `fresh_heap`
RESERVE = 128 << 10  # bytes; what glibc asks for beyond its need
WORD = 8  # bytes
LAST_BIN = 1032  # bytes; smaller requests have lists of free chunks of just their size


class _Mallinfo2(ctypes.Structure):
    _fields_ = [
        (name, ctypes.c_size_t)
        for name in (
            "arena ordblks smblks hblks hblkhd usmblks fsmblks uordblks fordblks keepcost"
        ).split()
    ]


def glibc() -> ctypes.CDLL | None:
    """Return glibc (2.33 or later) with the types of what is called here, or None."""
    if not sys.platform.startswith("linux"):
        return None
    libc = ctypes.CDLL(None)
    try:
        libc.mallinfo2.restype = _Mallinfo2
    except AttributeError:  # another C library: musl, or an older glibc
        return None
    libc.malloc.restype, libc.malloc.argtypes = ctypes.c_void_p, [ctypes.c_size_t]
    libc.free.argtypes = [ctypes.c_void_p]
    libc.sbrk.restype, libc.sbrk.argtypes = ctypes.c_void_p, [ctypes.c_ssize_t]
    return libc


@contextmanager
def fresh_heap() -> Iterator[None]:
    """Let what is asked for inside lie in order, on zeros, and large arrays by themselves.

    Where recovering a surface takes a further point, HXT (gmsh 4.15.2) reads and writes one
    or two values beyond arrays of one value a vertex or triangle (valgrind shows it, also
    without its optimisation). On a used heap this makes meshes that differ from run to run,
    or crashes. So all holes of the heap are filled first; arrays of more than a few pages
    come from the system one by one, with zeros up to the end of their last page. Vertices
    then also have addresses in the order of their numbers, in which HXT is given them.
    Needs glibc; elsewhere it does nothing.
    """
    libc = glibc()
    if libc is None:
        yield
        return
    libc.mallopt(MMAP_THRESHOLD, ALONE)
    libc.mallopt(TOP_PAD, 0)  # or large arrays are cut from what the heap has in reserve
    libc.malloc_trim(0)
    kept = []
    size = ALONE // 2
    while size > 0:
        end = libc.sbrk(0) - libc.mallinfo2().keepcost
        places = [libc.malloc(size) for _ in range(16)]
        kept += places
        if None in places or min(places) > end - 64:  # no hole was left of this size
            size = size // 2 if size > 2 * LAST_BIN else size - 16
    try:
        yield
    finally:
        for place in kept:
            libc.free(place)
        libc.malloc_trim(0)  # pages of the holes go back, or every mesh leaves some
        # where glibc's own thresholds end that move with what was freed
        libc.mallopt(MMAP_THRESHOLD, LARGEST)
        libc.mallopt(TRIM_THRESHOLD, 2 * LARGEST)
        libc.mallopt(TOP_PAD, RESERVE)


def room_behind(length: int) -> int:
    """Return how many bytes follow an array of `length` bytes in a `fresh_heap`."""
    if glibc() is None or length < ALONE:
        return 0
    page = mmap.PAGESIZE
    return -(length + 2 * WORD) % page
