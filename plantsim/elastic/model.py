"""ElasticModel: a mesh, a material and supports; loads -> Equilibrium."""

import os
from collections import OrderedDict
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_array

from plantsim.arrays import Array
from plantsim.cards import card
from plantsim.elastic.contact import Columns, Contact
from plantsim.elastic.corotational import Points
from plantsim.elastic.deformed import Deformed, Small
from plantsim.elastic.drag import Drag
from plantsim.elastic.equilibrium import Equilibrium
from plantsim.elastic.loads import Load, ids_in
from plantsim.elastic.material import Material
from plantsim.elastic.newton import large_equilibrium
from plantsim.elastic.pattern import Pattern
from plantsim.elastic.sag import unloaded
from plantsim.elastic.statics import equilibrium
from plantsim.elastic.stiffness import Blocks, blocks, mass
from plantsim.elastic.strength import warn_of_breakage
from plantsim.elastic.supports import check_held
from plantsim.elastic.weight import gravity
from plantsim.errors import ModelError, check_kind
from plantsim.mesh.tetmesh import TetMesh
from plantsim.solve.direct import Direct
from plantsim.solve.solver import Choice, Factor, choose
from plantsim.solve.stats import norm_inf

KEPT = 2  # factors that a model keeps: with no vertex moved, and for the latest moved set
FEW = 20  # moved vertices not known yet whose compliance is faster than a factor
MANY = 60  # moved vertices up to which their dense compliance is small


