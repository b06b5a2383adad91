"""Statics: loads gathered on a model, and the equilibrium under them."""

import time
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import scipy.linalg
from scipy.spatial.transform import Rotation

from plantsim.arrays import Array, few
from plantsim.elastic.contact import Contact
from plantsim.elastic.equilibrium import Equilibrium
from plantsim.elastic.loads import Composite, Force, Gravity, Hold, Load, Move, ids_in
from plantsim.errors import ModelError
from plantsim.mesh.tetmesh import TetMesh
from plantsim.solve.stats import SolveStats

if TYPE_CHECKING:
    from plantsim.elastic.model import ElasticModel


@dataclass(eq=False)
class Acting:
    """All loads together."""

    displacement: Array  # (n, 3) [m] of the moved vertices, else 0
    force: Array  # (n, 3) [N]
    moved: Array  # (k,) ids, in the order given
    # vertex, direction (3,), displacement [m] of every direction that is held alone
    holds: list[tuple[int, Array, float]] = field(default_factory=list)
    patches: list[Array] = field(default_factory=list)  # ids of each load that moves
    # ids and forces (k, 3) [N] at rest of each load that turns with its vertices
    following: list[tuple[Array, Array]] = field(default_factory=list)

    def following_forces(self, mesh: TetMesh, u: Array) -> Array:
        """Return the forces that follow, (n, 3) [N], where displacements u have them."""
        out = np.zeros_like(mesh.points)
        for ids, f in self.following:
            x = mesh.points[ids]
            turn = motion(x, x + u[ids])[0]
            out[ids] += Rotation.from_rotvec(turn).apply(f.copy())
        return out


def motion(one: Array, other: Array) -> tuple[Array, Array, Array]:
    """Return the turn [rad] and both centres of the rigid motion nearest to one -> other.

    By singular values. Source: Kabsch 1976.
    """
    at, to = one.mean(axis=0), other.mean(axis=0)
    if len(one) < 3:
        return np.zeros(3), at, to
    U, s, Vt = np.linalg.svd((other - to).T @ (one - at))
    if s[1] <= 1e-9 * max(float(s[0]), 1e-300):  # in line: the turn about it is unknown
        return np.zeros(3), at, to
    U[:, 2] *= np.sign(np.linalg.det(U @ Vt))
    return Rotation.from_matrix(U @ Vt).as_rotvec(), at, to


def turning(one: Array, other: Array, force: Array) -> tuple[Array, Array]:
    """Return what a patch's small turn does to forces that follow it, and what turns it.

    (k, 3, 3) each: forces by the turn's component; the turn by each vertex's motion, its
    components in rows. The best turn's own derivative, of a patch that is strained too:
    with arms q at rest, turned, and b now, (sum q.b - sum q b^T) w = sum q x du.
    """
    turn, at, to = motion(one, other)
    turned = Rotation.from_rotvec(turn)
    now, arm = turned.apply(force.copy()), turned.apply(one - at)
    mixed = arm.T @ (other - to)
    inertia = np.trace(mixed) * np.eye(3) - (mixed + mixed.T) / 2
    effect = np.cross(np.eye(3)[None], now[:, None]).transpose(0, 2, 1)
    return effect, np.cross(arm[:, None], np.eye(3)[None]) @ np.linalg.inv(inertia)


def gathered(model: "ElasticModel", loads: Iterable[Load]) -> Acting:
    """Return the loads on the mesh's vertices; ModelError where they contradict."""
    mesh, fixed = model.mesh, model.fixed_ids
    out = Acting(
        np.zeros_like(mesh.points), np.zeros_like(mesh.points), np.zeros(0, dtype=np.int64)
    )
    waiting = list(loads)
    held = np.zeros(0, dtype=np.int64)
    while waiting:
        load = waiting.pop(0)
        if isinstance(load, Move):
            ids = ids_in(mesh, load.ids, "moved")
            _check(ids, fixed, np.append(out.moved, held))
            out.displacement[ids] = _fit(load.displacement, ids)
            out.moved = np.concatenate([out.moved, ids])
            out.patches.append(ids)
        elif isinstance(load, Hold):
            ids = ids_in(mesh, load.ids, "held")
            _check(ids, fixed, np.append(out.moved, held))
            held = np.append(held, ids)
            goal = load.directions @ load.displacement
            out.holds += [
                (int(v), way, float(g))
                for v in ids
                for way, g in zip(load.directions, goal, strict=True)
            ]
        elif isinstance(load, Force):
            ids = ids_in(mesh, load.ids, "force")
            share = max(len(ids), 1) if load.force.ndim == 1 else 1
            f = np.broadcast_to(_fit(load.force, ids) / share, (len(ids), 3))
            if load.follows:
                _check_patch(mesh.points[ids], ids)
                out.following.append((ids, f))
            else:
                out.force[ids] += f
        elif isinstance(load, Gravity):
            out.force += model.nodal_mass[:, None] * load.acceleration
        elif isinstance(load, Composite):
            waiting = [*load.parts(mesh), *waiting]
        else:
            raise ModelError(
                f"{load!r} is no load: give move(), hold(), force(), traction(), hang() or "
                "gravity()."
            )
    return out


