"""Rigid: rigid-body modes, and the answer of a solve balanced by them."""

from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from plantsim.arrays import Array


def rigid_modes(points: Array) -> Array:
    """Return the six rigid-body modes (3n, 6) of vertices (n, 3), scaled to order one."""
    x = (points - points.mean(axis=0)) / max(float(np.ptp(points, axis=0).max()), 1e-300)
    modes = np.zeros((len(points), 3, 6))
    modes[:, :, :3] = np.eye(3)
    for i, axis in enumerate(np.eye(3)):
        modes[:, :, 3 + i] = np.cross(axis, x)
    return modes.reshape(-1, 6)


@dataclass(frozen=True, eq=False)
class Rigid:
    """Rigid modes of unknowns, to take sum and moment out of what a solve leaves.

    A backward error of 1e-12 leaves residuals whose sum was up to 1e-7 of the load on
    reference trees. The best multiples of the modes (Galerkin) take them out to rounding,
    so that reactions balance the load.
    """

    modes: Array  # (n, 6)
    pull: Array  # (n, 6): K on them
    stiffness: Array  # (6, 6)

    @classmethod
    def of(cls, K: Any, modes: Array) -> Self:
        """Return what is needed of K (n, n)."""
        pull = K @ modes
        return cls(modes, pull, modes.T @ pull)

    def balanced(self, u: Array, f: Array) -> Array:
        """Return u (n,), with f - K u free of rigid modes; f (n,)."""
        left = self.modes.T @ f - self.pull.T @ u
        return u + self.modes @ np.linalg.lstsq(self.stiffness, left, rcond=1e-12)[0]
