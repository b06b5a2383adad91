"""What is done to a plant: vertices moved or held, forces, tractions, weights, gravity."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import KDTree

from plantsim.arrays import Array, frozen, vertex_ids
from plantsim.elastic.faces import faces_within, shape_integrals
from plantsim.errors import ModelError
from plantsim.mesh.tetmesh import TetMesh

STANDARD_GRAVITY = 9.80665  # [m/s^2], CGPM 1901


@dataclass(frozen=True, eq=False)
class Move:
    """Vertices brought to given displacements [m]."""

    ids: ArrayLike
    displacement: Array  # (3,) for all, or (k, 3)


@dataclass(frozen=True, eq=False)
class Hold:
    """Vertices brought to given displacements in some directions, free in the others."""

    ids: ArrayLike
    directions: Array  # (j, 3) orthonormal: those in which they are held
    displacement: Array  # (3,) [m]; its part along the directions counts


@dataclass(frozen=True, eq=False)
class Force:
    """A force [N] on vertices."""

    ids: ArrayLike
    force: Array  # (3,) in all, shared evenly, or (k, 3)
    follows: bool = False  # turns with its vertices, which are taken for a rigid patch


@dataclass(frozen=True, eq=False)
class Gravity:
    """Weight of the plant's own mass."""

    acceleration: Array  # (3,) [m/s^2]


@runtime_checkable
class Composite(Protocol):
    """A load that becomes simpler ones once the mesh is known."""

    def parts(self, mesh: TetMesh) -> Sequence["Load"]:
        """Return the loads that it stands for."""
        ...


Load = Move | Hold | Force | Gravity | Composite


@dataclass(frozen=True, eq=False)
class Traction:
    """A traction [Pa] on the part of the surface between vertices."""

    where: ArrayLike
    stress: Array  # (3,), or () for a pressure: inwards, along the normal

    def parts(self, mesh: TetMesh) -> tuple[Force]:
        """Return the nodal forces that do the same work."""
        ids = ids_in(mesh, self.where, "traction")
        faces = faces_within(mesh, ids)
        if not len(faces):
            raise ModelError(
                f"traction: no face of the surface lies between the {len(ids)} vertices. "
                "Name all vertices of at least one face."
            )
        area, normal = shape_integrals(mesh, faces)
        f = np.zeros_like(mesh.points)
        each = -self.stress * normal if self.stress.ndim == 0 else area * self.stress
        np.add.at(f, faces, each)
        on = np.unique(faces)
        return (Force(on, f[on]),)


@dataclass(frozen=True, eq=False)
class Hanging:
    """Masses, such as fruits and leaves, that hang from the nearest surface vertices."""

    points: Array  # (k, 3) [m]
    mass: Array  # (k,) [kg]
    acceleration: Array  # (3,) [m/s^2]

    def parts(self, mesh: TetMesh) -> tuple[Force]:
        """Return their weights on the vertices nearest to them."""
        on = mesh.surface_vertices
        ids = on[KDTree(mesh.points[on]).query(self.points)[1]]
        mass = np.bincount(ids, self.mass, len(mesh.points))
        some = np.flatnonzero(mass)
        return (Force(some, mass[some, None] * self.acceleration),)


def move(ids: ArrayLike, displacement: ArrayLike) -> Move:
    """Return the load that moves vertices by `displacement` [m].

    (3,) for all, or one row a vertex, (k, 3).

    `ids`: vertex ids or a set's name. Raises ModelError for shapes that do not fit.
    """
    return Move(ids, _rows("displacement", ids, displacement))


def hold(
    ids: ArrayLike, *, free: ArrayLike = (), displacement: ArrayLike = (0, 0, 0)
) -> Hold:
    """Return the load that holds vertices in all directions but the `free` ones.

    `free`: none, one (3,) or two (2, 3) directions in which each vertex goes where it will,
    as a slide or a roller does. `displacement` (3,) [m]: where it is held.

    Raises ModelError for directions that are zero, parallel or more than two.
    """
    given = np.asarray(free, dtype=float)
    given = np.zeros((0, 3)) if given.size == 0 else np.atleast_2d(given)
    ways = frozen(given, (None, 3), name="free", error=ModelError)
    size = np.linalg.norm(ways, axis=1)
    _, span, axes = np.linalg.svd(ways / np.where(size > 0, size, 1)[:, None])
    if len(ways) > 2 or (span < 1e-6).any():
        raise ModelError(
            f"free: {len(ways)} directions of rank {(span >= 1e-6).sum()}. Give at most "
            "two that differ; leave a vertex out to free it altogether."
        )
    d = frozen(displacement, (3,), name="displacement", error=ModelError)
    return Hold(ids, axes[len(ways) :], d)


def force(ids: ArrayLike, force: ArrayLike, *, follows: bool = False) -> Force:
    """Return a force [N] on vertices.

    (3,) in all, shared evenly, or one row a vertex, (k, 3). It is a dead load, the same
    however the plant turns, as gravity is; with `follows=True` it turns with the patch of
    its vertices, as a grip's or a thruster's does. In linear theory there is no difference.

    `ids`: vertex ids or a set's name. Raises ModelError for shapes that do not fit.
    """
    return Force(ids, _rows("force", ids, force), follows)


def traction(where: ArrayLike, stress: ArrayLike) -> Traction:
    """Return a traction [Pa] on all faces of the surface between vertices `where`.

    `stress`: (3,) in space, or one number for a pressure, which pushes inwards. `where`: a
    set's name or vertex ids; a face counts if all of its vertices are named.
    """
    shape = () if np.ndim(stress) == 0 else (3,)
    return Traction(where, frozen(stress, shape, name="stress", error=ModelError))


def hang(
    points: ArrayLike,
    mass: ArrayLike,
    acceleration: ArrayLike = (0.0, 0.0, -STANDARD_GRAVITY),
) -> Hanging:
    """Return the weight of masses [kg] at points (k, 3), on the nearest surface vertices.

    `mass`: one for all, or (k,). For fruits and leaves that a skeleton bears.
    """
    at = frozen(np.atleast_2d(points), (None, 3), name="points", error=ModelError)
    m = frozen(
        np.broadcast_to(mass, (len(at),)) if np.ndim(mass) == 0 else mass,
        (len(at),),
        name="mass",
        error=ModelError,
    )
    if (m < 0).any():
        raise ModelError(f"mass: {m.min():.3g} kg. Give 0 or more.")
    g = frozen(acceleration, (3,), name="acceleration", error=ModelError)
    return Hanging(at, m, g)


def ids_in(mesh: TetMesh, ids: ArrayLike | str, what: str) -> Array:
    """Return vertex ids from ids or a set's name; ModelError if they are not the mesh's."""
    if isinstance(ids, str):
        if ids not in mesh.sets:
            names = ", ".join(mesh.sets) or "no sets"
            raise ModelError(f"{what}: no set {ids!r} in the mesh; there are: {names}.")
        return mesh.sets[ids]
    return vertex_ids(ids, len(mesh.points), what)


def _rows(name: str, ids: ArrayLike, values: ArrayLike) -> Array:
    if np.ndim(values) == 1:
        return frozen(values, (3,), name=name, error=ModelError)
    count = None if isinstance(ids, str) else np.size(ids)
    return frozen(values, (count, 3), name=name, error=ModelError)
