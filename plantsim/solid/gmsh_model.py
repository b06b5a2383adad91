"""The one door to gmsh: a session that is entered and left, its options, and its arrays.

gmsh is a global state machine under the GPL. Nothing outside this module calls it, no tag
leaves it, and a session that failed leaves it finalised, as after an error later calls
return no tets.
"""

import ctypes
import os
import re
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

from plantsim.arrays import Array
from plantsim.errors import DependencyError, MeshError
from plantsim.mesh.tetmesh import GMSH_ORDER
from plantsim.solid.delaunay import conforming, with_middles
from plantsim.solid.heap import fresh_heap, room_behind
from plantsim.solid.rings import Ring

try:
    import gmsh as _gmsh
except OSError as why:  # gmsh's wheel needs system libraries that it does not bring
    raise DependencyError(
        f"gmsh cannot be loaded ({why}). Run `plantsim doctor` for the line that installs "
        "what is missing."
    ) from None

gmsh: Any = _gmsh  # its stubs call arrays lists
HXT, DELAUNAY = 10, 1  # Mesh.Algorithm3D
TETS = {1: 4, 2: 11}  # element types by order
NAMES = {HXT: "HXT", DELAUNAY: "Delaunay"}
ROOM = 64  # bytes behind HXT's arrays; four more triangles have been seen
SHAKES = 3  # ways in which HXT gets a surface
SHAKE = 3e-3  # of the shortest edge at a point


def check_free() -> None:
    """Raise MeshError outside the main thread, or when a session of gmsh is open."""
    if threading.current_thread() is not threading.main_thread():
        raise MeshError("gmsh runs in the main thread only. Use processes, not threads.")
    if gmsh.isInitialized():
        raise MeshError("gmsh is in use in this process. Call gmsh.finalize() first.")


@contextmanager
def session(**options: float) -> Iterator[Any]:
    """Enter gmsh with one empty model, silent; yield the gmsh module; leave it finalised.

    Options are given with a double underscore for the dot: `Mesh__Optimize=1`. Any error
    that gmsh raises inside becomes a MeshError. Raises MeshError outside the main thread,
    where gmsh cannot be initialised, and when a session is open already.
    """
    check_free()
    pointers: dict[Any, Any] = getattr(ctypes, "_pointer_type_cache", {})
    known = set(pointers)
    pipe = getattr(signal, "SIGPIPE", None)  # not on Windows
    before = None if pipe is None else signal.getsignal(pipe)
    gmsh.initialize(readConfigFiles=False, interruptible=False)
    if pipe is not None and before is not None:
        # gmsh has undone Python's choice: a socket closed at its other end would end
        # the process without a word, for ever after
        signal.signal(pipe, before)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.option.setNumber(
            "General.NumThreads", 1
        )  # more, and meshes are not repeatable
        for name, value in options.items():
            gmsh.option.setNumber(name.replace("__", "."), value)
        gmsh.model.add("plant")
        yield gmsh
    except (MeshError, KeyboardInterrupt):
        raise
    except Exception as why:
        # gmsh raises bare Exception, and UnicodeDecodeError where names are not UTF-8
        if type(why) is not Exception and not isinstance(why, UnicodeDecodeError):
            raise
        raise MeshError(
            f"gmsh: {' '.join(str(why).split()) or 'failed without a word'}"
        ) from None
    finally:
        gmsh.finalize()
        for kind in set(pointers) - known:  # one for every length of an array, for ever
            del pointers[kind]


@contextmanager
def _mute() -> Iterator[None]:
    """Send to nowhere what C code prints on standard output, as the 3D kernels do."""
    if os.fstat(1).st_rdev == os.stat(os.devnull).st_rdev:
        yield  # it goes there as it is; behind a fence nothing could be opened to write
        return
    libc = ctypes.CDLL(None if os.name == "posix" else "msvcrt")
    sys.stdout.flush()
    libc.fflush(None)
    kept = os.dup(1)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.close(nowhere)
    try:
        yield
    finally:
        libc.fflush(None)
        os.dup2(kept, 1)
        os.close(kept)


