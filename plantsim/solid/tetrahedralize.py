"""Solid, or a geometry file of the user's own -> TetMesh."""

import logging
import os
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from plantsim.arrays import Array
from plantsim.errors import MeshError
from plantsim.mesh.tetmesh import TetMesh
from plantsim.paths import existing
from plantsim.solid import gmsh_model, occ, union, wild
from plantsim.solid.foreign import open_geometry
from plantsim.solid.quality import curve, flat_ends, on_axis, on_disc, repair
from plantsim.solid.sweep import Solid

AROUND = 7  # default number of points around a limb
WORST = 0.05  # smallest gamma that a mesh of ours may have
# Curved tets 1.5 edges long are some 1 % too stiff in bending (benchmarks/cantilever.py): a
# radius smaller by a quarter of that gives the second moment of area back
STIFFER = 0.0095
log = logging.getLogger(__name__)
# the ladder: (3D algorithm, turn of the rings [rad], all in the kernel) of each attempt
LADDER = (
    (gmsh_model.HXT, 0.0, False),
    (gmsh_model.DELAUNAY, 0.0, False),
    (gmsh_model.HXT, 0.4, False),
    (gmsh_model.HXT, 1.1, False),
    (gmsh_model.HXT, 0.7, True),
    (gmsh_model.DELAUNAY, 1.9, True),
)


def tetrahedralize(
    geometry: Solid | str | os.PathLike[str],
    size: float | None = None,
    *,
    order: int = 2,
    kernel: Literal["occ", "union"] = "occ",
    trust: bool = False,
    timeout: float = 600.0,
) -> TetMesh:
    """Return a tetrahedral mesh of a Solid, or of a file.

    Files: .geo, .step, .stp, .brep, .iges, and closed surfaces: .stl, .obj, .ply.

    For a Solid: `size` is the edge length over the local radius (default 0.9). Kernel
    "union" is a few times faster than "occ" and needs the extra `fast`; whichever fails
    gives way to fTetWild where pytetwild is installed. Order-2 tets are curved onto the
    tubes. Regions are the limbs, tets sorted by them; the set "base" is the vertices of the
    foot. `mesh.report` lists the attempts, what was repaired, and the seconds.

    For a file: `size` scales the sizes that the file sets (default 1); its physical volumes
    become regions and its other physical groups vertex sets. A script that could run
    programs or write files is refused unless `trust=True`. The triangles of a surface stay
    as they are (`size` has no say); coinciding points are merged, small holes closed, other
    open surfaces refused; the set "base" is its lowest points where it is cut level there.

    Raises DependencyError for kernel "union" without its packages, FileError for a file
    that is missing, foreign or refused, and MeshError when no attempt gave one sound mesh
    (worst gamma 0.05, every limb present).
    """
    if order not in (1, 2):
        raise MeshError(f"order is {order!r}; give 1 or 2.")
    if kernel not in ("occ", "union"):
        raise MeshError(f"kernel {kernel!r} is not known; give 'occ' or 'union'.")
    if size is not None and not 0.1 <= size <= 10:
        raise MeshError(f"size is {size}; give a factor from 0.1 to 10.")
    if not isinstance(geometry, Solid):
        path = existing(geometry)
        return _from_file(path, 1.0 if size is None else size, order, trust, timeout)
    gmsh_model.check_free()
    attempts: list[dict[str, Any]] = []
    around = AROUND if size is None else max(4, round(2 * np.pi / size))
    if kernel == "union":
        mesh = union.meshed(
            geometry,
            around,
            grow(around, order),
            partial(_finished, geometry, order=order),
            _timed,
            attempts,
        )
        if mesh is not None:
            return replace(mesh, report={"kernel": kernel, "attempts": attempts})
    for algorithm, turn, whole in LADDER if kernel == "occ" else ():
        note: dict[str, Any] = {
            "algorithm": "HXT" if algorithm == gmsh_model.HXT else "Delaunay",
            "turn": turn,
            "whole": whole,
        }
        attempts.append(note)
        try:
            points, faces = _timed(
                note,
                "surface",
                occ.surface,
                geometry,
                around,
                grow(around, order),
                turn,
                whole,
            )
            points, tets = _timed(note, "fill", gmsh_model.fill, points, faces, algorithm)
            mesh = _finished(geometry, points, tets, note, order=order)
        except MeshError as why:
            note["failure"] = str(why)
            log.info("meshing attempt %d failed: %s", len(attempts), why)
            continue
        return replace(mesh, report={"kernel": kernel, "attempts": attempts})
    if wild.installed():
        note = {"algorithm": "fTetWild"}
        attempts.append(note)
        try:
            points, tets = _timed(
                note, "fill", wild.fill, geometry, around, grow(around, order)
            )
            mesh = _finished(geometry, points, tets, note, order=order)
            return replace(mesh, report={"kernel": kernel, "attempts": attempts})
        except MeshError as why:
            note["failure"] = str(why)
    raise MeshError(
        f"no attempt of {len(attempts)} gave a sound mesh of {len(geometry.tubes)} limbs; "
        f"the last said: {attempts[-1]['failure']} Prune limbs that graze others, or try "
        "another size."
    )


