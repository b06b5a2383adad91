"""All stems of one level of the tree model: where they split, how they run, how thick.

The stems of a level walk together, one segment after the other, as arrays. The number of
random draws depends on the number of stems only, so a tree is a function of its seed.
Names in comments are those of Weber and Penn 1995; "the program" is tree-gen.
"""

from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from plantsim.arrays import Array
from plantsim.plant.frames import (
    Frames,
    about_x,
    about_y,
    about_z,
    declination,
    towards,
)
from plantsim.plant.parameters import LEVELS, WeberPenn
from plantsim.plant.profile import shape_ratio
from plantsim.plant.splits import Clones, Splits, turned_by_split

HELIX = 6  # points that follow half a turn of a helix


@dataclass(frozen=True, eq=False)
class Helix:
    """Stems wound round straight axes, half a turn a segment, beginning at their foot."""

    foot: Array  # (m, 3) [m]
    frames: Frames  # z along the axis of each helix
    rise: Array  # (m,) along the axis, a segment [m]
    radius: Array  # (m,) of the helix [m]
    phase: Array  # (m,)

    def at(self, row: Array, t: Array) -> tuple[Array, Array]:
        """Return points and tangents (.., 3) at t in segments from the foot."""
        x, y, z = (v[row] for v in (self.frames.x, self.frames.y, self.frames.z))
        begin, turn = self.phase[row], self.phase[row] + np.pi * t
        r, rise = self.radius[row], self.rise[row]
        points = (
            self.foot[row]
            + (r * (np.cos(turn) - np.cos(begin)))[..., None] * x
            + (r * (np.sin(turn) - np.sin(begin)))[..., None] * y
            + (rise * t)[..., None] * z
        )
        way = (
            (-r * np.pi * np.sin(turn))[..., None] * x
            + (r * np.pi * np.cos(turn))[..., None] * y
            + rise[..., None] * z
        )
        return points, way / np.sqrt(np.einsum("...i,...i->...", way, way))[..., None]


@dataclass(frozen=True, eq=False)
class Stems:
    """The stems of one level, m of them; a clone is a stem that begins at a split."""

    level: int
    segments: int  # of a whole stem
    parent: Array  # (m,) row in the level above; -1 for trunks
    offset: Array  # (m,) where a stem sits on its parent [m]
    whole: Array  # (m,) length [m] of the whole stem, which clones have too
    size: Array  # (m,) radius [m] at the foot of the whole stem
    free: Array  # (m,) that radius were it not capped at the parent's
    longest: Array  # (m,) children's length as a share of this one's
    start: Array  # (m,) int, segment at which a clone begins; 0 for the others
    origin: Array  # (m,) row of the stem that a clone splits from, else -1
    share: Array  # (m, segments) factor of the number of children, by segment
    base: Array  # (m,) bare length [m] of the trunk that a stem belongs to
    height: Array  # (m,) size of the tree (Scale as drawn) [m]
    nodes: Array  # (m, segments + 1, 3) ends of segments [m], void before `start`
    bend: Array  # (m, segments + 1, 3) second derivative of the curve through them
    side: Array  # (m, segments, 3) local y of each segment
    helix: Helix | None = None
    spared: int = 0  # stems of this level that got no course, see `grow_level`
    stretch: float = 1.0  # of the whole tree's heights (ZScale); the trunks'

    def at(self, row: Array, t: Array) -> tuple[Array, Array]:
        """Return points and tangents (.., 3) of stems at t in segments from the foot."""
        if self.helix is not None:
            return self.helix.at(row, t)
        s = np.clip(t.astype(int), self.start[row], self.segments - 1)
        b = (t - s)[..., None]
        a = 1 - b
        p, q = self.nodes[row, s], self.nodes[row, s + 1]
        u, v = self.bend[row, s], self.bend[row, s + 1]
        points = a * p + b * q + (a * a * a - a) / 6 * u + (b * b * b - b) / 6 * v
        way = q - p - (3 * a * a - 1) / 6 * u + (3 * b * b - 1) / 6 * v
        size = np.sqrt(np.einsum("...i,...i->...", way, way))
        return points, way / np.maximum(size, 1e-12)[..., None]


