"""Green woods, and some stems, by name, with their sources."""

import tomllib
from functools import cache
from importlib import resources
from typing import Any

from plantsim.elastic.material import Material
from plantsim.errors import MaterialError

POISSON = 0.3


@cache
def _table() -> dict[str, dict[str, Any]]:
    file = resources.files("plantsim.elastic").joinpath("wood.toml")
    return tomllib.loads(file.read_text(encoding="utf-8"))


def wood_names() -> tuple[str, ...]:
    """Return the names that `wood` knows."""
    return tuple(_table())


def wood(name: str, *, poisson: float = POISSON) -> Material:
    """Return a green wood or a stem: modulus along it, density, breaking stress in bending.

    Values and sources stand in wood.toml, next to this file; a living limb of juvenile wood
    is often softer, by a third and more. Raises MaterialError for a name not known.

    >>> float(wood("apple").strength) / 1e6
    51.0
    """
    found = _table().get(name.lower().replace(" ", "_"))
    if found is None:
        raise MaterialError(
            f"no wood {name!r}; there are: {', '.join(wood_names())}. Or give "
            "Material(young, poisson, density, strength=...)."
        )
    return Material(found["young"], poisson, found["density"], strength=found["strength"])
