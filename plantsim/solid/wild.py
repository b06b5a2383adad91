"""The one door to pytetwild (fTetWild): slow, and hardly ever fails; the last rung."""

import contextlib
import importlib.util
import tempfile
from typing import Any

import numpy as np

from plantsim.arrays import Array
from plantsim.errors import MeshError, needs
from plantsim.solid.rings import whole
from plantsim.solid.sweep import Solid

SPACING = 1.2  # of rings [radii]
SLACK = 0.04  # how far the surface may be off [thinnest radius]


def installed() -> bool:
    """Return whether pytetwild is there."""
    return importlib.util.find_spec("pytetwild") is not None


def fill(solid: Solid, around: int, grow: float) -> tuple[Array, Array]:
    """Return points and tets of a solid, by fTetWild, from its tubes as they overlap.

    On one thread, as meshes are not repeatable with more. The foot is made flat again.
    """
    pytetwild: Any = needs("pytetwild", "fast")
    points, faces, total = [], [], 0
    for tube in solid.tubes:
        foot = solid.foot[1] if tube is solid.tubes[0] else None
        p, f = whole(tube, around, grow, SPACING, foot=foot)
        points.append(p)
        faces.append(f + total)
        total += len(p)
    surface = np.concatenate(points)
    diagonal = float(np.linalg.norm(np.ptp(surface, axis=0)))
    off = SLACK * min(float(t.radii.min()) for t in solid.tubes)
    try:
        # it leaves __tracked_surface.stl in the current folder
        with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
            x, tets = pytetwild.tetrahedralize(
                surface,
                np.concatenate(faces).astype(np.int32),
                epsilon=off / diagonal,
                num_threads=1,
                quiet=True,
            )
    except RuntimeError as why:
        raise MeshError(f"fTetWild: {why}") from None
    if not len(tets):
        raise MeshError("fTetWild: no tetrahedra.")
    x, tets = np.array(x, dtype=float), np.array(tets, dtype=np.int64)
    six = np.linalg.det(x[tets[:, 1:]] - x[tets[:, :1]])
    tets[six < 0] = tets[six < 0][:, [0, 2, 1, 3]]
    return _on_the_ground(solid, x, off), tets


def _on_the_ground(solid: Solid, x: Array, off: float) -> Array:
    """Return points with those that are nearly on a flat end put on it."""
    ends = [(*solid.foot, solid.tubes[0].radius(0.0))]
    ends += [
        (t.axis(1.0), t.tangent(1.0), t.radius(1.0)) for t in solid.tubes if not t.round_tip
    ]
    x = x.copy()
    for centre, way, r in ends:
        height = (x - centre) @ way
        flat = (np.abs(height) < 1.5 * off) & (np.linalg.norm(x - centre, axis=1) < 1.3 * r)
        x[flat] -= height[flat][:, None] * way
    return x
