"""A plant under a hand: take hold of its surface, drag, feel the force, keep the touch.

What the live viewer computes, without a page. Of linear kinematics everything is at frame
rate: fields of weight and fruit are solved for once, and a stiffness common to the whole
plant scales them, so that no slider costs a solve. Of corotational kinematics a frame is
the tangent's answer, and `correction` solves for balance when there is time.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from plantsim.arrays import Array, Random, generator
from plantsim.elastic.contact import Contact
from plantsim.elastic.equilibrium import Equilibrium
from plantsim.elastic.loads import STANDARD_GRAVITY, force
from plantsim.elastic.model import ElasticModel
from plantsim.elastic.near import NearContact
from plantsim.elastic.weight import Weight, gravity
from plantsim.errors import ModelError
from plantsim.estimation.observation import Observation
from plantsim.mesh.tetmesh import TetMesh
from plantsim.plant.hung import Masses
from plantsim.view.following import Following, relief

KINEMATICS = ("linear", "corotational")


@dataclass(frozen=True, eq=False)
class Frame:
    """One moment of a drag."""

    surface: Array  # (s, 3) [m] where the surface's vertices are
    centre: Array  # (3,) [m] where the hand is
    force: Array  # (3,) [N] that the hand exerts
    travel: float  # [m] how far the hand has gone from rest
    exact: bool = True  # else extended from an equilibrium nearby: balance is not solved


@dataclass(frozen=True, eq=False)
class Balance:
    """An equilibrium that a hand may go on from."""

    following: Following
    near: NearContact

    @property
    def whole(self) -> bool:
        """Whether the plant could be bent as far as was asked for."""
        return getattr(self.near.state.stats, "fraction", 1.0) >= 1


@dataclass(frozen=True, eq=False)
class Burden:
    """What a plant bears: its own weight times `gravity`, `fruit` [kg], and its stiffness.

    `stiffness` multiplies Young's modulus everywhere.
    """

    gravity: float = 0.0
    fruit: float = 0.0
    stiffness: float = 1.0


class Touching:
    """A model, what it bears, and a hand that may hold a patch of it."""

    def __init__(self, model: ElasticModel, masses: Masses | None = None) -> None:
        self.model, self.masses = model, masses
        self.burden = Burden()
        self.ids: Array = np.zeros(0, dtype=np.int64)
        self._contact: Contact | None = None
        self._rest: Equilibrium | None = None  # of the burden alone, where not linear
        self._following: Following | None = None  # of a hand, where not linear
        self._asked: tuple[Array, Array | None] = (np.zeros(3), None)  # shift, turn
        self._move: Array = np.zeros((0, 3))
        self._turns: Array = np.zeros((3, 3))  # of a linear hand [rad/m], a row a direction
        self._still: tuple[Burden, Array, Array] | None = None  # its sag, and the surface

    @property
    def mesh(self) -> TetMesh:
        """The mesh."""
        return self.model.mesh

    @property
    def linear(self) -> bool:
        """Whether frames superpose."""
        return self.model.kinematics == "linear"

    @cached_property
    def triangles(self) -> Array:
        """Flat triangles (k, 3) of the surface; entries are rows of a Frame's surface."""
        return np.searchsorted(self.mesh.surface_vertices, self.mesh.triangles)

    @cached_property
    def tet_of_triangle(self) -> Array:
        """The tet (k,) behind each triangle."""
        return np.tile(
            self.mesh.surface_tets, len(self.triangles) // len(self.mesh.surface)
        )

    @cached_property
    def _unmoved(self) -> Equilibrium:
        return self.model.solve()

    @cached_property
    def _weight(self) -> Array:
        """Field (n, 3) [m] of the plant's own weight."""
        return self.model.solve(gravity()).displacement

    @cached_property
    def _fruit(self) -> Array:
        """Field (n, 3) [m] of 1 kg of fruit: where the masses are, or at limbs' tips."""
        return self.model.solve(self._fruit_load(1.0)).displacement

    def _fruit_load(self, mass: float) -> Any:
        mesh = self.mesh
        if self.masses is not None and self.masses.total:
            scale = mass / self.masses.total
            down = np.array([0, 0, -STANDARD_GRAVITY])
            _, hung = Weight(down, self.masses).parts(mesh)
            return force(hung.ids, scale * hung.force)
        return force(limb_tips(mesh), (0, 0, -mass * STANDARD_GRAVITY))

    def bear(self, burden: Burden) -> Frame:
        """Return the frame under another burden; the hand stays where it is to the plant.

        The hand's motion is counted from where its patch rests under the burden.
        """
        if not 0 < burden.stiffness < np.inf or burden.fruit < 0:
            raise ModelError(
                f"stiffness {burden.stiffness}, fruit {burden.fruit} kg. Give a positive "
                "stiffness and no negative mass."
            )
        self.burden = burden
        if not self.linear:
            self._rest = self.model.solve(*self._loads(), start=self._rest)
            if len(self.ids):
                self._following = Following(self._rest, self._loads(), self.ids)
                self._move = self._following.goal(*self._asked)
        return self._frame()

    def sag(self) -> Array:
        """Return the displacement (n, 3) [m] under the burden alone."""
        b = self.burden
        if self.linear:
            field = np.zeros_like(self.mesh.points)
            if b.gravity:
                field = field + b.gravity / b.stiffness * self._weight
            if b.fruit:
                field = field + b.fruit / b.stiffness * self._fruit
            return field
        return self._resting().displacement

    def _sagged(self) -> tuple[Array, Array]:
        """Return the sag and where the surface is with it, kept while the burden is."""
        if self._still is None or self._still[0] is not self.burden:
            sag, on = self.sag(), self.mesh.surface_vertices
            self._still = self.burden, sag, self.mesh.points[on] + sag[on]
        return self._still[1:]

    def _resting(self) -> Equilibrium:
        if self._rest is None:
            self._rest = self.model.solve(*self._loads())
        return self._rest

    def _loads(self) -> list[Any]:
        """Return weight and fruit over the stiffness, which bend the bare model as much."""
        b = self.burden
        loads: list[Any] = []
        if b.gravity:
            loads.append(gravity((0, 0, -b.gravity / b.stiffness * STANDARD_GRAVITY)))
        if b.fruit:
            loads.append(self._fruit_load(b.fruit / b.stiffness))
        return loads

    def hold(self, ids: ArrayLike) -> Frame:
        """Take hold of vertices (k,), the hand at rest; return the frame."""
        found = self.model.vertices(ids, "hold")
        contact = following = None
        if self.linear:
            contact = self.model.contact(found)
            contact.surface_displacement((0, 0, 0))  # made at first use: now, not in a drag
            arm = self.mesh.points[found] - self.mesh.points[found].mean(axis=0)
            calm = np.zeros_like(arm)
            turns = [relief(arm, contact.stiffness, d, calm) for d in np.eye(3)]
            self._turns = np.stack(turns)
        else:
            following = Following(self._resting(), self._loads(), found)
        self.ids, self._contact, self._following = found, contact, following
        self._asked = np.zeros(3), None
        self._move = np.zeros((len(found), 3))
        if following is not None:
            self._move = following.rest.displacement[found]
        return self._frame()

    def let_go(self) -> Frame:
        """Open the hand; return the frame at rest."""
        self.ids = np.zeros(0, dtype=np.int64)
        self._contact = self._following = None
        self._move = np.zeros((0, 3))
        return self._frame()

    def drag(self, shift: ArrayLike, turn: ArrayLike | None = None) -> Frame:
        """Move the patch as a rigid body by `shift` [m].

        `turn`: a rotation vector [rad] about its middle; where None, it turns as the plant
        likes, so that the hand feels no torque.
        """
        if not len(self.ids):
            raise ModelError("nothing is held. Hold some vertices first.")
        d = np.asarray(shift, dtype=float)
        angle = None if turn is None else np.asarray(turn, dtype=float)
        self._asked = d, angle
        if self._following is not None:
            self._move = self._following.goal(d, angle)
            return self._frame()
        arm = self._arm
        if angle is None:
            self._move = d + np.cross(d @ self._turns, arm)
        else:
            self._move = Rotation.from_rotvec(angle).apply(arm) - arm + d
        return self._frame()

    def correction(self) -> Callable[[], Balance] | None:
        """Return what solves for balance, in any one thread, or None if nothing is off.

        Give what it returns to `correct`.
        """
        following, goal = self._following, self._move
        if following is None or following.met(goal):
            return None
        return lambda: Balance(following, following.solved(goal))

    def correct(self, balance: Balance) -> Frame:
        """Go on from a balance; return the frame. One of another hand changes nothing."""
        if balance.following is self._following:
            balance.following.take(balance.near)
            self._move = balance.following.goal(*self._asked)
        return self._frame()

    @property
    def _arm(self) -> Array:
        """From the patch's middle to its vertices at rest, (k, 3) [m]."""
        held = self.mesh.points[self.ids]
        return held - held.mean(axis=0)

    def _frame(self) -> Frame:
        mesh, on = self.mesh, self.mesh.surface_vertices
        sag, surface = self._sagged()
        following = self._following
        total, exact = np.zeros(3), True
        if self._contact is not None:
            surface = surface + self._contact.surface_displacement(self._move)
            total = self._contact.force(self._move).sum(axis=0)
        elif following is not None:
            surface = mesh.points[on] + following.surface(self._move)
            total = following.force(self._move).sum(axis=0)
            exact = following.met(self._move)
        if not len(self.ids):
            return Frame(surface, mesh.points[0] + sag[0], total, 0.0)
        shift = self._asked[0]
        at = (mesh.points[self.ids] + sag[self.ids]).mean(axis=0)
        far = float(np.linalg.norm(shift))
        return Frame(surface, at + shift, self.burden.stiffness * total, far, exact)

    def displacement(self) -> Array:
        """Return the whole displacement (n, 3) [m] of this moment."""
        if self._following is not None:
            return self._following.field(self._move)
        if self._contact is not None:
            return self.sag() + self._contact.displacement(self._move)
        return self.sag()

    def von_mises(self) -> Array:
        """Return the von Mises stress (m,) [Pa] of every tet, of the latest balance."""
        return self.burden.stiffness * self._equilibrium().von_mises

    def max_rotation(self) -> float:
        """Return the largest rotation [rad] of a tet, of the latest balance."""
        return self._equilibrium().max_rotation

    def _equilibrium(self) -> Equilibrium:
        if self.linear:
            return replace(self._unmoved, displacement=self.displacement())
        return self._following.state if self._following is not None else self._resting()

    def record(
        self,
        *,
        displacement_noise: float = 0.0,
        force_noise: float = 0.0,
        rng: Random = 0,
    ) -> Observation:
        """Return this touch as a robot would see and feel it, against the burdened rest.

        `force_noise` [N] on the sum over the patch, shared evenly, `displacement_noise`
        [m]: one standard deviation. Linear kinematics only, since estimation is linear.
        """
        if self._contact is None:
            raise ModelError(
                "no touch to record. Hold some vertices and drag them, with linear "
                "kinematics."
            )
        if not self._move.any():
            raise ModelError("the hand has not moved. Drag it first.")
        random = generator(rng)
        u = self._contact.displacement(self._move)
        f = self.burden.stiffness * self._contact.force(self._move)
        each = force_noise / np.sqrt(len(self.ids))
        return Observation(
            moved=self.ids,
            move=self._move,
            force=f + each * random.normal(size=f.shape),
            seen=np.arange(len(u)),
            displacement=u + displacement_noise * random.normal(size=u.shape),
            force_noise=each,
            displacement_noise=displacement_noise,
        )

    def patch(self, point: ArrayLike, surface: Array, count: int) -> Array:
        """Return `count` free surface vertices near a point (3,) [m] of a frame's surface.

        All of the limb that the nearest is on, so that a hand does not take hold of two.
        """
        mesh, on = self.mesh, self.mesh.surface_vertices
        hit = int(on[np.linalg.norm(surface - np.asarray(point), axis=1).argmin()])
        region = np.asarray(mesh.region)[(mesh.tets == hit).any(axis=1)]
        own = np.unique(mesh.tets[np.isin(np.asarray(mesh.region), region)])
        free = np.setdiff1d(np.intersect1d(on, own), self.model.fixed_ids)
        if not len(free):
            raise ModelError("this limb is fixed all over. Take hold of another.")
        far = np.linalg.norm(mesh.points[free] - mesh.points[hit], axis=1)
        return free[np.argsort(far, kind="stable")[:count]]


