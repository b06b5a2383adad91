"""The exception family: what was wrong, the number seen, and what to do."""

import importlib
from collections.abc import Iterable
from typing import Any, TypeVar

K = TypeVar("K")


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


# how to get what is wanted, from what was given instead or from nothing
_WAYS = {
    ("Skeleton", "Solid"): "ps.sweep(skeleton)",
    ("Skeleton", "TetMesh"): "ps.tetrahedralize(ps.sweep(skeleton))",
    ("Solid", "TetMesh"): "ps.tetrahedralize(solid)",
    ("ElasticModel", "TetMesh"): "model.mesh",
    ("Equilibrium", "TetMesh"): "state.model.mesh",
    ("Equilibrium", "ElasticModel"): "state.model",
    ("Estimate", "TetMesh"): "found.model.mesh",
    ("Estimate", "ElasticModel"): "found.model",
    ("", "Skeleton"): "one of ps.weber_penn(...) or ps.read_skeleton(path)",
    ("", "Solid"): "one of ps.sweep(skeleton)",
    ("", "TetMesh"): "one of ps.tetrahedralize(solid) or ps.read_mesh(path)",
    ("", "ElasticModel"): "one of ps.ElasticModel(mesh, material)",
    ("", "Equilibrium"): "one of model.solve(...)",
    ("", "Observation"): "one of ps.observe(model, touch) or ps.read_observations(path)",
}


def check_kind(
    value: object,
    kind: type[K],
    who: str,
    error: type[PlantsimError] = ModelError,
    hint: str = "",
) -> K:
    """Return a value of a kind; raise `error`, with what to give instead, for others."""
    if isinstance(value, kind):
        return value
    given, wanted = type(value).__name__, kind.__name__
    way = _WAYS.get((given, wanted)) or _WAYS.get(("", wanted), "one")
    raise error(f"{who} takes {_a(wanted)}, not {_a(given)}. {hint}Give {way}.")


def checked_all(
    values: Any, kind: type, who: str, error: type[PlantsimError] = ModelError
) -> list[Any]:
    """Return values of a kind as a list; `error` where they are of another, or only one."""
    if isinstance(values, kind) or not isinstance(values, Iterable):
        given, wanted = type(values).__name__, kind.__name__
        raise error(f"{who} takes several {wanted}, not {_a(given)}. Give a list of them.")
    found = list(values)
    for value in found:
        check_kind(value, kind, who, error)
    return found


def _a(noun: str) -> str:
    return f"{'an' if noun[0] in 'AEIOU' else 'a'} {noun}"