def grow_level(
    m: WeberPenn,
    rng: np.random.Generator,
    level: int,
    start: Array,
    frames: Frames,
    seed: Stems,
    wanted: Array | None = None,
) -> Stems:
    """Return the stems of a level from where they begin.

    `start` (m, 3) [m] and `frames` (m): feet and first directions. `seed`: the stems with
    everything but splits and nodes. `wanted`: a mask of stems that are worth a course, for
    a level that bears no other; the others and their clones are left out, but the random
    draws are the same.
    """
    n = min(level, LEVELS - 1)
    segments = max(1, int(m.curve_res[n]))
    many = len(start)
    split, rows = _split(m, rng, level, many, segments)
    clones = Clones(np.array(split.number), np.array(split.count)) if split else None
    stems = replace(
        seed,
        segments=segments,
        parent=seed.parent[rows],
        offset=seed.offset[rows],
        whole=seed.whole[rows],
        size=seed.size[rows],
        free=seed.free[rows],
        longest=seed.longest[rows],
        base=seed.base[rows],
        height=seed.height[rows],
        start=np.array(split.start) if split else np.zeros(many, dtype=int),
        origin=np.array(split.origin) if split else np.full(many, -1),
        share=np.array(split.share) if split else np.ones((many, segments)),
    )
    if m.curve_v[n] < 0:
        return _wound(m, rng, stems, start, frames)
    noise = rng.uniform(-1, 1, (4, len(rows), segments))
    if wanted is not None:
        keep = wanted[rows]
        stems = replace(stems, side=stems.share, spared=int((~keep).sum()))
        stems = picked_stems(stems, keep, np.cumsum(keep) - 1)
        start, frames, noise = start[wanted], frames.picked(wanted), noise[:, keep]
        clones = clones.picked(keep) if clones else None
        many, rows = len(start), rows[keep]
    ways = _directions(m, noise, stems, frames, clones)
    stems = replace(stems, side=ways.y)
    keep = np.ones(len(rows), dtype=bool)
    if m.prune_ratio > 0:
        reach = np.cumsum(ways.z[stems.origin < 0], axis=1) / segments
        if level == 0 and not m.published:
            reach = _other_course(m, rng, seed, frames, segments)
        reach = reach[:, -1:] if _tip_alone(m, level) else reach
        stems, keep, _ = _fitted(m, stems, start, reach)
    if not keep.all():
        stems = picked_stems(stems, keep, np.cumsum(keep) - 1)
        ways = ways.picked(keep)
        start = start[keep[:many]]
    return _placed(stems, start, ways.z)


def picked_stems(stems: Stems, keep: Array, new: Array, up: Array | None = None) -> Stems:
    """Return the stems in a mask; `new` and `up`: new rows of origins and of parents."""
    names = ["parent", "offset", "whole", "size", "free", "longest", "base", "height"]
    names += [
        "start",
        "origin",
        "share",
        "side",
        *(("nodes", "bend") if stems.nodes.size else ()),
    ]
    values: dict[str, Any] = {k: getattr(stems, k)[keep] for k in names}
    values["origin"] = np.where(values["origin"] < 0, -1, new[values["origin"]])
    if up is not None:
        values["parent"] = np.where(values["parent"] < 0, -1, up[values["parent"]])
    if stems.helix is not None:
        h = stems.helix
        values["helix"] = Helix(
            h.foot[keep], h.frames.picked(keep), h.rise[keep], h.radius[keep], h.phase[keep]
        )
    return replace(stems, **values)


def _directions(
    m: WeberPenn,
    noise: Array,
    stems: Stems,
    frames: Frames,
    split: Clones | None,
) -> Frames:
    """Return the frame of every segment, (rows, segments, 3) each of x, y, z."""
    n, segments, total = min(stems.level, LEVELS - 1), stems.segments, len(stems.start)
    # the stems last in memory: long inner loops
    out = Frames(np.moveaxis(np.zeros((segments, 3, 3, total)), -1, 0))
    now = Frames(np.moveaxis(np.zeros((3, 3, total)), -1, 0))
    now.put(np.arange(len(frames.z)), frames)
    give_back = np.zeros(total)  # degrees a segment that undo the splits
    out.put((slice(None), 0), now)  # what has not begun is void and stays so when turned
    for s in range(1, segments):
        clones = np.flatnonzero(stems.start == s)
        angle = m.curve[n] / segments
        if m.curve_back[n]:
            half = m.curve[n] if s < segments / 2 else m.curve_back[n]
            angle = half / (segments / 2)
        turn = angle + noise[0, :, s] * m.curve_v[n] / segments - give_back
        f = now
        if m.bend_v[n]:
            f = about_y(f, -np.radians(noise[1, :, s] * m.bend_v[n] / segments))
        f = about_x(f, np.radians(turn))
        new: Frames | None = None
        if split is not None and len(clones):
            origin = stems.origin[clones]
            rows = np.unique(origin)
            old, new, tilt = turned_by_split(
                m, n, now, rows, clones, split, noise[:, :, s], stems.origin
            )
            give_back[rows] = tilt / (segments + 1 - s)
            give_back[clones] = give_back[origin]
            f.put(rows, old)
        now = _attracted(m, stems.level, segments, f)
        if new is not None:
            now.put(clones, new)
        out.put((slice(None), s), now)
    return out