def fused_surface(
    lofts: Sequence[list[Ring]],
    seams: Sequence[Ring],
    around: int,
    ground: tuple[Array, float] | None = None,
) -> tuple[Array, Array]:
    """Return points and triangles of lofts through circles, fused, open at the seams.

    Every seam is a circle that ends a loft; it gets `around` points, the first on the
    ring's first direction. Sizes follow the curvature: `around` points a circle. `ground`
    is the centre of a foot and how far from it all below is cut off.
    """
    radii = [r for rings in lofts for _, r, _, _ in rings]
    edge = 2 * np.pi / around
    with session(
        Geometry__OCCParallel=1,
        Mesh__MeshSizeFromCurvature=0,
        Mesh__MeshSizeExtendFromBoundary=1,
        Mesh__MeshSizeFromPoints=1,
        Mesh__MeshSizeMin=0.3 * edge * min(radii),
        Mesh__MeshSizeMax=1.5 * edge * max(radii),
        Mesh__LcIntegrationPrecision=1e-3,  # 1e-9 made curves half the time of meshing
        Mesh__Algorithm=6,
    ):
        volumes = [_loft(rings) for rings in lofts]
        if len(volumes) > 1:
            volumes, _ = gmsh.model.occ.fuse(volumes[:1], volumes[1:])
        if ground is not None:
            (x, y, z), reach = ground
            away = 2 * reach
            soil = gmsh.model.occ.addBox(x - reach, y - reach, z - away, away, away, away)
            gmsh.model.occ.cut(volumes, [(3, soil)])
        gmsh.model.occ.synchronize()
        ends = _end_faces(seams, around)
        _size_points(lofts, edge)
        gmsh.model.mesh.generate(2)
        tags, xyz, _ = gmsh.model.mesh.getNodes()
        row = np.full(int(tags.max(initial=0)) + 1, -1)
        row[tags.astype(np.int64)] = np.arange(len(tags))
        parts = [
            gmsh.model.mesh.getElementsByType(2, tag)[1]
            for _, tag in gmsh.model.getEntities(2)
            if tag not in ends
        ]
        faces = row[np.concatenate(parts).astype(np.int64)].reshape(-1, 3)
        return xyz.reshape(-1, 3).copy(), faces


def _loft(rings: list[Ring]) -> tuple[int, int]:
    """Add the solid through circles, ruled between them; return its (3, tag).

    Two circles on one axis give a true cylinder or cone, whose booleans are twice as fast.
    """
    occ = gmsh.model.occ
    (c, r, z, x), (end, r1, z1, x1) = rings[0], rings[-1]
    if len(rings) == 2 and (z == z1).all() and (x == x1).all():
        way = end - c
        tag = occ.addCylinder(*c, *way, r) if r == r1 else occ.addCone(*c, *way, r, r1)
        start = _first_direction(z)
        turn = np.arctan2(np.cross(start, x) @ z, start @ x)
        occ.rotate([(3, tag)], *c, *z, turn)
        return 3, tag
    wires = [
        occ.addCurveLoop([occ.addCircle(c[0], c[1], c[2], r, zAxis=list(z), xAxis=list(x))])
        for c, r, z, x in rings
    ]
    made = occ.addThruSections(wires, makeSolid=True, makeRuled=True)
    volumes = [pair for pair in made if pair[0] == 3]
    if len(volumes) != 1:
        raise MeshError(f"gmsh: a loft gave {len(volumes)} volumes instead of one.")
    return volumes[0]


def _first_direction(axis: Array) -> Array:
    """Return where OCC puts the seam of a cylinder about a unit axis (its class gp_Ax2)."""
    a, b, c = axis
    size = np.abs(axis)
    if size[1] <= size[0] and size[1] <= size[2]:
        d = (-c, 0.0, a) if size[0] > size[2] else (c, 0.0, -a)
    elif size[0] <= size[1] and size[0] <= size[2]:
        d = (0.0, -c, b) if size[1] > size[2] else (0.0, c, -b)
    else:
        d = (-b, a, 0.0) if size[0] > size[1] else (b, -a, 0.0)
    return np.array(d) / np.linalg.norm(d)


def _size_points(lofts: Sequence[list[Ring]], edge: float) -> None:
    """Give every vertex the edge length of the thinnest loft whose surface it is on."""
    centre = np.array([(rings[i][0]) for rings in lofts for i in range(len(rings) - 1)])
    way = (
        np.array([rings[i + 1][0] for rings in lofts for i in range(len(rings) - 1)])
        - centre
    )
    r0, r1 = (
        np.array([rings[i + k][1] for rings in lofts for i in range(len(rings) - 1)])
        for k in (0, 1)
    )
    for _, tag in gmsh.model.getEntities(0):
        x = np.asarray(gmsh.model.getValue(0, tag, []))
        t = np.clip(((x - centre) * way).sum(axis=1) / (way**2).sum(axis=1), 0, 1)
        r = r0 + t * (r1 - r0)
        on = np.abs(np.linalg.norm(x - centre - t[:, None] * way, axis=1) / r - 1) < 0.05
        gmsh.model.mesh.setSize(
            [(0, tag)], edge * float(r[on].min() if on.any() else r.min())
        )


