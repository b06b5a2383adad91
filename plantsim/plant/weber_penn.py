"""Procedural plants by the model of Weber and Penn: parameters -> Skeleton.

Source: J. Weber, J. Penn, "Creation and Rendering of Realistic Trees", SIGGRAPH 1995. What
the reference program tree-gen does otherwise stands in docs/plants.md and hangs on
`WeberPenn.rules`.
"""

from dataclasses import dataclass, replace

import numpy as np

from plantsim.arrays import Array, Random, generator, repeated
from plantsim.errors import GeometryError
from plantsim.plant.frames import Frames, about_x, about_y, about_z, on_tangent
from plantsim.plant.parameters import LEVELS, WeberPenn, species
from plantsim.plant.prepare import Forks, prepared
from plantsim.plant.profile import radius_at, shape_ratio
from plantsim.plant.sampled import THINNEST, joined
from plantsim.plant.skeleton import Skeleton
from plantsim.plant.splits import MOST
from plantsim.plant.stems import Stems, grow_level, picked_stems, rolled


def weber_penn(
    parameters: str | WeberPenn = "quaking_aspen",
    rng: Random = 7,
    levels: int | None = None,
    ready: bool = True,
    *,
    min_radius: float | None = None,
    max_limbs: int = 100,
    forks: Forks = "model",
) -> Skeleton:
    """Return a plant of the given species or parameters.

    `rng`: seed or Generator; the same seed gives the same plant. `levels` limits the
    recursion (1: trunk alone).

    With `ready` (default) the skeleton can be meshed, passes `check()`, and its `note` says
    what was left out: limbs are cut where they are thinner than `min_radius` [m] (default:
    2 % of the trunk, at least 0.5 mm), the `max_limbs` thickest stay, bends are eased until
    the tube clears itself, children start on their parents' axes, at most 0.85 as thick,
    and limbs that pass through others are dropped. `forks`: "model" for the radii of the
    model, "area" for areas that add up at every fork (da Vinci's rule).

    Without, it is everything the model grows, down to radii of 0.1 % of a stem's own.

    >>> weber_penn("quaking_aspen", rng=7).check()
    ()
    """
    model = species(parameters) if isinstance(parameters, str) else parameters
    if not isinstance(model, WeberPenn):
        raise GeometryError(
            f"parameters is {type(model).__name__}, wanted a species' name or a WeberPenn. "
            "Read a file with ps.WeberPenn.read(path)."
        )
    depth = model.levels if levels is None else levels
    if depth not in range(1, 9):
        raise GeometryError(
            f"levels is {levels!r}: give a whole number from 1 (trunk alone) to 8."
        )
    if not ready:
        return joined(model, grown(model, generator(rng), depth))
    floor = -1.0 if min_radius is None else min_radius
    stems = grown(model, generator(rng), depth, _Wanted(floor, 2 * max_limbs))
    known = sum(len(level.whole) for level in stems) + stems[-1].spared
    full = joined(model, _thick(stems, _Wanted(floor, 2 * max_limbs)))
    thin = max(5e-4, 0.02 * full.radius[0]) if min_radius is None else min_radius
    deeper = depth if len(stems) < depth and model.branches[min(len(stems), 3)] else 0
    return prepared(
        full, thin, max_limbs, forks, known, f"level {len(stems)}" if deeper else ""
    )


@dataclass(frozen=True)
class _Wanted:
    """Which stems a mesh will want, so that the others need no course."""

    min_radius: float  # m; below 0: 2 % of the trunk's
    most: int

    def floor(self, levels: list[Stems], *more: Array, spare: int = 1) -> float:
        """Return the radius [m] at its foot below which no stem will be wanted.

        `spare`: so many times as many, since pruning has yet to make some thinner.
        """
        sizes = np.concatenate([*(s.size for s in levels), *more])
        thin = self.min_radius
        thin = max(5e-4, 0.02 * float(levels[0].size[0])) if thin < 0 else thin
        most = spare * self.most
        if len(sizes) <= most:
            return thin
        return max(thin, float(np.partition(sizes, -most)[-most]))


