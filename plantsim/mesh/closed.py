"""Closed triangle surfaces of others: .stl, .obj and .ply, read and made watertight."""

import struct
from pathlib import Path

import numpy as np
from scipy.spatial import KDTree

from plantsim.arrays import Array, pieces
from plantsim.errors import FileError, MeshError
from plantsim.mesh.files import meshio_read

SURFACES = (".stl", ".obj", ".ply")
OBJ_WORDS = frozenset("v vn vt vp f l p o g s usemtl mtllib #".split())
MERGE = (0.0, 1e-7, 1e-5, 1e-4)  # distances of points that are one [of the diagonal]
SMALL = 16  # edges of the largest hole that is closed


def read_surface(path: Path) -> tuple[Array, Array]:
    """Return points (n, 3) and triangles (m, 3) of a .stl, .obj or .ply, as they stand.

    Polygons become fans of triangles. Raises FileError for what is not of the kind that its
    suffix says; nothing in the file is run.
    """
    kind = path.suffix.lower()
    _check_header(path, kind)
    raw = meshio_read(path, kind[1:])
    faces = [np.zeros((0, 3), dtype=np.int64)]
    for cells in raw.cells:
        if cells.dim != 2:
            continue
        for corners in [cells.data] if isinstance(cells.data, np.ndarray) else cells.data:
            ring = np.atleast_2d(np.asarray(corners, dtype=np.int64))
            for i in range(1, ring.shape[1] - 1):
                faces.append(ring[:, [0, i, i + 1]])
    triangles = np.concatenate(faces)
    points = np.asarray(raw.points, dtype=float)
    if not len(triangles) or points.shape[1] != 3:
        raise FileError(f"{path}: no triangles in it. Export the surface as triangles.")
    if triangles.min() < 0 or triangles.max() >= len(points):
        raise FileError(
            f"{path}: triangles name points that are not there. Export it anew."
        )
    if not np.isfinite(points[triangles]).all():
        raise FileError(f"{path}: coordinates that are not numbers. Export it anew.")
    return points, triangles


def _check_header(path: Path, kind: str) -> None:
    with path.open("rb") as f:
        head = f.read(4096)
    if kind == ".stl":
        text = head.lstrip().lower()
        binary = len(head) >= 84 and path.stat().st_size == 84 + 50 * _count(head)
        good = binary or (text.startswith(b"solid") and b"facet" in text)
    elif kind == ".ply":
        good = head.startswith(b"ply") and b"format" in head
    else:
        words = [line.split(None, 1)[0] for line in head.splitlines()[:-1] if line.split()]
        known = [
            w.decode("latin-1").startswith("#") or w.decode("latin-1") in OBJ_WORDS
            for w in words
        ]
        good = bool(known) and all(known)
    if not good:
        raise FileError(
            f"{path}: not a {kind} file by its first lines (a script, perhaps; nothing was "
            f"run). Export the surface as {kind}."
        )


def _count(head: bytes) -> int:
    return int(struct.unpack("<I", head[80:84])[0])


def closed_surface(points: Array, faces: Array) -> tuple[Array, Array, dict[str, int]]:
    """Return points and triangles of a watertight surface, outward, and what was mended.

    Coinciding points are merged, within 1e-4 of the diagonal where that closes the surface;
    triangles without area or twice there go; triangles are turned to one side; holes of up
    to sixteen edges are closed by a fan. Raises MeshError with the number of holes where
    others are left, and where more than two triangles meet at an edge.
    """
    diagonal = float(np.linalg.norm(np.ptp(points[faces].reshape(-1, 3), axis=0)))
    best: tuple[int, Array, Array] | None = None
    for share in MERGE:
        p, f = _merged(points, faces, share * diagonal)
        open_edges = int((_sides(f)[2] != 2).sum())
        if best is None or open_edges < best[0]:
            best = open_edges, p, f
        if not open_edges:
            break
    assert best is not None
    _, p, f = best
    if len(f) < 2:
        raise MeshError("the surface has no volume. Give a closed surface.")
    _, _, times = _sides(f)
    if (times > 2).any():
        raise MeshError(
            f"{int((times > 2).sum())} edges belong to three triangles or more, so the "
            "surface has walls inside or parts that touch. Unite its parts first."
        )
    f, turned = _one_sided(f)
    mended = {"merged": len(points) - len(p), "turned": turned, "holes": 0}
    loops = _holes(f)
    large = [loop for loop in loops if len(loop) > SMALL]
    if large:
        raise MeshError(
            f"the surface is open: {len(loops)} holes, the largest of "
            f"{max(map(len, loops))} edges; up to {SMALL} edges are closed here. Close the "
            "others in the program that made it."
        )
    for loop in loops:
        ring = np.array(loop)
        fan = np.stack([np.roll(ring, -1), ring, np.full(len(ring), len(p))], axis=1)
        p, f = np.vstack([p, p[ring].mean(axis=0)]), np.vstack([f, fan])
    mended["holes"] = len(loops)
    return p, _outward(p, f), mended


