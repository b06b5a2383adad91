"""Meshes in and out of files: .msh (2.2, 4.1; text or binary), .vtu and .npz."""

import contextlib
import io
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import meshio
import numpy as np
from numpy.typing import ArrayLike

from plantsim.arrays import Array, few
from plantsim.errors import FileError, MeshError
from plantsim.mesh.msh41 import write_msh41
from plantsim.mesh.tetmesh import TetMesh, compact
from plantsim.paths import existing, replacing, writable

FORMATS = (".msh", ".vtu", ".npz")
Version = Literal["4.1", "2.2"]
# VTK numbers the last two middles of a tetra10 the other way round than gmsh; meshio
# permutes.


def read_mesh(path: str | os.PathLike[str], *, drop_unused: bool = False) -> TetMesh:
    """Return the tetrahedral mesh in a .msh, .vtu or .npz file.

    Gmsh's physical volumes become regions, its physical points, curves and surfaces named
    vertex sets. A .vtu keeps region numbers (cell data "region") and sets (0/1 point data
    "set:NAME"). An .npz has `points` and `tets`, and may have `region`, `region_names` and
    `set:NAME`. `drop_unused` drops vertices that are in no tet, which are an error
    otherwise.

    Nothing in the file is run: scripts in the guise of a .msh and pickles are refused.
    Raises FileError for a file that is missing, broken, foreign or without tetrahedra, and
    MeshError for a mesh that no finite element method can use.
    """
    path = existing(path)
    readers = {".msh": _read_msh, ".vtu": _read_vtu, ".npz": _read_npz}
    if path.suffix.lower() not in readers:
        raise FileError(
            f"{path}: {path.suffix or 'no'} suffix; read_mesh takes {', '.join(FORMATS)}. "
            "For .geo and .step use tetrahedralize."
        )
    points, tets, region, names, sets = readers[path.suffix.lower()](path)
    if drop_unused:
        inside = (tets >= 0).all() and (tets < len(points)).all()
        points, tets, sets = compact(points, tets, sets) if inside else (points, tets, sets)
    try:
        return TetMesh(points, tets, region, sets, names)
    except MeshError as why:
        raise MeshError(f"{path}: {why}") from None


def write_mesh(
    mesh: TetMesh,
    path: str | os.PathLike[str],
    *,
    version: Version = "4.1",
    binary: bool = True,
    point_data: Mapping[str, ArrayLike] | None = None,
    cell_data: Mapping[str, ArrayLike] | None = None,
) -> Path:
    """Write the mesh to a .msh, .vtu or .npz file and return its path.

    `version` and `binary` concern .msh; vertex ids, regions and sets survive a round trip.
    `point_data` (n, ...) and `cell_data` (m, ...) go into a .vtu beside region and sets.
    The file appears whole or not at all. Raises FileError for an unknown suffix or version,
    or for data that the format cannot hold.
    """
    path = writable(path, *FORMATS)
    suffix = path.suffix.lower()
    if version not in ("4.1", "2.2"):
        raise FileError(f"{path}: .msh version {version!r}; there are '4.1' and '2.2'.")
    if suffix != ".vtu" and (point_data or cell_data):
        raise FileError(
            f"{path}: point and cell data are written to .vtu. Change the suffix."
        )
    with replacing(path) as temporary:
        if suffix == ".npz":
            _write_npz(mesh, temporary)
        elif suffix == ".vtu":
            _write_vtu(mesh, temporary, point_data or {}, cell_data or {})
        elif version == "4.1":
            write_msh41(mesh, temporary, binary=binary)
        else:
            _write_msh22(mesh, temporary, binary=binary)
    return path


Parts = tuple[Array, Array, Array | None, tuple[str, ...], dict[str, Array]]