def grow(around: int, order: int) -> float:
    """Return the factor on radii that gives a ring's polygon the section of the circle."""
    if order == 1:  # the volume between two polygons turned against each other
        half = np.pi / around
        ends, middle = np.sin(2 * half) / 2, np.cos(half / 2) ** 2 * np.sin(half)
        return float(np.sqrt(3 * np.pi / (around * (ends + 2 * middle))))
    return 1 - STIFFER * (AROUND / around) ** 3 / 4


def _timed(note: dict[str, Any], step: str, act: Callable[..., Any], *args: Any) -> Any:
    """Call `act` and note its seconds; so also where it fails."""
    began = time.perf_counter()
    try:
        return act(*args)
    finally:
        note.setdefault("seconds", {})[step] = time.perf_counter() - began


def _finished(
    solid: Solid,
    points: Array,
    tets: Array,
    note: dict[str, Any],
    known: tuple[Array, Array] | None = None,
    *,
    order: int,
) -> TetMesh:
    """Return the mesh repaired, labelled, curved and checked.

    `known`: the limb of each tet, and of each vertex of the surface (-1 if unknown).
    """
    points, note["slivers"], note["slivers_left"] = _timed(
        note, "repair", repair, points, tets, flat_ends(solid, points)
    )
    region, owner = known or (None, None)
    if region is None:
        region = _timed(note, "label", on_axis, solid, points[tets].mean(axis=1))[0]
    by_limb = np.argsort(region, kind="stable")
    mesh = TetMesh(
        points,
        tets[by_limb],
        region[by_limb],
        {"base": _foot(solid, points)},
        tuple(t.name for t in solid.tubes),
    )
    if order == 2:
        mesh = mesh.with_order(2)
        points, note["flattened"] = _timed(note, "curve", curve, mesh, solid, owner)
        mesh = replace(mesh, points=points)
    _check_whole(solid, mesh)
    return mesh


def _foot(solid: Solid, points: Array) -> Array:
    """Return the vertices on the flat foot of the trunk."""
    return np.flatnonzero(on_disc(solid.tubes[0], 0.0, points))


def _check_whole(solid: Solid, mesh: TetMesh) -> None:
    worst = float(mesh.quality.min())
    if worst < WORST:
        raise MeshError(f"the worst tet has gamma {worst:.3f}, wanted {WORST}.")
    if mesh.pieces.max():
        raise MeshError(f"the mesh has {mesh.pieces.max() + 1} separate pieces.")
    for i, tube in enumerate(solid.tubes):
        corners = np.unique(mesh.tets[mesh.region == i])
        end = np.linalg.norm(mesh.points[corners] - tube.axis(1.0), axis=1)
        if not len(corners) or end.min() > 1.5 * tube.radius(1.0):
            raise MeshError(f"limb {tube.name} is not in the mesh up to its tip.")
    off = mesh.volume / solid.volume - 1
    if abs(off) > 0.05:
        raise MeshError(f"the mesh has {100 * off:+.1f} % of the solid's volume too much.")


def _from_file(path: Path, size: float, order: int, trust: bool, timeout: float) -> TetMesh:
    began = time.perf_counter()
    points, tets, region, names, sets = open_geometry(
        path, size, order, trust=trust, timeout=timeout
    )
    report: dict[str, Any] = {"source": path.name, "seconds": time.perf_counter() - began}
    try:
        return TetMesh(points, tets, region, sets, names, report)
    except MeshError as why:
        raise MeshError(f"{path}: {why}") from None
