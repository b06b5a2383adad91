"""Meshes in and out of files: .msh (2.2, 4.1; text or binary), .vtu and .npz."""

import contextlib
import html
import io
import logging
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import meshio
import numpy as np
from numpy.typing import ArrayLike

from plantsim.arrays import Array, few, frozen, vertex_ids
from plantsim.errors import FileError, MeshError, ModelError, check_kind
from plantsim.mesh.msh41 import write_msh41
from plantsim.mesh.msh41_reader import Block, physical_names, read_msh41
from plantsim.mesh.surfaces import SURFACES, write_surface
from plantsim.mesh.tetmesh import TetMesh, compact
from plantsim.paths import existing, no_bomb, replacing, writable

FORMATS = (".msh", ".vtu", ".npz")  # that are read and written
TETS = ("tetra", "tetra10")
log = logging.getLogger(__name__)
Version = Literal["4.1", "2.2"]
# VTK numbers the last two middles of a tetra10 the other way round than gmsh; meshio
# permutes.


def read_mesh(path: str | os.PathLike[str], *, drop_unused: bool = False) -> TetMesh:
    """Return the tetrahedral mesh in a .msh, .vtu or .npz file.

    Gmsh's physical volumes become regions, its physical points, curves and surfaces named
    vertex sets. A .vtu keeps region numbers (cell data "region") and sets (0/1 point data
    "set:NAME"). An .npz has `points` and `tets`, and may have `region`, `region_names` and
    `set:NAME`. `drop_unused` drops vertices that are in no tet, which are an error
    otherwise. Elements of volumes that are no tets are left out, with their vertices, and
    counted in `mesh.report["left_out"]` and a warning of the log.

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
    points, tets, region, names, sets, others = readers[path.suffix.lower()](path)
    if others:
        log.warning("%s: elements that are no tetrahedra are left out: %s", path, others)
    try:
        if drop_unused or others:
            points, tets, sets = _compacted(points, tets, sets)
        report = {"left_out": others} if others else None
        return TetMesh(points, tets, region, sets, names, report)
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

    Its surface alone goes to .ply, .obj, .stl or .glb, as by `write_surface`.
    `version` and `binary` concern .msh; vertex ids, regions and sets survive a round trip.
    `point_data` (n, ...) and `cell_data` (m, ...) go into a .vtu beside region and sets.
    The file appears whole or not at all. Raises FileError for an unknown suffix or version,
    or for data that the format cannot hold.
    """
    check_kind(
        mesh,
        TetMesh,
        "write_mesh",
        FileError,
        "States go by ps.write_state, skeletons by ps.write_skeleton. ",
    )
    path = writable(path, *FORMATS, *SURFACES)
    suffix = path.suffix.lower()
    if version not in ("4.1", "2.2"):
        raise FileError(f"{path}: .msh version {version!r}; there are '4.1' and '2.2'.")
    if suffix != ".vtu" and (point_data or cell_data):
        raise FileError(
            f"{path}: point and cell data are written to .vtu. Change the suffix."
        )
    if suffix in SURFACES:
        return write_surface(mesh, path)
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


def _compacted(
    points: Array, tets: Array, sets: dict[str, Array]
) -> tuple[Array, Array, dict[str, Array]]:
    """Drop unused vertices of arrays that nobody has checked yet."""
    points = frozen(points, (None, 3), name="points", error=MeshError)
    tets = frozen(tets, (None, None), np.int64, name="tets", error=MeshError)
    if not tets.size or tets.min() < 0 or tets.max() >= len(points):
        return points, tets, sets  # for TetMesh to refuse
    checked = {}
    for name, ids in sets.items():
        try:
            checked[name] = vertex_ids(ids, len(points), f"set {name!r}")
        except ModelError as why:
            raise MeshError(str(why)) from None
    return compact(points, tets, checked)


Counts = dict[str, int]  # of elements left out, by kind
Parts = tuple[Array, Array, Array | None, tuple[str, ...], dict[str, Array], Counts]


def _read_msh(path: Path) -> Parts:
    raw = path.read_bytes()
    # gmsh itself takes any file without this header for a script, and scripts can call a
    # shell
    if not raw.lstrip().startswith((b"$MeshFormat", b"$Comments")):
        raise FileError(
            f"{path}: does not start with $MeshFormat, so it is not a gmsh mesh (a script, "
            "perhaps; nothing was run). Export it from gmsh as .msh 2.2 or 4.1."
        )
    try:
        names = physical_names(raw)
        modern = raw[raw.index(b"$MeshFormat") :].split(None, 2)[1].startswith(b"4.1")
        points, blocks = read_msh41(path) if modern else _read_msh22(path)
    except (ValueError, IndexError, OverflowError, MemoryError) as why:
        if isinstance(why, FileError):
            raise
        raise _unreadable(path, why) from None
    used = {(b.dim, tag) for b in blocks for tag in b.groups}
    if names and not used:
        raise FileError(
            f"{path}: it names groups ({few(names.values())}), but no element is in any, "
            "as Mesh.SaveAll does to version 2.2. Save it as 4.1, or without SaveAll."
        )
    groups = sorted(used | set(names))
    regions = [tag for dim, tag in groups if dim == 3]
    solid = [b for b in blocks if b.dim == 3 and len(b.nodes)]
    others = _one_order(
        path, [(b.kind, len(b.nodes)) for b in solid], [b.kind for b in blocks]
    )
    solid = [b for b in solid if b.kind in TETS]
    tets, region = _labelled_tets(solid, regions, once=modern)
    sets: dict[str, Array] = {}
    for dim, tag in groups:
        if dim == 3:
            continue
        kind = ("point", "curve", "surface")[dim]
        name = names.get((dim, tag), f"{kind} {tag}")
        ids = [
            b.nodes[b.groups[tag]].ravel()
            for b in blocks
            if b.dim == dim and tag in b.groups
        ]
        key = name if name not in sets else f"{kind} {name}"
        sets[key] = np.unique(np.concatenate([np.zeros(0, dtype=np.int64), *ids]))
    titles = tuple(names.get((3, tag), str(tag)) for tag in regions)
    if len(set(titles)) < len(titles):
        titles = tuple(f"{t} {tag}" for t, tag in zip(titles, regions, strict=True))
    if region is not None and (region == len(titles)).any():
        titles += ("rest",)
    return points, tets, region, titles if region is not None else (), sets, others


