"""plantsim: grow plants, make them solid, bend them, learn their stiffness from touches.

    Skeleton -> Solid -> TetMesh -> ElasticModel -> Equilibrium -> Observation -> Estimate

Every public name is here; its module is imported when the name is first used, so that
`import plantsim` itself loads numpy and scipy only.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from plantsim.datasets.generate import dataset as dataset
    from plantsim.datasets.reading import Dataset as Dataset
    from plantsim.datasets.reading import open_dataset as open_dataset
    from plantsim.datasets.recipe import Recipe as Recipe
    from plantsim.elastic.detachment import Detachment as Detachment
    from plantsim.elastic.detachment import detachment as detachment
    from plantsim.elastic.detachment import fruit_names as fruit_names
    from plantsim.elastic.equilibrium import Equilibrium as Equilibrium
    from plantsim.elastic.files import write_state as write_state
    from plantsim.elastic.files import write_states as write_states
    from plantsim.elastic.loads import force as force
    from plantsim.elastic.loads import hang as hang
    from plantsim.elastic.loads import hold as hold
    from plantsim.elastic.loads import move as move
    from plantsim.elastic.loads import traction as traction
    from plantsim.elastic.material import Material as Material
    from plantsim.elastic.model import ElasticModel as ElasticModel
    from plantsim.elastic.modes import modes as modes
    from plantsim.elastic.weight import gravity as gravity
    from plantsim.elastic.wood import wood as wood
    from plantsim.elastic.wood import wood_names as wood_names
    from plantsim.errors import BreakageWarning as BreakageWarning
    from plantsim.errors import DatasetError as DatasetError
    from plantsim.errors import DependencyError as DependencyError
    from plantsim.errors import EstimateError as EstimateError
    from plantsim.errors import FileError as FileError
    from plantsim.errors import GeometryError as GeometryError
    from plantsim.errors import MaterialError as MaterialError
    from plantsim.errors import MeshError as MeshError
    from plantsim.errors import ModelError as ModelError
    from plantsim.errors import PlantsimError as PlantsimError
    from plantsim.errors import SolverError as SolverError
    from plantsim.errors import StoppedWarning as StoppedWarning
    from plantsim.estimation.estimate import Estimate as Estimate
    from plantsim.estimation.estimate import estimate as estimate
    from plantsim.estimation.files import read_observations as read_observations
    from plantsim.estimation.files import write_observations as write_observations
    from plantsim.estimation.force_matrix import force_matrix as force_matrix
    from plantsim.estimation.next_touch import next_touch as next_touch
    from plantsim.estimation.observation import Observation as Observation
    from plantsim.estimation.observation import observe as observe
    from plantsim.estimation.parameters import features as features
    from plantsim.estimation.parameters import per_element as per_element
    from plantsim.estimation.parameters import per_limb as per_limb
    from plantsim.estimation.parameters import per_region as per_region
    from plantsim.estimation.prediction import predict as predict
    from plantsim.estimation.prediction import score as score
    from plantsim.mesh.files import read_mesh as read_mesh
    from plantsim.mesh.files import write_mesh as write_mesh
    from plantsim.mesh.surfaces import write_surface as write_surface
    from plantsim.mesh.tetmesh import TetMesh as TetMesh
    from plantsim.plant.files import read_skeleton as read_skeleton
    from plantsim.plant.files import write_skeleton as write_skeleton
    from plantsim.plant.hung import Masses as Masses
    from plantsim.plant.parameters import WeberPenn as WeberPenn
    from plantsim.plant.parameters import species as species
    from plantsim.plant.parameters import species_names as species_names
    from plantsim.plant.simple import fork as fork
    from plantsim.plant.simple import straight as straight
    from plantsim.plant.simple import tapered as tapered
    from plantsim.plant.simple import whorl as whorl
    from plantsim.plant.simple import zigzag as zigzag
    from plantsim.plant.skeleton import Limb as Limb
    from plantsim.plant.skeleton import Skeleton as Skeleton
    from plantsim.plant.weber_penn import weber_penn as weber_penn
    from plantsim.solid.sweep import Solid as Solid
    from plantsim.solid.sweep import sweep as sweep
    from plantsim.solid.tetrahedralize import tetrahedralize as tetrahedralize
    from plantsim.solve.direct import Direct as Direct
    from plantsim.solve.multigrid import Multigrid as Multigrid
    from plantsim.touch.grasp import grasp as grasp
    from plantsim.touch.grasp import nearest_vertices as nearest_vertices
    from plantsim.touch.sequences import lowest as lowest
    from plantsim.touch.sequences import sample_touches as sample_touches
    from plantsim.view.figures import animate_touch as animate_touch
    from plantsim.view.figures import figure_deformation as figure_deformation
    from plantsim.view.figures import figure_gallery as figure_gallery
    from plantsim.view.figures import figure_material as figure_material
    from plantsim.view.figures import figure_mesh as figure_mesh
    from plantsim.view.figures import figure_posterior as figure_posterior
    from plantsim.view.figures import figure_solid as figure_solid
    from plantsim.view.figures import figure_touch as figure_touch
    from plantsim.view.plots import figure_convergence as figure_convergence
    from plantsim.view.plots import figure_ratios as figure_ratios
    from plantsim.view.plots import figure_table_one as figure_table_one
    from plantsim.view.quality import figure_quality as figure_quality
    from plantsim.view.skeletons import figure_skeleton as figure_skeleton
    from plantsim.view.visibility import Camera as Camera
    from plantsim.view.visibility import visible_vertices as visible_vertices

__version__ = "0.1.0"

_HOME = {
    "plantsim.elastic.detachment": ("Detachment", "detachment", "fruit_names"),
    "plantsim.datasets.generate": ("dataset",),
    "plantsim.datasets.reading": ("Dataset", "open_dataset"),
    "plantsim.datasets.recipe": ("Recipe",),
    "plantsim.elastic.equilibrium": ("Equilibrium",),
    "plantsim.elastic.files": ("write_state", "write_states"),
    "plantsim.elastic.loads": ("force", "hang", "hold", "move", "traction"),
    "plantsim.elastic.material": ("Material",),
    "plantsim.elastic.model": ("ElasticModel",),
    "plantsim.elastic.modes": ("modes",),
    "plantsim.elastic.weight": ("gravity",),
    "plantsim.elastic.wood": ("wood", "wood_names"),
    "plantsim.errors": (
        "BreakageWarning",
        "DatasetError",
        "DependencyError",
        "EstimateError",
        "FileError",
        "GeometryError",
        "MaterialError",
        "MeshError",
        "ModelError",
        "PlantsimError",
        "SolverError",
        "StoppedWarning",
    ),
    "plantsim.estimation.estimate": ("Estimate", "estimate"),
    "plantsim.estimation.force_matrix": ("force_matrix",),
    "plantsim.estimation.files": ("read_observations", "write_observations"),
    "plantsim.estimation.next_touch": ("next_touch",),
    "plantsim.estimation.prediction": ("predict", "score"),
    "plantsim.estimation.observation": ("Observation", "observe"),
    "plantsim.estimation.parameters": (
        "features",
        "per_element",
        "per_limb",
        "per_region",
    ),
    "plantsim.mesh.files": ("read_mesh", "write_mesh"),
    "plantsim.mesh.surfaces": ("write_surface",),
    "plantsim.mesh.tetmesh": ("TetMesh",),
    "plantsim.plant.simple": ("fork", "straight", "tapered", "whorl", "zigzag"),
    "plantsim.plant.skeleton": ("Limb", "Skeleton"),
    "plantsim.plant.files": ("read_skeleton", "write_skeleton"),
    "plantsim.plant.hung": ("Masses",),
    "plantsim.plant.parameters": ("WeberPenn", "species", "species_names"),
    "plantsim.plant.weber_penn": ("weber_penn",),
    "plantsim.solid.sweep": ("Solid", "sweep"),
    "plantsim.solid.tetrahedralize": ("tetrahedralize",),
    "plantsim.solve.direct": ("Direct",),
    "plantsim.solve.multigrid": ("Multigrid",),
    "plantsim.touch.grasp": ("grasp", "nearest_vertices"),
    "plantsim.touch.sequences": ("lowest", "sample_touches"),
    "plantsim.view.figures": (
        "animate_touch",
        "figure_deformation",
        "figure_gallery",
        "figure_material",
        "figure_mesh",
        "figure_posterior",
        "figure_solid",
        "figure_touch",
    ),
    "plantsim.view.plots": ("figure_convergence", "figure_ratios", "figure_table_one"),
    "plantsim.view.quality": ("figure_quality",),
    "plantsim.view.skeletons": ("figure_skeleton",),
    "plantsim.view.visibility": ("Camera", "visible_vertices"),
}
_MODULE = {name: module for module, names in _HOME.items() for name in names}

__all__ = sorted([*_MODULE, "__version__"])  # noqa: PLE0605


def __getattr__(name: str) -> Any:
    module = _MODULE.get(name)
    if module is None:
        raise AttributeError(f"module 'plantsim' has no attribute {name!r}")
    value = getattr(importlib.import_module(module), name)
    globals()[name] = value  # the next look-up finds it at once
    return value


def __dir__() -> list[str]:
    return list(__all__)
