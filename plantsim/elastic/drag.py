"""Drag: vertices led along frame by frame, each frame an equilibrium begun from the last.

A frame begins where the tangent says, with half of the change of its answer since the frame
before, which makes the guess good to second order; one Newton step, by CG on a factor of
some frames ago, then does as a rule.
"""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from plantsim.arrays import Array
from plantsim.elastic.corotational import Turned
from plantsim.elastic.equilibrium import Equilibrium
from plantsim.elastic.loads import Load, Move
from plantsim.elastic.newton import large_equilibrium
from plantsim.elastic.warp import Warp
from plantsim.errors import ModelError

if TYPE_CHECKING:
    from plantsim.elastic.model import ElasticModel


LONGER = 2.0  # times the frame before that a frame may be, for its error to be of use


class Drag:
    """Vertices taken hold of and led along. Made by `model.drag`; `to(d)` is one frame."""

    def __init__(
        self,
        model: "ElasticModel",
        ids: Array,
        loads: tuple[Load, ...] = (),
        *,
        start: Equilibrium | None = None,
        tolerance: float = 1e-4,
    ) -> None:
        """Take hold of vertices (k,) where they are at `start`, or under `loads`."""
        if model.kinematics != "corotational":
            raise ModelError("drag is for corotational models; take model.contact(ids).")
        self.model, self.ids, self.loads, self.tolerance = model, ids, loads, tolerance
        if start is None:
            start = model.solve(*loads)
        self.state = self._solve(start.displacement[ids], start, None)
        self._warp: Warp | None = None
        # how far the vertices went [m], and how far the guess was off (n, 3)
        self._last: tuple[float, Array] | None = None

    def to(self, displacement: ArrayLike) -> Equilibrium:
        """Return the equilibrium with the vertices moved by (3,) or (k, 3) [m]."""
        old = self.state
        goal = np.broadcast_to(np.asarray(displacement, dtype=float), (len(self.ids), 3))
        step = goal - old.displacement[self.ids]
        guess = self._guess(step)
        plain, length = guess, float(np.linalg.norm(step))
        if guess is not None and self._last is not None:
            before, off = self._last
            if length <= LONGER * before:
                guess = guess + (length / before) ** 2 * off
        self.state = self._solve(goal, old, guess)
        self._last = None
        if plain is not None and length > 0:
            self._last = length, self.state.displacement - plain
        return self.state

    def _guess(self, step: Array) -> Array | None:
        """Return the displacements (n, 3) when the vertices move, by the latest tangent."""
        near = self.state.near
        if near is None or not near.fresh or not np.isfinite(step).all():
            return None
        order = np.argsort(self.ids)
        part = self.model.pattern.condense(near.K, near.free, self.ids[order])
        x = near.factor(-(part @ step[order].ravel()))[0]
        out = np.zeros_like(self.state.displacement)
        out[self.ids] = step
        out[near.free] = x.reshape(-1, 3)
        here = self.state.deformed
        assert isinstance(here, Turned)
        if self._warp is None or not np.array_equal(self._warp.free, near.free):
            self._warp = Warp.of(here.points, here.mu, near.free)
        return self.state.displacement + self._warp(here, out)

    def _solve(self, goal: Array, start: Equilibrium, guess: Array | None) -> Equilibrium:
        loads = (*self.loads, Move(self.ids, goal))
        return large_equilibrium(
            self.model, loads, start, tolerance=self.tolerance, guess=guess
        )

    def __repr__(self) -> str:
        return f"Drag({len(self.ids)} vertices of {self.model!r}; {self.state!r})"
