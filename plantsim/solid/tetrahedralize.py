"""Solid, or a geometry file of the user's own -> TetMesh."""

import logging
import os
import time
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from plantsim.arrays import Array
from plantsim.errors import MeshError, check_kind
from plantsim.mesh.tetmesh import TetMesh, boundary_places, face_order, quadratic
from plantsim.paths import existing
from plantsim.solid import apart, gmsh_model, occ, union, wild
from plantsim.solid.foreign import open_geometry
from plantsim.solid.quality import curve, flat_ends, limb_sets, on_axis, repair
from plantsim.solid.soundness import check_sound
from plantsim.solid.sweep import Solid

AROUND = 7  # default number of points around a limb
# Curved tets 1.5 edges long are 1.3 % too stiff in bending (benchmarks/cantilever.py): a
# radius smaller by a quarter of that gives the second moment of area back
STIFFER = 0.013
log = logging.getLogger(__name__)
# the ladder: turn of the rings [rad], all in the kernel, 3D algorithms to fill that surface
LADDER = (
    (0.0, False, (gmsh_model.HXT, gmsh_model.DELAUNAY)),
    (0.4, False, (gmsh_model.HXT,)),
    (1.1, False, (gmsh_model.HXT,)),
    (0.7, True, (gmsh_model.HXT,)),
    (1.9, True, (gmsh_model.DELAUNAY,)),
)


def tetrahedralize(
    geometry: Solid | str | os.PathLike[str],
    size: float | None = None,
    *,
    order: int = 2,
    kernel: Literal["occ", "union"] = "occ",
    trust: bool = False,
    timeout: float | None = None,
    parameters: Mapping[str, float | str] | None = None,
) -> TetMesh:
    """Return a tetrahedral mesh of a Solid, or of a file.

    Files: .geo, .step, .stp, .brep, .iges, and closed surfaces: .stl, .obj, .ply.

    For a Solid: `size` is the edge length over the local radius (default 0.9). Kernel
    "union" takes less time than "occ" and needs the extra `fast`; whichever fails gives way
    to fTetWild where pytetwild is installed. Order-2 tets are curved onto the tubes.
    Regions are the limbs, tets sorted by them; the sets are "base" (the foot), "tips" and
    the surface of each limb, "limb NAME". `mesh.report` lists the attempts, what was
    repaired, and the seconds.

    For a file: `size` scales the sizes that the file sets (default 1); its physical volumes
    become regions and its other physical groups vertex sets. `parameters` takes the place
    of values that a .geo script sets itself, as L = 1; or in a DefineConstant. A script
    that could run programs or write files is refused unless `trust=True`. The triangles of
    a surface stay as they are (`size` has no say); coinciding points are merged, small
    holes closed, other open surfaces refused; the set "base" is its lowest points where it
    is cut level there.

    `timeout` [s] is the longest that meshing may take. A file goes to a child process in
    any case (600 s), a Solid only if it is given.

    Raises DependencyError for kernel "union" without its packages, FileError for a file
    that is missing, foreign or refused, and MeshError when no attempt gave one sound mesh
    (what that is: `plantsim.solid.soundness`).
    """
    if order not in (1, 2):
        raise MeshError(f"order is {order!r}; give 1 or 2.")
    if kernel not in ("occ", "union"):
        raise MeshError(f"kernel {kernel!r} is not known; give 'occ' or 'union'.")
    if size is not None and not 0.1 <= size <= 10:
        raise MeshError(f"size is {size}; give a factor from 0.1 to 10.")
    if not isinstance(geometry, Solid):
        if not isinstance(geometry, str | os.PathLike):
            check_kind(geometry, Solid, "tetrahedralize", MeshError)
        path = existing(geometry)
        given = {"trust": trust, "timeout": timeout or 600.0, "parameters": parameters}
        return _from_file(path, 1.0 if size is None else size, order, **given)
    if trust or parameters:
        raise MeshError("trust and parameters are for files. Leave them out for a Solid.")
    if timeout is not None:
        return apart.tetrahedralized(geometry, size, order, kernel, timeout)
    gmsh_model.check_free()
    attempts: list[dict[str, Any]] = []
    report: dict[str, Any] = {"kernel": kernel, "attempts": attempts}
    around = AROUND if size is None else max(4, round(2 * np.pi / size))
    finish = partial(_finished, geometry, order, report)
    if kernel == "union":
        mesh = union.meshed(geometry, around, grow(around, order), finish, _timed, attempts)
    else:
        mesh = _climbed(geometry, around, grow(around, order), finish, attempts)
    if mesh is not None:
        return mesh
    if wild.installed():
        note = {"algorithm": "fTetWild"}
        attempts.append(note)
        try:
            points, tets = _timed(
                note, "fill", wild.fill, geometry, around, grow(around, order)
            )
            return finish(points, tets)
        except MeshError as why:
            note["failure"] = str(why)
            log.info("meshing attempt %d failed: %s", len(attempts), why)
    raise MeshError(
        f"no attempt of {len(attempts)} gave a sound mesh of {len(geometry.tubes)} limbs "
        f"at order {order} and size {2 * np.pi / AROUND if size is None else size:.2g}; "
        f"the last said: {attempts[-1]['failure']} Prune limbs that graze others, or try "
        "another size."
    )


