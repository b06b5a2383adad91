"""Newton's method for a corotational model: loads -> Equilibrium, in steps where need be.

A step moves the held vertices along their path and starts from the tangent's answer. Then
Newton on the energy: the exact tangent where it is positive definite, else the one without
its points' negative eigenvalues, and a line search that never lets the energy rise. Where
that fails the step is halved.
"""

import logging
import time
import warnings
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.linalg
from scipy.spatial.transform import Rotation

from plantsim.arrays import Array
from plantsim.elastic.deformed import Deformed
from plantsim.elastic.equilibrium import Equilibrium
from plantsim.elastic.loads import Load
from plantsim.elastic.statics import Acting, gathered, motion, turning
from plantsim.errors import ModelError, SolverError, StoppedWarning
from plantsim.solve.cg import refined
from plantsim.solve.solver import Factor, choose
from plantsim.solve.stats import SolveStats, norm

if TYPE_CHECKING:
    from plantsim.elastic.model import ElasticModel

log = logging.getLogger(__name__)

TOLERANCE = 1e-8  # |residual| / |forces|
NOISE = 4.0  # roundings of a model's forces or energy, below which nothing can be told
ITERATIONS = 40  # of Newton a step
SMALLEST = 1 / 32  # of the load in one step
BLEND = 0.25  # of the positive tangent, tried first where the exact one is not positive
CLOSE = 0.03  # residual from which forces that follow are balanced by the exact tangent
CHEAP = 24  # iterations of CG on an old factor that cost as much as a new factor


@dataclass(frozen=True)
class NewtonStats(SolveStats):
    """What Newton did; `iterations` are Newton's."""

    fraction: float = 1.0  # of the load that is carried
    steps: int = 1  # load steps
    factors: int = 0
    residual: float = 0.0  # |forces out of balance| / |applied forces and reactions|


@dataclass(eq=False)
class Near:
    """A factored tangent near an equilibrium, to begin the next one with."""

    free: Array  # (k,)
    K: Any  # (3n, 3n), the latest tangent
    inner: Any  # its part among the free vertices
    factor: Factor  # of that or of an earlier tangent
    fresh: bool  # whether of that


def large_equilibrium(
    model: "ElasticModel",
    loads: Iterable[Load],
    start: Equilibrium | None = None,
    *,
    tolerance: float = TOLERANCE,
    guess: Array | None = None,
) -> Equilibrium:
    """Return the equilibrium of a corotational model under loads.

    `start`: a state of the same mesh to go on from. `guess` (n, 3): displacements to begin
    with, instead of those that the tangent foretells.
    """
    began = time.perf_counter()
    if start is not None and len(start.displacement) != len(model.mesh.points):
        raise ModelError(
            f"start: a state of {len(start.displacement)} vertices for a model of "
            f"{len(model.mesh.points)}. Start from a state of the same mesh."
        )
    task = _Task.of(model, gathered(model, loads), start, tolerance)
    u, done, step, steps = task.begin, 0.0, 1.0, 0
    if guess is not None:
        u = guess.copy()
        u[task.acting.moved] = task.path(1.0)
        try:
            u = task.relax(u, 1.0)
            done, steps = 1.0, 1
        except SolverError:
            u = task.begin
    while done < 1:
        goal = min(done + step, 1.0)
        try:
            new = task.relax(task.foretold(u, done, goal), goal)
        except SolverError as why:
            step = (goal - done) / 2
            log.info("load fraction %.3g: %s; halving the step", goal, why)
            if step < SMALLEST:
                warnings.warn(
                    f"stopped at {done:.3g} of the load ({why}); the state is the one "
                    "there. Load less, or in another order, starting from it.",
                    StoppedWarning,
                    stacklevel=4,
                )
                break
        else:
            u, done, steps, step = new, goal, steps + 1, 1.5 * step
    return task.state(u, done, steps, began)


