"""What would hinder a mesh of a skeleton, in words that say what to do."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from plantsim.arrays import Array, few
from plantsim.plant.bends import worst_bend
from plantsim.plant.collisions import colliding

if TYPE_CHECKING:
    from plantsim.plant.skeleton import Skeleton

BEND = 0.95  # radius / bend radius beyond which the sweep refuses
JOINT = 0.95  # a child's radius over its parent's; the sweep refuses above 0.97
OFF_AXIS = 0.5  # a start's distance from the axis over the parent's radius; it refuses 0.7
TOUCH = 1.0  # distance over sum of radii


def hindrances(skeleton: "Skeleton") -> tuple[str, ...]:
    """Return what `Skeleton.check` says."""
    names = _Names(skeleton)
    found = []
    trunks = np.flatnonzero(skeleton.carrier < 0)
    if len(trunks) > 1:
        found.append(
            f"{len(trunks)} trunks ({names(trunks)}): a mesh is one body. Keep one: "
            "skeleton.ready()."
        )
    bend = worst_bend(skeleton.splines)
    for i in np.flatnonzero(bend >= BEND):
        found.append(
            f"limb {names(i)}: radius / bend radius reaches {bend[i]:.2f}, want below "
            f"{BEND}. Ease it: skeleton.smoothed()."
        )
    joints = skeleton.joints
    thick = skeleton.splines.thickness(joints.interval, joints.t)
    own = skeleton.radius[skeleton.first[joints.limb]]
    up = skeleton.carrier[joints.limb]
    for k in np.flatnonzero(joints.distance > OFF_AXIS * thick):
        found.append(
            f"limb {names(joints.limb[k])}: starts {joints.distance[k]:.2g} m off the axis "
            f"of limb {names(up[k])} (radius {thick[k]:.2g} m). Start it there: "
            "skeleton.ready()."
        )
    for k in np.flatnonzero(own > JOINT * thick):
        found.append(
            f"limb {names(joints.limb[k])}: radius {own[k]:.2g} m where limb "
            f"{names(up[k])} has {thick[k]:.2g} m, want at most {JOINT} of that. Thin it: "
            "skeleton.ready()."
        )
    for k in np.flatnonzero(~leaves(skeleton)):
        found.append(
            f"limb {names(joints.limb[k])}: ends inside limb {names(up[k])}. Drop it: "
            "skeleton.ready()."
        )
    for i, j in colliding(skeleton, TOUCH):
        other = "itself" if i == j else f"limb {names(j)}"
        found.append(
            f"limb {names(i)} runs into {other}. Turn or drop one: "
            "skeleton.without_collisions()."
        )
    return tuple(found)


def leaves(skeleton: "Skeleton") -> Array:
    """Return for each limb of `joints` whether its tip is outside its parent."""
    axes, joints = skeleton.splines, skeleton.joints
    up = skeleton.carrier[joints.limb]
    tip = skeleton.points[skeleton.last[joints.limb]]
    reach = axes.arc[skeleton.last[joints.limb]]
    out = np.ones(len(up), dtype=bool)
    # a limb longer than that is out, or runs into its parent, which is a collision
    k = np.flatnonzero(reach < 12 * axes.radius[axes.first[up]])
    if not len(k):
        return out
    size = axes.last[up[k]] - axes.first[up[k]] + 1
    begin = np.cumsum(size) - size
    node = np.arange(size.sum()) + np.repeat(axes.first[up[k]] - begin, size)
    away = axes.points[node] - np.repeat(tip[k], size, axis=0)
    far = np.einsum("ij,ij->i", away, away)
    best = np.repeat(np.minimum.reduceat(far, begin), size) == far
    hit = np.flatnonzero(best)
    arc = axes.arc[node[hit[np.searchsorted(hit, begin)]]]
    _, i, t, gap = axes.nearest(up[k], arc, tip[k])
    out[k] = gap > axes.thickness(i, t)
    return out


class _Names:
    """Names of limbs, made only when something is found."""

    def __init__(self, skeleton: "Skeleton") -> None:
        self.skeleton = skeleton

    def __call__(self, limbs: ArrayLike) -> str:
        return few(self.skeleton.limbs[i].name for i in np.atleast_1d(limbs))