def _merged(points: Array, faces: Array, within: float) -> tuple[Array, Array]:
    used, f = np.unique(faces, return_inverse=True)
    p, same = np.unique(points[used], axis=0, return_inverse=True)
    f = same.ravel()[f.reshape(-1, 3)]
    if within > 0:
        pairs = KDTree(p).query_pairs(within, output_type="ndarray")
        label = pieces(len(p), pairs)
        _, first = np.unique(label, return_index=True)
        p, f = p[first], label[f]
    f = f[(f != np.roll(f, 1, axis=1)).all(axis=1)]
    _, once = np.unique(np.sort(f, axis=1), axis=0, return_index=True)
    used, f = np.unique(f[np.sort(once)], return_inverse=True)
    return p[used], f.reshape(-1, 3)


def _sides(faces: Array) -> tuple[Array, Array, Array]:
    """Return directed sides (3 m, 2), the edge of each, and the triangles at each edge."""
    sides = faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    key = np.sort(sides, axis=1) @ [int(faces.max(initial=0)) + 1, 1]
    _, edge, times = np.unique(key, return_inverse=True, return_counts=True)
    return sides, edge.ravel(), times


def _one_sided(faces: Array) -> tuple[Array, int]:
    """Return triangles turned so that neighbours agree, and how many were."""
    sides, edge, times = _sides(faces)
    order = np.argsort(edge, kind="stable")
    order = order[times[edge[order]] == 2].reshape(-1, 2)
    one, two = order.T
    agree = sides[one, 0] != sides[two, 0]
    m = len(faces)
    # two nodes a triangle, as it is and turned; edges join what goes together
    a, b = one // 3, two // 3
    rows = np.concatenate([a, a + m])
    columns = np.concatenate([np.where(agree, b, b + m), np.where(agree, b + m, b)])
    label = pieces(2 * m, np.stack([rows, columns], axis=1))
    if (label[:m] == label[m:]).any():
        raise MeshError("the surface has one side only, like a Moebius strip. Remake it.")
    turn = label[:m] > label[m:]
    out = faces.copy()
    out[turn] = out[turn][:, ::-1]
    return out, int(turn.sum())


def _holes(faces: Array) -> list[list[int]]:
    """Return the loops of edges with one triangle, against the triangles' sense."""
    sides, edge, times = _sides(faces)
    free = sides[times[edge] == 1]
    after = {int(a): int(b) for a, b in free}
    if len(after) < len(free):
        raise MeshError("holes touch each other at a point. Close them where it was made.")
    loops = []
    while after:
        start, at = after.popitem()
        loop = [start]
        while at != start:
            loop.append(at)
            at = after.pop(at)
        loops.append(loop)
    return loops


def _outward(points: Array, faces: Array) -> Array:
    """Return triangles with the whole turned outwards (positive volume)."""
    x = points[faces] - points.mean(axis=0)
    volume = np.einsum("ij,ij->i", np.cross(x[:, 0], x[:, 1]), x[:, 2])
    joined = np.stack([np.repeat(faces[:, 0], 2), faces[:, 1:].ravel()], axis=1)
    shell = pieces(len(points), joined)[faces[:, 0]]
    inside_out = np.bincount(shell, weights=volume)[shell] < 0
    out = faces.copy()
    out[inside_out] = out[inside_out][:, ::-1]
    return out
