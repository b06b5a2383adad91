"""The one door to mmgpy: a part of a triangle surface meshed anew."""

from typing import Any

import numpy as np
from scipy.spatial import KDTree

from plantsim.arrays import Array
from plantsim.errors import MeshError, needs


def remeshed(
    points: Array, faces: Array, label: Array, free: Array, size: Array, grading: float
) -> tuple[Array, Array, Array, Array]:
    """Return points, triangles, labels and a mask of new points; the `free` part is new.

    `free` and `label` (m,): mask and number of each triangle; a new one gets the number of
    the nearest old. `size`: wanted edge length [m] at each point; it may grow by the factor
    `grading` from an edge to the next. All other triangles stay, and only those next to the
    free ones are shown to mmg.
    """
    mmgpy: Any = needs("mmgpy", "fast")
    touched = np.zeros(len(points), dtype=bool)
    touched[faces[free]] = True
    shown = touched[faces].any(axis=1)
    ids, part = np.unique(faces[shown], return_inverse=True)
    part = part.reshape(-1, 3)
    mesh = mmgpy.MmgMeshS()
    mesh.set_mesh_size(vertices=len(ids), triangles=len(part), edges=0)
    mesh.set_vertices(np.ascontiguousarray(points[ids]))
    mesh.set_triangles(part.astype(np.int32))
    mesh.set_field("metric", np.ascontiguousarray(size[ids])[:, None])
    mesh.set_required_triangles(np.flatnonzero(~free[shown]).astype(np.int32))
    scale = float(np.ptp(points, axis=0).max())
    try:
        mesh.remesh(verbose=-1, hgrad=grading, hausd=0.01 * scale, ar=180.0)
    except RuntimeError as why:
        raise MeshError(f"mmg: {why}") from None
    new = np.array(mesh.get_vertices())
    tri = np.array(mesh.get_triangles(), dtype=np.int64)
    held = ids[np.unique(part[~free[shown]])]
    away, at = KDTree(new).query(points[held])
    if (away > 1e-9 * scale).any() or len(np.unique(at)) < len(held):
        raise MeshError("mmg: points that were to stay have moved.")
    row = np.full(len(new), -1)
    row[at] = held
    fresh = np.flatnonzero(row < 0)
    row[fresh] = len(points) + np.arange(len(fresh))
    everything = np.concatenate([points, new[fresh]])
    centre = points[faces[shown]].mean(axis=1)
    nearest = KDTree(centre).query(new[tri].mean(axis=1))[1]
    out = np.concatenate([faces[~shown], row[tri]])
    used, out = np.unique(out, return_inverse=True)
    labels = np.concatenate([label[~shown], label[shown][nearest]])
    return everything[used], out.reshape(-1, 3), labels, used >= len(points)
