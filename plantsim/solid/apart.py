"""A solid meshed in a process of its own, so that a stuck or crashed kernel can end."""

import io
import json
from typing import Any

import numpy as np

from plantsim.mesh.tetmesh import TetMesh
from plantsim.solid.child import asked, packed, serve, sets_of
from plantsim.solid.sweep import Solid, Tube


def tetrahedralized(
    solid: Solid, size: float | None, order: int, kernel: str, timeout: float
) -> TetMesh:
    """Return tetrahedralize(solid, ...) of a child process, ended after `timeout` [s].

    Raises MeshError when it fails, crashes or takes longer.
    """
    limbs = len(solid.tubes)
    z = asked(
        "plantsim.solid.apart",
        {"size": size, "order": order, "kernel": kernel},
        _packed(solid),
        timeout,
        what="",
        late=f"meshing {limbs} limbs was not done after {timeout:g} s and was "
        "ended. Prune limbs, coarsen (size=...), or give more: timeout=...",
        crashed=f"the kernel crashed (exit {{exit}}) on a solid of {limbs} "
        "limbs. Thin or move limbs that graze each other.",
    )
    return TetMesh(
        z["points"],
        z["tets"],
        z["region"],
        sets_of(z),
        tuple(str(name) for name in z["names"]),
        json.loads(str(z["report"])),
    )


def _packed(solid: Solid) -> bytes:
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
    return packed(arrays)


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
    arrays: dict[str, Any] = {
        "points": mesh.points,
        "tets": mesh.tets,
        "region": np.asarray(mesh.region),
        "names": np.array(mesh.region_names, dtype=str),
        "report": np.array(json.dumps(dict(mesh.report or {}))),
    }
    return packed(arrays, dict(mesh.sets))


if __name__ == "__main__":
    serve(_work)
