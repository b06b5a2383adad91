"""The plant's surface on the page, in as many pieces as it has colours.

A page's mesh has one colour, so a field is drawn as one mesh for each of a few colours;
their vertices move together. While a plant moves it is drawn by fewer triangles, so that a
page without a graphics card keeps up; at rest by all.
"""

from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial import KDTree

from plantsim.arrays import Array
from plantsim.view.scenes import thinned
from plantsim.view.style import LIMBS, STIFFNESS, STRESS, UNCERTAINTY, colours, extent, rgb
from plantsim.view.touching import Touching

if TYPE_CHECKING:
    from plantsim.view.app import Viewer

SHADES = 20
LEAST = 0.01  # [MPa] at the end of the bar of stress, where there is none yet
PLAIN = (139, 158, 120)
NEAR = 1e-4  # of its size: a plant that moved less stands in its rest shape
# triangles that are drawn: of the corners, thinned where the surface is flat
MOST, MOVING, GHOST = 10_000, 5_000, 2_500


class Coat:
    """The surface by so many triangles, one mesh on the page for each of its colours."""

    def __init__(self, scene: Any, name: str, faces: Array, tets: Array) -> None:
        """Draw nothing yet: `tets` are those behind the faces, for their colours."""
        self._scene, self._name = scene, name
        self.faces, self.tets = faces, tets
        self.pieces: list[tuple[Any, Array]] = []
        self.visible = True
        self._shade: Array | None = None

    def move(self, points: Array) -> None:
        """Put the vertices (s, 3) [m] somewhere."""
        for handle, rows in self.pieces:
            handle.vertices = points[rows]

    def show(self, visible: bool) -> None:
        """Show it, or do not."""
        self.visible = visible
        for handle, _ in self.pieces:
            handle.visible = visible

    def paint(self, points: Array, shade: Array, table: Any) -> None:
        """Draw one mesh for each shade (k,) of the faces that is there."""
        key = np.append(shade, len(table))
        if self._shade is not None and np.array_equal(key, self._shade):
            return
        self._shade = key
        old = [handle for handle, _ in self.pieces]
        self.pieces = []
        for i, n in enumerate(np.unique(shade)):
            faces = self.faces[shade == n]
            rows = np.unique(faces)
            handle = self._scene.add_mesh_simple(
                f"/{self._name}/{i}",
                points[rows],
                np.searchsorted(rows, faces),
                color=table[int(n)],
                visible=self.visible,
            )
            self.pieces.append((handle, rows))
        for handle in old[len(self.pieces) :]:  # the others were replaced by name
            handle.remove()