def _attracted(m: WeberPenn, level: int, segments: int, f: Frames) -> Frames:
    """Turn frames up (or as tropism says) by one segment's share."""
    if m.published and m.tropism is None:
        if level < 2 or m.attraction_up == 0:
            return f
        up = m.attraction_up * np.radians(declination(f.z)) * f.y[..., 2] / segments
        return about_x(f, -up)
    pull = np.array(m.tropism if m.tropism is not None else (0.0, 0.0, m.attraction_up))
    if level < 2:
        pull[2] = 0.0
    return towards(f, pull, np.radians(10.0)) if pull.any() else f


def _split(
    m: WeberPenn, rng: np.random.Generator, level: int, many: int, segments: int
) -> tuple[Splits | None, Array]:
    """Return where stems split, and of all, clones last, the row of the one they are of."""
    n = min(level, LEVELS - 1)
    never = m.seg_splits[n] == 0 and (level > 0 or m.base_splits <= 0)
    if m.curve_v[n] < 0 or never:
        return None, np.arange(many)
    split = Splits(m, rng, level, segments)
    for _ in range(many):
        split.add(0, -1, 0, 0)
    for row in range(many):
        split.walk(row, 0, 1.0, 1.0)
    root = list(range(many))
    for origin in split.origin[many:]:
        root.append(root[origin])
    return split, np.array(root)


def _tip_alone(m: WeberPenn, level: int) -> bool:
    """Return whether only the tip must be inside the envelope: of trunks, bare below."""
    return level == 0 and m.bare[0] > 0


def _other_course(
    m: WeberPenn, rng: np.random.Generator, seed: Stems, frames: Frames, segments: int
) -> Array:
    """Return the ends of segments of trunks of length 1 m as the program tests them.

    It fits a trunk by other random numbers than it then grows it by, and with fewer splits
    at the base.
    """
    bases = int(rng.random() * (m.base_splits + 0.5)) if m.base_splits > 0 else 0
    many = len(seed.whole)
    other = m.with_(base_splits=bases, rules="tree-gen")
    split, rows = _split(other, rng, 0, many, segments)
    stems = replace(
        seed,
        segments=segments,
        start=np.array(split.start) if split else np.zeros(many, dtype=int),
        origin=np.array(split.origin) if split else np.full(many, -1),
    )
    clones = Clones(np.array(split.number), np.array(split.count)) if split else None
    noise = rng.uniform(-1, 1, (4, len(rows), segments))
    ways = _directions(other, noise, stems, frames, clones).z[:many]
    return np.cumsum(ways, axis=1) / segments


def _fitted(
    m: WeberPenn, stems: Stems, start: Array, reach: Array
) -> tuple[Stems, Array, Array]:
    """Shorten stems to the pruning envelope: (stems, a mask of those that stay, factors).

    `reach` (own, k, 3): points that must be inside, from the feet `start` (own, 3) [m] of
    stems that are not clones, for a stem of length 1 m.
    """
    own = np.flatnonzero(stems.origin < 0)
    factor = np.ones(len(own))
    step = 0.9 if not m.published else 0.95
    open_ = np.ones(len(own), dtype=bool)
    least = 0.15 if not m.published else 0.02
    trial = step ** np.arange(8)  # so many lengths at a time
    while open_.any():
        i = np.flatnonzero(open_)
        sizes = factor[i, None] * trial
        long = (sizes * stems.whole[own[i], None])[..., None]
        foot, way = start[own[i]], reach[i]
        x, y, z = (foot[:, k, None, None] + way[:, None, :, k] * long for k in range(3))
        tall = stems.height[own[i], None, None]
        q = (tall - z) / (tall * (1 - m.bare[0]))
        out = np.hypot(x, y) / tall
        good = (out < m.prune_width * shape_ratio(8, q, m)).all(axis=-1)
        good |= sizes < least
        fits = good.any(axis=1)
        factor[i] = np.where(
            fits, sizes[np.arange(len(i)), good.argmax(axis=1)], sizes[:, -1] * step
        )
        open_[i[fits]] = False
    factor[factor < least] = 0.0
    length = 1 - m.prune_ratio + m.prune_ratio * factor
    # clones have the fitted length of the stem that they split from
    root = list(range(len(stems.origin)))
    for i, up in enumerate(stems.origin.tolist()):
        root[i] = i if up < 0 else root[up]
    scale = length[root]
    power = 1.0 if stems.level == 0 else m.ratio_power
    with np.errstate(divide="ignore"):
        thick = stems.free * scale**power
    thick = thick if m.published or stems.level == 0 else np.maximum(thick, 0.005)
    size = np.minimum(thick, stems.size)
    return replace(stems, whole=stems.whole * scale, size=size), scale > 1e-3, scale


