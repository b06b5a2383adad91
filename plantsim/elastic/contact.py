"""Contact: what moved vertices feel, and where the plant goes, at frame rate.

With K factored once (base fixed) and unit columns E of the moved vertices' components,

    Y = K^-1 E,   S = E^T Y,   force = S^-1 d,   field = Y S^-1 d,

so that a new displacement of the same vertices costs one small dense product. S comes
first, by half solves where there are more than two vertices; Y once a field is asked for.
The columns of Y of a vertex are kept by the model.
"""

import time
from collections import OrderedDict
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike

from plantsim.arrays import Array
from plantsim.elastic.equilibrium import Equilibrium
from plantsim.errors import ModelError, SolverError
from plantsim.solve.rigid import Rigid, rigid_modes
from plantsim.solve.stats import SolveStats, norm

if TYPE_CHECKING:
    from plantsim.elastic.model import ElasticModel

COLUMN_BYTES = 2**28  # memory for columns that a model keeps, least recently used out first
BLOCK = 48  # columns at a time
ALONE = 2  # vertices up to which whole columns cost no more than their compliance alone


class Columns:
    """Compliance columns of a model by vertex: the field of a unit force on each axis."""

    def __init__(self, model: "ElasticModel", limit: int = COLUMN_BYTES) -> None:
        self._model, self._limit = model, limit
        self._kept: OrderedDict[int, Array] = OrderedDict()  # (3, 3n) a vertex

    def missing(self, ids: Array) -> int:
        """Return how many of the vertices would have to be solved for."""
        return sum(int(v) not in self._kept for v in ids)

    def of(self, ids: Array) -> Array:
        """Return the columns as rows, (3k, 3n) [m/N], zero where the model is fixed."""
        free, factor = self._model.base_factor()
        n = len(self._model.mesh.points)
        place = self._places(free, ids)
        out = np.empty((len(ids), 3, n, 3))
        new = []
        for i, v in enumerate(ids.tolist()):
            if v in self._kept:
                out[i] = self._kept[v]
                self._kept.move_to_end(v)
            else:
                new.append(i)
        for first in range(0, len(new), BLOCK // 3):
            some = new[first : first + BLOCK // 3]
            rows = (3 * place[some][:, None] + np.arange(3)).ravel()
            loads = np.zeros((3 * len(free), len(rows)), order="F")
            loads[rows, np.arange(len(rows))] = 1.0
            fields, _, _ = factor(loads)
            out[some] = 0
            for j, i in enumerate(some):
                out[i][:, free] = fields[:, 3 * j : 3 * j + 3].T.reshape(3, -1, 3)
                self._keep(int(ids[i]), out[i])
        return out.reshape(3 * len(ids), 3 * n)

    def between(self, ids: Array) -> Array:
        """Return the compliance among vertices alone, S (3k, 3k) [m/N], symmetric."""
        components = np.arange(3)
        if self.missing(ids) > ALONE:
            free, factor = self._model.base_factor()
            place = self._places(free, ids)
            S = factor.compliance((3 * place[:, None] + components).ravel())
            if S is not None:
                return S
        S = self.of(ids)[:, (3 * ids[:, None] + components).ravel()]
        return (S + S.T) / 2

    def _places(self, free: Array, ids: Array) -> Array:
        """Return where vertices are among the free ones; ModelError where they are not."""
        place = np.full(len(self._model.mesh.points), -1)
        place[free] = np.arange(len(free))
        if not len(ids) or (place[ids] < 0).any():
            raise ModelError(
                f"{int((place[ids] < 0).sum())} of {len(ids)} contact vertices are fixed. "
                "Choose free vertices, at least one."
            )
        return place[ids]

    def _keep(self, vertex: int, columns: Array) -> None:
        room = max(self._limit // columns.nbytes, 0)
        while self._kept and len(self._kept) >= room:
            self._kept.popitem(last=False)
        if room:
            self._kept[vertex] = columns.copy()


class Contact:
    """Moved vertices, prepared for many displacements. Made by `model.contact`.

    Displacements are (3,) for all vertices alike, (k, 3), or many at once, (T, k, 3).
    """

    def __init__(self, model: "ElasticModel", ids: Array, dtype: Any = np.float64) -> None:
        """Solve for the compliance among vertices `ids` (k,)."""
        self.model, self.ids, self.dtype = model, ids, np.dtype(dtype)
        if self.dtype not in (np.float32, np.float64):
            raise ModelError(f"dtype {self.dtype}; give numpy.float64 or numpy.float32.")
        self._rows = (3 * ids[:, None] + np.arange(3)).ravel()
        S = model.columns.between(ids)
        size = np.abs(scipy.linalg.eigvalsh(S))
        # about a state that stands only while it is held, S has a negative eigenvalue
        sound = size.min() > 1e-14 * size.max()
        if not sound or not (model.about_a_state or _positive(S)):
            raise ModelError(
                f"the {len(ids)} contact vertices cannot be told apart numerically. Leave "
                "out those that lie closest together."
            )
        inverse = scipy.linalg.inv(S)
        self.stiffness = (inverse + inverse.T) / 2  # (3k, 3k) [N/m]
        self.stiffness.flags.writeable = False
        self._stiffness = self.stiffness.astype(self.dtype)

    @cached_property
    def _field(self) -> Array:
        """Field of each unit displacement, (3k, 3n)."""
        field = self.stiffness @ self.model.columns.of(self.ids)  # S^-1 Y
        field[:, self._rows] = np.eye(len(field))  # which it is, but for rounding
        return field.astype(self.dtype)

    @cached_property
    def _together(self) -> Array:
        """Field when all move alike along each axis, (3, 3n)."""
        return self._field.reshape(len(self.ids), 3, -1).sum(axis=0)

    @cached_property
    def _surface(self) -> Array:
        n = len(self.model.mesh.points)
        on = self.model.mesh.surface_vertices
        field = self._field.reshape(-1, n, 3)[:, on]
        return np.ascontiguousarray(field.reshape(len(field), -1))

    def force(self, displacement: ArrayLike) -> Array:
        """Return the external force [N], (k, 3) or (T, k, 3), that displaces them so."""
        d, shape = self._flat(displacement)
        return (d @ self._stiffness).reshape(shape)

    def displacement(self, displacement: ArrayLike) -> Array:
        """Return the whole field [m], (n, 3) or (T, n, 3), when they are displaced so."""
        if np.shape(displacement) == (3,):
            d = self._finite(np.asarray(displacement, dtype=self.dtype))
            return (d @ self._together).reshape(-1, 3)
        d, shape = self._flat(displacement)
        return _product(d, self._field).reshape(*shape[:-2], -1, 3)

    def surface_displacement(self, displacement: ArrayLike) -> Array:
        """Return the field at `mesh.surface_vertices`, (s, 3) or (T, s, 3) [m]."""
        d, shape = self._flat(displacement)
        return _product(d, self._surface).reshape(*shape[:-2], -1, 3)

    def solve(self, displacement: ArrayLike) -> Equilibrium:
        """Return the equilibrium under one displacement, (3,) or (k, 3) [m]."""
        began = time.perf_counter()
        d, shape = self._flat(displacement)
        if d.ndim != 1:
            raise ModelError(f"one displacement at a time, not {shape}. Loop over them.")
        model = self.model
        u = _product(d, self._field).astype(float).reshape(-1, 3)
        u[self.ids] = np.asarray(displacement, dtype=float)
        f = np.zeros_like(u)
        u = self.balanced(u, f)
        error, unknowns = self.evidence(u, f)
        held = np.union1d(model.fixed_ids, self.ids)
        f[held] = model.internal(held, u)
        _, factor = model.base_factor()
        backend = f"{factor.backend}; compliance of {len(self.ids)} vertices"
        seconds = time.perf_counter() - began
        stats = SolveStats(factor.name, backend, unknowns, 0, error, seconds, False)
        for array in (u, f):
            array.flags.writeable = False
        return Equilibrium(model, u, f, self.ids, stats)

    def balanced(self, u: Array, load: Array) -> Array:
        """Return a field (n, 3) whose reactions balance the loads (n, 3) to rounding.

        As it is where the columns are exact, that is, by a direct factor in double
        precision.
        """
        if self.dtype == np.float64 and self.model.base_factor()[1].name == "direct":
            return u
        return self._rigid.balanced(u.ravel(), load.ravel()).reshape(-1, 3)

    @cached_property
    def _rigid(self) -> Rigid:
        """Rigid modes of the vertices that are neither fixed nor moved."""
        points = self.model.mesh.points
        rest = np.setdiff1d(self.model.base_factor()[0], self.ids)
        modes = np.zeros((len(points), 3, 6))
        if len(rest):
            modes[rest] = rigid_modes(points[rest]).reshape(-1, 3, 6)
        return Rigid.of(self.model.stiffness, modes.reshape(-1, 6))

    def evidence(self, u: Array, load: Array) -> tuple[float, int]:
        """Return the backward error of a field (n, 3) [m] under loads (n, 3) [N].

        That of the condensed system, in which what the moved vertices exert on the others
        is part of the load; and its number of unknowns. Raises SolverError above 1e-8, or
        1e-4 in single precision.
        """
        K = self.model.stiffness
        rest = np.setdiff1d(self.model.base_factor()[0], self.ids)
        pushed = np.zeros_like(u)
        pushed[self.ids] = u[self.ids]
        residual = ((K @ u.ravel()).reshape(-1, 3) - load)[rest]
        pull = (load - (K @ pushed.ravel()).reshape(-1, 3))[rest]
        scale = self.model.size * norm(u[rest].ravel()) + norm(pull.ravel())
        error = float(norm(residual.ravel()) / scale) if scale else 0.0
        wanted = 1e-8 if self.dtype == np.float64 else 1e-4
        if not error <= wanted:
            raise SolverError(
                f"contact: backward error {error:.1e}, wanted {wanted:.1e}. The moved "
                "vertices lie too close together: move fewer, or use model.solve."
            )
        return error, 3 * len(rest)

    def _flat(self, displacement: ArrayLike) -> tuple[Array, tuple[int, ...]]:
        """Return rows (3k,) or (T, 3k), and the shape of the forces that go with them."""
        d = np.asarray(displacement, dtype=self.dtype)
        k = len(self.ids)
        if d.shape == (3,):
            d = np.broadcast_to(d, (k, 3))
        if d.ndim not in (2, 3) or d.shape[-2:] != (k, 3):
            raise ModelError(
                f"displacement: shape {d.shape}, wanted (3,), ({k}, 3) or (any, {k}, 3). "
                "Give one row a contact vertex."
            )
        return self._finite(d).reshape(*d.shape[:-2], 3 * k), d.shape

    @staticmethod
    def _finite(d: Array) -> Array:
        if not np.isfinite(d).all():
            raise ModelError("displacement: NaN or infinite. Give finite metres.")
        return d

    def __repr__(self) -> str:
        return f"Contact({len(self.ids)} vertices of {self.model!r})"


def _positive(S: Array) -> bool:
    try:
        scipy.linalg.cholesky(S)
    except scipy.linalg.LinAlgError:
        return False
    return True


def _product(d: Array, fields: Array) -> Array:
    """Return d @ fields.

    One row at a time without BLAS: its threads gain nothing on so small a product, and cost
    some forty times as much where other work keeps the cores busy.
    """
    return np.einsum("i,ij->j", d, fields) if d.ndim == 1 else d @ fields
