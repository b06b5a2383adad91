"""The force matrix W: external forces are linear in the Lame parameters, f = W(u) theta."""

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_array

from plantsim.arrays import frozen
from plantsim.elastic.model import ElasticModel
from plantsim.errors import EstimateError


def force_matrix(model: ElasticModel, displacement: ArrayLike) -> csr_array:
    """Return W (3n, 2m) [m^2] with f = W theta at this displacement (n, 3) [m].

    theta is mu of every tet, then lam of every tet [Pa]; row 3 v + i is component i of the
    external force on vertex v. W theta = K(theta) u for any theta, or the internal forces
    there of a corotational model, which are linear in theta too.
    Source: Yao and Hauser, Generating and Estimating Linear FEM Plant Simulation Models.
    """
    n, m = len(model.mesh.points), len(model.mesh.tets)
    u = frozen(displacement, (n, 3), name="displacement", error=EstimateError)
    mu, lam = model.deformed(u).unit_forces()
    rows = (3 * model.mesh.tets[:, :, None] + np.arange(3)).reshape(m, -1)
    each = rows.shape[1]
    columns = np.repeat(np.arange(2 * m), each)
    values = np.concatenate([mu.ravel(), lam.ravel()])
    return csr_array((values, (np.tile(rows.ravel(), 2), columns)), shape=(3 * n, 2 * m))