def _placed(stems: Stems, start: Array, ways: Array) -> Stems:
    """Return the stems with nodes and the natural spline through them."""
    segments, total = stems.segments, len(stems.start)
    step = ways * (stems.whole / segments)[:, None, None]
    nodes = np.zeros((total, segments + 1, 3))
    bend = np.zeros_like(nodes)
    for s in np.unique(stems.start):
        rows = np.flatnonzero(stems.start == s)
        clones = stems.origin[rows] >= 0
        foot = np.where(
            clones[:, None], nodes[stems.origin[rows], s], start[np.where(clones, 0, rows)]
        )
        nodes[rows, s] = foot
        nodes[rows, s + 1 :] = foot[:, None] + np.cumsum(step[rows, s:], axis=1)
        bend[rows, s:] = _second(segments - s) @ nodes[rows, s:]
    return replace(stems, nodes=nodes, bend=bend)


def _wound(
    m: WeberPenn, rng: np.random.Generator, stems: Stems, start: Array, frames: Frames
) -> Stems:
    """Return stems wound to helices whose declination from the axis is |CurveV|."""
    angle = np.radians(abs(m.curve_v[min(stems.level, LEVELS - 1)]))
    step = stems.whole / stems.segments
    frames = _attracted(m, stems.level, stems.segments, frames)

    def helix_of(noise: Array) -> Helix:
        if m.published:  # arc length is the stem's length
            rise = step * np.cos(angle)
            radius = step * np.sin(angle) / np.pi
        else:  # the program's axis has the stem's length, and its radius is approximate
            rise = step * (0.8 + 0.4 * noise[0])
            radius = 6 * rise * np.tan(angle) / 16 * (0.8 + 0.4 * noise[1])
        return Helix(start, frames, rise, radius, 2 * np.pi * noise[2])

    helix = helix_of(rng.random((3, len(start))))
    keep = np.ones(len(start), dtype=bool)
    if m.prune_ratio > 0:
        tip = not m.published or _tip_alone(m, stems.level)  # the program asks no more
        ends = np.arange(stems.segments if tip else 1.0, stems.segments + 1)
        t = np.broadcast_to(ends, (len(start), len(ends)))
        # a trunk is fitted by other random numbers there, see _other_course
        other = stems.level == 0 and not m.published
        fitted = helix_of(rng.random((3, len(start)))) if other else helix
        points, _ = fitted.at(np.arange(len(start))[:, None].repeat(len(ends), axis=1), t)
        reach = (points - start[:, None]) / stems.whole[:, None, None]
        stems, keep, scale = _fitted(m, stems, start, reach)
        helix = replace(helix, rise=helix.rise * scale, radius=helix.radius * scale)
    out = replace(
        stems,
        helix=helix,
        side=np.repeat(frames.y[:, None], stems.segments, axis=1),
        nodes=np.zeros((len(start), 0, 3)),
        bend=np.zeros((len(start), 0, 3)),
    )
    return out if keep.all() else picked_stems(out, keep, np.cumsum(keep) - 1)


@cache
def _second(segments: int) -> Array:
    """Return the matrix from segments + 1 nodes to the spline's second derivatives."""
    if segments < 2:
        return np.zeros((segments + 1, segments + 1))
    grid = np.arange(segments + 1.0)
    return CubicSpline(grid, np.eye(segments + 1), bc_type="natural")(grid, 2)


def rolled(frames: Frames, azimuth: Array, down: Array) -> Frames:
    """Return frames turned about their z and then tipped down, both in degrees."""
    return about_x(about_z(frames, np.radians(azimuth)), np.radians(down))
