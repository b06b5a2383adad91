"""A hand that leads a corotational plant: frames at once, balance when there is time.

A frame is the tangent's answer about the latest equilibrium, at the cost of a linear one;
the equilibrium itself takes seconds for a large plant, and may be solved in another thread
while frames go on. Once it is taken over, frames go on from there.
"""

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from plantsim.arrays import Array
from plantsim.elastic.equilibrium import Equilibrium
from plantsim.elastic.near import NearContact

NEAR = 2e-3  # of the way from rest: a goal so close to the equilibrium's counts as met


class Following:
    """Vertices taken hold of at an equilibrium `rest` under `loads`, and led from there."""

    def __init__(self, rest: Equilibrium, loads: list[Any], ids: Array) -> None:
        self.rest, self.ids = rest, ids
        self.near = _prepared(rest, ids)
        self._loads, self._drag = loads, None

    @property
    def state(self) -> Equilibrium:
        """The latest equilibrium."""
        return self.near.state

    def goal(self, shift: Array, turn: Array | None) -> Array:
        """Return displacements (k, 3) [m] of the vertices, moved together from rest.

        By `shift` and, about their middle, the rotation vector `turn`; where that is None
        they turn until the hand feels no torque, by the latest tangent.
        """
        points, rest, state = self.rest.model.mesh.points, self.rest, self.state
        home = points[self.ids] + rest.displacement[self.ids]
        middle = home.mean(axis=0)
        if turn is not None:
            turned = Rotation.from_rotvec(turn).apply(home - middle)
            return middle + shift + turned - points[self.ids]
        now = points[self.ids] + state.displacement[self.ids]
        arm = now - now.mean(axis=0)
        step = middle + shift - now.mean(axis=0)
        angle = relief(arm, self.near.stiffness, step, self._felt(), carried=True)
        turned = Rotation.from_rotvec(angle).apply(arm)
        return now.mean(axis=0) + step + turned - points[self.ids]

    def met(self, goal: Array) -> bool:
        """Whether the latest equilibrium is at a goal (k, 3) [m]."""
        off = np.linalg.norm(goal - self.state.displacement[self.ids], axis=1).max()
        way = np.linalg.norm(goal - self.rest.displacement[self.ids], axis=1).max()
        return bool(off <= NEAR * way)

    def surface(self, goal: Array) -> Array:
        """Return displacements (s, 3) [m] of the surface with the vertices at a goal."""
        on = self.rest.model.mesh.surface_vertices
        step = goal - self.state.displacement[self.ids]
        return self.state.displacement[on] + self.near.contact.surface_displacement(step)

    def field(self, goal: Array) -> Array:
        """Return the whole displacement (n, 3) [m] with the vertices at a goal."""
        return self.near.displacement(goal - self.state.displacement[self.ids])

    def force(self, goal: Array) -> Array:
        """Return the hand's force (k, 3) [N] with the vertices at a goal."""
        step = goal - self.state.displacement[self.ids]
        return self._felt() + self.near.contact.force(step)

    def _felt(self) -> Array:
        return (self.state.force - self.rest.force)[self.ids]

    def solved(self, goal: Array) -> NearContact:
        """Return the equilibrium at a goal, prepared; seconds, in any one thread."""
        if self._drag is None:
            model = self.rest.model
            self._drag = model.drag(self.ids, *self._loads, start=self.rest)
        return _prepared(self._drag.to(goal), self.ids)

    def take(self, near: NearContact) -> None:
        """Go on from an equilibrium that `solved` returned."""
        self.near = near


def relief(
    arm: Array, stiffness: Array, shift: Array, force: Array, *, carried: bool = False
) -> Array:
    """Return the small turn [rad] that lets a patch feel no torque when it is shifted.

    `arm` (k, 3): from its middle to its vertices; `force` (k, 3): what it feels already. A
    point or a line cannot feel all turns: the least of those that do. `carried`: the arms
    turn too, so that forces within the patch, which turn with it, make no torque; linear
    theory keeps the arms of rest.
    """
    turns = np.stack([np.cross(axis, arm) for axis in np.eye(3)], axis=2).reshape(-1, 3)
    together = np.tile(np.eye(3), (len(arm), 1))
    after = force.ravel() + stiffness @ (together @ shift)
    slope = turns.T @ stiffness @ turns
    if carried:  # (turn x arm) x force, of what is felt: a far shift's forces are a guess
        slope = slope + arm.T @ force - np.einsum("ij,ij->", arm, force) * np.eye(3)
    return -np.linalg.pinv(slope, rcond=1e-9, hermitian=not carried) @ (turns.T @ after)


def _prepared(state: Equilibrium, ids: Array) -> NearContact:
    near = state.contact(ids)
    near.contact.surface_displacement((0, 0, 0))  # made at first use: now, not in a frame
    return near