class Skin:
    """What of a plant is seen, and the colours on it: coarser while it moves."""

    def __init__(self, scene: Any, touching: Touching) -> None:
        """Draw the surface at rest, plain, and its ghost, which stays there."""
        mesh = touching.mesh
        self._on = mesh.surface_vertices
        points = self._points = mesh.points[self._on]
        flat = np.searchsorted(self._on, mesh.surface[:, :3])
        faces, tets = touching.triangles, touching.tet_of_triangle
        middles = KDTree(points[flat].mean(axis=1))

        def coat(name: str, most: int) -> Coat:
            if len(faces) <= most:
                return Coat(scene, name, faces, tets)
            few = thinned(points, flat, most)
            near = middles.query(points[few].mean(axis=1))[1]
            return Coat(scene, name, few, mesh.surface_tets[near])

        self.full = self.worn = coat("plant", MOST)
        self.light = coat("moving", MOVING) if len(faces) > MOVING else self.full
        ghost = thinned(points, flat, GHOST)
        rest = np.unique(ghost)
        self._home, self._near = points, NEAR * float(np.ptp(points))
        self._moved, self._ghostly = False, True
        # no wireframe: where no graphics card draws, lines take longer than all else
        self.ghost = scene.add_mesh_simple(
            "/rest",
            points[rest],
            np.searchsorted(rest, ghost),
            color=(0, 0, 0),
            opacity=0.15,
            cast_shadow=False,
            receive_shadow=False,
            visible=False,
        )
        self.legend = ""
        self.colour_by("plain", None)
        if self.light is not self.full:  # on the page before a hand begins to move
            self.light.visible = False
            self.light.paint(points, np.zeros(len(self.light.faces), dtype=int), [PLAIN])

    @property
    def faces(self) -> Array:
        """The triangles (k, 3) that are drawn now, of the surface's vertices."""
        return self.worn.faces

    @property
    def pieces(self) -> list[tuple[Any, Array]]:
        """The meshes on the page that are drawn now, and the vertices of each."""
        return self.worn.pieces

    @property
    def count(self) -> int:
        """How many vertices are sent in every frame of a drag."""
        return sum(len(rows) for _, rows in self.light.pieces)

    def move(self, points: Array) -> bool:
        """Put the surface's vertices (s, 3) [m] somewhere, lightly drawn until `rest`.

        Return whether another coat is worn now, with colours that may be old.
        """
        self._points = points
        self._moved = bool(np.abs(points - self._home).max() > self._near)
        self.ghostly(self._ghostly)
        return self._wear(self.light)

    def rest(self) -> bool:
        """Draw the surface in full where it is; return whether it was not before."""
        return self.worn is not self.full and self._wear(self.full)

    def _wear(self, coat: Coat) -> bool:
        coat.move(self._points)
        if coat is self.worn:
            return False
        self.worn.show(False)
        coat.show(True)
        self.worn = coat
        return True

    def ghostly(self, shown: bool) -> None:
        """Show the shape at rest, or do not; where the plant stands in it, it is hidden."""
        self._ghostly = shown
        self.ghost.visible = shown and self._moved

    def colour_by(self, what: str, viewer: "Viewer | None") -> None:
        """Colour by "plain", "limb", "stress", "stiffness", "estimate", "uncertainty"."""
        self.legend = ""
        if what == "limb" and viewer is not None:
            region = np.asarray(viewer.touching.mesh.region)
            self.worn.paint(
                self._points, region[self.worn.tets] % len(LIMBS), [rgb(c) for c in LIMBS]
            )
            return
        values, unit, cmap = (None, "", "") if viewer is None else field(what, viewer)
        if values is None:
            self.worn.paint(self._points, np.zeros(len(self.faces), dtype=int), [PLAIN])
            return
        low, high = extent(values)
        if what == "stress":  # a few tets at the hand would take all colours but one
            low, high = 0.0, max(float(np.quantile(values[self.worn.tets], 0.98)), LEAST)
            unit = f"{unit}, or more"
        shade = np.clip((values - low) / (high - low) * SHADES, 0, SHADES - 1).astype(int)
        ramp = colours((np.arange(SHADES) + 0.5) / SHADES, cmap, (0.0, 1.0))
        self.legend = bar(ramp, low, high, unit)
        self.worn.paint(
            self._points, shade[self.worn.tets], [tuple(int(x) for x in c) for c in ramp]
        )


def field(what: str, viewer: "Viewer") -> tuple[Array | None, str, str]:
    """Return values (m,) of the tets, their unit and colour map, or None for plain."""
    touching = viewer.touching
    count = len(touching.mesh.tets)
    if what == "stress":
        return touching.von_mises() / 1e6, "MPa (von Mises)", STRESS
    if what == "stiffness":
        young = touching.burden.stiffness * touching.model.material.young
        return np.broadcast_to(young / 1e9, (count,)), "GPa", STIFFNESS
    if viewer.found is not None and what == "estimate":
        return (
            np.broadcast_to(viewer.found.material.young / 1e9, (count,)),
            "GPa",
            STIFFNESS,
        )
    if viewer.found is not None and what == "uncertainty":
        spread = viewer.uncertainty()
        return spread, "% (one standard deviation)", UNCERTAINTY
    return None, "", STIFFNESS


def bar(ramp: Array, low: float, high: float, unit: str) -> str:
    """Return a colour bar in HTML."""
    stops = ", ".join(f"rgb({r},{g},{b})" for r, g, b in ramp)
    return (
        f'<div style="padding:0 1em;font-size:0.8em"><div style="height:0.9em;'
        f'border-radius:3px;background:linear-gradient(to right,{stops})"></div>'
        f'<div style="display:flex;justify-content:space-between"><span>{low:.3g}</span>'
        f"<span>{unit}</span><span>{high:.3g}</span></div></div>"
    )
