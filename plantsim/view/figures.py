"""Figures in the paper's style, drawn off screen."""

import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from plantsim.arrays import Array
from plantsim.elastic.equilibrium import Equilibrium
from plantsim.errors import DependencyError, ModelError
from plantsim.mesh.tetmesh import TetMesh
from plantsim.paths import replacing, writable
from plantsim.view.probe import why_not_drawn

SIZE = (1200, 1200)


def figure_deformation(
    state: Equilibrium, out: str | os.PathLike[str], *, scale: float = 1.0
) -> Path:
    """Draw a deformed plant to a PNG and return its path.

    Black wireframe: at rest; grey surface: deformed, displacements times `scale`; red
    arrows: from where the moved vertices were the way they went (at least 4 % of the plant
    long, to be seen). Raises DependencyError where pictures cannot be drawn, with what to
    install.
    """
    pv = _pyvista()
    mesh = state.model.mesh
    plotter = pv.Plotter(off_screen=True, window_size=SIZE)
    plotter.set_background("white")
    rest = _surface(pv, mesh, mesh.points)
    deformed = _surface(pv, mesh, mesh.points + scale * state.displacement)
    edges = rest.extract_all_edges()
    plotter.add_mesh(edges, color="black", line_width=1, opacity=0.35)
    plotter.add_mesh(deformed, color="#9a9a9a", smooth_shading=True, specular=0.2)
    if len(state.moved):
        plotter.add_mesh(_arrows(pv, state, scale), color="#e31a1c", lighting=False)
    return _draw(pv, plotter, np.vstack([rest.points, deformed.points]), out)


def figure_material(
    mesh: TetMesh,
    field: ArrayLike,
    out: str | os.PathLike[str],
    *,
    label: str = "Young [GPa]",
) -> Path:
    """Draw the tets coloured by a field (m,), with a bar, to a PNG; return its path."""
    pv = _pyvista()
    values = np.asarray(field, dtype=float)
    if values.shape != (len(mesh.tets),):
        raise ModelError(
            f"field has shape {values.shape} for {len(mesh.tets)} tets. Give one value a "
            "tet."
        )
    cells = np.hstack([np.full((len(mesh.tets), 1), 4), mesh.tets[:, :4]])
    grid = pv.UnstructuredGrid(
        cells.ravel(), np.full(len(cells), pv.CellType.TETRA), np.asarray(mesh.points)
    )
    grid.cell_data[label] = values
    skin = grid.extract_surface(algorithm=None)
    plotter = pv.Plotter(off_screen=True, window_size=SIZE)
    plotter.set_background("white")
    plotter.add_mesh(
        skin,
        scalars=label,
        cmap="viridis",
        ambient=0.35,
        show_edges=True,
        edge_color="#202020",
        edge_opacity=0.25,
        line_width=0.3,
        scalar_bar_args={
            "color": "black",
            "vertical": True,
            "position_x": 0.82,
            "position_y": 0.25,
            "height": 0.5,
            "title_font_size": 20,
            "label_font_size": 20,
            "fmt": "%.2f",
        },
    )
    return _draw(pv, plotter, skin.points, out)


def _pyvista() -> Any:
    reason = why_not_drawn()
    if reason:
        raise DependencyError(f"no picture: {reason}")
    import pyvista  # noqa: PLC0415  only once it is known that drawing cannot crash

    return pyvista


def _surface(pv: Any, mesh: TetMesh, points: Array) -> Any:
    triangles = mesh.triangles
    faces = np.hstack([np.full((len(triangles), 1), 3), triangles]).ravel()
    return pv.PolyData(np.asarray(points), faces).clean()


def _arrows(pv: Any, state: Equilibrium, scale: float) -> Any:
    points = state.model.mesh.points[state.moved]
    way = scale * state.displacement[state.moved]
    size = np.linalg.norm(way, axis=1)
    span = float(np.ptp(state.model.mesh.points, axis=0).max())
    keep = size > 1e-9 * span
    arrows = pv.PolyData()
    for start, d, length in zip(points[keep], way[keep], size[keep], strict=True):
        # at least large enough to be seen
        long = max(length, 0.04 * span)
        arrows = arrows.append_polydata(
            pv.Arrow(
                start=start,
                direction=d,
                tip_length=0.3,
                tip_radius=0.08,
                shaft_radius=0.03,
                scale=long,
            )
        )
    return arrows


def _draw(pv: Any, plotter: Any, points: Array, out: str | os.PathLike[str]) -> Path:
    """Look at the plant from the side, a little above, and write the PNG."""
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
    plotter.camera.parallel_scale = 0.54 * float(max(span[2], span[1 - across]))
    plotter.renderer.reset_camera_clipping_range()
    path = writable(out, ".png")
    with replacing(path) as temporary:
        plotter.screenshot(temporary)
    plotter.close()
    return path
