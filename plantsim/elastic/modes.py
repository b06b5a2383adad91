"""Natural vibrations: K phi = omega^2 M phi, with the base fixed."""

import warnings
from dataclasses import dataclass

import numpy as np
from scipy.sparse.linalg import LinearOperator, eigsh, lobpcg

from plantsim.arrays import Array
from plantsim.elastic.equilibrium import Equilibrium
from plantsim.elastic.model import ElasticModel
from plantsim.errors import ModelError, SolverError
from plantsim.solve.multigrid import MultigridFactor
from plantsim.solve.rigid import rigid_modes
from plantsim.solve.solver import Factor

TOLERANCE = 1e-3  # |K phi - omega^2 M phi| / |omega^2 M phi|; omega errs by its square
STEPS = 30  # of LOBPCG


@dataclass(frozen=True, eq=False, repr=False)
class Modes:
    """Natural frequencies and shapes of a model, slowest first."""

    model: ElasticModel
    frequency: Array  # (count,) [Hz]; below 0 what grows, exp(2 pi |f| t), at a state
    shape: Array  # (count, n, 3), scaled so that phi . M phi = 1 kg m^2
    residual: Array  # (count,) |K phi - omega^2 M phi| / |omega^2 M phi|

    def __repr__(self) -> str:
        first = ", ".join(f"{f:.4g}" for f in self.frequency[:6])
        more = ", ..." if len(self.frequency) > 6 else ""
        return f"Modes({first}{more} Hz; residual {self.residual.max():.0e})"


class _Inverse(LinearOperator):
    """A factor, as ARPACK takes it."""

    def __init__(self, factor: Factor, size: int) -> None:
        super().__init__(np.dtype(float), (size, size))
        self._factor = factor

    def _matvec(self, x: Array) -> Array:
        return self._factor(x.ravel())[0]


def modes(model: ElasticModel | Equilibrium, count: int = 6) -> Modes:
    """Return the `count` slowest natural vibrations of a model, small and undamped.

    Given a state, the vibrations about it: a limb under load is slower or faster, and what
    buckles has a negative frequency.

    With a direct factor by Lanczos, inverse about zero; with multigrid by LOBPCG, which it
    preconditions (Knyazev 2001). Raises ModelError where there is no mass or there are too
    few unknowns, SolverError where the vibrations did not converge.
    """
    if isinstance(model, Equilibrium):
        model = model.linear
    free, factor = model.base_factor()
    size = 3 * len(free)
    if not 1 <= count < size // 5:
        raise ModelError(f"{count} modes of {size} unknowns; ask for 1 to {size // 5 - 1}.")
    rows = (3 * free[:, None] + np.arange(3)).ravel()
    K = model.stiffness[rows][:, rows]
    M = model.mass_matrix[rows][:, rows]
    if not M.diagonal().min() > 0:
        raise ModelError("modes: some of the plant has no mass. Give a density above 0.")
    if isinstance(factor, MultigridFactor):
        random = np.random.default_rng(0)  # a start, the same each time
        start = random.normal(size=(size, count + 4))
        start[:, : min(6, count + 4)] = rigid_modes(model.mesh.points[free])[:, : count + 4]
        # its tolerance is of |K phi - omega^2 M phi| and not relative, so it is not used:
        # it runs on until rounding stops it, and what it reached is checked below
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            _, phi = lobpcg(
                K, start, B=M, M=factor.preconditioner, largest=False, maxiter=STEPS
            )
        phi = np.asarray(phi)
    else:
        inverse = _Inverse(factor, size)
        start = rigid_modes(model.mesh.points[free]).sum(axis=1)
        _, phi = eigsh(K, count, M, sigma=0.0, OPinv=inverse, v0=start)
    square = np.einsum("ij,ij->j", phi, K @ phi) / np.einsum("ij,ij->j", phi, M @ phi)
    order = np.argsort(square)[:count]
    square, phi = square[order], phi[:, order]
    phi = phi / np.sqrt(np.einsum("ij,ij->j", phi, M @ phi))
    inertia = (M @ phi) * square
    off = np.linalg.norm(K @ phi - inertia, axis=0) / np.linalg.norm(inertia, axis=0)
    if not off.max() <= TOLERANCE:
        raise SolverError(
            f"modes: residual {off.max():.1e}, wanted {TOLERANCE:.0e}. Ask for fewer "
            "modes, or use solver='direct'."
        )
    shape = np.zeros((count, len(model.mesh.points), 3))
    shape[:, free] = phi.T.reshape(count, -1, 3)
    frequency = np.sign(square) * np.sqrt(np.abs(square)) / (2 * np.pi)
    for array in (shape, frequency, off):
        array.flags.writeable = False
    return Modes(model, frequency, shape, off)
