"""From the courses of stems to a skeleton: nodes along them, radii, joints."""

import numpy as np

from plantsim.arrays import Array
from plantsim.plant.parameters import LEVELS, WeberPenn
from plantsim.plant.profile import radius_at
from plantsim.plant.skeleton import Skeleton
from plantsim.plant.stems import Stems

THINNEST = 1e-6  # m; where the model's radius vanishes


def joined(m: WeberPenn, levels: list[Stems]) -> Skeleton:
    """Return the skeleton of all stems: sampled curves, radii, joints."""
    points, radius, limb_of, joint, depth = [], [], [], [], []
    firsts: list[Array] = []  # of each level: first node of each stem
    grids: list[dict[int, Array]] = []
    limbs = nodes = 0
    for stems in levels:
        rows = len(stems.whole)
        grid = {int(s): _grid(m, stems, int(s)) for s in np.unique(stems.start)}
        size = np.array([len(grid[int(s)]) for s in stems.start])
        first = nodes + np.cumsum(size) - size
        stem = np.repeat(np.arange(rows), size)
        time = np.concatenate([grid[int(s)] for s in stems.start])
        p = stems.at(stem, time)[0]
        foot = stems.size[stem]
        thin = radius_at(m, stems.level, foot, stems.whole[stem], time / stems.segments)
        r = np.maximum(thin, np.maximum(1e-3 * foot, THINNEST))
        at = np.full(rows, -1)
        clones = np.flatnonzero(stems.origin >= 0)
        own = np.flatnonzero(stems.origin < 0)
        at[clones] = _node(
            first, grid, stems, stems.origin[clones], stems.start[clones].astype(float)
        )
        if stems.level:
            above = levels[stems.level - 1]
            up = stems.parent[own]
            t = stems.offset[own] / above.whole[up] * above.segments
            at[own] = _node(firsts[-1], grids[-1], above, up, t)
        points.append(p)
        radius.append(r)
        limb_of.append(np.repeat(limbs + np.arange(rows), size))
        back = np.arange(nodes - 1, nodes + len(p) - 1)
        back[first - nodes] = at
        joint.append(back)
        depth.append(np.full(rows, stems.level))
        firsts.append(first)
        grids.append(grid)
        limbs += rows
        nodes += len(p)
    place = np.concatenate(points) * [1.0, 1.0, levels[0].stretch]
    return Skeleton(
        np.round(place, 9),  # so that all machines agree
        np.round(np.concatenate(radius), 10),
        np.concatenate(joint),
        np.concatenate(limb_of),
        np.concatenate(depth),
    )


def _grid(m: WeberPenn, stems: Stems, start: int) -> Array:
    """Return where a stem's nodes are, in segments from the foot."""
    n, segments = min(stems.level, LEVELS - 1), stems.segments
    fine = 8 if stems.level < 2 else 4
    if m.taper[n] > 2:  # beads
        fine = 48
    each = max(2, -(-fine // segments)) if segments > 1 else fine
    each = 6 if stems.helix is not None else each
    t = np.linspace(start, segments, (segments - start) * each + 1)
    if stems.level == 0 and m.flare and start == 0:
        t = np.union1d(t, segments * np.array([1 / 64, 1 / 32, 1 / 16, 3 / 32, 1 / 8]))
    if 1 < m.taper[n] <= 2:  # a round tip
        t = np.union1d(t, segments - np.array([0.3, 0.1, 0.03]) / each)
    return t[np.append(True, np.diff(t) > 1e-6)]


def _node(
    first: Array, grid: dict[int, Array], stems: Stems, row: Array, t: Array
) -> Array:
    """Return the node at or before t of stems."""
    out = np.empty(len(row), dtype=int)
    for s, times in grid.items():
        pick = stems.start[row] == s
        i = np.searchsorted(times, t[pick] + 1e-9, side="right") - 1
        out[pick] = first[row[pick]] + np.clip(i, 0, len(times) - 1)
    return out
