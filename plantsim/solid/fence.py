"""The last fence about a process that opens files of others: what the kernel refuses it.

A seccomp filter (Linux, x86-64 and ARM 64): from then on this process and its threads start
no program and no process, open no file to write, change no folder, reach no network and no
other process. Whatever a file talks gmsh into ends there. It cannot be taken off again.
"""

import ctypes
import errno
import os
import platform
import struct
import sys

SET_NO_NEW_PRIVS, SET_SECCOMP, FILTER = 38, 22, 2  # prctl
ALLOW, REFUSE, NOT_THERE = 0x7FFF0000, 0x50000 | errno.EPERM, 0x50000 | errno.ENOSYS
KILL = 0x80000000
LOAD, AND, EQUAL, ANY, AT_LEAST, RETURN = 0x20, 0x54, 0x15, 0x45, 0x35, 0x06  # BPF
NUMBER, ARCHITECTURE, ARGUMENT = 0, 4, 16  # places in struct seccomp_data
WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
THREAD = 0x00010000  # CLONE_THREAD
# audit's number of the architecture, the first system call of another ABI of it, and the
# numbers of the calls (Linux: arch/x86/entry/syscalls/syscall_64.tbl, and
# include/uapi/asm-generic/unistd.h, which ARM 64 follows). Not every machine has all.
MACHINES = {
    "x86_64": (
        0xC000003E,
        0x40000000,
        {
            "execve": 59, "execveat": 322, "fork": 57, "vfork": 58, "clone": 56,
            "clone3": 435, "open": 2, "openat": 257, "openat2": 437, "creat": 85,
            "truncate": 76, "rename": 82, "renameat": 264, "renameat2": 316, "mkdir": 83,
            "mkdirat": 258, "rmdir": 84, "unlink": 87, "unlinkat": 263, "link": 86,
            "linkat": 265, "symlink": 88, "symlinkat": 266, "mknod": 133, "mknodat": 259,
            "chmod": 90, "fchmod": 91, "fchmodat": 268, "fchmodat2": 452, "chown": 92,
            "fchown": 93, "lchown": 94, "fchownat": 260, "setxattr": 188, "mount": 165,
            "socket": 41, "socketpair": 53, "connect": 42, "sendto": 44, "kill": 62,
            "tkill": 200, "ptrace": 101, "process_vm_writev": 311, "pidfd_open": 434,
            "io_uring_setup": 425, "bpf": 321, "userfaultfd": 323, "unshare": 272,
            "memfd_create": 319, "setns": 308,
        },
    ),
    "aarch64": (
        0xC00000B7,
        0xFFFFFFFF,
        {
            "execve": 221, "execveat": 281, "clone": 220, "clone3": 435, "openat": 56,
            "openat2": 437, "truncate": 45, "renameat": 38, "renameat2": 276,
            "mkdirat": 34, "unlinkat": 35, "linkat": 37, "symlinkat": 36, "mknodat": 33,
            "fchmod": 52, "fchmodat": 53, "fchmodat2": 452, "fchown": 55, "fchownat": 54,
            "setxattr": 5, "mount": 40, "socket": 198, "socketpair": 199, "connect": 203,
            "sendto": 206, "kill": 129, "tkill": 130, "ptrace": 117,
            "process_vm_writev": 271, "pidfd_open": 434, "io_uring_setup": 425,
            "bpf": 280, "userfaultfd": 282, "unshare": 97, "memfd_create": 279,
            "setns": 268,
        },
    ),
}  # fmt: skip
FLAGS = {"open": 1, "openat": 2}  # which argument has the flags
GONE = ("clone3", "openat2", "io_uring_setup")  # the C library then takes the older call


def close() -> bool:
    """Raise the fence about this process for good; return whether this machine has it."""
    machine = MACHINES.get(platform.machine())
    if sys.platform != "linux" or machine is None:
        return False
    program = b"".join(_program(*machine))
    code = ctypes.create_string_buffer(program, len(program))
    length = len(program) // 8

    class Program(ctypes.Structure):
        _fields_ = (("count", ctypes.c_ushort), ("code", ctypes.c_void_p))

    given = Program(length, ctypes.addressof(code))
    prctl = ctypes.CDLL(None, use_errno=True).prctl
    if prctl(SET_NO_NEW_PRIVS, 1, 0, 0, 0):
        return False
    return prctl(SET_SECCOMP, FILTER, ctypes.byref(given), 0, 0) == 0


def _program(audit: int, other: int, calls: dict[str, int]) -> list[bytes]:
    """Return the filter's instructions: plain refusals, then those that hang on flags."""
    out = [
        _step(LOAD, ARCHITECTURE),
        _step(EQUAL, audit, 1, 0),
        _step(RETURN, KILL),
        _step(LOAD, NUMBER),
        _step(AT_LEAST, other, 0, 1),
        _step(RETURN, KILL),
    ]
    for name, number in calls.items():
        if name in FLAGS:
            out += [
                _step(EQUAL, number, 0, 4),
                _step(LOAD, ARGUMENT + 8 * FLAGS[name]),
                _step(ANY, WRITING, 0, 1),
                _step(RETURN, REFUSE),
                _step(RETURN, ALLOW),
            ]
        elif name == "clone":  # threads of this process are no processes
            out += [
                _step(EQUAL, number, 0, 4),
                _step(LOAD, ARGUMENT),
                _step(ANY, THREAD, 1, 0),
                _step(RETURN, REFUSE),
                _step(RETURN, ALLOW),
            ]
        else:
            out += [
                _step(EQUAL, number, 0, 1),
                _step(RETURN, NOT_THERE if name in GONE else REFUSE),
            ]
    return [*out, _step(RETURN, ALLOW)]


def _step(code: int, value: int, yes: int = 0, no: int = 0) -> bytes:
    return struct.pack("=HBBI", code, yes, no, value & 0xFFFFFFFF)
