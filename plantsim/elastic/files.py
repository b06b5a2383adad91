"""States out: one as .vtu or as a deformed surface, a sequence as a .pvd."""

import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from plantsim.elastic.equilibrium import Equilibrium
from plantsim.errors import FileError, check_kind, checked_all
from plantsim.mesh.files import write_mesh
from plantsim.mesh.surfaces import SURFACES, write_surface
from plantsim.paths import replacing, writable


def write_state(
    state: Equilibrium, path: str | os.PathLike[str], *, scale: float = 1.0
) -> Path:
    """Write a state to a .vtu, or its deformed surface to .ply, .obj, .stl or .glb.

    A .vtu is at rest, with units in the names: point data "displacement [m]" (warp by it in
    ParaView) and "force [N]"; cell data "young [Pa]", "poisson", "density [kg/m^3]",
    "stress [Pa]" (nine components) and "von_mises [Pa]"; regions and sets as in
    `write_mesh`. A surface is bent by the displacement times `scale`.
    """
    hint = "Meshes go by ps.write_mesh. "
    check_kind(state, Equilibrium, "write_state", FileError, hint)
    path = writable(path, ".vtu", *SURFACES)
    mesh = state.model.mesh
    if path.suffix.lower() != ".vtu":
        return write_surface(mesh, path, displacement=state.displacement, scale=scale)
    material, count = state.model.material, len(mesh.tets)
    return write_mesh(
        mesh,
        path,
        point_data={"displacement [m]": state.displacement, "force [N]": state.force},
        cell_data={
            "young [Pa]": np.broadcast_to(material.young, (count,)),
            "poisson": np.broadcast_to(material.poisson, (count,)),
            "density [kg/m^3]": np.broadcast_to(material.density, (count,)),
            "stress [Pa]": state.stress,
            "von_mises [Pa]": state.von_mises,
        },
    )


def write_states(
    states: Iterable[Equilibrium],
    path: str | os.PathLike[str],
    *,
    times: Sequence[float] | None = None,
) -> Path:
    """Write a sequence of states to a .pvd, which ParaView plays; return its path.

    Its frames are .vtu files in the folder NAME_frames beside it. `times`: one a state,
    ascending; 0, 1, 2, ... where None.
    """
    path = writable(path, ".pvd")
    frames = checked_all(states, Equilibrium, "write_states", FileError)
    at = np.arange(len(frames), dtype=float) if times is None else np.asarray(times, float)
    if not frames or at.shape != (len(frames),) or not (np.diff(at) > 0).all():
        raise FileError(
            f"{path}: {len(frames)} states with {at.size} times. Give at least one state, "
            "and one time for each, ascending."
        )
    folder = path.with_name(f"{path.stem}_frames")
    folder.mkdir(exist_ok=True)
    lines = []
    for i, (state, t) in enumerate(zip(frames, at, strict=True)):
        file = write_state(state, folder / f"{i:05d}.vtu")
        name = quoteattr(f"{folder.name}/{file.name}")
        lines.append(f'    <DataSet timestep="{t:.17g}" part="0" file={name}/>')
    text = "\n".join(
        [
            '<?xml version="1.0"?>',
            '<VTKFile type="Collection" version="0.1" byte_order="LittleEndian">',
            "  <Collection>",
            *lines,
            "  </Collection>",
            "</VTKFile>\n",
        ]
    )
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return path
