"""Contact: what moved vertices feel, and where the plant goes, at frame rate.

With K factored once (base fixed) and unit columns E of the moved vertices' components,

    Y = K^-1 E,   S = E^T Y,   force = S^-1 d,   field = Y force,

so that a new displacement of the same vertices costs one small dense product.
"""

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike

from plantsim.arrays import Array, frozen
from plantsim.errors import ModelError

if TYPE_CHECKING:
    from plantsim.elastic.model import ElasticModel


class Contact:
    """Moved vertices, prepared for many displacements. Made by `model.contact`."""

    def __init__(self, model: "ElasticModel", ids: Array) -> None:
        """Solve for the 3 k compliance columns of vertices `ids` (k,)."""
        self.model, self.ids = model, ids
        free, factor = model.base_factor()
        place = np.full(len(model.mesh.points), -1)
        place[free] = np.arange(len(free))
        if not len(ids) or (place[ids] < 0).any():
            raise ModelError(
                f"{int((place[ids] < 0).sum())} of {len(ids)} contact vertices are fixed. "
                "Choose free vertices, at least one."
            )
        rows = (3 * place[ids][:, None] + np.arange(3)).ravel()
        columns = np.zeros((len(rows), 3 * len(free)))
        for row, column in zip(rows, columns, strict=True):
            load = np.zeros(3 * len(free))
            load[row] = 1.0
            column[:], _, _ = factor(load)
        self._free = free
        self._field = columns.T  # Y
        S = columns[:, rows]
        self._cholesky = scipy.linalg.cho_factor((S + S.T) / 2)

    def force(self, displacement: ArrayLike) -> Array:
        """Return the external force (k, 3) [N] that displaces them by (k, 3) [m]."""
        d = self._rows(displacement)
        return scipy.linalg.cho_solve(self._cholesky, d.ravel()).reshape(-1, 3)

    def displacement(self, displacement: ArrayLike) -> Array:
        """Return the whole field (n, 3) [m] when they are displaced by (k, 3) [m]."""
        u = np.zeros((len(self.model.mesh.points), 3))
        u[self._free] = (self._field @ self.force(displacement).ravel()).reshape(-1, 3)
        return u

    @cached_property
    def stiffness(self) -> Array:
        """Stiffness (3k, 3k) [N/m] of the vertices together, positive definite."""
        return scipy.linalg.cho_solve(self._cholesky, np.eye(3 * len(self.ids)))

    def _rows(self, d: ArrayLike) -> Array:
        k = len(self.ids)
        shape = (3,) if np.ndim(d) == 1 else (k, 3)
        rows = frozen(d, shape, name="displacement", error=ModelError)
        return np.broadcast_to(rows, (k, 3))

    def __repr__(self) -> str:
        return f"Contact({len(self.ids)} vertices of {self.model!r})"
