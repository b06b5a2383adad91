"""A solid meshed in a process of its own, so that a stuck or crashed kernel can be ended.

The two processes are both ours and talk through pipes: plain arrays and JSON, no pickle.
"""

import contextlib
import ctypes
import io
import json
import os
import signal
import subprocess
import sys
from typing import Any

import numpy as np

from plantsim.errors import MeshError
from plantsim.mesh.tetmesh import TetMesh
from plantsim.solid.sweep import Solid, Tube

MARK = "plantsim-error:"
DIE_WITH_PARENT = 1  # prctl's PR_SET_PDEATHSIG


def tetrahedralized(
    solid: Solid, size: float | None, order: int, kernel: str, timeout: float
) -> TetMesh:
    """Return tetrahedralize(solid, ...) of a child process, ended after `timeout` [s].

    Raises MeshError when it fails, crashes or takes longer.
    """
    given = json.dumps({"size": size, "order": order, "kernel": kernel})
    try:
        done = subprocess.run(
            [sys.executable, "-m", "plantsim.solid.apart", given, str(os.getpid())],
            input=_packed(solid),
            capture_output=True,
            timeout=timeout,
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise MeshError(
            f"meshing {len(solid.tubes)} limbs was not done after {timeout:g} s and was "
            "ended. Prune limbs, coarsen (size=...), or give more: timeout=..."
        ) from None
    if done.returncode or not done.stdout:
        said = done.stderr.decode(errors="replace")
        if MARK in said:
            raise MeshError(said.rpartition(MARK)[2].strip())
        raise MeshError(
            f"the kernel crashed (exit {done.returncode}) on a solid of {len(solid.tubes)} "
            "limbs. Thin or move limbs that graze each other."
        )
    with np.load(io.BytesIO(done.stdout), allow_pickle=False) as z:
        sets = {k[4:]: z[k] for k in z.files if k.startswith("set:")}
        return TetMesh(
            z["points"],
            z["tets"],
            z["region"],
            sets,
            tuple(str(name) for name in z["names"]),
            json.loads(str(z["report"])),
        )


def _packed(solid: Solid) -> bytes:
    out = io.BytesIO()
    tubes = solid.tubes
    arrays: dict[str, Any] = {
        "names": np.array([t.name for t in tubes], dtype=str),
        "parent": [t.parent for t in tubes],
        "joint": [t.joint for t in tubes],
        "round_tip": [t.round_tip for t in tubes],
        "count": [len(t.points) for t in tubes],
        "points": np.concatenate([t.points for t in tubes]),
        "radii": np.concatenate([t.radii for t in tubes]),
    }
    np.savez(out, **arrays)
    return out.getvalue()


def _unpacked(data: bytes) -> Solid:
    with np.load(io.BytesIO(data), allow_pickle=False) as z:
        cuts = np.cumsum(z["count"])[:-1]
        rows = zip(
            z["names"],
            z["parent"],
            np.split(z["points"], cuts),
            np.split(z["radii"], cuts),
            z["joint"],
            z["round_tip"],
            strict=True,
        )
        return Solid(
            tuple(
                Tube(str(name), int(parent), x, r, float(u), bool(tip))
                for name, parent, x, r, u, tip in rows
            )
        )


def _work(given: dict[str, Any], data: bytes) -> bytes:
    from plantsim.solid.tetrahedralize import tetrahedralize  # noqa: PLC0415  it imports us

    mesh = tetrahedralize(_unpacked(data), **given)
    out = io.BytesIO()
    arrays: dict[str, Any] = {
        "points": mesh.points,
        "tets": mesh.tets,
        "region": np.asarray(mesh.region),
        "names": np.array(mesh.region_names, dtype=str),
        "report": np.array(json.dumps(dict(mesh.report or {}))),
    }
    arrays |= {f"set:{name}": ids for name, ids in mesh.sets.items()}
    np.savez(out, **arrays)
    return out.getvalue()


def end_with(parent: int) -> None:
    """End this process when its parent ends, however that ends (Linux)."""
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(DIE_WITH_PARENT, signal.SIGKILL)
    if os.getppid() != parent:  # it ended before
        os._exit(1)


def quiet_output() -> io.BufferedWriter:
    """Return standard output; what else is written to it goes nowhere."""
    result = os.fdopen(os.dup(1), "wb")
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    return result


def main() -> None:
    """Serve one request: the solid from standard input, the mesh to standard output."""
    end_with(int(sys.argv[2]))
    result = quiet_output()
    try:
        packed = _work(json.loads(sys.argv[1]), sys.stdin.buffer.read())
    except Exception as why:  # whatever it is, the parent tells it in a sentence
        sys.stderr.write(f"\n{MARK}{' '.join(str(why).split())}\n")
        sys.exit(3)
    with result:
        result.write(packed)


if __name__ == "__main__":
    main()
