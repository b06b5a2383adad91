"""Figures in three dimensions, in the paper's style, drawn off screen."""

import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from plantsim.elastic.equilibrium import Equilibrium
from plantsim.errors import ModelError, check_kind, checked_all
from plantsim.estimation.observation import Observation
from plantsim.mesh.tetmesh import TetMesh
from plantsim.solid.sweep import Solid
from plantsim.view.scenes import (
    Scene,
    deformation_scene,
    film,
    limbs_scene,
    material_scene,
    pictures,
    solid_scene,
    touch_scene,
)
from plantsim.view.style import STIFFNESS, UNCERTAINTY


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
    return pictures([(deformation_scene(state, scale, forces), "")], out)


def figure_material(
    mesh: TetMesh,
    field: ArrayLike,
    out: str | os.PathLike[str],
    *,
    label: str = "Young [GPa]",
    cmap: str = STIFFNESS,
    marks: ArrayLike = (),
    span: tuple[float, float] | None = None,
) -> Path:
    """Draw the tets coloured by a field (m,), with a bar, to a PNG; return its path.

    `label` names the field with its unit; `marks`: ids of vertices drawn as red dots;
    `span`: lowest and highest value of the bar, so that pictures can be compared.
    """
    return pictures([(material_scene(mesh, field, label, cmap, marks, span), "")], out)


def figure_mesh(mesh: TetMesh, out: str | os.PathLike[str]) -> Path:
    """Draw a mesh with every limb in a colour of its own to a PNG; return its path."""
    return pictures([(limbs_scene(mesh), "")], out)


def figure_solid(solid: Solid, out: str | os.PathLike[str]) -> Path:
    """Draw the tubes of a solid, seen through, to a PNG; return its path."""
    return pictures([(solid_scene(solid), "")], out)


def figure_touch(
    mesh: TetMesh,
    touch: Observation,
    out: str | os.PathLike[str],
    *,
    scale: float = 1.0,
) -> Path:
    """Draw what a robot saw and felt of one touch to a PNG; return its path.

    Blue dots: where seen vertices went, displacements times `scale`; red arrows: the
    gripper's motion; green: the force that it felt (or that was hung on).
    """
    return pictures([(touch_scene(mesh, touch, scale), "")], out)


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
    check_kind(mesh, TetMesh, "figure_posterior")

    def panel(field: ArrayLike, label: str, cmap: str, title: str) -> tuple[Scene, str]:
        return material_scene(mesh, field, label, cmap, next_touch), title

    panels = [
        panel(mean, f"Young [{unit}]", STIFFNESS, "estimate"),
        panel(std, f"std [{unit}]", UNCERTAINTY, "uncertainty"),
    ]
    if prior_std is not None:
        before = np.broadcast_to(np.asarray(prior_std, float), (len(mesh.tets),))
        share = 1 - (np.asarray(std, dtype=float) / before) ** 2
        known = material_scene(
            mesh, share, "share of variance", UNCERTAINTY, next_touch, (0.0, 1.0)
        )
        panels.append((known, "identified"))
    return pictures(panels, out)


def figure_gallery(
    plants: Iterable[Any] | Mapping[str, Any],
    out: str | os.PathLike[str],
    *,
    columns: int = 4,
) -> Path:
    """Draw solids and meshes (limbs in colours) and states (deformed) side by side.

    `plants`: `Solid`, `TetMesh` and `Equilibrium` values, or a mapping of titles to them;
    each to its own scale. Returns the path of the PNG.
    """
    if not isinstance(plants, Iterable) or isinstance(plants, str):
        raise ModelError(
            f"a gallery of one {type(plants).__name__}. Give a list of plants, or a "
            "mapping of titles to them."
        )
    named = plants.items() if isinstance(plants, Mapping) else [("", p) for p in plants]
    panels = [(_portrait(p), title) for title, p in named]
    if not panels:
        raise ModelError("an empty gallery. Give at least one mesh or state.")
    return pictures(panels, out, columns=columns, size=(480, 480))


def _portrait(plant: Any) -> Scene:
    if isinstance(plant, Equilibrium):
        return deformation_scene(plant, 1.0, False)
    return solid_scene(plant) if isinstance(plant, Solid) else limbs_scene(plant)


def animate_touch(
    states: Iterable[Equilibrium],
    out: str | os.PathLike[str],
    *,
    scale: float = 1.0,
    forces: bool = True,
    back: bool = True,
    size: tuple[int, int] = (600, 600),
) -> Path:
    """Draw states of one plant as the frames of an animated .gif or .mp4; return its path.

    With `back` they are played forth and back. The camera stays, fitted to all frames.
    `size` in pixels, even numbers.
    """
    frames = checked_all(states, Equilibrium, "animate_touch")
    scenes = [deformation_scene(state, scale, forces) for state in frames]
    if not scenes:
        raise ModelError("an animation without a state. Give at least one.")
    return film(scenes, out, back=back, size=size)