def _climbed(
    solid: Solid,
    around: int,
    growth: float,
    finish: Callable[[Array, Array], TetMesh],
    attempts: list[dict[str, Any]],
) -> TetMesh | None:
    """Return the mesh of the first rung of kernel "occ" that `finish` accepts, or None."""
    for turn, whole, algorithms in LADDER:
        skin: Any = None  # one surface for all algorithms of a rung
        for algorithm in algorithms:
            note: dict[str, Any] = {"turn": turn, "whole": whole}
            attempts.append(note)
            try:
                if skin is None:
                    ask = solid, around, growth, turn, whole
                    skin = _timed(note, "surface", occ.surface, *ask)
                flat = flat_ends(solid, skin[0])
                used = gmsh_model.able(algorithm, *map(len, skin))
                note["algorithm"] = gmsh_model.NAMES[used]
                ask = *skin, flat, used
                return finish(*_timed(note, "fill", gmsh_model.fill, *ask))
            except MeshError as why:
                note["failure"] = str(why)
                log.info("meshing attempt %d failed: %s", len(attempts), why)
            if skin is None:
                break  # another algorithm would not help
    return None


def grow(around: int, order: int) -> float:
    """Return the factor on radii that gives a ring's polygon the section of the circle."""
    if order == 1:  # the volume between two polygons turned against each other
        half = np.pi / around
        ends, middle = np.sin(2 * half) / 2, np.cos(half / 2) ** 2 * np.sin(half)
        return float(np.sqrt(3 * np.pi / (around * (ends + 2 * middle))))
    return 1 - STIFFER * (AROUND / around) ** 3 / 4


def _timed(note: dict[str, Any], step: str, act: Callable[..., Any], *args: Any) -> Any:
    """Call `act` and note its seconds; so also where it fails."""
    log.info("%s ...", step)
    began = time.perf_counter()
    try:
        return act(*args)
    finally:
        note.setdefault("seconds", {})[step] = time.perf_counter() - began


def _finished(
    solid: Solid,
    order: int,
    report: dict[str, Any],
    points: Array,
    tets: Array,
    known: tuple[Array, Array] | None = None,
) -> TetMesh:
    """Return the mesh repaired, labelled, curved and checked.

    `known`: the limb of each tet, and of each vertex of the surface (-1 if unknown).
    """
    note = report["attempts"][-1]
    points, note["slivers"], note["slivers_left"] = _timed(
        note, "repair", repair, points, tets, flat_ends(solid, points)
    )
    region, owner = known or (None, None)
    if region is None:
        region = _timed(note, "label", on_axis, solid, points[tets].mean(axis=1))[0]
    by_limb = np.argsort(region, kind="stable")
    region, tets = region[by_limb], tets[by_limb]
    places = boundary_places(face_order(tets, len(points)))
    if order == 2:
        points, tets, _ = quadratic(points, tets)
        ask = points, tets, solid, places, owner
        points, note["flattened"] = _timed(note, "curve", curve, *ask)
    names = tuple(t.name for t in solid.tubes)
    sets = limb_sets(solid, points, tets, region, places)
    mesh = _timed(note, "check", TetMesh, points, tets, region, sets, names, report)
    note["genus"] = _timed(note, "soundness", check_sound, solid, mesh)
    return mesh


def _from_file(path: Path, size: float, order: int, **given: Any) -> TetMesh:
    began = time.perf_counter()
    points, tets, region, names, sets, others = open_geometry(path, size, order, **given)
    report: dict[str, Any] = {"source": path.name, "seconds": time.perf_counter() - began}
    if others:
        report["left_out"] = others
        log.warning("%s: elements that are no tetrahedra are left out: %s", path, others)
    try:
        return TetMesh(points, tets, region, sets, names, report)
    except MeshError as why:
        raise MeshError(f"{path}: {why}") from None
