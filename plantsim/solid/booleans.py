"""The one door to manifold3d: unions of closed triangle surfaces that cannot fail."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from plantsim.arrays import Array
from plantsim.errors import MeshError, needs

Surface = tuple[Array, Array]  # points (n, 3) [m], outward triangles (m, 3)


def united(parts: Sequence[Surface], tolerance: float) -> tuple[Array, Array, Array, int]:
    """Return points, triangles, the part of each triangle, and the genus of the union.

    Edges shorter than `tolerance` [m] that do not shape the surface are collapsed. Raises
    MeshError where a part is not closed, or where the union is in several pieces.
    """
    m3: Any = needs("manifold3d", "fast")
    solids, part_of = [], {}
    for i, (points, faces) in enumerate(parts):
        mesh = m3.Mesh64(np.ascontiguousarray(points), faces.astype(np.uint64))
        solid = m3.Manifold(mesh).as_original()
        if solid.status() != m3.Error.NoError:
            raise MeshError(f"manifold3d: tube {i} is not closed ({solid.status()}).")
        part_of[solid.original_id()] = i
        solids.append(solid)
    union = m3.Manifold.batch_boolean(solids, m3.OpType.Add).simplify(tolerance)
    pieces = len(union.decompose())
    if pieces != 1:
        raise MeshError(f"the union is in {pieces} pieces.")
    out = union.to_mesh64()
    faces = np.asarray(out.tri_verts).astype(np.int64)
    runs = np.asarray(out.run_index).astype(np.int64) // 3
    owner = np.repeat([part_of[int(k)] for k in out.run_original_id], np.diff(runs))
    return np.array(out.vert_properties[:, :3]), faces, owner, int(union.genus())
