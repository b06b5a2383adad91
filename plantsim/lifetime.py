"""A child process that ends with its parent, whatever either is doing."""

import contextlib
import ctypes
import os
import signal

DIE_WITH_PARENT = 1  # prctl's PR_SET_PDEATHSIG


def end_with(parent: int) -> None:
    """End this process when the thread of process `parent` that started it ends (Linux).

    The kernel sees to it: Python may be kept from it by a library that does not give up
    the interpreter's lock.
    """
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(DIE_WITH_PARENT, signal.SIGKILL)
    if os.getppid() != parent:  # it ended before
        os._exit(1)
