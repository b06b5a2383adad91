"""The weight of a plant with its leaves and fruit: each mass carried by its own limb."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from plantsim.arrays import Array, frozen
from plantsim.elastic.loads import STANDARD_GRAVITY, Force, Gravity
from plantsim.errors import ModelError
from plantsim.mesh.tetmesh import TetMesh
from plantsim.plant.hung import Masses

CARRIERS = 8  # surface vertices that share the weight of one mass


@dataclass(frozen=True, eq=False)
class Weight:
    """Gravity on the plant's own mass and on masses that hang from its limbs."""

    acceleration: Array  # (3,) [m/s^2]
    masses: Masses

    def parts(self, mesh: TetMesh) -> tuple[Gravity, Force]:
        """Return the plant's own weight and the nodal forces of what hangs.

        The forces on the vertices nearest a mass's attachment, of its own limb, are the
        smallest that have its weight as their sum and its moment about the attachment.
        """
        f = np.zeros_like(mesh.points)
        skin = np.unique(mesh.surface[:, :3])
        for point, joint, mass, limb in zip(
            self.masses.points,
            self.masses.attachment,
            self.masses.mass,
            self.masses.limb,
            strict=True,
        ):
            own = np.intersect1d(skin, mesh.tets[np.asarray(mesh.region) == limb, :4])
            if len(own) < 3:
                raise ModelError(
                    f"a mass hangs on limb {limb}, which has {len(own)} surface vertices "
                    "in the mesh. Mesh the skeleton that bears it."
                )
            far = np.linalg.norm(mesh.points[own] - joint, axis=1)
            near = own[np.argsort(far, kind="stable")[:CARRIERS]]
            weight = mass * self.acceleration
            arms = mesh.points[near] - joint
            # rows: the sum of forces, and of (x - joint) x force
            sums = np.hstack([np.eye(3)] * len(near))
            turns = np.hstack([np.cross(arm, np.eye(3)).T for arm in arms])
            wanted = np.concatenate([weight, np.cross(point - joint, weight)])
            share, *_ = np.linalg.lstsq(np.vstack([sums, turns]), wanted, rcond=None)
            f[near] += share.reshape(-1, 3)
        ids = np.flatnonzero(f.any(axis=1))
        return Gravity(self.acceleration), Force(ids, f[ids])


def gravity(
    acceleration: ArrayLike = (0.0, 0.0, -STANDARD_GRAVITY), *, masses: Masses | None = None
) -> Gravity | Weight:
    """Return the weight of the plant by its density, and of leaves and fruit on it.

    `acceleration` (3,) [m/s^2], downwards. `masses`: `skeleton.masses` of the skeleton that
    was meshed. Raises ModelError where a mass's limb is not in the mesh.
    """
    g = frozen(acceleration, (3,), name="acceleration", error=ModelError)
    return Gravity(g) if masses is None else Weight(g, masses)
