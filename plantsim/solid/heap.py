"""A heap without holes, so that code that depends on what was freed is repeatable."""

import ctypes
import gc
import mmap
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

TRIM_THRESHOLD, TOP_PAD, MMAP_THRESHOLD = -1, -2, -3  # glibc's mallopt
LARGEST = 32 << 20  # bytes; what glibc ever takes from the heap
ALONE = 16 << 10  # bytes; longer arrays come from the system inside `fresh_heap`
RESERVE = 128 << 10  # bytes; what glibc asks for beyond its need
WORD = 8  # bytes
LAST_BIN = 1032  # bytes; smaller requests have lists of free chunks of just their size
LISTED = 16  # chunks that such a list holds at most


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
def fresh_heap() -> Iterator[Callable[[], None]]:
    """Let what is asked for inside lie in order, on zeros, and large arrays by themselves.

    From the call of the function that is yielded on: what shall stay small and low, as
    gmsh's own start, comes before that, and what is asked for is let go of before the end.

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
        yield lambda: None
        return
    holes = _Chunks(libc)
    collecting = gc.isenabled()
    gc.disable()  # what is made inside stays of the youngest generation

    def begin() -> None:
        libc.mallopt(MMAP_THRESHOLD, LARGEST)
        libc.mallopt(TOP_PAD, 0)
        holes.take_holes()
        libc.malloc_trim(0)  # or large arrays are cut from what it has in reserve
        libc.mallopt(MMAP_THRESHOLD, ALONE)

    try:
        yield begin
    finally:
        gc.collect(0)  # types that ctypes makes for arrays are in cycles
        if collecting:
            gc.enable()
        # lists of freed chunks hold some of what was asked for inside: they are to hold
        # what lies lower, or the next fill would begin behind those, and the heap grow
        holes.take_listed()
        holes.free()
        libc.malloc_trim(0)  # pages of the holes go back, or every mesh leaves some
        # where glibc's own thresholds end that move with what was freed
        libc.mallopt(MMAP_THRESHOLD, LARGEST)
        libc.mallopt(TRIM_THRESHOLD, 2 * LARGEST)
        libc.mallopt(TOP_PAD, RESERVE)


class _Chunks:
    """Chunks of the heap, each with the address of the one before: a list would grow."""

    def __init__(self, libc: ctypes.CDLL) -> None:
        self.libc = libc
        self.last = 0

    def _take(self, place: int) -> None:
        ctypes.c_size_t.from_address(place).value = self.last
        self.last = place

    def take_holes(self) -> None:
        """Take all that is free in the heap, largest first.

        Large holes go in few pieces, of which a page each is touched: they take no memory.
        """
        end = self.libc.sbrk(0) - self.libc.mallinfo2().keepcost
        size = LARGEST // 2
        while size > 0:
            place = self.libc.malloc(size) or end  # none: there is a limit to memory
            if place < end:
                self._take(place)
            else:  # no hole was left of this size
                if place > end:
                    self.libc.free(place)
                size = size // 2 if size > 2 * LAST_BIN else size - 2 * WORD

    def take_listed(self) -> None:
        """Take chunks until no list of freed ones of some size holds any."""
        for size in range(WORD, LAST_BIN + 1, 2 * WORD):
            for _ in range(LISTED):
                if place := self.libc.malloc(size):
                    self._take(place)

    def free(self) -> None:
        """Free all, what is lowest first: that fills the lists, and the rest is joined."""
        places = []
        while self.last:
            places.append(self.last)
            self.last = ctypes.c_size_t.from_address(self.last).value
        for place in sorted(places):
            self.libc.free(place)


def room_behind(length: int) -> int:
    """Return how many bytes follow an array of `length` bytes in a `fresh_heap`."""
    if glibc() is None or length < ALONE:
        return 0
    page = mmap.PAGESIZE
    return -(length + 2 * WORD) % page