@dataclass(eq=False)
class _Task:
    model: "ElasticModel"
    acting: Acting
    begin: Array  # (n, 3) where to start
    held: Array
    free: Array
    force: tuple[Array, Array]  # (n, 3) dead loads at the start and in the end
    near: Near | None
    tolerance: float
    floor: float  # size of the forces at the start
    iterations: int = 0
    factors: int = 0
    residual: float = 0.0
    last: tuple[Array, Deformed] | None = None
    share: float = 0.0  # of the loads, when last asked

    @classmethod
    def of(
        cls,
        model: "ElasticModel",
        acting: Acting,
        start: Equilibrium | None,
        tolerance: float,
    ) -> "_Task":
        held = np.union1d(model.fixed_ids, acting.moved)
        free = np.setdiff1d(np.arange(len(model.mesh.points)), held)
        begin, before, near, floor = (
            np.zeros_like(acting.force),
            0 * acting.force,
            None,
            0.0,
        )
        if start is not None:
            begin = start.displacement.copy()
            begin[model.fixed_ids] = 0
            before = start.force.copy()  # of vertices let go now: fades out
            before[free] -= acting.following_forces(model.mesh, begin)[free]
            floor = float(norm(start.force.ravel()))
            # of another material or rest shape too: its order and CG on its factor serve
            near = start.near
            if near is not None and not np.array_equal(near.free, free):
                near = None
        return cls(
            model, acting, begin, held, free, (before, acting.force), near, tolerance, floor
        )

    def path(self, t: float) -> Array:
        """Return where the moved vertices are at fraction t, (k, 3): turning as a body."""
        acting, x = self.acting, self.model.mesh.points
        out = np.zeros_like(x)
        for ids in acting.patches:
            one, other = x[ids] + self.begin[ids], x[ids] + acting.displacement[ids]
            turn, at, to = motion(one, other)
            part = Rotation.from_rotvec(t * turn)
            whole = Rotation.from_rotvec(turn)
            rest = other - to - whole.apply(one - at)  # what no rigid motion does
            out[ids] = part.apply(one - at) + at + t * (to - at) + t * rest - x[ids]
        return out[acting.moved]

    def load(self, u: Array, t: float) -> Array:
        """Return the external forces on free vertices at fraction t, (n, 3) [N]."""
        self.share = t
        before, after = self.force
        dead = before + t * (after - before)
        return dead + t * self.acting.following_forces(self.model.mesh, u)

    def foretold(self, u: Array, t: float, goal: float) -> Array:
        """Return the tangent's answer to the step from t to `goal`, from rest at t."""
        out = u.copy()
        out[self.acting.moved] = self.path(goal)
        deformed = self.at(u)
        lack = (self.load(u, goal) - deformed.forces)[self.free]
        if not len(self.free):
            return out
        near = self.tangent(deformed, self.near if t == 0 else None)
        if len(self.acting.moved):
            at = np.sort(self.acting.moved)
            pull = (
                self.model.pattern.condense(near.K, self.free, at) @ (out - u)[at].ravel()
            )
            lack = lack - pull.reshape(-1, 3)
        out[self.free] += self.direction(near, lack, self.gap(u, goal))
        return out

    def relax(self, u: Array, t: float) -> Array:
        """Return the equilibrium at fraction t; SolverError where none is found."""
        small = 0
        for _ in range(ITERATIONS):
            deformed = self.at(u)
            load = self.load(u, t)
            internal = deformed.forces
            lack = self.unheld((load - internal)[self.free])
            off, self.residual = self.balance(lack, internal, load)
            noise = deformed.noise[0]
            gap = self.gap(u, t)
            closed = np.abs(gap).max(initial=0.0) <= 1e-12
            if closed and (self.residual <= self.tolerance or off <= NOISE * noise):
                return u
            if not np.isfinite(off):
                raise SolverError("forces are no longer finite")
            self.iterations += 1
            near = self.tangent(deformed, self.near)
            x = self.direction(near, lack, gap)
            slope = float(np.einsum("ij,ij->", x, lack))
            follows = bool(self.acting.following)  # which no energy stands for
            if slope <= 0 and closed and not follows:  # not downhill
                near = self.tangent(deformed, None, positive=True)
                x = self.direction(near, lack, gap)
                slope = float(np.einsum("ij,ij->", x, lack))
            free = follows or not closed
            u, length = self.search(u, x, slope, deformed, load, free=free)
            small = small + 1 if length < 1e-2 else 0
            if small >= 3:
                raise SolverError(f"steps of {length:.0e} at residual {self.residual:.0e}")
        raise SolverError(f"residual {self.residual:.0e} after {ITERATIONS} iterations")

    def balance(self, lack: Array, internal: Array, load: Array) -> tuple[float, float]:
        """Return the size of the forces out of balance, and relative to those that act."""
        size = norm(internal[self.held].ravel()) + norm(load[self.free].ravel())
        size, off = max(float(size), self.floor), float(norm(lack.ravel()))
        return off, off / size if size else 0.0

    def search(
        self,
        u: Array,
        x: Array,
        slope: float,
        deformed: Deformed,
        load: Array,
        *,
        free: bool,
    ) -> tuple[Array, float]:
        """Return u + a x with the energy no higher, and a, halved from 1 on."""
        work = np.einsum("ij,ij->", load[self.free], x)
        before, length = deformed.energy, 1.0
        while True:
            new = u.copy()
            new[self.free] += length * x
            energy = self.at(new).energy
            rise = energy - before - length * work
            # what rounding hides is no rise
            hidden = 1e-13 * (abs(energy) + abs(before)) + NOISE * deformed.noise[1]
            if free or rise <= hidden - 1e-4 * length * slope:
                return new, length
            if length < 1e-6:
                raise SolverError("no step lowers the energy")
            length /= 2

    def at(self, u: Array) -> Deformed:
        if self.last is None or not np.array_equal(self.last[0], u):
            self.last = u, self.model.deformed(u)
        return self.last[1]

    def tangent(
        self, deformed: Deformed, old: Near | None, *, positive: bool = False
    ) -> Near:
        """Return the tangent with a factor: of its own, or of an old tangent near it."""
        exact = None if positive else deformed.tangent()
        # a direct factor in the order of the last one costs some 14 back-solves; CG on the
        # last one took 19 on average over a drag
        if exact is not None and old is not None and old.factor.name != "direct":
            inner: Any = self.model.pattern.condense(exact, self.free, self.free)
            self.near = Near(self.free, exact, inner.tocsr(), old.factor, False)
            return self.near
        # where the exact one is not positive: first with a little of the positive one
        for share in (1.0,) if exact is None else (0.0, BLEND, 1.0):
            K = deformed.tangent(positive=True) if share or exact is None else exact
            if exact is not None and 0 < share < 1:
                K = exact + share * (K - exact)
            inner = self.model.pattern.condense(K, self.free, self.free)
            try:
                factor = self._factored(inner)
            except SolverError:
                if share == 1:
                    raise
                continue
            self.near = Near(self.free, K, inner.tocsr(), factor, True)
            # forces that follow have no energy to lower: near balance the exact tangent is
            # right whatever its signs, and the mixed one converges by an eighth a step
            if factor.definite or (self.acting.following and self.residual < CLOSE):
                break
        assert self.near is not None
        return self.near

    def _factored(self, inner: Any) -> Factor:
        self.factors += 1
        solver = choose(self.model.solver, inner.shape[0])
        like = self.near.factor if self.near is not None else None
        return solver.factor(inner, self.model.mesh.points[self.free], like)

    def direction(self, near: Near, lack: Array, gap: Array) -> Array:
        """Return the step (k, 3) of the free vertices against forces out of balance."""
        b = lack.ravel()
        if self.acting.holds and self.acting.following:
            raise ModelError(
                "forces that follow together with directions held alone: not both. Hold "
                "the vertices altogether, or let the forces be dead."
            )
        if self.acting.holds or self.acting.following:
            if not near.fresh:
                near.factor, near.fresh = self._factored(near.inner), True
            if self.acting.holds:
                return self._direction_held(near, b, gap).reshape(-1, 3)
            return self._direction_following(near, b).reshape(-1, 3)
        if near.fresh:
            return near.factor(b)[0].reshape(-1, 3)
        x = refined(near.inner, near.factor, b, CHEAP)
        if x is None:
            # too far from the old one, or not positive definite
            factor = self._factored(near.inner)
            if not factor.definite:
                assert self.last is not None
                return self.direction(
                    self.tangent(self.last[1], None, positive=True), lack, gap
                )
            near.factor, near.fresh = factor, True
            x = factor(b)[0]
        return x.reshape(-1, 3)

    def _direction_held(self, near: Near, b: Array, gap: Array) -> Array:
        """Return the step that also closes the gaps of directions held alone."""
        C = self._ways()
        response = near.factor(C)[0]
        x = near.factor(b)[0]
        multiplier = scipy.linalg.solve(C.T @ response, gap - C.T @ x, assume_a="sym")
        return x + response @ multiplier

    def _direction_following(self, near: Near, b: Array) -> Array:
        """Return the step that knows how forces that follow turn with it.

        They add -A T to the tangent, three columns a patch: T the small turn of the patch,
        A what a turn does to its forces. By the formula of Sherman, Morrison, Woodbury.
        """
        assert self.last is not None
        u, x = self.last[0], self.model.mesh.points
        n, some = len(x), []
        for ids, f in self.acting.following:
            A, T = np.zeros((n, 3, 3)), np.zeros((n, 3, 3))
            A[ids], T[ids] = turning(x[ids], x[ids] + u[ids], self.share * f)
            some.append((A[self.free].reshape(-1, 3), T[self.free].reshape(-1, 3)))
        A, T = (np.hstack([pair[i] for pair in some]) for i in (0, 1))
        solved = near.factor(b)[0]
        response = near.factor(np.asfortranarray(A))[0]
        core = np.eye(A.shape[1]) - T.T @ response
        return solved + response @ np.linalg.solve(core, T.T @ solved)

    def _ways(self) -> Array:
        """Return the held directions as columns over the free components."""
        ids, ways, _ = (np.array(part) for part in zip(*self.acting.holds, strict=True))
        C = np.zeros((3 * len(self.free), len(ids)), order="F")
        rows = 3 * np.searchsorted(self.free, ids)[:, None] + np.arange(3)
        C[rows, np.arange(len(ids))[:, None]] = ways
        return C

    def gap(self, u: Array, t: float) -> Array:
        """Return how far the directions held alone are from where they shall be [m]."""
        goal = [
            (1 - t) * float(way @ self.begin[v]) + t * g - float(way @ u[v])
            for v, way, g in self.acting.holds
        ]
        return np.array(goal)

    def unheld(self, lack: Array) -> Array:
        """Return forces without those along directions held alone, whatever they are."""
        out = lack.copy()
        for v, way, _ in self.acting.holds:
            i = int(np.searchsorted(self.free, v))
            out[i] -= (way @ out[i]) * way
        return out

    def state(self, u: Array, done: float, steps: int, began: float) -> Equilibrium:
        acting, model = self.acting, self.model
        deformed = self.at(u)
        internal = deformed.forces
        f = self.load(u, done)
        for v, way, _ in acting.holds:
            f[v] += (way @ (internal[v] - f[v])) * way
        f[self.held] = internal[self.held]
        off = norm((f - internal)[self.free].ravel())
        scale = model.size * norm(u.ravel()) + norm(f.ravel())
        near = self.near
        name = near.factor.name if near else "none"
        backend = near.factor.backend if near else "nothing to solve"
        stats = NewtonStats(
            name,
            f"Newton, {backend}",
            3 * len(self.free),
            self.iterations,
            float(off / scale) if scale else 0.0,
            time.perf_counter() - began,
            self.factors > 0,
            done,
            steps,
            self.factors,
            self.balance(self.unheld((f - internal)[self.free]), internal, f)[1],
        )
        for array in (u, f):
            array.flags.writeable = False
        ids = np.append(
            acting.moved, np.unique([v for v, _, _ in acting.holds]).astype(int)
        )
        return Equilibrium(model, u, f, ids, stats, near)
