"""Limb: one limb of a skeleton; and polylines, which limbs are made of."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from plantsim.arrays import Array


@dataclass(frozen=True, eq=False)
class Limb:
    """One limb of a skeleton, from its start on the parent's axis to its tip."""

    index: int
    name: str  # "0" trunk; "3" its third child; "3.1" the first child of that; "t2" trunk 2
    level: int  # 0 trunk, 1 branch, ...
    parent: int  # index of the parent limb, -1 for the trunk
    points: Array  # (k, 3) [m]
    radius: Array  # (k,) [m]

    @property
    def length(self) -> float:
        """Length [m] of the polyline."""
        return float(np.linalg.norm(np.diff(self.points, axis=0), axis=1).sum())

    @property
    def base_radius(self) -> float:
        """Radius [m] at the start."""
        return float(self.radius[0])

    @property
    def tip_radius(self) -> float:
        """Radius [m] at the end."""
        return float(self.radius[-1])

    @property
    def tip(self) -> Array:
        """Last point, (3,) [m]."""
        return self.points[-1]

    def __repr__(self) -> str:
        return (
            f"Limb({self.name}: level {self.level}, {self.length:.3g} m, "
            f"radius {self.base_radius:.3g} to {self.tip_radius:.3g} m)"
        )


class Joints(NamedTuple):
    """Where limbs start on their parents' axes."""

    limb: Array  # (k,) the limbs that have a parent
    arc: Array  # (k,) along the parent's chords [m]
    interval: Array  # (k,) interval of the parent's spline
    t: Array  # (k,) fraction of it
    distance: Array  # (k,) of the limb's first node from that point [m]


class Polyline(NamedTuple):
    """What `Skeleton.from_limbs` takes: a limb before it has nodes in a skeleton."""

    points: ArrayLike  # (k, 3) [m], the first on the parent's polyline
    radius: ArrayLike  # (k,) [m]
    parent: int = -1  # index of an earlier limb, -1 for the trunk
    level: int | None = None  # one more than the parent's where None


def nearest_on_polyline(points: Array, x: Array) -> tuple[int, float]:
    """Return the node at or before the point nearest to `x`, and its arc length [m].

    >>> line = np.array([[0.0, 0, 0], [1, 0, 0], [3, 0, 0]])
    >>> nearest_on_polyline(line, np.array([2.0, 1, 0]))
    (1, 2.0)
    """
    a, d = points[:-1], np.diff(points, axis=0)
    length = np.linalg.norm(d, axis=1)
    t = np.clip(np.einsum("ij,ij->i", x - a, d) / length**2, 0, 1)
    distance = np.linalg.norm(a + t[:, None] * d - x, axis=1)
    i = int(distance.argmin())
    arc = length[:i].sum() + t[i] * length[i]
    # within rounding of the next node, that node is the one at or before
    node = i + int(t[i] > 1 - 1e-9)
    return node, float(arc)
