"""Geometry files of others, opened by gmsh in a child process.

The child may write no file and start no program (`fence.py`), has no input, and is ended
after a time limit; a crash of gmsh or OCC there is one sentence here. It sends back an .npz
of plain arrays through a pipe.
"""

import json
import resource
import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from plantsim.arrays import Array
from plantsim.errors import FileError, MeshError
from plantsim.mesh.closed import SURFACES, closed_surface, read_surface
from plantsim.mesh.tetmesh import TetMesh
from plantsim.solid import fence
from plantsim.solid.child import asked, packed, serve, sets_of
from plantsim.solid.geo_script import CAD, check_opened
from plantsim.solid.parameters import with_parameters
from plantsim.solid.quality import repair

OPENED = (".geo", ".geo_unrolled", *CAD[:-1], *SURFACES)
Opened = tuple[
    Array, Array, Array | None, tuple[str, ...], dict[str, Array], dict[str, int]
]


def open_geometry(
    path: Path,
    size: float,
    order: int,
    *,
    trust: bool,
    timeout: float,
    parameters: Mapping[str, float | str] | None = None,
) -> Opened:
    """Return points, tets, region, region names and sets of a geometry file.

    Last, how many elements of its volumes are no tets and were left out, by kind.

    Raises FileError for a suffix that is not known or a script that is refused, and
    MeshError when gmsh fails, crashes or takes longer than `timeout` seconds.
    """
    suffix = path.suffix.lower()
    if suffix not in OPENED:
        raise FileError(
            f"{path}: tetrahedralize takes {', '.join(OPENED)} files. Read a mesh with "
            "read_mesh."
        )
    if suffix in SURFACES:
        if parameters:
            raise FileError(f"{path}: only .geo scripts have parameters. Leave them out.")
        return _filled(path, order, timeout)
    with tempfile.TemporaryDirectory(prefix="plantsim-") as folder:
        opened = path.resolve()
        if path.suffix != suffix:
            # gmsh would take plant.STEP for a script: it knows the suffixes in small
            # letters only
            opened = Path(folder) / f"geometry{suffix}"
            shutil.copyfile(path, opened)
        if not trust:
            check_opened(opened)
        if parameters:
            if suffix != ".geo":
                raise FileError(
                    f"{path}: only .geo scripts have parameters. Leave them out."
                )
            text = with_parameters(opened, parameters)
            opened = Path(folder) / "with_parameters.geo"
            opened.write_bytes(text.encode("latin-1"))
        request = {"path": str(opened), "size": size, "order": order, "trust": trust}
        data = _child(path, request, timeout)
    names = tuple(str(n) for n in data["names"])
    others = json.loads(str(data["others"]))
    return data["points"], data["tets"], data.get("region"), names, sets_of(data), others


def _filled(path: Path, order: int, timeout: float) -> Opened:
    """Return a closed surface filled with tets; its triangles stay as they are."""
    try:
        points, faces, _ = closed_surface(*read_surface(path))
    except MeshError as why:
        raise MeshError(f"{path}: {why}") from None
    with tempfile.TemporaryDirectory(prefix="plantsim-") as folder:
        surface = Path(folder) / "surface.npz"
        np.savez(surface, points=points, faces=faces)
        data = _child(path, {"surface": str(surface), "trust": False}, timeout)
    mesh = TetMesh(data["points"], data["tets"], sets=_ground(points, faces))
    mesh = mesh.with_order(order)
    return mesh.points, mesh.tets, None, (), dict(mesh.sets), {}


def _ground(points: Array, faces: Array) -> dict[str, Array]:
    """Return the set "base": the lowest points, where the surface is cut level there."""
    height = points[:, 2] - points[:, 2].min()
    low = height < 1e-6 * float(height.max())
    level = low[faces].all(axis=1)
    return {"base": np.unique(faces[level])} if level.any() else {}


def _child(path: Path, request: dict[str, Any], timeout: float) -> dict[str, Array]:
    return asked(
        "plantsim.solid.foreign",
        request,
        b"",
        timeout,
        what=f"{path}: ",
        late=f"{path}: gmsh was not done after {timeout:.0f} s and was ended. Simplify the "
        "geometry, or give more: timeout=...",
        crashed=f"{path}: gmsh crashed on it (exit {{exit}}). Check the geometry in "
        "gmsh itself; if it opens there, report this.",
    )


def _work(request: dict[str, Any], _: bytes) -> bytes:
    """Open, mesh and pack; in the child."""
    from plantsim.solid import gmsh_model  # noqa: PLC0415  gmsh is loaded in the child alone

    if not request["trust"]:
        resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))
        fence.close()
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    if "surface" in request:
        with np.load(request["surface"], allow_pickle=False) as z:
            points, tets = _fill(gmsh_model, z["points"], z["faces"])
        return packed({"points": points, "tets": tets})
    with gmsh_model.session(General__NoPopup=1):
        gmsh_model.open_file(request["path"])
        gmsh_model.mesh_opened(request["size"], request["order"])
        points, tets, region, names, sets = gmsh_model.arrays(request["order"])
        others = json.dumps(gmsh_model.left_out())
    out: dict[str, Any] = {
        "points": points,
        "tets": tets,
        "names": np.array(names, dtype=str),
        "others": np.array(others),
    }
    if region is not None:
        out["region"] = region
    return packed(out, sets)


def _fill(gmsh_model: Any, points: Array, faces: Array) -> tuple[Array, Array]:
    """Fill by HXT, or by Delaunay where that fails, and mend slivers inside."""
    still = np.ones(len(points), dtype=bool)
    try:
        first = gmsh_model.able(gmsh_model.HXT, len(points), len(faces))
        x, tets = gmsh_model.fill(points, faces, still, first)
    except MeshError:
        x, tets = gmsh_model.fill(points, faces, still, gmsh_model.DELAUNAY)
    held = np.arange(len(x)) < len(points)
    return repair(x, tets, held)[0], tets


if __name__ == "__main__":
    serve(_work)
