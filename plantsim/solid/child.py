"""Child processes that mesh: asked by the parent, and served at their end.

The two processes are both ours and talk through pipes: JSON, bytes and plain arrays, no
pickle. A child dies with its parent, is ended after a time limit, and what it or a library
prints goes nowhere; its failure comes back as a sentence.
"""

import io
import json
import os
import subprocess
import sys
from collections.abc import Callable
from typing import Any

import numpy as np

from plantsim.arrays import Array
from plantsim.errors import MeshError
from plantsim.lifetime import end_with

MARK = "plantsim-error:"


def asked(
    module: str,
    request: dict[str, Any],
    data: bytes,
    timeout: float,
    *,
    what: str,
    late: str,
    crashed: str,
) -> dict[str, Array]:
    """Return the arrays that a module's `main` answers to a request, in a child process.

    Raises MeshError, with `what` before the child's own words, or with `late` where it was
    ended after `timeout` [s], or with `crashed`, in which {exit} is its exit code.
    """
    command = [sys.executable, "-m", module, json.dumps(request), str(os.getpid())]
    try:
        done = subprocess.run(
            command, input=data, capture_output=True, timeout=timeout, check=False
        )
    except subprocess.TimeoutExpired:
        raise MeshError(late) from None
    if done.returncode or not done.stdout:
        said = done.stderr.decode(errors="replace")
        if MARK in said:
            raise MeshError(what + said.rpartition(MARK)[2].strip())
        raise MeshError(crashed.replace("{exit}", str(done.returncode)))
    with np.load(io.BytesIO(done.stdout), allow_pickle=False) as z:
        return {name: z[name] for name in z.files}


def packed(arrays: dict[str, Any], sets: dict[str, Array] | None = None) -> bytes:
    """Return arrays, and vertex sets as "set:NAME", as the bytes of an .npz."""
    named: dict[str, Any] = {f"set:{name}": ids for name, ids in (sets or {}).items()}
    out = io.BytesIO()
    np.savez(out, **arrays, **named)
    return out.getvalue()


def sets_of(arrays: dict[str, Array]) -> dict[str, Array]:
    """Return the vertex sets among what `packed` packed."""
    return {k.removeprefix("set:"): v for k, v in arrays.items() if k.startswith("set:")}


def serve(work: Callable[[dict[str, Any], bytes], bytes]) -> None:
    """Answer one request: `work` gets it, and standard input, and returns packed arrays."""
    end_with(int(sys.argv[2]))
    result = _quiet_output()
    try:
        answer = work(json.loads(sys.argv[1]), sys.stdin.buffer.read())
    except Exception as why:  # whatever it is, the parent tells it in a sentence
        sys.stderr.write(f"\n{MARK}{' '.join(str(why).split())}\n")
        sys.exit(3)
    with result:
        result.write(answer)


def _quiet_output() -> io.BufferedWriter:
    """Return standard output; what else is written to it goes nowhere."""
    result = os.fdopen(os.dup(1), "wb")
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    return result
