"""Scenes in three dimensions, drawn off screen (pyvista's home).

A scene is made of functions that take pyvista and return a mesh, so that none is loaded
before it is known that it can draw.
"""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from plantsim.arrays import Array
from plantsim.elastic.equilibrium import Equilibrium
from plantsim.errors import DependencyError, ModelError, check_kind, needs
from plantsim.estimation.observation import Observation
from plantsim.mesh.tetmesh import TetMesh
from plantsim.paths import Picture, replacing, writable
from plantsim.solid.rings import frames
from plantsim.solid.sweep import Solid, Tube
from plantsim.view.probe import why_not_drawn
from plantsim.view.style import BLUE, CONTACT, DEFORMED, LIMBS, MOVED, REST, extent

SIZE = (1200, 1200)
FORCE = 0.12  # of the plant's size: the longest arrow of a force
PATCH = 0.08  # of the plant's size: moved vertices nearer than this are one hand's
FPS = 20  # of an animation
SEEN = BLUE
BENT = "A state is drawn by ps.figure_deformation, a skeleton by ps.figure_skeleton. "


@dataclass(frozen=True, eq=False)
class Scene:
    """Surfaces to be drawn, each with its options, and the points that must be seen."""

    points: Array
    parts: tuple[tuple[Any, dict[str, Any]], ...]  # a function of pyvista -> mesh; options

    def add(self, pv: Any, plotter: Any) -> None:
        """Put all parts into a plotter."""
        plotter.set_background("white")
        for make, options in self.parts:
            made = make(pv)
            if made.n_points:
                plotter.add_mesh(made, **options)
        for bar in plotter.scalar_bars.values():
            bar.SetVerticalTitleSeparation(16)  # else the title stands on the top number


def deformation_scene(state: Equilibrium, scale: float, forces: bool) -> Scene:
    """Return a plant at rest and deformed, arrows where it is moved; forces in green."""
    check_kind(state, Equilibrium, "this picture")
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
            parts.append(_forces(bent[state.moved], state.force[state.moved], span))
    return Scene(np.vstack([mesh.points, bent]), tuple(parts))


def _forces(at: Array, f: Array, span: float) -> tuple[Any, dict[str, Any]]:
    """Return arrows of forces f (k, 3) at points; of a small patch the sum alone."""
    if np.ptp(at, axis=0).max() < PATCH * span:
        f, at = f.sum(axis=0)[None], at.mean(axis=0)[None]
    most = max(float(np.linalg.norm(f, axis=1).max()), 1e-300)
    long = FORCE * span / most * f
    return lambda pv: _arrows(pv, at, long, span), {"color": CONTACT, "lighting": False}


def touch_scene(mesh: TetMesh, touch: Observation, scale: float) -> Scene:
    """Return what a robot saw and felt: dots where vertices were seen to go, arrows."""
    if not isinstance(mesh, TetMesh):
        raise ModelError(
            f"a touch is drawn on a mesh, not on {mesh!r}. Give the mesh that was touched "
            "first: touch.plot(mesh, 'touch.png')."
        )
    check_kind(touch, Observation, "this picture")
    ids = np.concatenate([touch.moved, touch.seen, touch.loaded])
    if len(ids) and ids.max() >= len(mesh.points):
        raise ModelError(
            f"the touch names vertex {ids.max()} of a mesh of {len(mesh.points)}. Give the "
            "mesh that was touched."
        )
    span = float(np.ptp(mesh.points, axis=0).max())
    start = mesh.points[touch.moved]
    gone = start + scale * touch.move
    seen = mesh.points[touch.seen] + scale * touch.displacement
    parts: list[tuple[Any, dict[str, Any]]] = [
        (
            lambda pv: _surface(pv, mesh, mesh.points),
            {"color": DEFORMED, "opacity": 0.35, "smooth_shading": True},
        )
    ]
    if len(seen):
        parts.append(
            (
                lambda pv: pv.PolyData(np.ascontiguousarray(seen)),
                {"color": SEEN, "point_size": 4, "render_points_as_spheres": True},
            )
        )
    if len(start):
        parts.append(
            (
                lambda pv: _arrows(pv, start, gone - start, span, least=0.04 * span),
                {"color": MOVED, "lighting": False},
            )
        )
        if touch.force is not None:
            parts.append(_forces(gone, touch.force, span))
        elif touch.wrench is not None:
            at = gone.mean(axis=0, keepdims=True)
            parts.append(_forces(at, touch.wrench[None, :3], span))
    if len(touch.loaded):
        parts.append(_forces(mesh.points[touch.loaded], touch.load, span))
    return Scene(np.vstack([mesh.points, gone, seen]), tuple(parts))


def solid_scene(solid: Solid) -> Scene:
    """Return the tubes of a solid, each in one of the style's colours, seen through."""
    check_kind(solid, Solid, "this picture")
    skins = [_tube(tube) for tube in solid.tubes]
    parts = tuple(
        (
            lambda pv, rings=rings: pv.StructuredGrid(*rings.T).extract_surface(
                algorithm="dataset_surface"
            ),
            {"color": LIMBS[i % len(LIMBS)], "opacity": 0.75, "culling": "back"},
        )
        for i, rings in enumerate(skins)
    )
    return Scene(np.vstack([rings.reshape(-1, 3) for rings in skins]), parts)


