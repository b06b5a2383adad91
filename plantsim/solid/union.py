"""Kernel "union": tube surfaces united by manifold3d, their joints meshed anew by mmg.

Away from the joints the surface stays as the rings put it down; there the union leaves
triangles of any shape, which are meshed anew with the rest held.
"""

import logging
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.sparse import csr_array

from plantsim.arrays import Array, few
from plantsim.errors import MeshError
from plantsim.mesh.tetmesh import TetMesh, gamma
from plantsim.solid import gmsh_model
from plantsim.solid.booleans import united
from plantsim.solid.crossings import crossings
from plantsim.solid.quality import flat_ends, on_axis
from plantsim.solid.remesh import remeshed
from plantsim.solid.rings import STEP, whole
from plantsim.solid.sweep import Solid

# Joints have fewer and longer tets than those of kernel "occ" and are a little too stiff;
# radii smaller by this share make up for half of that
STIFFER = 0.002
EDGE = 1.1  # of the joints [edges around the thinner limb]
THICK, FINER = 3.0, 0.7  # a limb that many times thinner has a joint with shorter edges
GRADING = 1.4  # growth of edges away from a joint
SHORT = 1e-3  # edges of the union below this share of the thinnest edge are collapsed
# rings of triangles about a joint that are meshed anew, by attempt
ZONES = (1, 2, 1, 1, 2, 1, 2, 1)
PULLS = 6  # onto the tubes that meet at a joint
OUT = (0.6, 1.2)  # distances from the axis [radii] that count as on a limb's surface
FOLD = 0.4  # cosine of the largest turn of a triangle's normal as its corners move out
BAD = 0.1  # gamma below which an element's limbs are turned before the next attempt
log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Skin:
    """A closed surface and the limb that each of its triangles came from."""

    points: Array  # (n, 3) [m]
    faces: Array  # (m, 3)
    limb: Array  # (m,) int

    @cached_property
    def pairs(self) -> tuple[Array, Array]:
        """Vertices, and the limbs whose surface they are on; those at joints twice."""
        at = self.faces.ravel(), np.repeat(self.limb, 3)
        shape = len(self.points), int(self.limb.max()) + 1
        once = csr_array((np.ones(self.faces.size), at), shape=shape)
        vertex = np.repeat(np.arange(len(self.points)), np.diff(once.indptr))
        return vertex, once.indices.astype(np.int64)

    @cached_property
    def limb_of(self) -> Array:
        """The limb that each vertex is on, -1 at the joints."""
        vertex, limb = self.pairs
        out = np.full(len(self.points), -1)
        out[vertex] = limb
        out[np.bincount(vertex) > 1] = -1
        return out

    def limbs_at(self, vertices: Array) -> Array:
        """Return the limbs whose triangles have one of the vertices (ids)."""
        hit = np.zeros(len(self.points), dtype=bool)
        hit[vertices[vertices < len(self.points)]] = True
        return np.unique(self.limb[hit[self.faces].any(axis=1)])


def unite(solid: Solid, around: int, grow: float, seams: Array) -> tuple[Skin, int]:
    """Return the union of all tubes and its genus; each tube turned by its seam [rad]."""
    parts = [
        whole(
            tube,
            around,
            grow,
            STEP * 2 * np.pi / around,
            float(seam),
            solid.foot[1] if tube is solid.tubes[0] else None,
        )
        for tube, seam in zip(solid.tubes, seams, strict=True)
    ]
    thin = min(float(t.radii.min()) for t in solid.tubes)
    points, faces, limb, genus = united(parts, SHORT * 2 * np.pi / around * thin)
    return Skin(points, faces, limb), genus