def equilibrium(model: "ElasticModel", loads: Iterable[Load]) -> Equilibrium:
    """Return the equilibrium of a model under loads."""
    began = time.perf_counter()
    acting = gathered(model, loads)
    for ids, follower in acting.following:
        acting.force[ids] += follower
    held = np.union1d(model.fixed_ids, acting.moved)
    if len(acting.moved) and not acting.holds and model.columns_pay(held, acting.moved):
        u, (name, backend, unknowns, iterations, error) = _by_contact(model, acting)
        new = False
    else:
        u, (name, backend, unknowns, iterations, error), new = _by_factor(
            model, acting, held
        )
    f = acting.force
    # where a vertex is held, whatever K u asks for is external; elsewhere it is the load
    f[held] = model.internal(held, u)
    seconds = time.perf_counter() - began
    for array in (u, f):
        array.flags.writeable = False
    stats = SolveStats(name, backend, unknowns, iterations, error, seconds, new)
    moved = np.append(acting.moved, np.unique([v for v, _, _ in acting.holds]).astype(int))
    return Equilibrium(model, u, f, moved, stats)


Evidence = tuple[str, str, int, int, float]


def _by_factor(
    model: "ElasticModel", acting: Acting, held: Array
) -> tuple[Array, Evidence, bool]:
    """Return the displacement by the factor of the vertices that are not held."""
    u = acting.displacement.copy()
    free, factor, new = model.factor(held)
    b = acting.force[free].ravel()
    if len(acting.moved):
        at = np.sort(acting.moved)
        b = b - model.pattern.condense(model.stiffness, free, at) @ u[at].ravel()
    x, iterations, error = factor(b)
    worst = float(error)
    if acting.holds:
        ids, ways, goal = (np.array(part) for part in zip(*acting.holds, strict=True))
        place = np.searchsorted(free, ids)
        # multipliers: C K^-1 C^T lambda = goal - C K^-1 b, one column a held direction
        loads = np.zeros((len(b), len(ids)), order="F")
        rows = 3 * place[:, None] + np.arange(3)
        loads[rows, np.arange(len(ids))[:, None]] = ways
        response, more, errors = factor(loads)
        compliance = scipy.linalg.cho_factor(loads.T @ response)
        multiplier = np.zeros(len(ids))
        for _ in range(2):  # once more for what rounding left
            short = goal - (x.reshape(-1, 3)[place] * ways).sum(axis=1)
            more_force = scipy.linalg.cho_solve(compliance, short)
            multiplier += more_force
            x = x + response @ more_force
        np.add.at(acting.force, ids, multiplier[:, None] * ways)
        iterations, worst = max(iterations, more), max(worst, float(errors.max()))
    u[free] = x.reshape(-1, 3)
    return u, (factor.name, factor.backend, 3 * len(free), iterations, worst), new


def _by_contact(model: "ElasticModel", acting: Acting) -> tuple[Array, Evidence]:
    """Return the displacement by the forces that the moved vertices ask for."""
    free, factor = model.base_factor()
    contact = Contact(model, acting.moved)
    goal = acting.displacement[acting.moved]
    u = np.zeros_like(acting.displacement)
    short, f = goal, acting.force.copy()
    if acting.force.any():
        u[free] = factor(acting.force[free].ravel())[0].reshape(-1, 3)
        short = goal - u[acting.moved]
    f[acting.moved] += contact.force(short)
    u[free] = factor(f[free].ravel())[0].reshape(-1, 3)
    u[acting.moved] = goal
    u = contact.balanced(u, acting.force)
    error, unknowns = contact.evidence(u, acting.force)
    backend = f"{factor.backend}; compliance of {len(acting.moved)} vertices"
    return u, (factor.name, backend, unknowns, 0, error)


def _fit(rows: Array, ids: Array) -> Array:
    if rows.ndim == 2 and len(rows) != len(ids):
        raise ModelError(
            f"{len(rows)} rows for {len(ids)} vertices. Give one row a vertex."
        )
    return rows


def _check_patch(x: Array, ids: Array) -> None:
    spread = np.linalg.svd(x - x.mean(axis=0), compute_uv=False) if len(x) > 2 else [1, 0]
    if spread[1] <= 1e-6 * spread[0]:
        raise ModelError(
            f"a force that follows on {len(ids)} vertices in line (first ids: {few(ids)}), "
            "whose turn is unknown. Name three or more that are not in line."
        )


def _check(ids: Array, fixed: Array, moved: Array) -> None:
    both = np.intersect1d(ids, fixed)
    if both.size:
        raise ModelError(
            f"{both.size} vertices are both fixed and moved (first ids: {few(both)}). "
            "Leave them out of one."
        )
    twice = np.intersect1d(ids, moved)
    if twice.size:
        raise ModelError(
            f"{twice.size} vertices are moved twice (first ids: {few(twice)}). Move each "
            "once."
        )