def _end_faces(seams: Sequence[Ring], around: int) -> set[int]:
    """Give the seams' circles their points; return the discs that close them."""
    vertices = gmsh.model.getEntities(0)
    at = np.array([gmsh.model.getValue(0, tag, []) for _, tag in vertices])
    discs = set()
    for centre, r, _, first in seams:
        off = np.linalg.norm(at - centre - r * first, axis=1)
        _, tag = vertices[int(off.argmin())]
        curves = gmsh.model.getAdjacencies(0, tag)[0]
        closed = [c for c in curves if len(set(gmsh.model.getAdjacencies(1, c)[1])) == 1]
        if off.min() > 1e-6 * r or len(closed) != 1:
            raise MeshError("gmsh: the end of a joint was lost in the boolean.")
        gmsh.model.mesh.setTransfiniteCurve(int(closed[0]), around + 1)
        faces = gmsh.model.getAdjacencies(1, closed[0])[0]
        flat = [int(f) for f in faces if gmsh.model.getType(2, f) == "Plane"]
        if len(flat) != 1:
            raise MeshError("gmsh: the end of a joint is not a disc.")
        discs.add(flat[0])
    return discs


def able(algorithm: int, points: int, faces: int) -> int:
    """Return the 3D algorithm to fill a surface by: the wanted one, or Delaunay for HXT.

    For so many points and triangles: HXT may go beyond arrays with a value for each
    (`heap.fresh_heap`), and is used where that does no harm.
    """
    behind = (room_behind(8 * points), room_behind(8 * faces))
    return DELAUNAY if algorithm == HXT and min(behind) < ROOM else algorithm


def fill(points: Array, faces: Array, flat: Array, algorithm: int) -> tuple[Array, Array]:
    """Return points and tets that fill a closed surface, whose points come first.

    The filler gets the surface shaken along its normals by some thousandths of its edges.
    Rings have many points on one sphere, of which it would make tets without volume, a
    tenth of all; shaken every way four points of a ring still leave its plane, and most of
    those tets stay. Points in the mask `flat` (n,) stay in the plane of their triangles.
    HXT gets the surface made `conforming`, where that can be, with a few more points, which
    follow those given. Where it cannot, and HXT needs further points to keep the surface,
    which is where it reads what it did not write, it gets it shaken in another way. Raises
    MeshError if it always does.
    """
    ends = points[faces]
    along = np.roll(ends, -1, axis=1) - ends
    edge = np.linalg.norm(along, axis=2)
    local = np.full(len(points), np.inf)
    np.minimum.at(local, faces.ravel(), edge.ravel())
    across = np.cross(along[:, 0], along[:, 1])[:, None]
    # each corner's share by the sine of its angle: a strip's triangles meet evenly there
    across = across / (edge * np.roll(edge, 1, axis=1))[:, :, None]
    normal, end = np.zeros_like(points), np.zeros_like(points)
    disc = flat[faces].all(axis=1)
    for out, mine in ((normal, ~disc), (end, disc)):
        np.add.at(out, faces[mine].ravel(), across[mine].reshape(-1, 3))
    end /= np.maximum(np.linalg.norm(end, axis=1), 1e-300)[:, None]
    normal -= (normal * end).sum(axis=1)[:, None] * end  # a rim stays in its plane
    size = np.linalg.norm(normal, axis=1)
    normal *= (local / np.where(size > 0, size, np.inf))[:, None]
    # where nothing is shaken, HXT would do the same each time
    for seed in range(SHAKES if algorithm == HXT and not flat.all() else 1):
        shake = np.random.default_rng(seed).uniform(-SHAKE, SHAKE, len(points))
        shaken = points + shake[:, None] * normal
        ask, ends = faces, np.zeros((0, 2), dtype=np.int64)
        if algorithm == HXT and not flat.all():
            made = conforming(shaken, faces, flat)
            if made and able(HXT, len(points) + len(made[1]), len(made[0])) == HXT:
                ask, ends = made
        filled = _filled(with_middles(shaken, ends), ask, algorithm)
        if filled is not None:
            xyz, tets = (part.copy() for part in filled)  # not where the heap was fresh
            given = with_middles(points, ends)
            xyz[: len(given)] = given
            return xyz, tets
    raise MeshError("gmsh: HXT cannot keep the surface without points of its own.")


