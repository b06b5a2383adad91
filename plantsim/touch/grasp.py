"""Grasp: a patch of vertices that a gripper moves as a rigid body; its wrench."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from plantsim.arrays import Array, frozen
from plantsim.elastic.equilibrium import Equilibrium
from plantsim.elastic.loads import Move, ids_in
from plantsim.elastic.model import ElasticModel
from plantsim.errors import ModelError, check_kind
from plantsim.mesh.tetmesh import TetMesh


@dataclass(frozen=True, eq=False)
class Grasp:
    """A rigid patch, turned about its centre and then shifted. A load for `model.solve`."""

    ids: ArrayLike  # (k,) vertex ids, or a set's name
    translation: Array  # (3,) [m]
    rotation: Array  # (3,) rotation vector [rad], about the patch's centre

    def parts(self, mesh: TetMesh) -> tuple[Move]:
        """Return the displacement of each vertex of the patch."""
        ids = self.on(mesh)
        arm = mesh.points[ids] - self.centre(mesh)
        turned = Rotation.from_rotvec(self.rotation.copy()).apply(arm)
        return (Move(ids, turned - arm + self.translation),)

    def on(self, mesh: TetMesh) -> Array:
        """Return the vertex ids (k,); ModelError if the patch is empty."""
        ids = ids_in(mesh, self.ids, "grasp")
        if not len(ids):
            raise ModelError("grasp: no vertex in the patch. Name at least one.")
        return ids

    def centre(self, mesh: TetMesh) -> Array:
        """Return the mean of the patch's vertices at rest, (3,) [m]."""
        return mesh.points[self.on(mesh)].mean(axis=0)

    def wrench(self, state: Equilibrium) -> Array:
        """Return the gripper's force [N] and torque about the centre [N m], (6,).

        In linear theory arms and centre are those at rest; of a corotational model those
        where the patch is.
        """
        mesh, ids = state.model.mesh, self.on(state.model.mesh)
        x = mesh.points[ids]
        if state.model.kinematics != "linear":
            x = x + state.displacement[ids]
        return _modes(x).T @ state.force[ids].ravel()

    def stiffness(self, model: ElasticModel) -> Array:
        """Return the grasp stiffness (6, 6), symmetric: d wrench / d (shift, small turn).

        In N/m, N/rad, N m/m and N m/rad. Singular where the patch is a point or a line.
        """
        B = _modes(model.mesh.points[self.on(model.mesh)])
        return B.T @ model.contact(self.on(model.mesh)).stiffness @ B


def _modes(x: Array) -> Array:
    """Return the displacements (3k, 6) of unit shifts and small turns of points (k, 3)."""
    arm = x - x.mean(axis=0)
    shift = np.broadcast_to(np.eye(3), (len(arm), 3, 3))
    turn = np.stack([np.cross(axis, arm) for axis in np.eye(3)], axis=2)
    return np.concatenate([shift, turn], axis=2).reshape(-1, 6)


def grasp(
    ids: ArrayLike, *, translation: ArrayLike = (0, 0, 0), rotation: ArrayLike = (0, 0, 0)
) -> Grasp:
    """Return a rigid patch of vertices moved by a gripper.

    `translation` (3,) [m]; `rotation` (3,) [rad], the rotation vector about the patch's
    centre, any size. Solve with it, then ask for its wrench and stiffness:

        grip = ps.grasp(ids, rotation=(0, 0, 0.1))
        grip.wrench(model.solve(grip)), grip.stiffness(model)
    """
    return Grasp(
        ids,
        frozen(translation, (3,), name="translation", error=ModelError),
        frozen(rotation, (3,), name="rotation", error=ModelError),
    )


def nearest_vertices(
    mesh: TetMesh, point: ArrayLike, *, radius: float | None = None, count: int = 1
) -> Array:
    """Return ids of the surface vertices nearest to a point (3,) [m], nearest first.

    With `radius` [m] all within it, else the `count` nearest. Raises ModelError where none
    is within the radius.
    """
    check_kind(mesh, TetMesh, "nearest_vertices")
    at = frozen(point, (3,), name="point", error=ModelError)
    on = mesh.surface_vertices
    distance = np.linalg.norm(mesh.points[on] - at, axis=1)
    order = np.argsort(distance, kind="stable")
    if radius is None:
        return on[order[:count]]
    found = on[order[distance[order] <= radius]]
    if not len(found):
        raise ModelError(
            f"no surface vertex within {radius:.3g} m of {at}; the nearest is "
            f"{distance.min():.3g} m away. Take a larger radius."
        )
    return found
