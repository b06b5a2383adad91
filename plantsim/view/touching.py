"""A plant under a hand: take hold of its surface, drag, feel the force, keep the touch.

What the live viewer computes, without a page. Of linear kinematics everything is at frame
rate: fields of weight and fruit are solved for once, and a stiffness common to the whole
plant scales them, so that no slider costs a solve.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from plantsim.arrays import Array, Random, generator
from plantsim.elastic.contact import Contact
from plantsim.elastic.equilibrium import Equilibrium
from plantsim.elastic.loads import STANDARD_GRAVITY, force, move
from plantsim.elastic.model import ElasticModel
from plantsim.elastic.weight import Weight, gravity
from plantsim.errors import ModelError
from plantsim.estimation.observation import Observation
from plantsim.mesh.tetmesh import TetMesh
from plantsim.plant.hung import Masses

KINEMATICS = ("linear", "corotational")


@dataclass(frozen=True, eq=False)
class Frame:
    """One moment of a drag."""

    surface: Array  # (s, 3) [m] where the surface's vertices are
    centre: Array  # (3,) [m] where the hand is
    force: Array  # (3,) [N] that the hand exerts
    travel: float  # [m] how far the hand has gone from rest


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
        self._state: Equilibrium | None = None
        self._move: Array = np.zeros((0, 3))
        self._free: Array = np.zeros((3, 3))

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
        return self._linear_field(gravity())

    @cached_property
    def _fruit(self) -> Array:
        """Field (n, 3) [m] of 1 kg of fruit: where the masses are, or at limbs' tips."""
        return self._linear_field(self._fruit_load(1.0))

    def _linear_field(self, load: Any) -> Array:
        model = self.model if self.linear else replace(self.model, kinematics="linear")
        return model.solve(load).displacement

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
        self.burden, self._rest = burden, None
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
        if self._rest is None:
            self._rest = self._stiffened().solve(*self._loads())
        return self._rest.displacement

    def _loads(self) -> list[Any]:
        b = self.burden
        loads: list[Any] = []
        if b.gravity:
            loads.append(gravity((0, 0, -b.gravity * STANDARD_GRAVITY)))
        if b.fruit:
            loads.append(self._fruit_load(b.fruit))
        return loads

    def _stiffened(self) -> ElasticModel:
        material = self.model.material
        return self.model.with_material(
            material.with_young(self.burden.stiffness * material.young)
        )

    def hold(self, ids: ArrayLike) -> Frame:
        """Take hold of vertices (k,), the hand at rest; return the frame."""
        found = self.model.vertices(ids, "hold")
        contact = self.model.contact(found) if self.linear else None
        if contact is not None:
            contact.surface_displacement((0, 0, 0))  # made at first use: now, not in a drag
        self.ids, self._contact = found, contact
        self._free = np.zeros((3, 3)) if contact is None else self._freely(contact)
        self._move = np.zeros((len(found), 3))
        return self._frame()

    def let_go(self) -> Frame:
        """Open the hand; return the frame at rest."""
        self.ids, self._contact = np.zeros(0, dtype=np.int64), None
        self._move = np.zeros((0, 3))
        return self._frame()

    def drag(self, shift: ArrayLike, turn: ArrayLike | None = None) -> Frame:
        """Move the patch as a rigid body by `shift` [m].

        `turn`: a rotation vector [rad] about its middle; where None, it turns as the plant
        likes, so that the hand feels no torque (of linear kinematics; others hold it).
        """
        if not len(self.ids):
            raise ModelError("nothing is held. Hold some vertices first.")
        d, arm = np.asarray(shift, dtype=float), self._arm
        if turn is None and self._contact is not None:
            self._move = d + np.cross(self._free @ d, arm)
        else:
            angle = np.zeros(3) if turn is None else np.asarray(turn, dtype=float)
            self._move = Rotation.from_rotvec(angle).apply(arm) - arm + d
        return self._frame()

    @property
    def _arm(self) -> Array:
        """From the patch's middle to its vertices at rest, (k, 3) [m]."""
        held = self.mesh.points[self.ids]
        return held - held.mean(axis=0)

    def _freely(self, contact: Contact) -> Array:
        """Return the small turn (3, 3) [rad/m] a shift that takes no torque comes with."""
        arm = self._arm
        turns = np.stack([np.cross(axis, arm) for axis in np.eye(3)], axis=2)
        R = turns.reshape(-1, 3)
        T = np.tile(np.eye(3), (len(arm), 1))
        torque, both = R.T @ contact.stiffness @ R, R.T @ contact.stiffness @ T
        # a point or a line cannot feel all turns: the least of those that do
        return -np.linalg.pinv(torque, rcond=1e-9, hermitian=True) @ both

    def _frame(self) -> Frame:
        mesh, on = self.mesh, self.mesh.surface_vertices
        sag = self.sag()
        surface = mesh.points[on] + sag[on]
        total = np.zeros(3)
        if self._contact is not None:
            surface = surface + self._contact.surface_displacement(self._move)
            total = self.burden.stiffness * self._contact.force(self._move).sum(axis=0)
        elif len(self.ids):
            state = self._solved()
            surface = mesh.points[on] + state.displacement[on]
            assert self._rest is not None
            total = (state.force - self._rest.force)[self.ids].sum(axis=0)
        else:
            self._state = None
        shift = self._move.mean(axis=0) if len(self.ids) else np.zeros(3)
        at = mesh.points[self.ids] + sag[self.ids] if len(self.ids) else mesh.points[:1]
        return Frame(surface, at.mean(axis=0) + shift, total, float(np.linalg.norm(shift)))

    def _solved(self) -> Equilibrium:
        """Return the equilibrium of the hand and the burden by a solve of its own."""
        goal = self.sag()[self.ids] + self._move
        self._state = self._stiffened().solve(move(self.ids, goal), *self._loads())
        return self._state

    def displacement(self) -> Array:
        """Return the whole displacement (n, 3) [m] of this moment."""
        if self._contact is not None:
            return self.sag() + self._contact.displacement(self._move)
        return self.sag() if self._state is None else self._state.displacement

    def von_mises(self) -> Array:
        """Return the von Mises stress (m,) [Pa] of every tet at this moment."""
        factor = self.burden.stiffness if self.linear else 1.0
        return factor * self._equilibrium().von_mises

    def max_rotation(self) -> float:
        """Return the largest rotation [rad] of a tet at this moment."""
        return self._equilibrium().max_rotation

    def _equilibrium(self) -> Equilibrium:
        if self.linear:
            return replace(self._unmoved, displacement=self.displacement())
        state = self._state if self._state is not None else self._rest
        return self._unmoved if state is None else state

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
