"""Figures in three dimensions, in the paper's style, drawn off screen (pyvista's home)."""

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from plantsim.arrays import Array
from plantsim.elastic.equilibrium import Equilibrium
from plantsim.errors import DependencyError, ModelError, needs
from plantsim.mesh.tetmesh import TetMesh
from plantsim.paths import Picture, replacing, writable
from plantsim.view.probe import why_not_drawn
from plantsim.view.style import (
    CONTACT,
    DEFORMED,
    LIMBS,
    MOVED,
    REST,
    STIFFNESS,
    UNCERTAINTY,
)

SIZE = (1200, 1200)
FORCE = 0.12  # of the plant's size: the longest arrow of a force
PATCH = 0.08  # of the plant's size: moved vertices nearer than this are one hand's
FPS = 20  # of an animation


def figure_deformation(
    state: Equilibrium,
    out: str | os.PathLike[str],
    *,
    scale: float = 1.0,
    forces: bool = False,
) -> Path:
    """Draw a deformed plant to a PNG and return its path.

    Black wireframe: at rest; grey surface: deformed, displacements times `scale`; red
    arrows: from where the moved vertices were the way they went (at least 4 % of the plant
    long, to be seen); with `forces` green arrows: the contact forces there, the largest
    12 % of the plant long, or their sum alone where the vertices are one small patch, in
    which neighbours push against each other. Raises DependencyError where pictures cannot
    be drawn, with what to install.
    """
    return _pictures([(_deformation(state, scale, forces), "")], out)


def figure_material(
    mesh: TetMesh,
    field: ArrayLike,
    out: str | os.PathLike[str],
    *,
    label: str = "Young [GPa]",
    cmap: str = STIFFNESS,
    marks: ArrayLike = (),
) -> Path:
    """Draw the tets coloured by a field (m,), with a bar, to a PNG; return its path.

    `label` names the field with its unit; `marks`: ids of vertices drawn as red dots.
    """
    return _pictures([(_material(mesh, field, label, cmap, marks), "")], out)


def figure_mesh(mesh: TetMesh, out: str | os.PathLike[str]) -> Path:
    """Draw a mesh with every limb in a colour of its own to a PNG; return its path."""
    return _pictures([(_limbs(mesh), "")], out)


def figure_posterior(
    mesh: TetMesh,
    mean: ArrayLike,
    std: ArrayLike,
    out: str | os.PathLike[str],
    *,
    prior_std: ArrayLike | None = None,
    next_touch: ArrayLike = (),
    unit: str = "GPa",
) -> Path:
    """Draw an estimate of Young's modulus and its uncertainty side by side to a PNG.

    `mean` and `std` (m,), one standard deviation, in `unit`. With `prior_std`, () or (m,),
    a third picture shows what the touches identified: the share of the prior's variance
    that they removed, 0 nothing to 1 all. `next_touch`: ids of vertices to touch next, red.
    """
    panels = [
        (_material(mesh, mean, f"Young [{unit}]", STIFFNESS, next_touch), "estimate"),
        (_material(mesh, std, f"std [{unit}]", UNCERTAINTY, next_touch), "uncertainty"),
    ]
    if prior_std is not None:
        before = np.broadcast_to(np.asarray(prior_std, float), (len(mesh.tets),))
        share = 1 - (np.asarray(std, dtype=float) / before) ** 2
        known = _material(mesh, share, "share of variance", UNCERTAINTY, next_touch)
        panels.append((known, "identified"))
    return _pictures(panels, out)


def figure_gallery(
    plants: Sequence[Any] | Mapping[str, Any],
    out: str | os.PathLike[str],
    *,
    columns: int = 4,
) -> Path:
    """Draw meshes (limbs in colours) and states (deformed) beside each other to a PNG.

    `plants`: `TetMesh` and `Equilibrium` values, or a mapping of titles to them; each to
    its own scale.
    """
    named = plants.items() if isinstance(plants, Mapping) else [("", p) for p in plants]
    panels = [
        (_deformation(p, 1.0, False) if isinstance(p, Equilibrium) else _limbs(p), title)
        for title, p in named
    ]
    if not panels:
        raise ModelError("an empty gallery. Give at least one mesh or state.")
    return _pictures(panels, out, columns=columns, size=(480, 480))


