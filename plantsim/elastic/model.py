"""ElasticModel: a mesh, a material and supports; loads -> Equilibrium."""

import time
from collections import OrderedDict
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import bsr_array, csr_array

from plantsim.arrays import Array, few, vertex_ids
from plantsim.elastic.contact import Contact
from plantsim.elastic.equilibrium import Equilibrium
from plantsim.elastic.loads import Force, Gravity, Load, Move
from plantsim.elastic.material import Material
from plantsim.elastic.stiffness import Blocks, Pattern, blocks
from plantsim.elastic.supports import check_held
from plantsim.errors import ModelError
from plantsim.mesh.tetmesh import TetMesh
from plantsim.solve.solver import Choice, Factor, choose
from plantsim.solve.stats import SolveStats

KEPT = 2  # factors that a model keeps: with no vertex moved, and for the latest moved set


@dataclass(frozen=True, eq=False, repr=False)
class ElasticModel:
    """Linear elasticity of a mesh, held at `fixed`.

    `fixed`: a set's name or vertex ids. `solver`: "auto" (direct up to 400,000 unknowns,
    else multigrid), "direct", "multigrid", or a solver value such as
    `ps.Multigrid(tolerance=1e-10)`.

    Raises ModelError for ids out of range or an unknown set, and where a connected piece of
    the mesh is not held by at least three vertices that are not in line, since K would be
    singular.
    """

    mesh: TetMesh
    material: Material
    fixed: Array | str | ArrayLike = "base"
    solver: Choice = "auto"
    kinematics: Literal["linear"] = "linear"
    _shared: "_Shared | None" = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        if self.kinematics != "linear":
            raise ModelError(f"kinematics {self.kinematics!r} is not known; give 'linear'.")
        self.material.per_tet(len(self.mesh.tets))
        choose(self.solver, 0)
        ids = self.vertices(self.fixed, "fixed")
        object.__setattr__(self, "fixed", ids)
        shared = self._shared
        if (
            shared is None or shared.mesh is not self.mesh
        ):  # dataclasses.replace may change it
            shared = _Shared(self.mesh)
            object.__setattr__(self, "_shared", shared)
        shared.check_held(ids)

    def vertices(self, ids: ArrayLike | str, what: str = "vertices") -> Array:
        """Return vertex ids from a set's name, ids or a mask; ModelError names `what`."""
        if isinstance(ids, str):
            if ids not in self.mesh.sets:
                names = ", ".join(self.mesh.sets) or "no sets"
                raise ModelError(f"{what}: no set {ids!r} in the mesh; there are: {names}.")
            return self.mesh.sets[ids]
        return vertex_ids(ids, len(self.mesh.points), what)

    def with_material(self, material: Material) -> Self:
        """Return the same model of another material; blocks and pattern are shared."""
        return replace(self, material=material)

    @property
    def blocks(self) -> Blocks:
        """Unit-parameter blocks of the tets, made at first use and shared."""
        assert self._shared is not None
        return self._shared.blocks

    @property
    def pattern(self) -> Pattern:
        """Pattern of K over vertices, made at first use and shared."""
        assert self._shared is not None
        return self._shared.pattern

    @cached_property
    def _K(self) -> bsr_array:
        mu, lam, _ = self.material.per_tet(len(self.mesh.tets))
        return self.pattern.assemble(self.blocks.element(mu, lam))

    @cached_property
    def stiffness(self) -> csr_array:
        """K (3n, 3n) [N/m] over all vertices: x, y, z of vertex 0, then of vertex 1, ..."""
        return self._K.tocsr()

    @cached_property
    def _factors(self) -> "OrderedDict[bytes, tuple[Array, Factor]]":
        return OrderedDict()

    def _factor(self, held: Array) -> tuple[Array, Factor, bool]:
        """Return the free vertices, the factor of K among them, and whether it is new."""
        key = held.tobytes()
        new = key not in self._factors
        if new:
            free = np.setdiff1d(np.arange(len(self.mesh.points)), held)
            K: Any = self.pattern.condense(self._K, free, free)
            solver = choose(self.solver, K.shape[0])
            made = solver.factor(K, self.mesh.points[free]) if len(free) else Nothing()
            self._factors[key] = free, made
            while len(self._factors) > KEPT:
                self._factors.popitem(last=False)
        self._factors.move_to_end(key)
        return *self._factors[key], new

    def solve(self, *loads: Load) -> Equilibrium:
        """Return the equilibrium under these loads together: `move`, `force`, `gravity`.

        Raises ModelError for ids out of range, a vertex both fixed and moved, or moved
        twice, and SolverError when the solve misses its backward error.
        """
        began = time.perf_counter()
        fixed = np.asarray(self.fixed)
        u, f = np.zeros_like(self.mesh.points), np.zeros_like(self.mesh.points)
        moved = np.zeros(0, dtype=np.int64)
        for load in loads:
            if isinstance(load, Move):
                ids = self.vertices(load.ids, "moved")
                self._check_moved(ids, fixed, moved)
                u[ids] = _fit(load.displacement, ids)
                moved = np.concatenate([moved, ids])
            elif isinstance(load, Force):
                ids = self.vertices(load.ids, "force")
                share = max(len(ids), 1) if load.force.ndim == 1 else 1
                f[ids] += _fit(load.force, ids) / share
            elif isinstance(load, Gravity):
                f += self._nodal_mass[:, None] * load.acceleration
            else:
                raise ModelError(f"{load!r} is no load: give move(), force() or gravity().")
        held = np.union1d(fixed, moved)
        free, factor, new = self._factor(held)
        b = f.ravel().reshape(-1, 3)[free].ravel()
        if len(moved):
            at = np.sort(moved)
            b = b - self.pattern.condense(self._K, free, at) @ u[at].ravel()
        x, iterations, error = factor(b)
        u[free] = x.reshape(-1, 3)
        # where a vertex is held, whatever K u asks for is external; elsewhere it is the
        # load
        everything = np.arange(len(u))
        f[held] = (self.pattern.condense(self._K, held, everything) @ u.ravel()).reshape(
            -1, 3
        )
        seconds = time.perf_counter() - began
        stats = SolveStats(
            factor.name, factor.backend, 3 * len(free), iterations, error, seconds, new
        )
        for array in (u, f):
            array.flags.writeable = False
        return Equilibrium(self, u, f, moved, stats)

    def base_factor(self) -> tuple[Array, Factor]:
        """Return the vertices that are not fixed, and the factor of K among them."""
        free, factor, _ = self._factor(np.unique(np.asarray(self.fixed)))
        return free, factor

    def contact(self, ids: ArrayLike | str) -> Contact:
        """Return vertices prepared for many displacements: `force(d)`, `displacement(d)`.

        Raises ModelError for ids out of range or fixed.
        """
        return Contact(self, self.vertices(ids, "contact"))

    @cached_property
    def _nodal_mass(self) -> Array:
        """Mass [kg] that each vertex carries under a uniform acceleration, (n,)."""
        _, _, rho = self.material.per_tet(len(self.mesh.tets))
        share = rho[:, None] * self.blocks.weight
        return np.bincount(self.mesh.tets.ravel(), share.ravel(), len(self.mesh.points))

    @property
    def mass(self) -> float:
        """Mass [kg] of the plant."""
        return float(self._nodal_mass.sum())

    def _check_moved(self, ids: Array, fixed: Array, moved: Array) -> None:
        both = np.intersect1d(ids, fixed)
        if both.size:
            raise ModelError(
                f"{both.size} vertices are both fixed and moved (first ids: {few(both)}). "
                "Leave them out of one."
            )
        twice = np.intersect1d(ids, moved)
        if twice.size:
            raise ModelError(
                f"{twice.size} vertices are moved twice (first ids: {few(twice)}). Move "
                "each once."
            )

    def __repr__(self) -> str:
        fixed = np.asarray(self.fixed)
        solver = self.solver if isinstance(self.solver, str) else type(self.solver).__name__
        free = 3 * (len(self.mesh.points) - len(fixed))
        return (
            f"ElasticModel({len(self.mesh.tets):,} tets of order {self.mesh.order}, "
            f"{free:,} unknowns, {len(fixed)} vertices fixed, solver {solver}; "
            f"{self.material!r})"
        )


@dataclass(frozen=True)
class Nothing:
    """The factor of no unknowns at all: every free vertex is moved."""

    name: str = "none"
    backend: str = "nothing to solve"

    def __call__(self, f: Array) -> tuple[Array, int, float]:
        """Return f, which is empty."""
        return f, 0, 0.0


class _Shared:
    """What depends on the mesh alone, made at first use."""

    def __init__(self, mesh: TetMesh) -> None:
        self.mesh = mesh
        self._held: set[bytes] = set()

    def check_held(self, fixed: Array) -> None:
        """Raise ModelError unless these vertices hold the mesh; checked once a set."""
        if fixed.tobytes() not in self._held:
            check_held(self.mesh, fixed)
            self._held.add(fixed.tobytes())

    @cached_property
    def blocks(self) -> Blocks:
        return blocks(self.mesh)

    @cached_property
    def pattern(self) -> Pattern:
        return Pattern.of(self.mesh.tets, len(self.mesh.points))


def _fit(rows: Array, ids: Array) -> Array:
    if rows.ndim == 2 and len(rows) != len(ids):
        raise ModelError(
            f"{len(rows)} rows for {len(ids)} vertices. Give one row a vertex."
        )
    return rows