@dataclass(frozen=True, eq=False, repr=False)
class ElasticModel:
    """Elasticity of a mesh, held at `fixed`.

    `kinematics`: "linear", right for rotations up to some 5 degrees, or "corotational", for
    rotations of any size and small strains; `solve` then goes by Newton's method.

    `fixed`: a set's name or vertex ids. `solver`: "auto" (direct up to 400,000 unknowns, a
    million with pypardiso, else multigrid), "direct", "multigrid", or a solver value such
    as `ps.Multigrid(tolerance=1e-10)`.

    Raises ModelError for ids out of range or an unknown set, and where a connected piece of
    the mesh is not held by at least three vertices that are not in line, since K would be
    singular.
    """

    mesh: TetMesh
    material: Material
    fixed: Array | str | ArrayLike = "base"
    solver: Choice = "auto"
    kinematics: Literal["linear", "corotational"] = "linear"
    _shared: "_Shared | None" = field(default=None, kw_only=True)
    _tangent: csr_array | None = field(default=None, kw_only=True)  # about a state

    def __post_init__(self) -> None:
        if self.kinematics not in ("linear", "corotational"):
            raise ModelError(
                f"kinematics {self.kinematics!r} is not known; give 'linear' or "
                "'corotational'."
            )
        check_kind(self.mesh, TetMesh, "ElasticModel")
        self.material.per_tet(len(self.mesh.tets))
        choose(self.solver, 0)
        ids = ids_in(self.mesh, self.fixed, "fixed")
        object.__setattr__(self, "fixed", ids)
        shared = self._shared
        # dataclasses.replace may have changed the mesh
        if shared is None or shared.mesh is not self.mesh:
            shared = _Shared(self.mesh)
            object.__setattr__(self, "_shared", shared)
            object.__setattr__(self, "_tangent", None)
        shared.check_held(ids)

    def vertices(self, ids: ArrayLike | str, what: str = "vertices") -> Array:
        """Return vertex ids from a set's name, ids or a mask; ModelError names `what`."""
        return ids_in(self.mesh, ids, what)

    def with_material(self, material: Material) -> Self:
        """Return the same model of another material; blocks and pattern are shared."""
        return replace(self, material=material, _tangent=None)

    @property
    def blocks(self) -> Blocks:
        """Unit-parameter blocks of the tets, made at first use and shared."""
        assert self._shared is not None
        return self._shared.blocks

    @property
    def points(self) -> Points:
        """Points at which corotational strain is measured, made at first use and shared."""
        assert self._shared is not None
        return self._shared.points

    def deformed(self, u: Array) -> Deformed:
        """Return energy, strain, forces and tangent under displacements u (n, 3) [m]."""
        if self.kinematics == "linear":
            return Small(self, u)
        mu, lam, _ = self.material.per_tet(len(self.mesh.tets))
        return self.points.at(u, mu, lam)

    @property
    def about_a_state(self) -> bool:
        """Whether K is the tangent at a state, which need not be positive definite."""
        return self._tangent is not None

    def about(self, tangent: csr_array, held: Array) -> Self:
        """Return the linear model with this tangent for its K, fixed where `held`."""
        return replace(self, kinematics="linear", fixed=held, _tangent=tangent)

    @property
    def pattern(self) -> Pattern:
        """Pattern of K over vertices, made at first use and shared."""
        assert self._shared is not None
        return self._shared.pattern

    @cached_property
    def stiffness(self) -> csr_array:
        """K (3n, 3n) [N/m] over all vertices: x, y, z of vertex 0, then of vertex 1, ...

        That of the plant at rest, unless the model is `state.linear`.
        """
        if self._tangent is not None:
            return self._tangent
        mu, lam, _ = self.material.per_tet(len(self.mesh.tets))
        return self.blocks.stiffness(mu, lam)

    @cached_property
    def mass_matrix(self) -> csr_array:
        """Consistent mass matrix (3n, 3n) [kg], on the pattern of K."""
        _, _, rho = self.material.per_tet(len(self.mesh.tets))
        return mass(self.mesh, self.pattern, rho)

    @property
    def fixed_ids(self) -> Array:
        """Ids of the fixed vertices."""
        return np.asarray(self.fixed)

    @cached_property
    def size(self) -> float:
        """Largest absolute row sum of K [N/m], which bounds its 2-norm."""
        return norm_inf(self.stiffness)

    def internal(self, ids: Array, u: Array) -> Array:
        """Return K u at some vertices, (k, 3) [N]; u (n, 3) [m]."""
        rows = (3 * ids[:, None] + np.arange(3)).ravel()
        return (self.stiffness[rows] @ u.ravel()).reshape(-1, 3)

    @cached_property
    def columns(self) -> Columns:
        """Compliance columns by vertex, kept while memory allows."""
        return Columns(self)

    @cached_property
    def _factors(self) -> "OrderedDict[bytes, tuple[Array, Factor]]":
        return OrderedDict()

    def factor(self, held: Array) -> tuple[Array, Factor, bool]:
        """Return the free vertices, the factor of K among them, and whether it is new.

        `held`: ids (k,), ascending. The latest few factors are kept.
        """
        key = held.tobytes()
        new = key not in self._factors
        if new:
            free = np.setdiff1d(np.arange(len(self.mesh.points)), held)
            K: Any = self.pattern.condense(self.stiffness, free, free)
            solver = choose(self.solver, K.shape[0])
            made: Any = solver.factor(K, self.mesh.points[free]) if len(free) else Nothing()
            self._factors[key] = free, made
            while len(self._factors) > KEPT:
                self._factors.popitem(last=False)
        self._factors.move_to_end(key)
        return *self._factors[key], new

    def columns_pay(self, held: Array, moved: Array) -> bool:
        """Return whether moved vertices are faster by their compliance than a factor.

        Measured on a reference tree, orders 1 and 2: ten vertices take a third of the time
        of a factor, 20 half of it, 30 as long. The first moved set gets a factor of its
        own; the second has the base factored, which serves all to come.
        """
        if held.tobytes() in self._factors or self.columns.missing(moved) > FEW:
            return False
        if not self._factors or len(moved) > MANY:
            return False
        solver = choose(self.solver, 3 * len(self.mesh.points))
        return isinstance(solver, Direct) or self.columns.missing(moved) == 0

    def solve(
        self, *loads: Load, start: Equilibrium | None = None, tolerance: float = 1e-8
    ) -> Equilibrium:
        """Return the equilibrium under these loads together: `move`, `force`, `gravity`...

        For a corotational model: `start` is a state to go on from, which saves steps and
        chooses among several equilibria; forces balance to `tolerance` of their size. Where
        the whole load cannot be carried, StoppedWarning says at which fraction it stopped,
        and the state is the one there.

        Where the material has a strength, BreakageWarning says which limb would break.

        Raises ModelError for ids out of range, a vertex both fixed and moved, or moved
        twice, and SolverError when the solve misses its backward error.
        """
        if self.kinematics == "linear":
            state = equilibrium(self, loads)
        else:
            state = large_equilibrium(self, loads, start, tolerance=tolerance)
        warn_of_breakage(state)
        return state

    def base_factor(self) -> tuple[Array, Factor]:
        """Return the vertices that are not fixed, and the factor of K among them."""
        free, factor, _ = self.factor(np.unique(self.fixed_ids))
        return free, factor

    def contact(self, ids: ArrayLike | str, *, dtype: Any = np.float64) -> Contact:
        """Return vertices prepared for many displacements: `force(d)`, `displacement(d)`.

        `dtype=numpy.float32` halves the memory and the time of a field. Raises ModelError
        for ids out of range or fixed.
        """
        if self.kinematics != "linear":
            raise ModelError(
                "contact is linear, about one state of a corotational model: take "
                "state.contact(ids), or model.drag(ids) to go far."
            )
        return Contact(self, ids_in(self.mesh, ids, "contact"), dtype)

    def drag(
        self,
        ids: ArrayLike | str,
        *loads: Load,
        start: Equilibrium | None = None,
        tolerance: float = 1e-4,
    ) -> Drag:
        """Return vertices to be led along frame by frame: `drag.to(d)` is an equilibrium.

        `loads` act all the while. Corotational models only.
        """
        on = ids_in(self.mesh, ids, "drag")
        return Drag(self, on, loads, start=start, tolerance=tolerance)

    def settled(self, *loads: Load) -> Equilibrium:
        """Return the plant under its own weight, or under `loads` instead.

        With `ps.gravity(masses=skeleton.masses)` under that of its leaves and fruit too. Go
        on from it with `solve(..., start=...)`, naming the weight again.
        """
        return self.solve(*(loads or (gravity(),)))

    def unloaded(self, *loads: Load, tolerance: float = 1e-6) -> "ElasticModel":
        """Return the model that sags to the shape of this one's mesh under its weight.

        For a plant scanned or photographed where it stands: under `loads` (its own weight
        where none are given) the model returned has the scanned shape, to `tolerance` [m],
        so that it is not bent twice. What hangs is borne by the vertices nearest to it in
        the scanned shape: take `loads = ps.gravity(masses=skeleton.masses).parts(mesh)` for
        this and for what follows. Raises SolverError where there is no such shape.
        """
        return unloaded(self, loads or (gravity(),), tolerance)[0]

    @cached_property
    def nodal_mass(self) -> Array:
        """Mass [kg] that each vertex carries under a uniform acceleration, (n,)."""
        _, _, rho = self.material.per_tet(len(self.mesh.tets))
        share = rho[:, None] * self.blocks.weight
        return np.bincount(self.mesh.tets.ravel(), share.ravel(), len(self.mesh.points))

    @property
    def mass(self) -> float:
        """Mass [kg] of the plant."""
        return float(self.nodal_mass.sum())

    def plot(self, out: str | os.PathLike[str] = "model.png", **options: Any) -> Path:
        """Draw Young's modulus of the tets to a PNG; options as of `ps.figure_material`."""
        from plantsim.view.figures import figure_material  # noqa: PLC0415

        count = len(self.mesh.tets)
        young = np.broadcast_to(self.material.young / 1e9, (count,))
        return figure_material(self.mesh, young, out, **options)

    _repr_html_ = card  # what a notebook shows

    def __repr__(self) -> str:
        fixed = self.fixed_ids
        solver = self.solver if isinstance(self.solver, str) else type(self.solver).__name__
        free = 3 * (len(self.mesh.points) - len(fixed))
        kind = "" if self.kinematics == "linear" else f"{self.kinematics}, "
        return (
            f"ElasticModel({kind}{len(self.mesh.tets):,} tets of order {self.mesh.order}, "
            f"{free:,} unknowns, {len(fixed)} vertices fixed, solver {solver}; "
            f"{self.material!r})"
        )


@dataclass(frozen=True)
class Nothing:
    """The factor of no unknowns at all: every free vertex is moved."""

    name: str = "none"
    backend: str = "nothing to solve"

    def __call__(self, f: Array, *, check: bool = True) -> tuple[Array, int, float]:
        """Return f, which is empty."""
        return f, 0, 0.0

    def precondition(self, f: Array) -> Array:
        """Return f, which is empty."""
        return f

    @property
    def definite(self) -> bool:
        """True of no unknowns."""
        return True


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
        return blocks(self.mesh, self.pattern)

    @cached_property
    def points(self) -> Points:
        return Points.of(self.mesh, self.pattern)

    @cached_property
    def pattern(self) -> Pattern:
        return Pattern.of(self.mesh.tets, len(self.mesh.points))