def limb_tips(mesh: TetMesh) -> Array:
    """Return for each region but the first the vertex farthest from where it begins."""
    region = np.asarray(mesh.region)
    tips = []
    seen = np.zeros(len(mesh.points), dtype=bool)
    for r in np.unique(region):
        ids = np.unique(mesh.tets[region == r])
        foot = ids[seen[ids]]
        start = mesh.points[foot].mean(axis=0) if len(foot) else None
        if start is None:  # the trunk: farthest from its lowest point
            start = mesh.points[ids[mesh.points[ids, 2].argmin()]]
        far = np.linalg.norm(mesh.points[ids] - start, axis=1)
        tips.append(int(ids[far.argmax()]))
        seen[ids] = True
    return np.unique(tips[1:] if len(tips) > 1 else tips)


def hit(origin: ArrayLike, way: ArrayLike, points: Array, triangles: Array) -> Array | None:
    """Return where a ray first meets triangles (k, 3) of points (s, 3), or None.

    Source: Moeller and Trumbore, Fast minimum storage ray-triangle intersection, 1997.
    """
    o, d = np.asarray(origin, dtype=float), np.asarray(way, dtype=float)
    a, b, c = (points[triangles[:, i]] for i in range(3))
    e, f = b - a, c - a
    p = np.cross(d, f)
    det = np.einsum("ij,ij->i", e, p)
    flat = np.abs(det) < 1e-300
    inverse = 1 / np.where(flat, 1, det)
    s = o - a
    u = np.einsum("ij,ij->i", s, p) * inverse
    q = np.cross(s, e)
    v = (q @ d) * inverse
    t = np.einsum("ij,ij->i", f, q) * inverse
    slack = 1e-9
    inside = ~flat & (u >= -slack) & (v >= -slack) & (u + v <= 1 + slack) & (t > 0)
    return o + t[inside].min() * d if inside.any() else None


def beside(origin: ArrayLike, way: ArrayLike, points: Array, angle: float) -> Array | None:
    """Return the point nearest to a ray by angle [rad] from its origin, or None beyond."""
    to = points - np.asarray(origin, dtype=float)
    d = np.asarray(way, dtype=float)
    far = np.maximum(np.linalg.norm(to, axis=1) * np.linalg.norm(d), 1e-300)
    cosine = to @ d / far
    best = int(cosine.argmax())
    return points[best] if cosine[best] >= np.cos(angle) else None
