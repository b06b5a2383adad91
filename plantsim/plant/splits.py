"""Where stems split into clones, and how far the parts turn from each other."""

from dataclasses import dataclass

import numpy as np

from plantsim.arrays import Array
from plantsim.errors import GeometryError
from plantsim.plant.frames import (
    Frames,
    about_vertical,
    about_x,
    about_y,
    declination,
)
from plantsim.plant.parameters import LEVELS, WeberPenn

MOST = 200_000  # stems of a level: more is a slip in seg_splits or branches


@dataclass(eq=False)
class Splits:
    """Where the stems of a level split: a walk along them one after another."""

    model: WeberPenn
    rng: np.random.Generator
    level: int
    segments: int

    def __post_init__(self) -> None:
        self.start: list[int] = []
        self.origin: list[int] = []
        self.number: list[int] = []  # which clone of its split
        self.count: list[int] = []  # how many clones its split makes
        self.share: list[list[float]] = []
        self.error = 0.0
        m, n = self.model, min(self.level, LEVELS - 1)
        self.rate = m.seg_splits[n]
        self.first = int(np.ceil(m.bare[0] * max(1, int(m.curve_res[0]))))
        self.based = self.level == 0 and m.base_splits > 0

    def add(self, start: int, origin: int, number: int, count: int) -> int:
        """Note a stem and return its row; `number` of `count` clones of its split."""
        self.start.append(start)
        self.origin.append(origin)
        self.number.append(number)
        self.count.append(count)
        self.share.append([1.0] * self.segments)
        if len(self.start) > MOST:
            raise GeometryError(
                f"level {self.level} grows more than {MOST} stems: seg_splits "
                f"{self.rate} over {self.segments} segments is too much. Lower it."
            )
        return len(self.start) - 1

    def walk(self, row: int, start: int, chance: float, factor: float) -> None:
        """Split a stem along its segments; error diffusion carries fractions on."""
        m, share, last = self.model, self.share[row], self.segments
        gain = factor if m.published else factor * (1 - start / last)
        quick = m.published and self.level > 0
        s = start
        while s < last:
            s += 1
            if quick:  # straight on to the next segment that splits
                idle = last - s
                if self.rate > 0:
                    idle = int(min(idle, (1 - 1e-9 - self.error) / self.rate))
                share[s - 1 : s - 1 + idle] = [gain] * idle
                self.error += idle * self.rate
                s += idle
            clones = 0
            base = self.based and s == self.first
            if base:
                clones = int(m.base_splits)
            elif (
                self.rate > 0
                and s < last
                and (self.level > 0 or s > self.first)
                and (m.published or self.rng.random() <= chance)
            ):
                clones = int(self.rate + self.error + 1e-9)
                self.error -= clones - self.rate
                if not m.published:  # the program splits ever more rarely
                    chance /= clones + 1
                    factor = max(0.8, factor / (clones + 1))
                    gain *= factor
            share[s - 1] = gain
            if clones and m.published:  # together they carry nBranches children
                gain = factor = gain / (clones + 1)
            if clones and s < last:
                for j in range(clones):
                    clone = self.add(s, row, j, -clones if base else clones)
                    self.walk(clone, s, chance, factor)


@dataclass(frozen=True, eq=False)
class Clones:
    """Of every stem of a level, which clone of its split it is; c stems in all."""

    number: Array  # (c,) among the clones of its split
    count: Array  # (c,) clones of the split, negative for a split at the base

    def picked(self, rows: Array) -> "Clones":
        """Return those of some stems."""
        return Clones(self.number[rows], self.count[rows])


def turned_by_split(
    m: WeberPenn,
    n: int,
    now: Frames,
    rows: Array,
    clones: Array,
    split: Clones,
    noise: Array,
    of: Array,
) -> tuple[Frames, Frames, Array]:
    """Return the frames of splitting stems and of their clones, and the tilts [degrees].

    `now`: frames of all stems; `rows`, sorted, split and `clones` begin; `of`: the stem
    that each splits from; `noise` (4, all) uniform in -1 .. 1.
    """
    origin = np.searchsorted(rows, of[clones])  # among those that split
    number, count = split.number[clones], split.count[clones]
    base = count < 0
    many = np.zeros(len(rows), dtype=int)
    many[origin] = np.abs(count)
    direct = m.split_angle[n] < 0
    stems, own = now.picked(rows), noise[:, rows]
    lean = declination(stems.z)
    tilt = np.maximum(0.0, m.split_angle[n] + own[0] * m.split_angle_v[n] - lean)
    spread = 20 + 0.75 * (30 + np.abs(lean - 90) * ((own[1] + 1) / 2) ** 2)
    if direct:  # in the plane of the stem, by the program
        tilt = np.zeros_like(tilt)
        spread = np.abs(m.split_angle[n]) + own[0] * m.split_angle_v[n]
    share = 1.0 if m.published else 0.5  # the program halves tilt and spread
    side = np.where(number % 2 == 0, -1.0, 1.0)
    if m.published:  # one clone goes to either side by chance
        side = side * np.where(own[2, origin] < 0, -1.0, 1.0)
    turn = side * spread[origin] * (share if not direct else 0.5)
    ring = (number + 1) * 360 / (many[origin] + 1) + noise[3, clones] * m.split_angle_v[n]
    turn = np.where(base, ring, turn)
    old = about_x(stems, np.radians(share * tilt))
    clone = old.picked(origin)
    alone = np.zeros(len(many), dtype=bool)
    alone[origin[~base]] = True
    alone &= many == 1
    back = np.where(alone, spread / 2, 0.0)
    if direct:
        return (
            about_y(old, np.radians(back)),
            about_y(clone, np.radians(turn)),
            tilt,
        )
    if m.published:
        back = np.zeros_like(back)
    return (
        about_vertical(old, np.radians(back)),
        about_vertical(clone, np.radians(turn)),
        tilt,
    )
