"""Is a mesh one solid body with one closed surface? Counted, not assumed."""

from dataclasses import dataclass

import numpy as np

from plantsim.arrays import Array, pieces
from plantsim.mesh.tetmesh import TetMesh


@dataclass(frozen=True, eq=False)
class Topology:
    """What a mesh's tets and boundary triangles hang together like."""

    body: Array  # (m,) piece of each tet, joined through faces, 0 the largest
    euler: tuple[int, ...]  # V - E + F of each closed piece of the surface
    open_edges: Array  # (k, 2) vertices of surface edges not between two triangles
    pinched: Array  # (k,) vertices where the surface touches itself

    @property
    def genus(self) -> int:
        """Number of handles: loops that limbs make by touching each other."""
        return sum((2 - chi) // 2 for chi in self.euler)


def topology(mesh: TetMesh) -> Topology:
    """Return how the mesh hangs together, of corners alone."""
    joined = pieces(len(mesh.tets), mesh.neighbours)
    size = np.bincount(joined)
    rank = np.empty_like(size)
    rank[np.argsort(-size, kind="stable")] = np.arange(len(size))
    faces = mesh.surface[:, :3].astype(np.int64)
    sides = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    key = sides[:, 0] * len(mesh.points) + sides[:, 1]
    order = np.argsort(key, kind="stable")
    ranked = sides[order]
    edge = np.cumsum(np.r_[0, key[order][1:] != key[order][:-1]])
    times = np.bincount(edge)
    first = np.searchsorted(edge, np.arange(len(times)))
    pairs = order[first[times == 2][:, None] + [0, 1]]  # places: face times three and side
    # corners of two triangles that share an edge are one where they are the same vertex
    corners = faces.ravel()
    a, b = pairs.T
    ends = [
        np.stack([3 * (p // 3) + p % 3, 3 * (p // 3) + (p + 1) % 3], axis=1) for p in (a, b)
    ]
    swap = corners[ends[0][:, 0]] != corners[ends[1][:, 0]]
    other = np.where(swap[:, None], ends[1][:, ::-1], ends[1])
    umbrella = pieces(len(corners), np.stack([ends[0].ravel(), other.ravel()], axis=1))
    vertex = np.zeros(umbrella.max() + 1, dtype=np.int64)
    vertex[umbrella] = corners
    ids, fans = np.unique(vertex, return_counts=True)
    shell = pieces(len(faces), pairs // 3)
    edge_of = np.empty_like(edge)
    edge_of[order] = edge
    euler = []
    for k in range(shell.max() + 1):
        mine = shell == k
        v = len(np.unique(umbrella.reshape(-1, 3)[mine]))
        e = len(np.unique(edge_of.reshape(-1, 3)[mine]))
        euler.append(int(v - e + mine.sum()))
    return Topology(rank[joined], tuple(euler), ranked[first[times != 2]], ids[fans > 1])