def _thick(levels: list[Stems], wanted: _Wanted) -> list[Stems]:
    """Return the stems whose foot is thick enough, and those that carry them."""
    floor, out = wanted.floor(levels), []
    below = np.ones(1, dtype=bool)
    for stems in levels:
        keep = stems.size >= floor
        keep &= below[stems.parent] if stems.level else True
        stands = keep.tolist()
        for i, up in enumerate(stems.origin.tolist()):
            stands[i] = stands[i] and (up < 0 or stands[up])
        keep = np.array(stands)
        if not keep.any():
            break
        new = np.append(np.cumsum(keep) - 1, -1)
        lower = np.append(np.cumsum(below) - 1, -1) if stems.level else new
        out.append(picked_stems(stems, keep, new, lower))
        below = keep
    return out


def _bound(m: WeberPenn, stems: Stems) -> float:
    """Return a radius [m] that no child of these stems exceeds at its foot."""
    n = min(stems.level + 1, LEVELS - 1)
    size = m.radius_mod[n] * stems.size * stems.longest**m.ratio_power
    return float(
        np.minimum(size if m.published else np.maximum(size, 0.005), stems.size).max()
    )


def grown(
    m: WeberPenn, rng: np.random.Generator, levels: int, wanted: _Wanted | None = None
) -> list[Stems]:
    """Return the stems that the model grows, level by level.

    With `wanted`, a level that bears none of those ends the growth, and those of the last
    level that are not get no course; the others are as they are in the whole plant.
    """
    trunks = max(1, int(m.branches[0]))
    roll = rng.uniform(0, 2 * np.pi, trunks)
    girth = m.scale0 + m.scale0_v * rng.uniform(-1, 1, trunks)
    height = np.maximum(m.scale + m.scale_v * rng.uniform(-1, 1, trunks), 1e-3)
    length = height * (m.length[0] + m.length_v[0] * rng.uniform(-1, 1, trunks))
    thick = m.ratio * m.radius_mod[0] * girth
    start = _places(m, rng, trunks)
    eye = np.tile(np.eye(3), (trunks, 1, 1))
    seed = _seed(m, rng, 0, length, length * thick)
    # the crown begins at BaseSize of the tree; the program says of the trunk
    bare = m.bare[0] * (height if m.published else length)
    tall = m.z_scale + (m.z_scale_v * rng.uniform(-1, 1) if m.z_scale_v else 0.0)
    seed = replace(
        _with(seed, base=np.minimum(bare, 0.99 * length), height=height), stretch=tall
    )
    out = [grow_level(m, rng, 0, start, about_z(Frames(eye), roll), seed)]
    if not len(out[0].whole):
        raise GeometryError(
            f"the pruning envelope of prune_width {m.prune_width} leaves no trunk. Widen "
            "it, or lower prune_ratio below 1."
        )
    while len(out) < levels:
        if wanted is not None and _bound(m, out[-1]) < wanted.floor(out):
            break
        born = _children(m, rng, out[-1], out[-2] if len(out) > 1 else None)
        if born is None:
            break
        mask, seed = None, born[2]
        if wanted is not None:
            floor = wanted.floor(out, seed.size, spare=1 if m.prune_ratio == 0 else 2)
            last = len(out) + 1 == levels or _bound(m, seed) < floor
            mask = seed.size >= floor if last else None
        if mask is not None and not mask.any():
            break
        out.append(grow_level(m, rng, len(out), *born, mask))
        if mask is not None:
            break
    return out


def _seed(
    m: WeberPenn, rng: np.random.Generator, level: int, length: Array, radius: Array
) -> Stems:
    """Return stems that have sizes but no course yet."""
    n, many = min(level + 1, LEVELS - 1), len(length)
    longest = m.length[n] + m.length_v[n] * rng.uniform(-1, 1, many)
    none = np.zeros(many, dtype=int)
    void = np.zeros(0)
    return Stems(
        level, 1, none - 1, void, length, radius, radius, np.maximum(longest, 0.0), none,
        none - 1, void, void, void, void, void, void,
    )  # fmt: skip