def _labelled_tets(
    solid: list[Block], regions: list[int], *, once: bool
) -> tuple[Array, Array | None]:
    """Return the tets and the region of each, the first of the groups that it is in.

    Version 2.2 writes a tet once for every group that it is in, not `once` in all.
    """
    nodes = np.concatenate([b.nodes for b in solid])
    label = np.full(len(nodes), len(regions))
    start = 0
    for block in solid:
        for tag, rows in block.groups.items():
            place = regions.index(tag)
            label[start + rows] = np.minimum(label[start + rows], place)
        start += len(block.nodes)
    if once:
        return nodes, label if regions else None
    _, first, same = np.unique(
        np.sort(nodes[:, :4], axis=1), axis=0, return_index=True, return_inverse=True
    )
    if len(first) < len(nodes):
        best = np.full(len(first), len(regions))
        np.minimum.at(best, same.ravel(), label)
        label = best[same.ravel()]
        keep = np.sort(first)
        nodes, label = nodes[keep], label[keep]
    return nodes, label if regions else None


def _one_order(path: Path, solid: list[tuple[str, int]], everything: list[str]) -> Counts:
    """Return the elements that are no tets; FileError unless the tets are of one order."""
    kinds = {kind for kind, _ in solid} & set(TETS)
    if not kinds:
        raise FileError(
            f"{path}: no tetrahedra in it "
            f"({', '.join(sorted(set(everything))) or 'no cells'}). Mesh the volume in 3D "
            "with tetrahedra, or use tetrahedralize on its geometry."
        )
    if len(kinds) == 2:
        raise FileError(
            f"{path}: tetrahedra of order 1 and 2 mixed. Write the mesh with one order."
        )
    others: Counts = {}
    for kind, count in solid:
        if kind not in TETS:
            others[kind] = others.get(kind, 0) + count
    return others


def _read_msh22(path: Path) -> tuple[Array, list[Block]]:
    raw = meshio_read(path, "gmsh")
    blocks = []
    physical = raw.cell_data.get(
        "gmsh:physical", [np.zeros(len(c.data)) for c in raw.cells]
    )
    for cells, tags in zip(raw.cells, physical, strict=True):
        tag = np.abs(np.asarray(tags, dtype=np.int64))
        groups = {int(t): np.flatnonzero(tag == t) for t in np.unique(tag[tag > 0])}
        blocks.append(Block(cells.dim, cells.type, cells.data.astype(np.int64), groups))
    return np.asarray(raw.points, dtype=float), blocks


def _unreadable(path: Path, why: object) -> FileError:
    text = " ".join(str(why).split()) or type(why).__name__
    return FileError(
        f"{path}: cannot be read as {path.suffix} ({text[:120]}). It is cut short or "
        "damaged: write it again."
    )


def meshio_read(path: Path, kind: str) -> Any:
    """Return what meshio reads, silently; FileError whatever it stumbles over."""
    silence = io.StringIO()  # meshio prints what it then raises
    try:
        with (
            contextlib.redirect_stdout(silence),
            contextlib.redirect_stderr(silence),
            np.errstate(all="ignore"),
        ):
            return meshio.read(path, file_format=kind)
    except (SystemExit, Exception) as why:  # whatever meshio makes of a broken file
        raise _unreadable(path, why) from None


def _read_vtu(path: Path) -> Parts:
    raw = meshio_read(path, "vtu")
    solid = [b for b, c in enumerate(raw.cells) if c.dim == 3 and len(c.data)]
    others = _one_order(
        path,
        [(raw.cells[b].type, len(raw.cells[b].data)) for b in solid],
        [c.type for c in raw.cells],
    )
    solid = [b for b in solid if raw.cells[b].type in TETS]
    tets = np.concatenate([raw.cells[b].data for b in solid]).astype(np.int64)
    region = raw.cell_data.get("region")
    if region is not None:
        region = np.concatenate([np.asarray(region[b]) for b in solid])
    sets = {
        html.unescape(name.removeprefix("set:")): np.flatnonzero(np.asarray(values) == 1)
        for name, values in raw.point_data.items()
        if name.startswith("set:")
    }
    return np.asarray(raw.points, dtype=float), tets, region, (), sets, others


def _read_npz(path: Path) -> Parts:
    no_bomb(path)
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
    return data["points"], data["tets"], data.get("region"), names, sets, {}


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
        key = f"set:{html.escape(name)}"  # meshio writes names into XML as they are
        points[key] = np.zeros(len(mesh.points), dtype=np.uint8)
        points[key][ids] = 1
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
