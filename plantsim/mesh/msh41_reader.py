"""Reading gmsh's .msh 4.1, text and binary: nodes, elements and every physical group.

meshio refuses ordinary exports (Mesh.SaveAll, parametric nodes, partitions) and keeps one
group an entity. Source of the format: the gmsh reference manual, section "MSH file format".
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from plantsim.arrays import Array
from plantsim.errors import FileError
from plantsim.mesh.tetmesh import GMSH_ORDER

# gmsh's element types: dimension and number of nodes
KINDS = {
    15: (0, 1),
    **{1: (1, 2), 8: (1, 3)},
    **{2: (2, 3), 9: (2, 6), 3: (2, 4), 10: (2, 9), 16: (2, 8)},
    **{4: (3, 4), 11: (3, 10), 5: (3, 8), 12: (3, 27), 17: (3, 20), 6: (3, 6), 13: (3, 18)},
    **{18: (3, 15), 7: (3, 5), 14: (3, 14), 19: (3, 13)},
}
TETS = {4: "tetra", 11: "tetra10"}
OTHERS = {5: "hexahedron", 6: "wedge", 7: "pyramid", 12: "hexahedron27", 13: "wedge18"}


@dataclass(frozen=True, eq=False)
class Block:
    """Elements of one kind, and which of them are in which physical group."""

    dim: int
    kind: str  # "tetra", "tetra10", or another name
    nodes: Array  # (k, c) rows of the points
    groups: dict[int, Array] = field(default_factory=dict)  # physical tag -> rows


def physical_names(raw: bytes) -> dict[tuple[int, int], str]:
    """Return the names of physical groups by (dimension, tag), of either version."""
    names = {}
    for line in _section(raw, b"PhysicalNames").splitlines()[1:]:
        parts = line.split(None, 2)
        if len(parts) == 3:
            text = parts[2].strip().decode("utf-8", errors="replace")
            names[int(parts[0]), int(parts[1])] = text.strip('"')
    return names


def read_msh41(path: Path) -> tuple[Array, list[Block]]:
    """Return points (n, 3) and blocks of elements; ValueError or such where broken."""
    raw = path.read_bytes()
    _, kind, size = _section(raw, b"MeshFormat").split(b"\n", 1)[0].split()[:3]
    binary = kind == b"1"
    if int(size) != 8:
        raise FileError(
            f"{path}: data size {int(size)}, wanted 8. Write it on a 64-bit machine."
        )
    groups = _entities(_Numbers(_section(raw, b"Entities"), binary))
    groups |= _partitioned(_Numbers(_section(raw, b"PartitionedEntities"), binary), groups)
    points, row = _nodes(_Numbers(_section(raw, b"Nodes"), binary))
    numbers = _Numbers(_section(raw, b"Elements"), binary)
    blocks = []
    for _ in range(numbers.sizes(4)[0]):
        dim, entity, kind = numbers.ints(3)
        count = numbers.sizes(1)[0]
        if int(kind) not in KINDS:
            raise FileError(f"{path}: elements of gmsh's type {kind}. Write order 1 or 2.")
        columns = 1 + KINDS[int(kind)][1]
        nodes = row[numbers.sizes(int(count) * columns).reshape(-1, columns)[:, 1:]]
        if kind == 11:
            nodes = nodes[:, GMSH_ORDER]
        everything = np.arange(len(nodes))
        tags = {tag: everything for tag in groups.get((int(dim), int(entity)), ())}
        blocks.append(
            Block(int(dim), (TETS | OTHERS).get(int(kind), f"type {kind}"), nodes, tags)
        )
    return points, blocks


class _Numbers:
    """The numbers of a section, one after the other, from text or bytes."""

    def __init__(self, section: bytes, binary: bool) -> None:
        self.binary, self.at = binary, 0
        self.data: Any = section if binary else np.array(section.split(), dtype=float)

    def _take(self, dtype: str, count: int) -> Array:
        if self.binary:
            size = np.dtype(dtype).itemsize
            out = np.frombuffer(self.data, dtype, count, self.at)
            self.at += size * count
            return out
        out = self.data[self.at : self.at + count]
        if len(out) < count:
            raise ValueError("a section ends early")
        self.at += count
        return out.astype(dtype)

    def ints(self, count: int) -> Array:
        return self._take("<i4", int(count)).astype(np.int64)

    def sizes(self, count: int) -> Array:
        return self._take("<u8", int(count)).astype(np.int64)

    def doubles(self, count: int) -> Array:
        return self._take("<f8", int(count))

    def __bool__(self) -> bool:
        return len(self.data) > 0


def _section(raw: bytes, name: bytes) -> bytes:
    start = raw.find(b"$" + name)
    if start < 0:
        return b""
    start = raw.index(b"\n", start) + 1
    end = raw.find(b"$End" + name, start)
    if end < 0:
        raise ValueError(f"no $End{name.decode()}")
    return raw[start:end]


def _entities(numbers: _Numbers) -> dict[tuple[int, int], tuple[int, ...]]:
    """Return the physical tags of each entity (dimension, tag)."""
    groups: dict[tuple[int, int], tuple[int, ...]] = {}
    if not numbers:
        return groups
    for dim, count in enumerate(numbers.sizes(4)):
        for _ in range(count):
            tag = int(numbers.ints(1)[0])
            numbers.doubles(3 if dim == 0 else 6)
            groups[dim, tag] = _tags(numbers)
            if dim:
                numbers.ints(numbers.sizes(1)[0])
    return groups


def _partitioned(
    numbers: _Numbers, parents: dict[tuple[int, int], tuple[int, ...]]
) -> dict[tuple[int, int], tuple[int, ...]]:
    """Return the same for the pieces of a partitioned mesh; or else the parent's."""
    groups: dict[tuple[int, int], tuple[int, ...]] = {}
    if not numbers:
        return groups
    numbers.sizes(1)
    numbers.ints(2 * numbers.sizes(1)[0])
    for dim, count in enumerate(numbers.sizes(4)):
        for _ in range(count):
            tag, parent_dim, parent = (int(i) for i in numbers.ints(3))
            numbers.ints(numbers.sizes(1)[0])
            numbers.doubles(3 if dim == 0 else 6)
            own = _tags(numbers)
            above = parents.get((dim, parent), ()) if parent_dim == dim else ()
            groups[dim, tag] = own or above
            if dim:
                numbers.ints(numbers.sizes(1)[0])
    return groups


def _tags(numbers: _Numbers) -> tuple[int, ...]:
    # a negative tag says that the entity is in the group the other way round
    return tuple(abs(int(t)) for t in numbers.ints(numbers.sizes(1)[0]))


def _nodes(numbers: _Numbers) -> tuple[Array, Array]:
    """Return points, and the row of each node tag (-1 where there is none)."""
    blocks, count, _, highest = numbers.sizes(4)
    if not 0 <= highest < 2**40 or count > 2**32:
        raise ValueError("absurd numbers of nodes")
    points, tags = [np.zeros((0, 3))], [np.zeros(0, dtype=np.int64)]
    for _ in range(blocks):
        dim, _, parametric = numbers.ints(3)
        many = int(numbers.sizes(1)[0])
        tags.append(numbers.sizes(many))
        columns = 3 + (int(dim) if parametric else 0)
        points.append(numbers.doubles(many * columns).reshape(-1, columns)[:, :3])
    tag = np.concatenate(tags)
    row = np.full(int(tag.max(initial=0)) + 1, -1)
    row[tag] = np.arange(len(tag))
    return np.concatenate(points), row
