"""Where a triangle surface passes through itself."""

import numpy as np
from scipy.spatial import KDTree

from plantsim.arrays import Array

NEIGHBOURS = 24  # triangles that an edge is tested against


def crossings(points: Array, faces: Array) -> Array:
    """Mask the points (n,) of edges, and of triangles that such an edge passes through.

    Each edge is tested against the nearest triangles that do not share a point with it.
    Source of the test: Moeller and Trumbore 1997.
    """
    out = np.zeros(len(points), dtype=bool)
    if len(faces) < 2:
        return out
    other = np.roll(faces, -1, axis=1)
    keys = np.minimum(faces, other) * len(points) + np.maximum(faces, other)
    edges = np.stack(np.divmod(np.unique(keys), len(points)), axis=1)
    x = points[edges]
    corners = points[faces]
    k = min(NEIGHBOURS, len(faces))
    near = KDTree(corners.mean(axis=1)).query(x.mean(axis=1), k)[1].reshape(-1, k)
    # of triangles beside a smooth surface few have an edge's ends on two sides of them
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    level = np.einsum("fi,fi->f", normal, corners[:, 0])[near]
    normal = normal[near]
    first, second = (
        np.einsum("eki,ei->ek", normal, end) - level for end in (x[:, 0], x[:, 1])
    )
    edge, place = np.nonzero(first * second < 0)
    face = near[edge, place]
    apart = (faces[face][:, :, None] != edges[edge][:, None]).all(axis=(1, 2))
    edge, face = edge[apart], face[apart]
    a, b, c = points[faces[face]].transpose(1, 0, 2)
    start, way = x[edge, 0], x[edge, 1] - x[edge, 0]
    u, v = b - a, c - a
    p = np.cross(way, v)
    size = (u * p).sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        s = ((start - a) * p).sum(axis=1) / size
        q = np.cross(start - a, u)
        t = (way * q).sum(axis=1) / size
        along = (v * q).sum(axis=1) / size
        hit = (s > 0) & (t > 0) & (s + t < 1) & (along > 0) & (along < 1)
    out[edges[edge[hit]]] = True
    out[faces[face[hit]]] = True
    return out