def animate_touch(
    states: Iterable[Equilibrium],
    out: str | os.PathLike[str],
    *,
    scale: float = 1.0,
    forces: bool = True,
    back: bool = True,
    size: tuple[int, int] = (600, 600),
) -> Path:
    """Draw states of one plant as the frames of an animated .gif; return its path.

    With `back` they are played forth and back. The camera stays, fitted to all frames.
    """
    scenes = [_deformation(state, scale, forces) for state in states]
    if not scenes:
        raise ModelError("an animation without a state. Give at least one.")
    path = writable(out, ".gif")
    every = np.vstack([scene.points for scene in scenes])
    pv = _pyvista()
    images = []
    for scene in scenes:
        plotter = pv.Plotter(off_screen=True, window_size=size)
        scene.add(pv, plotter)
        _look(plotter, every)
        images.append(plotter.screenshot(None, return_img=True))
        plotter.close()
    images += images[-2:0:-1] if back else []
    with replacing(path) as temporary:
        needs("imageio.v3", "view").imwrite(temporary, images, duration=1000 / FPS, loop=0)
    return Picture(path)


@dataclass(frozen=True, eq=False)
class _Scene:
    """Surfaces to be drawn, each with its options, and the points that must be seen."""

    points: Array
    parts: tuple[tuple[Any, dict[str, Any]], ...]  # a function of pyvista -> mesh; options

    def add(self, pv: Any, plotter: Any) -> None:
        plotter.set_background("white")
        for make, options in self.parts:
            made = make(pv)
            if made.n_points:
                plotter.add_mesh(made, **options)


def _deformation(state: Equilibrium, scale: float, forces: bool) -> _Scene:
    mesh = state.model.mesh
    bent = mesh.points + scale * state.displacement
    parts: list[tuple[Any, dict[str, Any]]] = [
        (
            lambda pv: _surface(pv, mesh, mesh.points).extract_all_edges(),
            {"color": REST, "line_width": 1, "opacity": 0.35},
        ),
        (
            lambda pv: _surface(pv, mesh, bent),
            {"color": DEFORMED, "smooth_shading": True, "specular": 0.2},
        ),
    ]
    if len(state.moved):
        way = scale * state.displacement[state.moved]
        span = float(np.ptp(mesh.points, axis=0).max())
        starts = mesh.points[state.moved]
        parts.append(
            (
                lambda pv: _arrows(pv, starts, way, span, least=0.04 * span),
                {"color": MOVED, "lighting": False},
            )
        )
        if forces:
            f, at = state.force[state.moved], bent[state.moved]
            if np.ptp(starts, axis=0).max() < PATCH * span:
                f, at = f.sum(axis=0)[None], at.mean(axis=0)[None]
            most = max(float(np.linalg.norm(f, axis=1).max()), 1e-300)
            long = FORCE * span / most * f
            parts.append(
                (
                    lambda pv: _arrows(pv, at, long, span),
                    {"color": CONTACT, "lighting": False},
                )
            )
    return _Scene(np.vstack([mesh.points, bent]), tuple(parts))


