"""The plant's surface on the page, in as many pieces as it has colours.

A page's mesh has one colour, so a field is drawn as one mesh for each of a few colours;
their vertices move together.
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
MOST = 10_000  # triangles that are drawn, half for the ghost: else of corners, thinned


class Skin:
    """What of a plant is seen, and the colours on it."""

    def __init__(self, scene: Any, touching: Touching) -> None:
        """Draw the surface at rest, plain, and its ghost, which stays there."""
        self._scene = scene
        mesh = touching.mesh
        self._on = mesh.surface_vertices
        points = self._points = mesh.points[self._on]
        flat = np.searchsorted(self._on, mesh.surface[:, :3])
        faces, tets = touching.triangles, touching.tet_of_triangle
        if len(faces) > MOST:
            faces = thinned(points, flat, MOST)
            near = KDTree(points[flat].mean(axis=1)).query(points[faces].mean(axis=1))[1]
            tets = mesh.surface_tets[near]
        self.faces, self._tets = faces, tets
        self.pieces: list[tuple[Any, Array]] = []
        self._shade: Array | None = None
        ghost = thinned(points, flat, MOST // 2)
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

    @property
    def count(self) -> int:
        """How many vertices are sent in every frame."""
        return sum(len(rows) for _, rows in self.pieces)

    def move(self, points: Array) -> None:
        """Put the surface's vertices (s, 3) [m] somewhere."""
        self._points = points
        self._moved = bool(np.abs(points - self._home).max() > self._near)
        self.ghostly(self._ghostly)
        for handle, rows in self.pieces:
            handle.vertices = points[rows]

    def ghostly(self, shown: bool) -> None:
        """Show the shape at rest, or do not; where the plant stands in it, it is hidden."""
        self._ghostly = shown
        self.ghost.visible = shown and self._moved

    def colour_by(self, what: str, viewer: "Viewer | None") -> None:
        """Colour by "plain", "limb", "stress", "stiffness", "estimate", "uncertainty"."""
        self.legend = ""
        if what == "limb" and viewer is not None:
            region = np.asarray(viewer.touching.mesh.region)
            self._paint(region[self._tets] % len(LIMBS), [rgb(c) for c in LIMBS])
            return
        values, unit, cmap = (None, "", "") if viewer is None else field(what, viewer)
        if values is None:
            self._paint(np.zeros(len(self.faces), dtype=int), [PLAIN])
            return
        low, high = extent(values)
        if what == "stress":  # a few tets at the hand would take all colours but one
            low, high = 0.0, max(float(np.quantile(values[self._tets], 0.98)), LEAST)
            unit = f"{unit}, or more"
        shade = np.clip((values - low) / (high - low) * SHADES, 0, SHADES - 1).astype(int)
        ramp = colours((np.arange(SHADES) + 0.5) / SHADES, cmap, (0.0, 1.0))
        self.legend = bar(ramp, low, high, unit)
        self._paint(shade[self._tets], [tuple(int(x) for x in c) for c in ramp])

    def _paint(self, shade: Array, table: Any) -> None:
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
                f"/plant/{i}",
                self._points[rows],
                np.searchsorted(rows, faces),
                color=table[int(n)],
            )
            self.pieces.append((handle, rows))
        for handle in old[len(self.pieces) :]:  # the others were replaced by name
            handle.remove()


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