def _tube(tube: Tube) -> Array:
    """Return circles (k, 25, 3) along a tube, and about its tip where that is round."""
    u = np.linspace(0, 1, 8 * len(tube.points))
    centre, tangent, normal = frames(tube, u)
    radius = tube.radius(u)
    if tube.round_tip:
        up = np.linspace(0, np.pi / 2, 7)[1:]
        end = centre[-1] + radius[-1] * np.sin(up)[:, None] * tangent[-1]
        centre, radius = (
            np.vstack([centre, end]),
            np.append(radius, radius[-1] * np.cos(up)),
        )
        tangent, normal = (
            np.vstack([v, np.tile(v[-1], (6, 1))]) for v in (tangent, normal)
        )
    angle = np.linspace(0, 2 * np.pi, 25)[:, None, None]
    way = np.cos(angle) * normal + np.sin(angle) * np.cross(tangent, normal)
    return (centre + radius[:, None] * way).swapaxes(0, 1)


def material_scene(
    mesh: TetMesh,
    field: ArrayLike,
    label: str,
    cmap: str,
    marks: ArrayLike,
    span: tuple[float, float] | None = None,
) -> Scene:
    """Return tets coloured by a field (m,), a bar beside them, and marked vertices.

    `span`: lowest and highest value of the bar, the field's own by default.
    """
    check_kind(mesh, TetMesh, "this picture")
    try:
        values = np.asarray(field, dtype=float)
    except (TypeError, ValueError):
        kind = type(field).__name__
        raise ModelError(f"field is a {kind}. Give one number a tet.") from None
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
        "title_font_size": 26,
        "label_font_size": 26,
        "fmt": "%.2f",
    }
    options: dict[str, Any] = {
        "scalars": label,
        "cmap": cmap,
        "clim": span or extent(values),
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
    return Scene(mesh.points, tuple(parts))


def limbs_scene(mesh: TetMesh) -> Scene:
    """Return a mesh with every limb in one of the style's colours."""
    check_kind(mesh, TetMesh, "this picture", hint=BENT)

    def skin(pv: Any) -> Any:
        surface = _surface(pv, mesh, mesh.points, clean=False)
        behind = np.tile(mesh.surface_tets, len(mesh.triangles) // len(mesh.surface))
        surface.cell_data["limb"] = np.asarray(mesh.region)[behind] % len(LIMBS)
        return surface

    options = {"scalars": "limb", "cmap": list(LIMBS), "clim": (0, len(LIMBS) - 1)}
    return Scene(
        mesh.points, ((skin, options | {"show_scalar_bar": False, "ambient": 0.3}),)
    )


def pyvista() -> Any:
    """Return pyvista; DependencyError, with what to install, where it cannot draw."""
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


def thinned(points: Array, triangles: Array, count: int) -> Array:
    """Return about `count` triangles (k, 3) in place of more, between the same points.

    By collapsing edges where the surface is flattest.
    Source: Schroeder, Zarge, Lorensen, Decimation of triangle meshes, 1992, in VTK.
    """
    if len(triangles) <= count:
        return triangles
    pv = needs("pyvista", "view")
    rows = np.unique(triangles)
    full = pv.PolyData.from_regular_faces(points[rows], np.searchsorted(rows, triangles))
    full["row"] = rows
    thin = full.decimate_pro(1 - count / len(triangles), preserve_topology=True)
    return np.asarray(thin["row"])[thin.regular_faces]


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


def pictures(
    panels: Sequence[tuple[Scene, str]],
    out: str | os.PathLike[str],
    *,
    columns: int = 4,
    size: tuple[int, int] = SIZE,
) -> Path:
    """Draw scenes beside and below each other to a PNG."""
    path = writable(out, ".png")
    pv = pyvista()
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
        look(plotter, scene.points, 0.6 if title else 0.54)
    with replacing(path) as temporary:
        plotter.screenshot(temporary)
    plotter.close()
    return Picture(path)


def film(
    scenes: Sequence[Scene],
    out: str | os.PathLike[str],
    *,
    back: bool,
    size: tuple[int, int],
) -> Path:
    """Draw scenes as the frames of a .gif or .mp4, the camera fitted to all of them."""
    path = writable(out, ".gif", ".mp4")
    if any(side < 16 or side % 2 for side in size):
        raise ModelError(f"size {size}: a film's sides are even, 16 pixels and more.")
    iio = needs("imageio.v3", "view")
    video = path.suffix.lower() == ".mp4"
    if video:
        needs("imageio_ffmpeg", "view", "write a .gif")
    every = np.vstack([scene.points for scene in scenes])
    pv = pyvista()
    images = []
    for scene in scenes:
        plotter = pv.Plotter(off_screen=True, window_size=size)
        scene.add(pv, plotter)
        look(plotter, every)
        images.append(plotter.screenshot(None, return_img=True))
        plotter.close()
    images += images[-2:0:-1] if back else []
    options: dict[str, Any] = (
        {"plugin": "FFMPEG", "fps": FPS, "codec": "libx264", "macro_block_size": 2}
        if video
        else {"duration": 1000 / FPS, "loop": 0}
    )
    with replacing(path) as temporary:
        iio.imwrite(temporary, np.stack(images), **options)
    return Picture(path)


def look(plotter: Any, points: Array, margin: float = 0.54) -> None:
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
