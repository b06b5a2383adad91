"""Observation: what a robot saw and felt in one touch; simulated, and its files."""

import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from plantsim.arrays import Array, Random, frozen, generator
from plantsim.cards import card
from plantsim.elastic.loads import Move
from plantsim.elastic.model import ElasticModel
from plantsim.errors import EstimateError, FileError
from plantsim.paths import existing, replacing, writable

_FIELDS = ("moved", "move", "force", "seen", "displacement")


@dataclass(frozen=True, eq=False, repr=False)
class Observation:
    """One touch: vertices moved, the force that took, and the displacements that were seen.

    Noise is one standard deviation of each component; 0 means exact. Raises EstimateError
    for shapes that do not fit, repeated ids, and negative noise.
    """

    moved: Array  # (k,) ids of the vertices that the gripper moved
    move: Array  # (k, 3) their displacement [m]; (3,) for all alike
    force: Array  # (k, 3) external force on each [N]
    seen: Array  # (s,) ids of the vertices that the camera saw
    displacement: Array  # (s, 3) their displacement [m]
    force_noise: float = 0.0  # [N]
    displacement_noise: float = 0.0  # [m]

    def __post_init__(self) -> None:
        moved = self._fill("moved", (None,), np.int64)
        k = len(moved)
        if np.ndim(self.move) == 1 and np.size(self.move) == 3:
            object.__setattr__(self, "move", np.tile(np.asarray(self.move), (k, 1)))
        self._fill("move", (k, 3), float)
        self._fill("force", (k, 3), float)
        seen = self._fill("seen", (None,), np.int64)
        self._fill("displacement", (len(seen), 3), float)
        for name, ids in (("moved", moved), ("seen", seen)):
            if len(np.unique(ids)) < len(ids) or (ids < 0).any():
                raise EstimateError(
                    f"{name}: ids repeated or negative. Name each vertex once."
                )
        if k == 0:
            raise EstimateError(
                "an observation without a moved vertex. Touch at least one."
            )
        for name in ("force_noise", "displacement_noise"):
            noise = getattr(self, name)
            if not isinstance(noise, (int, float, np.number)) or not 0 <= noise < np.inf:
                raise EstimateError(f"{name} is {noise!r}; give one number, 0 or more.")

    def _fill(self, name: str, shape: tuple[int | None, ...], dtype: type) -> Array:
        raw = np.asarray(getattr(self, name))
        if dtype is np.int64 and raw.size == 0:
            raw = raw.astype(np.int64)
        value = frozen(raw, shape, dtype, name=name, error=EstimateError)
        object.__setattr__(self, name, value)
        return value

    _repr_html_ = card  # what a notebook shows

    def __repr__(self) -> str:
        total = np.linalg.norm(self.force.sum(axis=0))
        return (
            f"Observation({len(self.moved)} vertices moved by up to "
            f"{1000 * np.linalg.norm(self.move, axis=1).max():.3g} mm, {total:.3g} N in "
            f"all; {len(self.seen):,} vertices seen)"
        )


def observe(
    model: ElasticModel,
    touch: Move,
    *,
    seen: ArrayLike | str | None = None,
    displacement_noise: float = 0.0,
    force_noise: float = 0.0,
    rng: Random | None = None,
) -> Observation:
    """Return what a robot would see and feel when it moves vertices of this model.

    `seen`: the vertices whose displacement is seen (ids, mask or set), all where None. The
    noise [m, N] is normal, independent in every component; it needs an `rng`, and one
    Generator for all touches if they are to differ. The gripper knows its own motion.
    """
    if rng is None and (displacement_noise or force_noise):
        raise EstimateError("noise without rng. Pass one numpy Generator for all touches.")
    random = generator(0 if rng is None else rng)
    count = len(model.mesh.points)
    ids = np.arange(count) if seen is None else model.vertices(seen, "seen")
    state = model.solve(touch)
    u, f = state.displacement[ids], state.force[state.moved]
    return Observation(
        moved=state.moved,
        move=state.displacement[state.moved],
        force=f + force_noise * random.normal(size=f.shape),
        seen=ids,
        displacement=u + displacement_noise * random.normal(size=u.shape),
        force_noise=force_noise,
        displacement_noise=displacement_noise,
    )


def write_observations(
    observations: Iterable[Observation], path: str | os.PathLike[str]
) -> Path:
    """Write observations to an .npz file: arrays "0/moved", "0/move", ... in SI units."""
    path = writable(path, ".npz")
    arrays: dict[str, Any] = {"format": np.array("plantsim observations 1")}
    for i, seen in enumerate(observations):
        arrays |= {f"{i}/{name}": getattr(seen, name) for name in _FIELDS}
        arrays[f"{i}/noise"] = np.array([seen.force_noise, seen.displacement_noise])
    with replacing(path) as temporary, temporary.open("wb") as f:
        np.savez_compressed(f, **arrays)
    return path


def read_observations(path: str | os.PathLike[str]) -> tuple[Observation, ...]:
    """Return the observations in an .npz file; FileError if it is broken or foreign."""
    path = existing(path)
    try:
        with np.load(path, allow_pickle=False) as z:
            data = {name: z[name] for name in z.files}
        if str(data.pop("format")) != "plantsim observations 1":
            raise KeyError("format")
        count = len({name.split("/")[0] for name in data})
        return tuple(
            Observation(
                *(data[f"{i}/{name}"] for name in _FIELDS), *map(float, data[f"{i}/noise"])
            )
            for i in range(count)
        )
    except EstimateError as why:
        raise FileError(f"{path}: {why}") from None
    except Exception as why:  # zip, zlib, header, key and pickle errors
        raise FileError(
            f"{path}: not a file of observations ({why}). Write it with write_observations."
        ) from None
