"""Fewer limbs: cut where thin, the thickest only, whole subtrees dropped."""

from typing import TYPE_CHECKING, TypeVar

import numpy as np

from plantsim.arrays import Array
from plantsim.errors import GeometryError

if TYPE_CHECKING:
    from plantsim.plant.skeleton import Skeleton

S = TypeVar("S", bound="Skeleton")
STUB = 4.0  # radii of length below which a limb is not worth a tube


def pruned(skeleton: S, min_radius: float, max_limbs: int | None, levels: int | None) -> S:
    """Return what `Skeleton.pruned` says."""
    if not min_radius >= 0 or (max_limbs is not None and max_limbs < 1):
        raise GeometryError(
            f"pruned: min_radius {min_radius} m, max_limbs {max_limbs}; want at least "
            "0 m and at least one limb."
        )
    assert skeleton.level is not None
    first, last, limb = skeleton.first, skeleton.last, skeleton.limb
    place = np.arange(len(limb)) - first[limb]
    thin = np.where(skeleton.radius < min_radius, place, len(limb))
    cut = np.minimum(np.minimum.reduceat(thin, first), last - first + 1)
    points, radius = skeleton.points.copy(), skeleton.radius.copy()
    arc = skeleton.arc
    reach = arc[last].copy()

    short = np.flatnonzero((cut > 0) & (cut <= last - first))
    node = first[short] + cut[short]  # the first thin node becomes the cut
    t = (radius[node - 1] - min_radius) / (radius[node - 1] - radius[node])
    reach[short] = arc[node - 1] + t * (arc[node] - arc[node - 1])
    points[node] = points[node - 1] + t[:, None] * (points[node] - points[node - 1])
    radius[node] = min_radius
    flat = t * (arc[node] - arc[node - 1]) < 1e-9  # the node before is as thin
    size = cut + np.isin(np.arange(len(cut)), short[~flat])
    reach[cut == 0] = 0.0

    good = (size >= 2) & ((reach >= STUB * radius[first]) | (skeleton.carrier < 0))
    if levels is not None:
        good &= skeleton.level < levels
    kept = _standing(skeleton, good, _feet(skeleton), reach)
    if not kept[skeleton.carrier < 0].any():
        raise GeometryError(
            f"pruned: nothing of the trunk (radius {skeleton.radius[0]:.2g} m) is left "
            f"above min_radius {min_radius:.2g} m. Lower it."
        )
    thick = kept.copy()
    if max_limbs is not None and kept.sum() > max_limbs:
        thick = _thickest(skeleton, kept, max_limbs)
    out = skeleton.trusted(points=points, radius=radius)
    out = picked(out, thick, place < size[limb], arc[last])
    notes = []
    if not kept.all():
        notes.append(
            f"{(~kept).sum()} of {len(kept)} limbs thinner than {1e3 * min_radius:.2g} mm, "
            "short, or too deep left out"
        )
    if (kept & ~thick).any():
        notes.append(f"{(kept & ~thick).sum()} beyond the {max_limbs} thickest left out")
    return out.with_note(*notes)


def _feet(skeleton: "Skeleton") -> Array:
    """Return arcs [m] along their parents at which limbs start, (limbs,), by the chords."""
    p, arc = skeleton.points, skeleton.arc
    out = np.zeros(len(skeleton.first))
    mine = np.flatnonzero(skeleton.carrier >= 0)
    foot = skeleton.first[mine]
    node = skeleton.parent[foot]
    after = np.minimum(node + 1, skeleton.last[skeleton.carrier[mine]])
    way = p[after] - p[node]
    size = np.maximum((way * way).sum(axis=1), 1e-30)
    t = np.clip(((p[foot] - p[node]) * way).sum(axis=1) / size, 0, 1)
    out[mine] = arc[node] + t * (arc[after] - arc[node])
    return out


def _standing(skeleton: "Skeleton", good: Array, start: Array, reach: Array) -> Array:
    """Return a mask of the limbs that are good and whose parents stand up to them."""
    kept = good.tolist()
    carrier = skeleton.carrier.tolist()
    below = np.where(skeleton.carrier < 0, True, start <= reach[skeleton.carrier] + 1e-9)
    for i, (p, stands) in enumerate(zip(carrier, below.tolist(), strict=True)):
        kept[i] = kept[i] and stands and (p < 0 or kept[p])
    return np.array(kept)


def _thickest(skeleton: "Skeleton", kept: Array, count: int) -> Array:
    """Return a mask of the `count` thickest limbs of `kept`, closed under parents."""
    base = skeleton.radius[skeleton.first].tolist()
    for i, p in enumerate(skeleton.carrier.tolist()):
        if p >= 0:  # a child never counts as thicker than what carries it
            base[i] = min(base[i], base[p])
    rank = np.where(kept, base, -1.0)
    mask = np.zeros(len(rank), dtype=bool)
    mask[np.argsort(-rank, kind="stable")[:count]] = True
    return mask & kept


def picked(
    skeleton: S, limbs: Array, nodes: Array | None = None, whole: Array | None = None
) -> S:
    """Return the skeleton of the limbs and nodes in masks; parents must be among them.

    `whole`: lengths [m] of the limbs before they were cut, for what hangs on them.
    """
    assert skeleton.level is not None
    keep = limbs[skeleton.limb] if nodes is None else limbs[skeleton.limb] & nodes
    new = np.cumsum(keep) - 1
    parent = skeleton.parent[keep]
    # a joint that lay just before a cut hangs on the last node that stays
    safe = np.minimum(new[np.maximum(parent, 0)], np.arange(len(parent)) - 1)
    hung = skeleton.hung
    if hung.kind:
        nodes = np.bincount(skeleton.limb[keep], minlength=len(limbs))
        end = np.clip(skeleton.first + nodes - 1, skeleton.first, skeleton.last)
        full = skeleton.arc[skeleton.last] if whole is None else whole
        hung = hung.picked(limbs, skeleton.arc[end] / full)
    return skeleton.trusted(
        hung=hung,
        points=skeleton.points[keep],
        radius=skeleton.radius[keep],
        parent=np.where(parent < 0, -1, safe),
        limb=(np.cumsum(limbs) - 1)[skeleton.limb[keep]],
        level=skeleton.level[limbs],
    )


def without(skeleton: S, drop: Array) -> S:
    """Return the skeleton without the limbs in a mask and all that they carry."""
    kept = (~drop).tolist()
    for i, p in enumerate(skeleton.carrier.tolist()):
        kept[i] = kept[i] and (p < 0 or kept[p])
    limbs = np.array(kept)
    out = picked(skeleton, limbs)
    if "joints" in skeleton.__dict__ and "splines" in skeleton.__dict__:
        # those that stay run as before
        nodes = limbs[skeleton.limb]
        new = np.cumsum(nodes) - 1
        old, stay = skeleton.joints, limbs[skeleton.joints.limb]
        joints = old._replace(**{k: v[stay] for k, v in old._asdict().items()})
        out.__dict__["splines"] = skeleton.splines.picked(nodes, out.first)
        out.__dict__["joints"] = joints._replace(
            limb=(np.cumsum(limbs) - 1)[joints.limb], interval=new[joints.interval]
        )
    return out
