"""Random trees for the meshing benchmark: as many limbs as wanted, none through another."""

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial import KDTree

import plantsim as ps
from plantsim.plant.limb import Polyline

THINNEST = 0.003  # m
CLEAR = 1.1  # least distance of two axes over the sum of their radii, away from joints


class Grown:
    """One limb that was grown: its nodes and a fine sampling of its spline."""

    def __init__(self, nodes: np.ndarray, radii: np.ndarray, parent: int, level: int):
        self.nodes, self.radii, self.parent, self.level = nodes, radii, parent, level
        step = np.linalg.norm(np.diff(nodes, axis=0), axis=1)
        self.length = float(step.sum())
        self.u = np.r_[0, np.cumsum(step)] / self.length
        self.axis = CubicSpline(self.u, nodes)
        fine = np.linspace(0, 1, 60)
        self.x, self.r = self.axis(fine), np.interp(fine, self.u, radii)
        self.tree = KDTree(self.x)
        self.low, self.high = self.x.min(axis=0), self.x.max(axis=0)
        self.children: list[tuple[float, float]] = []  # (fraction, radius)

    def hits(self, other: "Grown", beyond: float = 0.0) -> bool:
        """Whether this limb comes too near another, `beyond` its start."""
        room = CLEAR * (self.r[0] + other.r[0])
        if (self.low > other.high + room).any() or (self.high < other.low - room).any():
            return False
        mine = np.linalg.norm(self.x - self.x[0], axis=1) >= beyond
        d, j = other.tree.query(self.x[mine])
        return bool((d < CLEAR * (self.r[mine] + other.r[j])).any())


def wander(rng, start, way, length, bend, rise, segments):
    """Return nodes from `start`, each step turned at random and drawn upwards."""
    nodes = [start]
    for _ in range(segments):
        way = way + rng.normal(0, bend / np.sqrt(2 * segments), 3) + [0, 0, rise / segments]
        way = way / np.linalg.norm(way)
        nodes.append(nodes[-1] + length / segments * way)
    return np.array(nodes)


def random_tree(limbs: int, seed: int) -> ps.Skeleton:
    """Return a tree of `limbs` limbs on up to four levels, 3 m high.

    Where a level has no room for its share, the next one gets the rest.
    """
    rng = np.random.default_rng([limbs, seed])
    depth = 1 if limbs <= 10 else 2 if limbs <= 40 else 3
    height, foot = 3 * rng.uniform(0.85, 1.15), 0.09 * rng.uniform(0.8, 1.2)
    trunk = wander(rng, np.zeros(3), np.array([0, 0, 1.0]), height, 0.3, 0.3, 10)
    grown = [Grown(trunk, foot * np.linspace(1, 0.3, 11), -1, 0)]
    share = np.array([1, 2.5, 5.0])[:depth]
    wanted = np.maximum(1, np.round(share / share.sum() * (limbs - 1))).astype(int)
    wanted[-1] += limbs - 1 - wanted.sum()
    for level in range(1, depth + 1):
        count = wanted[level - 1] if level < depth else limbs - len(grown)
        parents = [i for i, g in enumerate(grown) if g.level == level - 1]
        weight = np.array([grown[i].length for i in parents])
        made = tries = 0
        while made < count:
            tries += 1
            if tries > 60 * count:
                if level == depth:
                    raise RuntimeError(f"no room for {limbs} limbs (seed {seed})")
                wanted[level] += count - made
                break
            which = int(rng.choice(parents, p=weight / weight.sum()))
            child = sprout(rng, grown[which], which, level)
            if child is None or any(
                child.hits(g, 4 * child.room if i == which else 0.0)
                for i, g in enumerate(grown)
            ):
                continue
            grown[which].children.append((child.fraction, child.radii[0]))
            grown.append(child)
            made += 1
    return ps.Skeleton.from_limbs(
        [Polyline(g.nodes, g.radii, g.parent, g.level) for g in grown]
    )


def sprout(rng, parent: Grown, which: int, level: int) -> Grown | None:
    """Return a child at a random place of a parent, None where there is no room."""
    at = rng.uniform(0.3 if level == 1 else 0.2, 0.95)
    thick = float(np.interp(at, parent.u, parent.radii))
    length = parent.length * rng.uniform(0.35, 0.6) * (1 - 0.5 * (at - 0.3))
    radius = parent.radii[0] * (length / parent.length) ** 1.25
    radius = min(0.75 * thick, max(radius, 2.3 * THINNEST))
    for place, r in parent.children:
        if abs(place - at) * parent.length < 1.6 * (r + radius):
            return None
    along = parent.axis(at, 1)
    along = along / np.linalg.norm(along)
    side = np.cross(along, rng.normal(size=3))
    side = side / np.linalg.norm(side)
    down = np.radians(np.clip(rng.normal(52, 10), 30, 80))
    way = np.cos(down) * along + np.sin(down) * side
    segments = 8 if level < 3 else 6
    nodes = wander(rng, parent.axis(at), way, length, 0.6, 0.25, segments)
    tip = max(0.3 * radius, min(1.4 * THINNEST, 0.7 * radius))
    child = Grown(nodes, radius * np.linspace(1, tip / radius, segments + 1), which, level)
    child.fraction, child.room = at, thick / np.sin(down)
    return child