def _with(stems: Stems, **values: Array) -> Stems:
    values.setdefault("offset", np.zeros(len(stems.whole)))
    return replace(stems, **values)


def _places(m: WeberPenn, rng: np.random.Generator, trunks: int) -> Array:
    """Return where trunks stand: one at the origin, several apart on a disc."""
    out = np.zeros((trunks, 3))
    if trunks == 1:
        return out
    apart = 2.5 * (m.scale + m.scale_v) * m.length[0] * m.ratio
    disc = np.sqrt((trunks - 1) / 2.5 * m.scale * m.ratio)
    for i in range(trunks):
        near, tries = True, 0
        while near:  # a wider disc when the first is full
            wide = disc * (1 + tries / 100)
            r, angle = wide * np.sqrt(rng.random()), 2 * np.pi * rng.random()
            out[i] = r * np.cos(angle), r * np.sin(angle), 0
            near = i > 0 and (np.linalg.norm(out[:i] - out[i], axis=1) < apart).any()
            tries += 1
    return out


def _counts(
    m: WeberPenn, rng: np.random.Generator, stems: Stems, above: Stems | None
) -> Array:
    """Return how many children each stem has on each segment, (rows, segments) int."""
    most = m.branches[min(stems.level + 1, LEVELS - 1)]
    rows = len(stems.whole)
    if above is None:
        number = np.full(rows, float(most))
        if not m.published:
            number *= rng.uniform(0.9, 1.1, rows)
    else:
        carrier = above.whole[stems.parent]
        if stems.level == 1:
            longest = np.maximum(above.longest[stems.parent], 1e-9)
            number = most * (0.2 + 0.8 * stems.whole / carrier / longest)
        else:
            number = most * (1 - 0.5 * stems.offset / carrier)
    number = number / (1 - m.bare[min(stems.level, LEVELS - 1)])
    rate = number[:, None] / stems.segments * stems.share
    rate[np.arange(stems.segments) < stems.start[:, None]] = 0.0
    # fractions are carried on from segment to segment
    return np.diff(np.floor(np.cumsum(rate, axis=1) + 1e-9), axis=1, prepend=0).astype(int)


def _children(
    m: WeberPenn, rng: np.random.Generator, stems: Stems, above: Stems | None
) -> tuple[Array, Frames, Stems] | None:
    """Return feet, first frames and sizes of the children of a level's stems."""
    level, segments = stems.level, stems.segments
    n, over = min(level + 1, LEVELS - 1), min(level, LEVELS - 1)
    first = rng.uniform(0, 360, len(stems.whole))
    if m.branches[n] < 0:
        row, t, azimuth = _fan(m, rng, n, stems)
    else:
        counts = _counts(m, rng, stems, above)
        if counts.sum() > MOST:
            raise GeometryError(
                f"level {level + 1} grows {counts.sum():,} stems, more than {MOST:,}. "
                f"Lower branches[{n}] = {m.branches[n]}, or seg_splits."
            )
        place = _whorls if m.branch_dist[n] > 1 else _single
        row, t, azimuth = place(m, n, stems, counts, first)
    noise = rng.uniform(-1, 1, (2, len(row)))
    whole = stems.whole[row]
    offset = t / segments * whole
    azimuth = azimuth + m.rotate_v[n] * noise[0] * np.where(azimuth < 0, -1, 1)
    down = np.full(len(row), float(m.down_angle[n]))
    if m.down_angle_v[n] >= 0:
        down += m.down_angle_v[n] * noise[1]
    else:
        q = (whole - offset) / (whole * (1 - m.bare[over]))
        down += m.down_angle_v[n] * (1 - 2 * shape_ratio(0, q))
        if not m.published:
            down += 0.1 * np.abs(down) * noise[1]
    if level == 0:
        q = np.clip((whole - offset) / (whole - stems.base[row]), 0, 1)
        length = whole * stems.longest[row] * shape_ratio(m.shape, q, m)
    else:
        length = stems.longest[row] * (whole - (0.6 if m.published else 0.7) * offset)
    length = np.maximum(length, 0.0)
    fan = m.branches[n] < 0
    limit = radius_at(m, level, stems.size[row], whole, offset / whole)
    if fan:  # the tip has no radius left to limit them
        limit = np.maximum(limit, 0.5 * stems.size[row])
    free = m.radius_mod[n] * stems.size[row] * (length / whole) ** m.ratio_power
    radius = np.minimum(free if m.published else np.maximum(free, 0.005), limit)
    keep = (length > 1e-4) & (radius > (THINNEST if m.published else 1e-4))
    if not keep.any():
        return None
    row, t, offset = row[keep], t[keep], offset[keep]
    azimuth, down = azimuth[keep], down[keep]
    start, tangent = stems.at(row, t)
    s = np.minimum(t.astype(int), segments - 1)
    frames = on_tangent(stems.side[row, s], tangent)
    if fan:
        frames = about_x(about_y(frames, np.radians(azimuth)), np.radians(down))
    else:
        frames = rolled(frames, azimuth, down)
    seed = _seed(m, rng, level + 1, length[keep], radius[keep])
    return (
        start,
        frames,
        _with(
            seed,
            parent=row,
            offset=offset,
            free=free[keep],
            base=stems.base[row],
            height=stems.height[row],
        ),
    )


