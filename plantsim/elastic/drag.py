"""Drag: vertices led along frame by frame, each frame an equilibrium begun from the last.

A frame begins where the tangent says, with half of the change of its answer since the frame
before, which makes the guess good to second order; one Newton step, by CG on a factor of
some frames ago, then does as a rule.
"""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from plantsim.arrays import Array
from plantsim.elastic.equilibrium import Equilibrium
from plantsim.elastic.loads import Load, Move
from plantsim.elastic.newton import CHEAP, large_equilibrium
from plantsim.errors import ModelError
from plantsim.solve.cg import refined

if TYPE_CHECKING:
    from plantsim.elastic.model import ElasticModel


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
        self._last: tuple[Array, Array] | None = None  # what was asked for, and came

    def to(self, displacement: ArrayLike) -> Equilibrium:
        """Return the equilibrium with the vertices moved by (3,) or (k, 3) [m]."""
        old = self.state
        goal = np.broadcast_to(np.asarray(displacement, dtype=float), (len(self.ids), 3))
        step = goal - old.displacement[self.ids]
        guess, came = None, self._tangent_answer(step)
        if came is not None:
            guess = old.displacement + came
            if self._last is not None:
                before, then = self._last
                if np.linalg.norm(step - before) < 0.2 * np.linalg.norm(step):
                    guess = guess + (came - then) / 2
        self.state = self._solve(goal, old, guess)
        self._last = None if came is None else (step, came)
        return self.state

    def _tangent_answer(self, step: Array) -> Array | None:
        """Return the displacements (n, 3) by the latest tangent when the vertices move."""
        near = self.state.near
        if near is None or not np.isfinite(step).all():
            return None
        order = np.argsort(self.ids)
        at = self.ids[order]
        part = self.model.pattern.condense(near.K, near.free, at)
        b = -(part @ step[order].ravel())
        x = near.factor(b)[0] if near.fresh else refined(near.inner, near.factor, b, CHEAP)
        if x is None:
            return None
        out = np.zeros_like(self.state.displacement)
        out[self.ids] = step
        out[near.free] = x.reshape(-1, 3)
        return out

    def _solve(self, goal: Array, start: Equilibrium, guess: Array | None) -> Equilibrium:
        loads = (*self.loads, Move(self.ids, goal))
        return large_equilibrium(
            self.model, loads, start, tolerance=self.tolerance, guess=guess
        )

    def __repr__(self) -> str:
        return f"Drag({len(self.ids)} vertices of {self.model!r}; {self.state!r})"