def _filled(points: Array, faces: Array, algorithm: int) -> tuple[Array, Array] | None:
    """Return points and tets, or None where HXT has added points to keep the surface."""
    tags, xyz, corners = np.arange(1, len(points) + 1), points.ravel(), faces.ravel() + 1
    with (
        fresh_heap() as begin,
        session(
            Mesh__Algorithm3D=algorithm,
            Mesh__Optimize=algorithm != HXT,
            Mesh__OptimizeThreshold=0.3,
            Mesh__MeshSizeExtendFromBoundary=1,
            Mesh__MeshSizeFromPoints=0,
            Mesh__MeshSizeFromCurvature=0,
        ),
    ):
        skin = gmsh.model.addDiscreteEntity(2)
        begin()
        with _mute():
            gmsh.model.mesh.addNodes(2, skin, tags, xyz)
            gmsh.model.mesh.addElementsByType(skin, 2, [], corners)
            loop = gmsh.model.geo.addSurfaceLoop([skin])
            gmsh.model.geo.addVolume([loop])
            gmsh.model.geo.synchronize()
            gmsh.logger.start()
            gmsh.model.mesh.generate(3)
            # "Delaunay of 213 points on 1 threads - mesh.nvert: 7020", a line a round
            vertices = [
                int(n) for n in re.findall(r"nvert: *(\d+)", "\n".join(gmsh.logger.get()))
            ]
            gmsh.logger.stop()
            if algorithm == HXT:
                if len(vertices) > 1 and vertices[1] != len(points):
                    return None
                gmsh.model.mesh.optimize()
            filled, tets, *_ = arrays(1)
            return filled.copy(), tets


def open_file(path: str) -> None:
    """Open a script, CAD or mesh file, which the caller has checked."""
    gmsh.open(path)


def mesh_opened(size: float, order: int) -> None:
    """Mesh what was opened with sizes scaled, unless it has tets; then set their order."""
    if not any(len(gmsh.model.mesh.getElementsByType(kind)[0]) for kind in TETS.values()):
        gmsh.option.setNumber("Mesh.MeshSizeFactor", size)
        gmsh.model.mesh.generate(3)
    gmsh.model.mesh.setOrder(order)


def left_out() -> dict[str, int]:
    """Return how many elements of volumes are no tetrahedra, by gmsh's names of kinds."""
    out = {}
    for kind in gmsh.model.mesh.getElementTypes(3):
        if kind not in TETS.values():
            name = gmsh.model.mesh.getElementProperties(kind)[0]
            out[name] = len(gmsh.model.mesh.getElementsByType(kind)[0])
    return out


Arrays = tuple[Array, Array, Array | None, tuple[str, ...], dict[str, Array]]


def arrays(order: int) -> Arrays:
    """Return points, tets (VTK order), region, region names and sets, straight from memory.

    Physical volumes give regions, other physical groups vertex sets; nodes in no tet are
    left out. `region` is None where there is no physical volume; then all tets are taken,
    else those of the physical volumes.
    """
    tags, xyz, _ = gmsh.model.mesh.getNodes()
    points = xyz.reshape(-1, 3)
    row = np.full(int(tags.max(initial=0)) + 1, -1)
    row[tags.astype(np.int64)] = np.arange(len(tags))
    groups = [
        (d, t, gmsh.model.getPhysicalName(d, t)) for d, t in gmsh.model.getPhysicalGroups()
    ]
    volumes = [(t, name) for d, t, name in groups if d == 3]

    def cells(entity: int) -> Array:
        _, nodes = gmsh.model.mesh.getElementsByType(TETS[order], entity)
        return row[nodes.astype(np.int64)].reshape(-1, 4 if order == 1 else 10)

    parts: list[Array] = []
    names: list[str] = []
    if volumes:
        seen: set[int] = set()
        for tag, name in volumes:
            mine = [int(e) for e in gmsh.model.getEntitiesForPhysicalGroup(3, tag)]
            block = [cells(e) for e in mine if e not in seen]
            seen.update(mine)
            if sum(map(len, block)):
                parts.append(np.concatenate(block))
                names.append(name or str(tag))
    else:
        parts = [cells(tag) for _, tag in gmsh.model.getEntities(3)]
    if not sum(map(len, parts)):
        there = ", ".join(left_out()) or "none"
        raise MeshError(
            f"gmsh: no tetrahedra (elements of volumes: {there}). Give the geometry a "
            "volume, and mesh it without recombination or extruded layers."
        )
    tets = np.concatenate(parts)
    region = np.repeat(np.arange(len(parts)), [len(p) for p in parts]) if volumes else None
    if order == 2:
        tets = tets[:, GMSH_ORDER]
    used = np.zeros(len(points), dtype=bool)
    used[tets] = True
    new = np.cumsum(used) - 1
    sets = {}
    for dim, tag, name in groups:
        if dim < 3:
            nodes = row[
                gmsh.model.mesh.getNodesForPhysicalGroup(dim, tag)[0].astype(np.int64)
            ]
            sets[name or f"{('point', 'curve', 'surface')[dim]} {tag}"] = np.unique(
                new[nodes[used[nodes]]]
            )
    return points[used], new[tets], region, tuple(names), sets
