"""What a camera sees of a mesh: rays from every surface vertex to the camera, by VTK."""

import importlib.util
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from plantsim.arrays import Array, frozen
from plantsim.errors import DependencyError, ModelError, check_kind
from plantsim.mesh.tetmesh import TetMesh

OFF = 1e-4  # rays start this share of the mesh's size off the surface


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera that looks from `position` at `target`."""

    position: Array  # (3,) [m]
    target: Array  # (3,) [m]
    angle: float = 60.0  # full angle of view [degrees], of a cone

    def __post_init__(self) -> None:
        for name in ("position", "target"):
            value = frozen(getattr(self, name), (3,), name=name, error=ModelError)
            object.__setattr__(self, name, value)
        if not 0 < self.angle < 180 or np.array_equal(self.position, self.target):
            raise ModelError(
                f"camera at {self.position}, looking at {self.target}, angle {self.angle}; "
                "give two points that differ and an angle between 0 and 180 degrees."
            )


def visible_vertices(
    mesh: TetMesh, camera: Camera | ArrayLike, *, points: Array | None = None
) -> Array:
    """Return ids of the surface vertices that a camera sees, ascending.

    `camera`: a `ps.Camera`, or its position (3,) [m] alone if it has all in view. `points`
    (n, 3): where the vertices are, if not at rest. A vertex is hidden where the plant is in
    the way or its surface is turned away. Needs the extra `view`.
    """
    check_kind(mesh, TetMesh, "visible_vertices")
    x = mesh.points if points is None else np.asarray(points, dtype=float)
    on = mesh.surface_vertices
    if isinstance(camera, Camera):
        eye = camera.position
        axis = camera.target - eye
        way = x[on] - eye
        along = way @ axis / np.linalg.norm(axis)
        inside = along > np.cos(np.radians(camera.angle / 2)) * np.linalg.norm(way, axis=1)
        on = on[inside]
    else:
        eye = frozen(camera, (3,), name="camera", error=ModelError)
    if not len(on):
        return on
    span = float(np.ptp(x, axis=0).max())
    tree = _tree(x, mesh.triangles)
    to_eye = eye - x[on]
    distance = np.linalg.norm(to_eye, axis=1)
    start = x[on] + to_eye * (OFF * span / np.maximum(distance, 1e-300))[:, None]
    free = [not tree.IntersectWithLine(p, eye, None, None) for p in start]
    return on[np.array(free)]


def _tree(points: Array, triangles: Array) -> Any:
    if importlib.util.find_spec("vtkmodules") is None:
        raise DependencyError(
            "what a camera sees needs VTK. Run: pip install 'plantsim[view]'"
        )
    from vtkmodules.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray  # noqa: PLC0415
    from vtkmodules.vtkCommonCore import vtkPoints  # noqa: PLC0415
    from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPolyData  # noqa: PLC0415
    from vtkmodules.vtkFiltersGeneral import vtkOBBTree  # noqa: PLC0415

    at = vtkPoints()
    at.SetData(numpy_to_vtk(np.ascontiguousarray(points), deep=True))
    cells = vtkCellArray()
    cells.SetData(
        numpy_to_vtkIdTypeArray(np.arange(0, triangles.size + 1, 3), deep=True),
        numpy_to_vtkIdTypeArray(np.ascontiguousarray(triangles.ravel()), deep=True),
    )
    skin = vtkPolyData()
    skin.SetPoints(at)
    skin.SetPolys(cells)
    tree = vtkOBBTree()
    tree.SetDataSet(skin)
    tree.BuildLocator()
    return tree