def _read_msh(path: Path) -> Parts:
    with path.open("rb") as f:
        head = f.read(4096)
    # gmsh itself takes any file without this header for a script, and scripts can call a
    # shell
    if not head.lstrip().startswith((b"$MeshFormat", b"$Comments")):
        raise FileError(
            f"{path}: does not start with $MeshFormat, so it is not a gmsh mesh (a script, "
            "perhaps; nothing was run). Export it from gmsh as .msh 2.2 or 4.1."
        )
    raw = _meshio_read(path, "gmsh")
    groups = _groups(raw)
    points, tets, blocks = _tets(path, raw)
    region: Array | None = None
    names: list[str] = []
    sets: dict[str, Array] = {}
    start = np.cumsum([0] + [len(block.data) for block in raw.cells])
    label = np.full(start[-1], -1)
    for (dim, name), cells in groups.items():
        if dim == 3:
            label[cells] = len(names)
            names.append(name)
            continue
        ids = [
            raw.cells[b].data[
                cells[(cells >= start[b]) & (cells < start[b + 1])] - start[b]
            ]
            for b in range(len(raw.cells))
            if raw.cells[b].dim == dim
        ]
        sets[name] = np.unique(np.concatenate([i.ravel() for i in ids]))
    if names:
        region = np.concatenate([label[start[b] : start[b + 1]] for b in blocks])
        if (region < 0).any():
            region = np.where(region < 0, len(names), region)
            names.append("rest")
        present, region = np.unique(region, return_inverse=True)
        names = [names[i] for i in present]
    return points, tets, region, tuple(names), sets


def _groups(raw: Any) -> dict[tuple[int, str], Array]:
    """Return the cells, counted over all blocks, of each group (dimension, name)."""
    start = np.cumsum([0] + [len(block.data) for block in raw.cells])
    names = {(int(dim), int(tag)): name for name, (tag, dim) in raw.field_data.items()}
    groups: dict[tuple[int, str], list[Array]] = {}
    seen = set()
    for name, cells in raw.cell_sets.items():  # version 4.1: every group of every entity
        if name not in raw.field_data:
            continue
        dim = int(raw.field_data[name][1])
        parts = [
            start[b] + np.asarray(c, dtype=np.int64)
            for b, c in enumerate(cells)
            if c is not None and len(c)
        ]
        if parts:
            groups[dim, name] = parts
            seen.add((dim, name))
    for b, tags in enumerate(raw.cell_data.get("gmsh:physical", [])):
        dim = raw.cells[b].dim
        for tag in np.unique(tags):
            name = names.get((dim, int(tag)), str(tag))
            if tag > 0 and (dim, name) not in seen:
                where = start[b] + np.flatnonzero(np.asarray(tags) == tag)
                groups.setdefault((dim, name), []).append(where)
    return {key: np.concatenate(parts) for key, parts in groups.items()}


def _tets(path: Path, raw: Any) -> tuple[Array, Array, list[int]]:
    """Return points, tets and the numbers of the blocks that hold them."""
    kinds = {block.type for block in raw.cells if len(block.data)}
    wanted = kinds & {"tetra", "tetra10"}
    if not wanted:
        raise FileError(
            f"{path}: no tetrahedra in it ({', '.join(sorted(kinds)) or 'no cells'}). "
            "Mesh the volume in 3D, or use tetrahedralize on its geometry."
        )
    if len(wanted) == 2:
        raise FileError(
            f"{path}: tetrahedra of order 1 and 2 mixed. Write the mesh with one order."
        )
    blocks = [
        b for b, block in enumerate(raw.cells) if block.type in wanted and len(block.data)
    ]
    tets = np.concatenate([raw.cells[b].data for b in blocks])
    return np.asarray(raw.points, dtype=float), tets.astype(np.int64), blocks


def _meshio_read(path: Path, kind: str) -> Any:
    silence = io.StringIO()  # meshio prints what it then raises
    try:
        with contextlib.redirect_stdout(silence), contextlib.redirect_stderr(silence):
            return meshio.read(path, file_format=kind)
    except (
        SystemExit,
        Exception,
    ) as why:  # meshio raises anything, and exits, on broken files
        text = " ".join(str(why).split()) or type(why).__name__
        raise FileError(
            f"{path}: cannot be read as {path.suffix} ({text[:120]}). Write it again, "
            "from gmsh with physical groups and without Mesh.SaveAll."
        ) from None


