"""Writing gmsh's .msh 4.1 so that vertex ids, overlapping sets and regions survive.

meshio's writer regroups the vertices by entity, which renumbers them, and gives each entity
one group at most; so the few sections are written here. Reading is meshio's. Source of the
format: the gmsh reference manual, section "MSH file format".
"""

from pathlib import Path
from typing import BinaryIO

import numpy as np

from plantsim.arrays import Array
from plantsim.mesh.tetmesh import GMSH_ORDER, TetMesh

TET = {1: 4, 2: 11}  # gmsh's element types of tetrahedra by order
POINT = 15


def write_msh41(mesh: TetMesh, path: Path, *, binary: bool) -> None:
    """Write a volume entity a region, a point entity a set, all vertices in one block."""
    region = np.asarray(mesh.region)
    sets = list(mesh.sets.values())
    tags = range(1, len(mesh.region_names) + 1)
    tets = mesh.tets if mesh.order == 1 else mesh.tets[:, GMSH_ORDER]
    with path.open("wb") as f:
        out = _Section(f, binary)
        f.write(f"$MeshFormat\n4.1 {int(binary)} 8\n".encode())
        if binary:
            out.ints([1])
            out.end()
        f.write(b"$EndMeshFormat\n$PhysicalNames\n")
        names = [(0, i, name) for i, name in enumerate(mesh.sets, 1)]
        names += [(3, i, name) for i, name in enumerate(mesh.region_names, 1)]
        f.write(f"{len(names)}\n".encode())
        for dim, tag, name in names:
            f.write(f'{dim} {tag} "{_quoted(name)}"\n'.encode())
        f.write(b"$EndPhysicalNames\n$Entities\n")
        _entities(out, mesh, sets, tags)
        f.write(b"$EndEntities\n$Nodes\n")
        n = len(mesh.points)
        out.sizes([1, n, 1, n])
        out.ints([3, int(region[0]) + 1, 0])
        out.sizes([n])
        out.table(np.arange(1, n + 1)[:, None], "<u8", "%d")
        out.table(mesh.points, "<f8", "%.17g")
        out.end()
        f.write(b"$EndNodes\n$Elements\n")
        blocks: list[tuple[int, int, int, Array]] = []
        # runs of equal region, so that tets keep their order
        cuts = np.flatnonzero(np.diff(region)) + 1
        for run in np.split(np.arange(len(tets)), cuts):
            blocks.append((3, int(region[run[0]]) + 1, TET[mesh.order], tets[run]))
        for i, ids in enumerate(sets, 1):
            blocks.append((0, i, POINT, ids[:, None]))
        blocks = [block for block in blocks if len(block[3])]
        total = sum(len(block[3]) for block in blocks)
        out.sizes([len(blocks), total, 1, total])
        start = 1
        for dim, tag, kind, nodes in blocks:
            out.ints([dim, tag, kind])
            out.sizes([len(nodes)])
            numbers = np.arange(start, start + len(nodes))[:, None]
            out.table(np.hstack([numbers, nodes + 1]), "<u8", "%d")
            start += len(nodes)
        out.end()
        f.write(b"$EndElements\n")


def _entities(out: "_Section", mesh: TetMesh, sets: list[Array], tags: range) -> None:
    low, high = mesh.points.min(axis=0), mesh.points.max(axis=0)
    out.sizes([len(sets), 0, 0, len(tags)])
    for i, ids in enumerate(sets, 1):
        out.ints([i])
        out.doubles(mesh.points[ids[0]] if len(ids) else low)
        out.sizes([1])
        out.ints([i])
        out.row()
    for tag in tags:
        out.ints([tag])
        out.doubles(np.r_[low, high])
        out.sizes([1])
        out.ints([tag])
        out.sizes([0])
        out.row()
    out.end()


class _Section:
    """Numbers of a section, as text or as little-endian bytes."""

    def __init__(self, file: BinaryIO, binary: bool) -> None:
        self.file, self.binary = file, binary

    def _put(self, values: Array, dtype: str, form: str) -> None:
        if self.binary:
            self.file.write(np.ascontiguousarray(values, dtype=dtype).tobytes())
        else:
            self.file.write((" ".join(form % v for v in values) + " ").encode())

    def ints(self, values: list[int]) -> None:
        self._put(np.asarray(values), "<i4", "%d")

    def sizes(self, values: list[int]) -> None:
        self._put(np.asarray(values), "<u8", "%d")
        if len(values) == 4:
            self.row()

    def doubles(self, values: Array) -> None:
        self._put(values, "<f8", "%.17g")

    def row(self) -> None:
        if not self.binary:
            self.file.write(b"\n")

    def table(self, values: Array, dtype: str, form: str) -> None:
        if self.binary:
            self.file.write(np.ascontiguousarray(values, dtype=dtype).tobytes())
        else:
            self.file.write(b"\n")
            np.savetxt(self.file, values, fmt=form)

    def end(self) -> None:
        if self.binary:
            self.file.write(b"\n")


def _quoted(name: str) -> str:
    return name.replace('"', "'").replace("\n", " ")
