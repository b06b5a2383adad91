"""Detachment: what it takes to part a fruit from its limb."""

from dataclasses import dataclass

from plantsim.errors import ModelError


@dataclass(frozen=True)
class Detachment:
    """A pull and a turn, each of which alone parts a fruit from its limb."""

    force: float  # [N], along the stalk
    torque: float  # [N m], about the abscission layer
    source: str

    def parts(self, force: float, torque: float = 0.0) -> bool:
        """Return whether a pull [N] and a turn [N m] together part them.

        By the sum of their shares, which is on the safe side where they do not help each
        other.
        """
        return abs(force) / self.force + abs(torque) / self.torque >= 1


# One fruit so far: of others no figure was found whose source could be read
_KNOWN = {
    "apple": Detachment(
        47.0,
        0.05,
        "Journal of the Japanese Society of Agricultural Machinery 61(1), 131 (1999): "
        "tensile strength between peduncle and absciss layer about 47 N, rotational "
        "strength about 0.05 N m",
    )
}


def detachment(fruit: str) -> Detachment:
    """Return what parts a fruit from its limb, with its source.

    Raises ModelError for a fruit not known: give a `Detachment` of your own measurements.

    >>> detachment("apple").force
    47.0
    """
    found = _KNOWN.get(fruit)
    if found is None:
        raise ModelError(
            f"no detachment force of {fruit!r}; there are: {', '.join(_KNOWN)}. Measure "
            "it, and give Detachment(force, torque, source)."
        )
    return found
