"""What an entry of a recipe may be: a rule returns it settled, or says what is wrong."""

import difflib
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields
from typing import Any, NoReturn

import numpy as np

from plantsim.errors import DatasetError

Rule = Callable[[str, Any], Any]


@dataclass(frozen=True)
class Span:
    """A range that is drawn from; equal ends are a constant."""

    low: float
    high: float

    def draw(self, rng: np.random.Generator) -> float:
        """Return a number between the ends, all alike."""
        return float(rng.uniform(self.low, self.high))

    def draw_log(self, rng: np.random.Generator) -> float:
        """Return a number between the ends, all orders of size alike."""
        return float(np.exp(rng.uniform(np.log(self.low), np.log(self.high))))

    def draw_whole(self, rng: np.random.Generator) -> int:
        """Return a whole number from low to high, both included."""
        return int(rng.integers(int(self.low), int(self.high) + 1))

    def plain(self) -> list[float]:
        """Return the ends, as a recipe writes them."""
        return [self.low, self.high]


def refuse(where: str, value: Any, want: str) -> NoReturn:
    """Raise DatasetError that names the entry, the value seen and what is allowed."""
    raise DatasetError(f"{where} is {value!r}: allowed is {want}. Mend that entry.")


def number(low: float = -math.inf, high: float = math.inf, *, above: bool = False) -> Rule:
    """Return the rule of a number from low (not itself with `above`) to high."""
    want = f"a number {_limits(low, high, above)}"

    def rule(where: str, value: Any) -> float:
        if not _plain_number(value) or not _within(value, low, high, above):
            refuse(where, value, want)
        return float(value)

    return rule


def whole(low: int, high: int) -> Rule:
    """Return the rule of a whole number from low to high."""

    def rule(where: str, value: Any) -> int:
        good = _plain_number(value) and float(value).is_integer()
        if not good or not low <= value <= high:
            refuse(where, value, f"a whole number from {low} to {high}")
        return int(value)

    return rule


def span(low: float, high: float, *, above: bool = False, integers: bool = False) -> Rule:
    """Return the rule of a number or a pair [low, high] to draw from."""
    kind = "a whole number" if integers else "a number"
    want = f"{kind} {_limits(low, high, above)}, or two as [low, high]"

    def rule(where: str, value: Any) -> Span:
        if isinstance(value, Span):
            value = value.plain()
        pair = value if isinstance(value, (list, tuple)) else [value, value]
        good = len(pair) == 2 and all(map(_plain_number, pair)) and pair[0] <= pair[1]
        if not good or not all(_within(v, low, high, above) for v in pair):
            refuse(where, value, want)
        if integers and not all(float(v).is_integer() for v in pair):
            refuse(where, value, want)
        cast = int if integers else float
        return Span(cast(pair[0]), cast(pair[1]))

    return rule


def one_of(*allowed: Any) -> Rule:
    """Return the rule of a value out of a few."""

    def rule(where: str, value: Any) -> Any:
        if value not in allowed or isinstance(value, bool) != isinstance(allowed[0], bool):
            refuse(where, value, " or ".join(map(repr, allowed)))
        return value

    return rule


def text(where: str, value: Any) -> str:
    """Settle a name: letters, digits, space and _ - . only."""
    good = isinstance(value, str) and 0 < len(value) <= 60
    if not good or not all(c.isalnum() or c in " _-." for c in value):
        refuse(where, value, "a name of 1 to 60 letters, digits, spaces and _ - .")
    return value


def settle(value: Any, where: str, rules: Mapping[str, Rule]) -> None:
    """Put each field of a frozen value through its rule, in `__post_init__`."""
    for f in fields(value):
        if f.name in rules:
            at = f"{where}{f.name}"
            object.__setattr__(value, f.name, rules[f.name](at, getattr(value, f.name)))


def known(values: Any, names: Iterable[str], where: str) -> dict[str, Any]:
    """Return a table whose names are all known; else name the nearest that is."""
    names = list(names)
    if not isinstance(values, Mapping):
        refuse(where.rstrip(".") or "the recipe", values, "a table")
    for name in values:
        if name not in names:
            near = difflib.get_close_matches(str(name), names, 1)
            hint = f"did you mean {near[0]}? There are" if near else "there are"
            raise DatasetError(
                f"{where}{name} is not an entry of a recipe; {hint}: "
                f"{', '.join(sorted(names))}. Mend or drop it."
            )
    return dict(values)


def _plain_number(value: Any) -> bool:
    kinds = (int, float, np.integer, np.floating)
    return isinstance(value, kinds) and not isinstance(value, bool) and math.isfinite(value)


def _within(value: float, low: float, high: float, above: bool) -> bool:
    return (low < value if above else low <= value) and value <= high


def _limits(low: float, high: float, above: bool) -> str:
    least = f"above {low:g}" if above else f"from {low:g}"
    if math.isinf(low):
        least = "that is finite"
    return (
        least
        if math.isinf(high)
        else f"{least} {'and at most' if above else 'to'} {high:g}"
    )
