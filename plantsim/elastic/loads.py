"""What is done to a plant: vertices moved, forces, gravity."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from plantsim.arrays import Array, frozen
from plantsim.errors import ModelError

STANDARD_GRAVITY = 9.80665  # [m/s^2], CGPM 1901


@dataclass(frozen=True, eq=False)
class Move:
    """Vertices brought to given displacements [m]."""

    ids: ArrayLike
    displacement: Array  # (3,) for all, or (k, 3)


@dataclass(frozen=True, eq=False)
class Force:
    """A force [N] on vertices."""

    ids: ArrayLike
    force: Array  # (3,) in all, shared evenly, or (k, 3)


@dataclass(frozen=True, eq=False)
class Gravity:
    """Weight of the plant's own mass."""

    acceleration: Array  # (3,) [m/s^2]


Load = Move | Force | Gravity


def move(ids: ArrayLike, displacement: ArrayLike) -> Move:
    """Return the load that moves vertices by `displacement` [m].

    (3,) for all, or one row a vertex, (k, 3).

    `ids`: vertex ids or a set's name. Raises ModelError for shapes that do not fit.
    """
    return Move(ids, _rows("displacement", ids, displacement))


def force(ids: ArrayLike, force: ArrayLike) -> Force:
    """Return a force [N] on vertices.

    (3,) in all, shared evenly, or one row a vertex, (k, 3).

    `ids`: vertex ids or a set's name. Raises ModelError for shapes that do not fit.
    """
    return Force(ids, _rows("force", ids, force))


def gravity(acceleration: ArrayLike = (0.0, 0.0, -STANDARD_GRAVITY)) -> Gravity:
    """Return the weight of the plant, by its density; (3,) [m/s^2], downwards."""
    return Gravity(frozen(acceleration, (3,), name="acceleration", error=ModelError))


def _rows(name: str, ids: ArrayLike, values: ArrayLike) -> Array:
    if np.ndim(values) == 1:
        return frozen(values, (3,), name=name, error=ModelError)
    count = None if isinstance(ids, str) else np.size(ids)
    return frozen(values, (count, 3), name=name, error=ModelError)
