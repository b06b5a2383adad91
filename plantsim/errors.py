"""The exception family: what was wrong, the number seen, and what to do."""

import importlib
from typing import Any


class PlantsimError(Exception):
    """Any error that plantsim raises on purpose."""


class GeometryError(PlantsimError, ValueError):
    """A skeleton or solid that cannot be swept or meshed."""


class MeshError(PlantsimError, ValueError):
    """A mesh that no finite element method can use, or a mesher that failed."""


class FileError(PlantsimError, ValueError):
    """A file that is missing, broken, foreign, or that would run code."""


class MaterialError(PlantsimError, ValueError):
    """Moduli or densities that no stable solid has."""


class ModelError(PlantsimError, ValueError):
    """Supports, loads or moved vertices that make no well-posed problem."""


class SolverError(PlantsimError, RuntimeError):
    """A solve that did not reach its backward error."""


class EstimateError(PlantsimError, ValueError):
    """Observations or options from which nothing can be estimated."""


class DatasetError(PlantsimError, ValueError):
    """A recipe that cannot be followed, or a data set that could not be finished."""


class DependencyError(PlantsimError, ImportError):
    """An optional package or a system library that is not installed."""


class StoppedWarning(UserWarning):
    """A load was carried in part only; the state's stats tell how much."""


class BreakageWarning(UserWarning):
    """A state in which a limb would break."""


def needs(package: str, extra: str, instead: str = "") -> Any:
    """Return an optional package; DependencyError, with the pip line, where absent.

    `instead`: what else to do.
    """
    try:
        return importlib.import_module(package)
    except ImportError as why:
        raise DependencyError(
            f"{package} cannot be imported ({why}). Run: pip install 'plantsim[{extra}]'"
            f"{f', or {instead}' if instead else ''}"
        ) from None