def _single(
    m: WeberPenn, n: int, stems: Stems, counts: Array, first: Array
) -> tuple[Array, Array, Array]:
    """Place children one by one: (row, t in segments, azimuth in degrees)."""
    flat = counts.ravel()
    cell, k = repeated(flat)
    row, s = cell // stems.segments, cell % stems.segments
    shift = np.where(k % 2 == 1, m.branch_dist[n], 0.0)
    middle = 0.5 if m.published else 0.0
    t = s + np.clip((k + middle - shift) / flat[cell], 0, 1)
    keep = t / stems.segments > m.bare[min(stems.level, LEVELS - 1)]
    if m.published and stems.level == 0:
        keep = t / stems.segments * stems.whole[row] > stems.base[row]
    row, t = row[keep], t[keep]
    place = np.arange(len(row)) - np.searchsorted(row, row)  # among its siblings
    if m.rotate[n] >= 0:
        return row, t, first[row] + m.rotate[n] * (place + 1)
    return row, t, np.where(place % 2 == 0, 1.0, -1.0) * (180 + m.rotate[n])


def _whorls(
    m: WeberPenn, n: int, stems: Stems, counts: Array, first: Array
) -> tuple[Array, Array, Array]:
    """Place children in whorls of branch_dist + 1."""
    each = m.branch_dist[n] + 1
    whorls = (counts / each + 1e-9).astype(int).ravel()
    cell, w = repeated(whorls)
    row = cell // stems.segments
    t = cell % stems.segments + w / whorls[cell]
    turn = first[row] + m.rotate[n] * (np.arange(len(row)) - np.searchsorted(row, row))
    size = np.floor((w + 1) * each + 1e-9) - np.floor(w * each + 1e-9)
    size[t / stems.segments <= m.bare[min(stems.level, LEVELS - 1)]] = 0
    size = size.astype(int)
    pick, k = repeated(size)
    return row[pick], t[pick], turn[pick] + 360 * k / size[pick]


def _fan(
    m: WeberPenn, rng: np.random.Generator, n: int, stems: Stems
) -> tuple[Array, Array, Array]:
    """Place children side by side at the tip, spread over `rotate` degrees."""
    many = abs(m.branches[n]) / (1 - m.bare[min(stems.level, LEVELS - 1)])
    number = np.full(len(stems.whole), float(many))
    if stems.level == 0 and not m.published:
        number *= rng.uniform(0.9, 1.1, len(number))
    number = np.floor(number * stems.share[:, -1] + 1e-9).astype(int)
    row, k = repeated(number)
    last = number[row] - 1
    spread = m.rotate[n] * (k / np.maximum(last, 1) - 0.5 * (last > 0))
    return row, np.full(len(row), float(stems.segments)), spread