def _read_vtu(path: Path) -> Parts:
    raw = _meshio_read(path, "vtu")
    points, tets, blocks = _tets(path, raw)
    region = raw.cell_data.get("region")
    if region is not None:
        region = np.concatenate([np.asarray(region[b]) for b in blocks]).astype(np.int64)
    sets = {
        name.removeprefix("set:"): np.flatnonzero(values)
        for name, values in raw.point_data.items()
        if name.startswith("set:")
    }
    return points, tets, region, (), sets


def _read_npz(path: Path) -> Parts:
    try:
        with np.load(path, allow_pickle=False) as z:
            data = {name: z[name] for name in z.files}
    except Exception as why:  # zip, zlib, header and pickle errors, each of another class
        text = (
            "it holds pickled objects, which could run code"
            if "pickle" in str(why)
            else why
        )
        raise FileError(
            f"{path}: cannot be read as .npz ({text}). Write it with plantsim.write_mesh."
        ) from None
    missing = [name for name in ("points", "tets") if name not in data]
    if missing:
        raise FileError(
            f"{path}: no array {' nor '.join(missing)} in it (it has: {few(data, 8)}). An "
            ".npz mesh holds points (n, 3) and tets (m, 4 or 10)."
        )
    names = tuple(str(name) for name in np.atleast_1d(data.get("region_names", ())))
    sets = {k.removeprefix("set:"): v for k, v in data.items() if k.startswith("set:")}
    return data["points"], data["tets"], data.get("region"), names, sets


def _write_npz(mesh: TetMesh, path: Path) -> None:
    arrays: dict[str, Any] = {
        "points": mesh.points,
        "tets": mesh.tets,
        "region": np.asarray(mesh.region),
        "region_names": np.array(mesh.region_names, dtype=str),
    }
    arrays |= {f"set:{name}": ids for name, ids in mesh.sets.items()}
    with path.open("wb") as f:
        np.savez_compressed(f, **arrays)


def _write_vtu(
    mesh: TetMesh,
    path: Path,
    point_data: Mapping[str, ArrayLike],
    cell_data: Mapping[str, ArrayLike],
) -> None:
    points: dict[str, Any] = {}
    for name, ids in mesh.sets.items():
        points[f"set:{name}"] = np.zeros(len(mesh.points), dtype=np.uint8)
        points[f"set:{name}"][ids] = 1
    cells: dict[str, Any] = {"region": np.asarray(mesh.region)}
    for given, kept, count, what in (
        (point_data, points, len(mesh.points), "vertices"),
        (cell_data, cells, len(mesh.tets), "tets"),
    ):
        for name, values in given.items():
            array = np.array(values)
            if array.ndim == 0 or len(array) != count:
                raise FileError(
                    f"{path}: data {name!r} has shape {array.shape} for {count} {what}. "
                    "Give one row each."
                )
            # VTK knows scalars and vectors; a tensor goes in as its nine components
            kept[name] = array.reshape(count, -1) if array.ndim > 2 else array
    kind = "tetra" if mesh.order == 1 else "tetra10"
    meshio.write(
        path,
        meshio.Mesh(
            mesh.points,
            [(kind, mesh.tets)],
            point_data=points,
            cell_data={name: [values] for name, values in cells.items()},
        ),
        file_format="vtu",
    )


def _write_msh22(mesh: TetMesh, path: Path, *, binary: bool) -> None:
    """Write version 2.2, where every element carries its own physical tag."""
    names = [(name, 3) for name in mesh.region_names] + [(name, 0) for name in mesh.sets]
    tags = {pair: i + 1 for i, pair in enumerate(names)}
    region = np.asarray(mesh.region)
    cells: list[Any] = [("tetra" if mesh.order == 1 else "tetra10", mesh.tets)]
    physical: list[Any] = [region + 1]
    for name, ids in mesh.sets.items():
        cells.append(("vertex", ids[:, None]))
        physical.append(np.full(len(ids), tags[name, 0]))
    meshio.write(
        path,
        meshio.Mesh(
            mesh.points,
            cells,
            cell_data={"gmsh:physical": physical, "gmsh:geometrical": physical},
            field_data={name: np.array([tag, dim]) for (name, dim), tag in tags.items()},
        ),
        file_format="gmsh22",
        binary=binary,
    )
