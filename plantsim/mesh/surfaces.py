"""Surfaces out: .ply, .obj, .stl and .glb for renderers and printers (trimesh's home)."""

import os
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from plantsim.arrays import frozen
from plantsim.errors import FileError, ModelError, check_kind, needs
from plantsim.mesh.tetmesh import TetMesh
from plantsim.paths import replacing, writable

SURFACES = (".ply", ".obj", ".stl", ".glb")
# glTF is in metres with y up (Khronos, glTF 2.0, section 3.4), plants have z up
Y_UP = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])


@runtime_checkable
class Bent(Protocol):
    """A plant that is bent, as an Equilibrium is."""

    @property
    def model(self) -> Any:
        """The model, which has the mesh."""
        ...

    @property
    def displacement(self) -> Any:
        """Where its vertices went, (n, 3) [m]."""
        ...


def write_surface(
    mesh: TetMesh | Bent,
    path: str | os.PathLike[str],
    *,
    displacement: ArrayLike | None = None,
    scale: float = 1.0,
    colours: ArrayLike | None = None,
) -> Path:
    """Write the outer surface to .ply, .obj, .stl or .glb, in metres; return the path.

    `displacement` (n, 3) [m], times `scale`, bends it first; an Equilibrium in place of the
    mesh brings its own. Curved faces go as four flat
    triangles. `colours` (n, 3), 0 to 255, one a vertex, are kept by .ply and .glb. Vertices
    are `mesh.surface_vertices`, in that order (.stl has no vertices, only triangles). A
    .glb has y up, as its standard asks; the others z.

    Raises FileError for another suffix and DependencyError where trimesh is not installed.
    """
    path = writable(path, *SURFACES)
    suffix = path.suffix.lower()
    if isinstance(mesh, Bent) and not callable(mesh.displacement):  # as a contact's is
        if displacement is not None:
            raise ModelError(
                "a state and a displacement. Give one of them: write_surface(state, path), "
                "or write_surface(state.model.mesh, path, displacement=...)."
            )
        mesh, displacement = mesh.model.mesh, mesh.displacement
    mesh = check_kind(mesh, TetMesh, "write_surface", FileError)
    on = mesh.surface_vertices
    points = mesh.points[on]
    if displacement is not None:
        shape = mesh.points.shape
        u = frozen(displacement, shape, name="displacement", error=ModelError)
        points = points + scale * u[on]
    if suffix == ".glb":
        points = points @ Y_UP.T
    rgb = None
    if colours is not None:
        if suffix not in (".ply", ".glb"):
            raise FileError(f"{path}: {suffix} has no colours. Write a .ply or a .glb.")
        shape = mesh.points.shape
        rgb = frozen(colours, shape, name="colours", error=ModelError)[on].astype(np.uint8)
    faces = np.searchsorted(on, mesh.triangles)
    surface = needs("trimesh", "io").Trimesh(
        points, faces, vertex_colors=rgb, process=False
    )
    with replacing(path) as temporary:
        surface.export(temporary, file_type=suffix[1:])
    return path
