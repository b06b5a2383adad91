"""The one door to gmsh: a session that is entered and left, its options, and its arrays.

gmsh is a global state machine under the GPL. Nothing outside this module calls it, no tag
leaves it, and a session that failed leaves it finalised, as after an error later calls
return no tets.
"""

import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

from plantsim.arrays import Array
from plantsim.errors import DependencyError, MeshError

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
GMSH_TO_VTK = [0, 1, 2, 3, 4, 5, 6, 7, 9, 8]  # the last two middles are swapped


@contextmanager
def session(**options: float) -> Iterator[Any]:
    """Enter gmsh with one empty model, silent; yield the gmsh module; leave it finalised.

    Options are given with a double underscore for the dot: `Mesh__Optimize=1`. Any error
    that gmsh raises inside becomes a MeshError. Raises MeshError outside the main thread,
    where gmsh cannot be initialised, and when a session is open already.
    """
    if threading.current_thread() is not threading.main_thread():
        raise MeshError("gmsh runs in the main thread only. Use processes, not threads.")
    if gmsh.isInitialized():
        raise MeshError("gmsh is in use in this process. Call gmsh.finalize() first.")
    gmsh.initialize(readConfigFiles=False, interruptible=False)
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
        if type(why) is not Exception:  # gmsh raises bare Exception; others are ours to see
            raise
        raise MeshError(
            f"gmsh: {' '.join(str(why).split()) or 'failed without a word'}"
        ) from None
    finally:
        gmsh.finalize()


def ruled_loft(rings: Sequence[tuple[Array, float, Array, Array]]) -> tuple[int, int]:
    """Add the solid through circles (centre, radius, axis, first direction)."""
    occ = gmsh.model.occ
    wires = [
        occ.addCurveLoop([occ.addCircle(c[0], c[1], c[2], r, zAxis=list(z), xAxis=list(x))])
        for c, r, z, x in rings
    ]
    made = occ.addThruSections(wires, makeSolid=True, makeRuled=True)
    volumes = [pair for pair in made if pair[0] == 3]
    if len(volumes) != 1:
        raise MeshError(f"gmsh: a loft gave {len(volumes)} volumes instead of one.")
    return volumes[0]


def fuse(volumes: Sequence[tuple[int, int]]) -> float:
    """Join the volumes to one, make it the model, and return its volume [m^3]."""
    occ = gmsh.model.occ
    if len(volumes) > 1:
        occ.fuse(list(volumes[:1]), list(volumes[1:]))
    occ.synchronize()
    left = gmsh.model.getEntities(3)
    if len(left) != 1:
        raise MeshError(
            f"gmsh: joining {len(volumes)} limbs gave {len(left)} pieces, not one."
        )
    return float(occ.getMass(3, left[0][1]))


def generate(algorithm: int) -> None:
    """Fill the model with tets of order 1."""
    gmsh.option.setNumber("Mesh.Algorithm3D", algorithm)
    gmsh.model.mesh.generate(3)


def open_file(path: str) -> None:
    """Open a script, CAD or mesh file, which the caller has checked."""
    gmsh.open(path)


def mesh_opened(size: float, order: int) -> None:
    """Mesh what was opened with sizes scaled, unless it has tets; then set their order."""
    if not any(len(gmsh.model.mesh.getElementsByType(kind)[0]) for kind in TETS.values()):
        gmsh.option.setNumber("Mesh.MeshSizeFactor", size)
        gmsh.model.mesh.generate(3)
    gmsh.model.mesh.setOrder(order)


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
        raise MeshError("gmsh: no tetrahedra. Does the geometry have a volume?")
    tets = np.concatenate(parts)
    region = np.repeat(np.arange(len(parts)), [len(p) for p in parts]) if volumes else None
    if order == 2:
        tets = tets[:, GMSH_TO_VTK]
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