def _material(
    mesh: TetMesh, field: ArrayLike, label: str, cmap: str, marks: ArrayLike
) -> _Scene:
    values = np.asarray(field, dtype=float)
    if values.shape != (len(mesh.tets),):
        raise ModelError(
            f"field has shape {values.shape} for {len(mesh.tets)} tets. Give one value a "
            "tet."
        )

    def skin(pv: Any) -> Any:
        surface = _surface(pv, mesh, mesh.points, clean=False)
        behind = np.tile(mesh.surface_tets, len(mesh.triangles) // len(mesh.surface))
        surface.cell_data[label] = values[behind]
        return surface

    bar = {
        "color": "black",
        "vertical": True,
        "position_x": 0.82,
        "position_y": 0.25,
        "height": 0.5,
        "title_font_size": 20,
        "label_font_size": 20,
        "fmt": "%.2f",
    }
    options: dict[str, Any] = {
        "scalars": label,
        "cmap": cmap,
        "ambient": 0.35,
        "show_edges": True,
        "edge_color": "#202020",
        "edge_opacity": 0.25,
        "line_width": 0.3,
        "scalar_bar_args": bar,
    }
    parts = [(skin, options)]
    ids = np.asarray(marks, dtype=int).ravel()
    if len(ids):
        ball = 0.015 * float(np.ptp(mesh.points, axis=0).max())
        parts.append(
            (
                lambda pv: pv.PolyData(np.asarray(mesh.points[ids])).glyph(
                    geom=pv.Sphere(radius=ball), scale=False, orient=False
                ),
                {"color": MOVED},
            )
        )
    return _Scene(mesh.points, tuple(parts))


def _limbs(mesh: TetMesh) -> _Scene:
    """Return a mesh with every limb in one of the style's colours."""

    def skin(pv: Any) -> Any:
        surface = _surface(pv, mesh, mesh.points, clean=False)
        behind = np.tile(mesh.surface_tets, len(mesh.triangles) // len(mesh.surface))
        surface.cell_data["limb"] = np.asarray(mesh.region)[behind] % len(LIMBS)
        return surface

    options = {"scalars": "limb", "cmap": list(LIMBS), "clim": (0, len(LIMBS) - 1)}
    return _Scene(
        mesh.points, ((skin, options | {"show_scalar_bar": False, "ambient": 0.3}),)
    )


def _pyvista() -> Any:
    reason = why_not_drawn()
    if reason:
        raise DependencyError(f"no picture: {reason}")
    import pyvista  # noqa: PLC0415  only once it is known that drawing cannot crash

    return pyvista


def _surface(pv: Any, mesh: TetMesh, points: Array, *, clean: bool = True) -> Any:
    triangles = mesh.triangles
    faces = np.hstack([np.full((len(triangles), 1), 3), triangles]).ravel()
    surface = pv.PolyData(np.asarray(points), faces)
    return surface.clean() if clean else surface


def _arrows(pv: Any, starts: Array, way: Array, span: float, least: float = 0.0) -> Any:
    size = np.linalg.norm(way, axis=1)
    keep = size > 1e-9 * span
    arrows = pv.PolyData()
    for start, d, length in zip(starts[keep], way[keep], size[keep], strict=True):
        arrows = arrows.append_polydata(
            pv.Arrow(
                start=start,
                direction=d,
                tip_length=0.3,
                tip_radius=0.08,
                shaft_radius=0.03,
                scale=max(length, least),
            )
        )
    return arrows


def _pictures(
    panels: Sequence[tuple[_Scene, str]],
    out: str | os.PathLike[str],
    *,
    columns: int = 4,
    size: tuple[int, int] = SIZE,
) -> Path:
    """Draw scenes beside and below each other to a PNG."""
    path = writable(out, ".png")
    pv = _pyvista()
    across = min(columns, len(panels))
    rows = -(-len(panels) // across)
    plotter = pv.Plotter(
        shape=(rows, across),
        off_screen=True,
        window_size=(across * size[0], rows * size[1]),
        border=False,
    )
    plotter.set_background("white")
    for i, (scene, title) in enumerate(panels):
        plotter.subplot(*divmod(i, across))
        scene.add(pv, plotter)
        if title:
            plotter.add_text(title, position="upper_edge", color="black", font_size=12)
        _look(plotter, scene.points, 0.6 if title else 0.54)
    with replacing(path) as temporary:
        plotter.screenshot(temporary)
    plotter.close()
    return Picture(path)


def _look(plotter: Any, points: Array, margin: float = 0.54) -> None:
    """Look at the plant from the side, a little above, all of it in the picture."""
    low, high = points.min(axis=0), points.max(axis=0)
    centre, span = (low + high) / 2, high - low
    across = 1 if span[0] >= span[1] else 0  # look along the narrower horizontal axis
    view = np.zeros(3)
    view[across] = -1.0 if across else 1.0
    view[2] = 0.15
    plotter.camera.focal_point = centre
    plotter.camera.position = centre + view * max(span.max(), 1e-9)
    plotter.camera.up = (0, 0, 1)
    plotter.enable_parallel_projection()
    # half of what is to be seen from top to bottom, with a margin
    plotter.camera.parallel_scale = margin * float(max(span[2], span[1 - across]))
    plotter.renderer.reset_camera_clipping_range()
