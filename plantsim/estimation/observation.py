"""Observation: what a robot saw and felt in one touch; and its simulation."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from plantsim.arrays import Array, Random, frozen, generator
from plantsim.cards import card
from plantsim.elastic.equilibrium import Equilibrium
from plantsim.elastic.loads import Load, Move
from plantsim.elastic.model import ElasticModel
from plantsim.elastic.statics import gathered
from plantsim.errors import EstimateError, check_kind
from plantsim.mesh.tetmesh import TetMesh
from plantsim.touch.grasp import Grasp

_NOTHING: tuple[()] = ()


@dataclass(frozen=True, eq=False, repr=False)
class Observation:
    """One touch: vertices moved, the force that took, and the displacements that were seen.

    Displacements and forces count from the rest before the touch; `loaded` and `load` are
    forces that came with it, such as a weight hung on. The gripper feels the force on each
    moved vertex, or a `wrench` alone: force (3,), or force and torque about the mean of the
    moved vertices at rest (6,), or neither. Noise is one standard deviation, one for all or
    one an entry; 0 means exact. Raises EstimateError for shapes that do not fit, repeated
    ids, and negative noise.
    """

    moved: Array  # (k,) ids of the vertices that the gripper moved
    move: Array  # (k, 3) their displacement [m]; (3,) for all alike
    force: Array | None = None  # (k, 3) external force on each [N]
    seen: Array = _NOTHING  # type: ignore[assignment]  # (s,) ids that the camera saw
    displacement: Array = _NOTHING  # type: ignore[assignment]  # (s, 3) [m]
    force_noise: float | Array = 0.0  # [N], () or (k, 3)
    displacement_noise: float | Array = 0.0  # [m], (), (s,) or (s, 3)
    wrench: Array | None = None  # (3,) [N], or (6,) [N, N m]
    wrench_noise: float | Array = 0.0  # (), (3,) or (6,) [N, N m]
    loaded: Array = _NOTHING  # type: ignore[assignment]  # (l,) ids of loaded vertices
    load: Array = _NOTHING  # type: ignore[assignment]  # (l, 3) force on each [N]

    def __post_init__(self) -> None:
        moved = self._fill("moved", (None,), np.int64)
        k = len(moved)
        if np.ndim(self.move) == 1 and np.size(self.move) == 3:
            object.__setattr__(self, "move", np.tile(np.asarray(self.move), (k, 1)))
        self._fill("move", (k, 3))
        seen, loaded = (self._fill(n, (None,), np.int64) for n in ("seen", "loaded"))
        self._fill("displacement", (len(seen), 3))
        self._fill("load", (len(loaded), 3))
        if self.force is not None:
            self._fill("force", (k, 3))
        if self.wrench is not None:
            self._fill("wrench", (6 if np.size(self.wrench) == 6 else 3,))
        for name, ids in (("moved", moved), ("seen", seen), ("loaded", loaded)):
            if len(np.unique(ids)) < len(ids) or (ids < 0).any():
                raise EstimateError(
                    f"{name}: ids repeated or negative. Name each vertex once."
                )
        if k == 0 and not len(loaded):
            raise EstimateError(
                "an observation without a moved vertex or a load. Touch at least one."
            )
        if k == 0 and (self.force is not None or self.wrench is not None):
            raise EstimateError("a force without a moved vertex. Leave it out.")
        for name, of in (
            ("force", self.force),
            ("displacement", self.displacement),
            ("wrench", self.wrench),
        ):
            self._check_noise(f"{name}_noise", None if of is None else np.shape(of))

    def _fill(self, name: str, shape: tuple[int | None, ...], dtype: type = float) -> Array:
        raw = np.asarray(getattr(self, name))
        if raw.size == 0 and raw.ndim < len(shape):
            raw = np.zeros(tuple(n or 0 for n in shape))
        if dtype is np.int64 and raw.size == 0:
            raw = raw.astype(np.int64)
        value = frozen(raw, shape, dtype, name=name, error=EstimateError)
        object.__setattr__(self, name, value)
        return value

    def _check_noise(self, name: str, shape: tuple[int, ...] | None) -> None:
        noise = getattr(self, name)
        if np.ndim(noise) == 0:
            if not isinstance(noise, (int, float, np.number, np.ndarray)) or not (
                0 <= float(noise) < np.inf
            ):
                raise EstimateError(f"{name} is {noise!r}; give one number, 0 or more.")
            object.__setattr__(self, name, float(noise))
            return
        allowed = [] if shape is None else [shape, shape[:1]]
        if np.shape(noise) not in allowed:
            raise EstimateError(
                f"{name}: shape {np.shape(noise)}, wanted one number or "
                f"{' or '.join(map(str, dict.fromkeys(allowed)))}. Give one an entry."
            )
        value = frozen(noise, np.shape(noise), name=name, error=EstimateError)
        if (value < 0).any():
            raise EstimateError(f"{name}: {value.min():.3g}. Give 0 or more.")
        object.__setattr__(self, name, value)

    def noise_of(self, name: str) -> Array:
        """Return the noise of "force", "displacement" or "wrench" in the shape of it."""
        shape = np.shape(getattr(self, name))
        noise = np.asarray(getattr(self, f"{name}_noise"))
        if noise.ndim == 1 and len(shape) == 2:
            noise = noise[:, None]
        return np.broadcast_to(noise, shape)

    def plot(
        self, mesh: TetMesh, out: str | os.PathLike[str] = "touch.png", **options: Any
    ) -> Path:
        """Draw the touch on the mesh that it names vertices of, to a PNG; return its path.

        Options as of `ps.figure_touch`.
        """
        # a picture is the only call that goes up, through this one door
        from plantsim.view.figures import figure_touch  # noqa: PLC0415

        return figure_touch(mesh, self, out, **options)

    _repr_html_ = card  # what a notebook shows

    def __repr__(self) -> str:
        parts = []
        if len(self.moved):
            far = 1000 * np.linalg.norm(self.move, axis=1).max()
            parts.append(f"{len(self.moved)} vertices moved by up to {far:.3g} mm")
        if len(self.loaded):
            parts.append(f"{np.linalg.norm(self.load.sum(axis=0)):.3g} N hung on")
        if self.force is not None:
            parts.append(f"{np.linalg.norm(self.force.sum(axis=0)):.3g} N in all")
        elif self.wrench is not None:
            parts.append(f"{np.linalg.norm(self.wrench[:3]):.3g} N at the wrist")
        else:
            parts.append("no force felt")
        return f"Observation({', '.join(parts)}; {len(self.seen):,} vertices seen)"


def observe(
    model: ElasticModel,
    touch: Load | Grasp,
    *loads: Load,
    seen: ArrayLike | str | None = None,
    displacement_noise: float | Array = 0.0,
    force_noise: float | Array = 0.0,
    torque_noise: float | None = None,
    feels: str = "auto",
    rng: Random | None = None,
) -> Observation:
    """Return what a robot would see and feel when it touches this model.

    `touch`: `ps.move(...)`, whose forces are felt vertex by vertex; `ps.grasp(...)`, whose
    wrench alone is felt; or a load that is hung on. `loads` come with the touch. `seen`:
    the vertices whose displacement is seen (ids, mask or set; `ps.visible_vertices` tells
    what a camera sees), all where None, none where empty. The noise [m, N] is normal,
    independent in every component, of one standard deviation or one an entry as in
    `Observation`, and needs an `rng`; pass one Generator for all touches if they are to
    differ. A wrench has one; `torque_noise` [N m]: by default the force's times the patch's
    radius. `feels`: "forces", "wrench", "total" (force at the wrist), "nothing", or "auto"
    as above. The gripper knows its own motion.
    """
    check_kind(model, ElasticModel, "observe", EstimateError)
    if rng is None and any(
        np.any(noise) for noise in (displacement_noise, force_noise, torque_noise or 0)
    ):
        raise EstimateError("noise without rng. Pass one numpy Generator for all touches.")
    if feels == "auto":
        feels = "wrench" if isinstance(touch, Grasp) else "forces"
    if feels not in ("forces", "wrench", "total", "nothing"):
        raise EstimateError(
            f"feels is {feels!r}; give 'forces', 'wrench', 'total' or 'nothing'."
        )
    random = generator(0 if rng is None else rng)
    count = len(model.mesh.points)
    ids = np.arange(count)
    if seen is not None:
        ids = model.vertices(seen, "seen")
    state = model.solve(touch, *loads)
    acting = gathered(model, (touch, *loads))
    if acting.holds:
        raise EstimateError("a held vertex is no touch. Move it, or leave it free.")
    at = np.flatnonzero(acting.force.any(axis=1))
    u = state.displacement[ids]
    felt: dict[str, Any] = {}
    if len(state.moved) and feels == "forces":
        # an applied load is not felt by the gripper
        f = state.force[state.moved] - acting.force[state.moved]
        felt = {
            "force": f + _per_entry(force_noise, f) * random.normal(size=f.shape),
            "force_noise": force_noise,
        }
    elif len(state.moved) and feels != "nothing":
        size = 6 if feels == "wrench" else 3
        moved = state.displacement[state.moved]
        modes = wrench_modes(arms(model, state.moved, moved))[:, :size]
        w = modes.T @ (state.force - acting.force)[state.moved].ravel()
        if np.ndim(force_noise):
            raise EstimateError("one force_noise for each vertex, but a wrench is felt.")
        noise = np.full(size, float(force_noise))
        if size == 6:
            arm = np.sqrt((modes[:, 3:] ** 2).sum() / (2 * len(state.moved)))
            noise[3:] = force_noise * arm if torque_noise is None else torque_noise
        felt = {"wrench": w + noise * random.normal(size=size), "wrench_noise": noise}
    return Observation(
        moved=state.moved,
        move=state.displacement[state.moved],
        seen=ids,
        displacement=u + _per_entry(displacement_noise, u) * random.normal(size=u.shape),
        displacement_noise=displacement_noise,
        loaded=at,
        load=acting.force[at],
        **felt,
    )


def _per_entry(noise: float | Array, values: Array) -> Array:
    """Return standard deviations of (k, 3) values: (), (k,) and (k, 3) made (k, 3)."""
    given = np.asarray(noise, dtype=float)
    if given.shape not in ((), values.shape[:1], values.shape):
        raise EstimateError(
            f"noise of shape {given.shape} for values of shape {values.shape}. Give one "
            "number, one an entry, or one a vertex."
        )
    column = given[:, None] if given.ndim == 1 else given
    return np.broadcast_to(column, values.shape)


def arms(model: ElasticModel, ids: Array, move: Array) -> Array:
    """Return where moved vertices act, (k, 3) [m]: at rest in linear theory, else moved."""
    return model.mesh.points[ids] + (0 if model.kinematics == "linear" else move)


def wrench_modes(points: Array) -> Array:
    """Return (3k, 6): forces on points (k, 3) times its rows are force, and torque.

    The torque is about the mean of the points.
    """
    arm = points - points.mean(axis=0)
    shift = np.broadcast_to(np.eye(3), (len(arm), 3, 3))
    turn = np.stack([np.cross(axis, arm) for axis in np.eye(3)], axis=2)
    return np.concatenate([shift, turn], axis=2).reshape(-1, 6)


def as_move(touch: Any, model: ElasticModel) -> Move:
    """Return a touch (a Move, a Grasp, a Touch's last step) as one Move."""
    if isinstance(touch, Move):
        return touch
    if isinstance(touch, Grasp):
        return touch.parts(model.mesh)[0]
    if hasattr(touch, "last"):
        return touch.last
    raise EstimateError(f"{touch!r} is no touch: give ps.move(...) or ps.grasp(...).")


def moved_force(state: Equilibrium) -> Array:
    """Return the contact forces (k, 3) [N] of a state."""
    return state.force[state.moved]