def mended(
    solid: Solid, union: Skin, around: int, grow: float, zone: int
) -> tuple[Skin, Array]:
    """Return the surface, its joints meshed anew, and a mask of points where it crosses.

    The new vertices lie on the flat sides of the rings' polygons; they are moved out onto
    the tubes, or the section would lose up to an eighth.
    """
    radius, thickest, free = _radii(solid, union)
    radius[free & (thickest > THICK * radius)] *= FINER
    for _ in range(zone):
        hit = free[union.faces].any(axis=1)
        free[union.faces[hit]] = True
    size = EDGE * 2 * np.pi / around * radius
    # mmg would round the rim of a foot or flat tip off: their discs stay
    disc = flat_ends(solid, union.points)[union.faces].all(axis=1)
    near = np.asarray(free[union.faces].any(axis=1) & ~disc)
    if not near.any():
        return union, np.zeros(len(union.points), dtype=bool)
    new = remeshed(union.points, union.faces, union.limb, near, size, GRADING)
    points, faces, limb, fresh = new
    moved = _on_tubes(solid, Skin(points, faces, limb), fresh, grow)
    mine = faces[fresh[faces].any(axis=1)]
    for _ in range(8):
        crossed = crossings(moved, mine)
        back = crossed.copy()
        back[mine[_turned(points, moved, mine)]] = True
        back &= (moved != points).any(axis=1)
        if not back.any():
            return Skin(moved, faces, limb), crossed
        moved[back] = points[back]
    return Skin(moved, faces, limb), crossings(moved, mine)


def _on_tubes(solid: Solid, skin: Skin, fresh: Array, grow: float) -> Array:
    """Return points with the fresh ones (mask) drawn onto the tubes that they are on.

    A point at a joint goes from one tube to the other in turn, which ends where they meet.
    """
    vertex, limb = skin.pairs
    vertex, limb = vertex[fresh[vertex]], limb[fresh[vertex]]
    points = skin.points.copy()
    for turn in range(PULLS):
        many = np.bincount(vertex, minlength=len(points)) > 1
        if turn == 1:  # points of one limb are there
            vertex, limb = vertex[many[vertex]], limb[many[vertex]]
        for i in np.unique(limb):
            mine = vertex[limb == i]
            foot, radius = solid.tubes[i].foot(points[mine])
            off = points[mine] - foot
            ratio = np.linalg.norm(off, axis=1) / (grow * radius)
            ok = (ratio > OUT[0]) & (ratio < OUT[1])
            points[mine[ok]] = (foot + off / ratio[:, None])[ok]
    return points


def _turned(before: Array, after: Array, faces: Array) -> Array:
    """Mask the triangles whose normal turns by more than FOLD."""
    n, m = (
        np.cross(x[faces[:, 1]] - x[faces[:, 0]], x[faces[:, 2]] - x[faces[:, 0]])
        for x in (before, after)
    )
    size = np.linalg.norm(n, axis=1) * np.linalg.norm(m, axis=1)
    return (n * m).sum(axis=1) < FOLD * size


def _radii(solid: Solid, union: Skin) -> tuple[Array, Array, Array]:
    """Return the least and greatest radius [m] at each point, and a mask of the joints'."""
    n = len(union.points)
    vertex, limb = union.pairs
    least, greatest = np.full(n, np.inf), np.zeros(n)
    for i, tube in enumerate(solid.tubes):
        mine = vertex[limb == i]
        if len(mine):
            r = tube.radius_near(union.points[mine])
            least[mine] = np.minimum(least[mine], r)
            greatest[mine] = np.maximum(greatest[mine], r)
    return least, greatest, np.bincount(vertex, minlength=n) > 1


Finish = Callable[[Array, Array, tuple[Array, Array]], TetMesh]


