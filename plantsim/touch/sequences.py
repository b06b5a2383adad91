"""Touch sequences: where and how a plant is pushed, drawn at random."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from plantsim.arrays import Array, Random, frozen, generator
from plantsim.elastic.loads import Move
from plantsim.elastic.model import ElasticModel
from plantsim.errors import ModelError

TOUCHABLE = 0.85  # the paper's protocol: vertices above the lowest 15 % in z


@dataclass(frozen=True, eq=False)
class Touch:
    """One touch: vertices moved further and further, in steps."""

    ids: Array  # (k,)
    moves: Array  # (steps, k, 3) [m], the last the deepest

    def __len__(self) -> int:
        return len(self.moves)

    def __iter__(self) -> Iterator[Move]:
        """Yield the load of each step."""
        return (Move(self.ids, d) for d in self.moves)

    @property
    def last(self) -> Move:
        """The deepest step, as a load."""
        return Move(self.ids, self.moves[-1])


def sample_touches(
    model: ElasticModel,
    shots: int,
    *,
    vertices: int = 10,
    direction: ArrayLike | Literal["normal"] = (0.0, 0.0, -1.0),
    depth: float = 0.15,
    steps: int = 15,
    rng: Random,
) -> tuple[Touch, ...]:
    """Return random touches of a model's free vertices.

    The defaults are the paper's protocol: `vertices` among the upper 85 % by height, moved
    together along `direction` (3,), in even steps to `depth` [m]; fix the lowest 10 % with
    `lowest(mesh)`. With `direction="normal"` each vertex is a finger's, on the surface, and
    pushed inwards along its normal; `vertices=1` is a single finger.

    Raises ModelError where fewer vertices can be touched than are asked for.
    """
    random = generator(rng)
    mesh = model.mesh
    if shots < 1 or steps < 1 or vertices < 1 or not 0 < depth < np.inf:
        raise ModelError(
            f"{shots} shots of {vertices} vertices in {steps} steps to {depth} m; give at "
            "least 1 of each, and a positive depth."
        )
    if isinstance(direction, str) and direction != "normal":
        raise ModelError(f"direction {direction!r}; give 'normal' or three numbers.")
    z = mesh.points[:, 2]
    high = np.flatnonzero(z >= np.quantile(z, 1 - TOUCHABLE))
    if isinstance(direction, str):
        high = np.intersect1d(high, mesh.surface_vertices)
    pool = np.setdiff1d(high, model.fixed_ids)
    if len(pool) < vertices:
        raise ModelError(
            f"{vertices} vertices to touch, but only {len(pool)} can be. Ask for fewer, or "
            "fix fewer."
        )
    if isinstance(direction, str):
        inward = np.zeros_like(mesh.points)
        inward[mesh.surface_vertices] = -mesh.normals
    else:
        way = frozen(direction, (3,), name="direction", error=ModelError)
        size = float(np.linalg.norm(way))
        if not size:
            raise ModelError("direction is zero. Give one that points somewhere.")
        inward = np.broadcast_to(way / size, mesh.points.shape)
    reach = depth * np.arange(1, steps + 1) / steps
    out = []
    for _ in range(shots):
        ids = random.choice(pool, vertices, replace=False)
        moves = reach[:, None, None] * inward[ids]
        for array in (ids, moves):
            array.flags.writeable = False
        out.append(Touch(ids, moves))
    return tuple(out)


def lowest(mesh: object, share: float = 0.1) -> Array:
    """Return ids of the lowest `share` of a mesh's vertices by height, to be fixed."""
    points = np.asarray(getattr(mesh, "points", mesh))
    return np.argsort(points[:, 2], kind="stable")[: int(share * len(points))]
