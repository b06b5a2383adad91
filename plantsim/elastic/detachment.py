"""Detachment: what it takes to part a fruit from its limb."""

from dataclasses import dataclass

from plantsim.errors import ModelError


@dataclass(frozen=True)
class Detachment:
    """A pull and a turn, each of which alone parts a fruit from its limb."""

    force: float  # [N], along the stalk
    torque: float | None  # [N m], about the abscission layer; None where it is not known
    source: str

    def parts(self, force: float, torque: float = 0.0) -> bool:
        """Return whether a pull [N] and a turn [N m] together part them.

        By the sum of their shares, which is on the safe side where they do not help each
        other. Raises ModelError for a turn where the torque is not known.
        """
        share = abs(force) / self.force
        if torque:
            if self.torque is None:
                raise ModelError(
                    "detachment: no torque is known for this fruit. Measure it, and give "
                    "Detachment(force, torque, source)."
                )
            share += abs(torque) / self.torque
        return share >= 1


# Only figures that stand in what could be read of the source: most often its abstract
_KNOWN = {
    "apple": Detachment(
        47.0,
        0.05,
        "Journal of the Japanese Society of Agricultural Machinery 61(1), 131 (1999): "
        "tensile strength between peduncle and absciss layer about 47 N, rotational "
        "strength about 0.05 N m. Bu, Hu, Chen and others 2020, Scientia "
        "Horticulturae 261, 108937: 4.6 to 47.7 N by the angle of the pull ('Pink Lady')",
    ),
    "green_apple": Detachment(
        19.9,
        None,
        "Hussain, He, Schupp, Heinemann 2022, Journal of the ASABE 65(4), 779-788: fruit "
        "to be thinned, 19.91 N at the spur's end of the stem, 24.78 N at the fruit's",
    ),
    "cherry": Detachment(
        8.4,
        None,
        "Wirch, Kappel, Scheewe 2009, Journal of the American Pomological Society 63(3), "
        "108-114: sweet cherry from its pedicel, means of cultivars from 655 to 1061 g; "
        "the middle of these",
    ),
    "orange": Detachment(
        66.6,
        None,
        "Fruit abscission pattern of 'Valencia' orange with canopy shaker system, Scientia "
        "Horticulturae 246 (2019), 916-920: mean pull 66.6 N where the stem parts, 88.7 N "
        "at the calyx, 99.3 N where the peel tears",
    ),
    "cherry_tomato": Detachment(
        1.5,
        None,
        "Xie, Kong, Shan, Xu 2021, Agriculture 11(9), 815: 0.58 to 2.46 N at the calyx, by "
        "the angles of the pull; the middle of these",
    ),
    "strawberry": Detachment(
        4.9,
        None,
        "Miyazaki, Miyaka, Yabuuchi 1978, Nippon Shokuhin Kogyo Gakkaishi 25(9), 496-501: "
        "from its calyx, over 500 g for table strawberries, so a lower bound",
    ),
}


def fruit_names() -> tuple[str, ...]:
    """Return the names that `detachment` knows."""
    return tuple(_KNOWN)


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