def meshed(
    solid: Solid,
    around: int,
    grow: float,
    finish: Finish,
    timed: Callable[..., Any],
    attempts: list[dict[str, Any]],
) -> TetMesh | None:
    """Return the mesh of the first attempt that `finish` accepts, None if all fail.

    `finish` is given points, tets, and the limbs of all tets and of all vertices of the
    surface (-1 at joints). Raises DependencyError without the extra
    `fast`.
    """
    grow *= 1 - STIFFER
    rng = np.random.default_rng(0)
    seams = rng.uniform(0, 2 * np.pi, len(solid.tubes))
    for zone in ZONES:
        turned = np.arange(len(seams))  # where the surface itself failed: all limbs
        note: dict[str, Any] = {"zone": zone}
        attempts.append(note)
        try:
            union, genus = timed(note, "union", unite, solid, around, grow, seams)
            skin, crossed = timed(note, "joints", mended, solid, union, around, grow, zone)
            if crossed.any():
                turned = skin.limbs_at(np.flatnonzero(crossed))
                names = few(solid.tubes[i].name for i in turned)
                raise MeshError(f"the surface crosses itself where limbs {names} meet.")
            _check_skin(skin, genus)
        except MeshError as fault:
            note["failure"] = str(fault)
            seams[turned] = rng.uniform(0, 2 * np.pi, len(turned))
            continue
        flat = flat_ends(solid, skin.points)
        for algorithm in (gmsh_model.HXT, gmsh_model.DELAUNAY):
            if "algorithm" in note:
                note = {"zone": zone}
                attempts.append(note)
            used = gmsh_model.able(algorithm, len(skin.points), len(skin.faces))
            note["algorithm"] = gmsh_model.NAMES[used]
            points, tets = skin.points, np.zeros((0, 4), dtype=np.int64)
            try:
                points, tets = timed(
                    note, "fill", gmsh_model.fill, skin.points, skin.faces, flat, used
                )
                region = timed(note, "label", limbs, solid, skin, points, tets)
                return finish(points, tets, (region, skin.limb_of))
            except MeshError as fault:
                note["failure"] = str(fault)
                log.info("meshing attempt %d failed: %s", len(attempts), fault)
                if len(tets):
                    bad = tets[gamma(points[tets]) < BAD]
                    turned = skin.limbs_at(np.unique(bad))
        seams[turned] = rng.uniform(0, 2 * np.pi, len(turned))
    return None


def _check_skin(skin: Skin, genus: int) -> None:
    """Raise MeshError unless the surface is closed and has the genus of the union."""
    n = len(skin.points)
    sides = np.sort(skin.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    _, times = np.unique(sides @ [n, 1], return_counts=True)
    if (times != 2).any():
        raise MeshError(
            f"the surface is open or pinched at {int((times != 2).sum())} edges."
        )
    euler = n - len(times) + len(skin.faces)
    if euler != 2 - 2 * genus:
        raise MeshError(
            f"the surface has Euler characteristic {euler}, not {2 - 2 * genus}."
        )


def limbs(solid: Solid, skin: Skin, points: Array, tets: Array) -> Array:
    """Return the limb of every tet (m, 4): the one whose surface its corners are on.

    At least three corners have to be on a surface, and those at a joint are on two. Where
    that does not leave one limb, it is the nearest in radii.
    """
    on = np.full((len(points), 3), -1)
    vertex, limb = skin.pairs
    first = np.searchsorted(vertex, vertex)
    place = np.arange(len(vertex)) - first
    on[vertex[place < 3], place[place < 3]] = limb[place < 3]
    inside = on[:, 0] < 0
    corner = np.where(inside[tets], -1, tets)
    start = tets[np.arange(len(tets)), corner.argmax(axis=1)]  # a corner on the surface
    shared = (on[start] >= 0) & ((corner >= 0).sum(axis=1) >= 3)[:, None]
    for column in corner.T:
        same = (on[column][:, :, None] == on[start][:, None]).any(axis=1)
        shared &= same | (column < 0)[:, None]
    out = on[start, shared.argmax(axis=1)]
    unclear = shared.sum(axis=1) != 1
    # in a crotch all corners may be on one limb, and the tet well outside of it
    crotch = np.flatnonzero((on[tets, 1] >= 0).any(axis=1) & ~unclear)
    away = on_axis(solid, points[tets[crotch]].mean(axis=1), out[crotch])[1] > OUT[1]
    unclear[crotch[away]] = True
    out[unclear] = on_axis(solid, points[tets[unclear]].mean(axis=1))[0]
    return out
