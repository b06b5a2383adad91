"""Warp: a linear answer led along the rotations that it holds.

A tangent's answer du turns every limb along its tangent line, and so stretches it: by the
square of the turn, against all its axial stiffness. Of du at each point only the turn w and
the strain E are believed,

    F_new = exp([w]x) (F + E R),   grad du R^T = [w]x + E,

and the displacements are those whose gradients come nearest to F_new - I, weighed by mu: a
scalar Laplacian, the same for all three components and wherever the plant is.
Sources: Huang, Tong, Zhou, Bao, Desbrun 2011 (rotation-strain coordinates); Sorkine and
Alexa 2007 (the fit).
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial.transform import Rotation

from plantsim.arrays import Array
from plantsim.elastic.corotational import Points, Turned
from plantsim.solve.direct import Direct
from plantsim.solve.solver import Factor


@dataclass(frozen=True, eq=False)
class Warp:
    """The Laplacian of a mesh, factored among its free vertices."""

    free: Array  # (k,)
    mu: Array  # (m,) [Pa]
    factor: Factor

    @classmethod
    def of(cls, points: Points, mu: Array, free: Array) -> "Warp":
        """Return the warp of a mesh with free vertices (k,)."""
        tets = points.mesh.tets
        one, other = np.triu_indices(tets.shape[1])
        values = (mu[:, None] * points.products).ravel()
        rows, columns = tets[:, one].ravel(), tets[:, other].ravel()
        n = len(points.mesh.points)
        half = csr_array((values, (rows, columns)), shape=(n, n))
        # a vertex with itself comes once in each tet, two of them in either order
        L = (half + half.T).tocsr()
        L.setdiag(half.diagonal())
        L = L[free][:, free].tocsr()
        L.sort_indices()
        return cls(free, mu, Direct().factor(L, points.mesh.points[free]))

    def __call__(self, here: Turned, du: Array) -> Array:
        """Return du (n, 3) [m] with its turns taken as turns; held vertices as they are."""
        points, R = here.points, here.rotation
        dF = points.gradients(du)
        A = dF @ R.transpose(0, 2, 1)
        turned = A.transpose(0, 2, 1)
        w = (A - turned)[:, [2, 0, 1], [1, 2, 0]] / 2
        turn = Rotation.from_rotvec(w).as_matrix()
        new = turn @ (here.F + (A + turned) / 2 @ R)
        off = np.repeat(self.mu, points.weight.shape[1])[:, None, None] * (
            new - here.F - dF
        )
        pull = points.sums @ points.integral(off).reshape(-1, 3)
        out = du.copy()
        out[self.free] += self.factor(pull[self.free], check=False)[0]
        return out
