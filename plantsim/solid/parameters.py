"""Values that a caller gives to a gmsh script: put in place of those it sets itself."""

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from plantsim.arrays import few
from plantsim.errors import FileError
from plantsim.solid.geo_script import FILES, TOKEN, check_string

OPEN, CLOSE = "([{", ")]}"
NAME = re.compile(r"[A-Za-z_]\w*")


class _Place(NamedTuple):
    """Where a script first gives a value to a name."""

    start: int
    end: int
    kind: str  # "number" or "string"


def with_parameters(path: Path, parameters: Mapping[str, float | str]) -> str:
    """Return the script's text with the first value of each named parameter replaced.

    A parameter is a name that the script sets outside braces, `L = 1;`, or in a
    `DefineConstant[ ... ]`; what includes set is not changed. Files that it includes are
    named in full, as the text will lie elsewhere. Raises FileError for names that the
    script does not set and values that it could not hold.
    """
    text = path.read_bytes().decode("latin-1")
    places = _places(text)
    edits = _full_names(path, text)
    for name, value in parameters.items():
        if name not in places:
            raise FileError(
                f"{path}: it sets no parameter {name!r} (it sets: "
                f"{few(places, 12) or 'none'}). Name one of these."
            )
        place = places[name]
        edits.append((place.start, place.end, _written(path, name, value, place.kind)))
    for start, end, new in sorted(edits, reverse=True):
        text = text[:start] + new + text[end:]
    return text


def _written(path: Path, name: str, value: float | str, kind: str) -> str:
    if isinstance(value, str):
        if kind != "string" or '"' in value or not value.isprintable():
            raise FileError(
                f"{path}: parameter {name} = {value!r}; give a {kind}"
                + (" of printable characters without quotes." if kind == "string" else ".")
            )
        check_string(path, f'"{value}"')
        return f'"{_bytes(value)}"'
    number = not isinstance(value, bool) and hasattr(value, "__float__")
    if kind != "number" or not number or not math.isfinite(value):
        raise FileError(f"{path}: parameter {name} = {value!r}; give a finite {kind}.")
    return repr(float(value))


def _bytes(text: str) -> str:
    """Return text as the script's text is held: a character for every byte of its UTF-8."""
    return text.encode().decode("latin-1")


def _tokens(text: str) -> list[tuple[str, str, int, int]]:
    return [
        (m.lastgroup or "", m.group(), m.start(), m.end())
        for m in TOKEN.finditer(text)
        if m.lastgroup != "comment" and not m.group().isspace()
    ]


def _places(text: str) -> dict[str, _Place]:
    """Return the first place of every name that gets a value, by name."""
    places: dict[str, _Place] = {}
    tokens = _tokens(text)
    depth, constants = 0, 0  # depth within the brackets of a DefineConstant, if any
    for i, (kind, value, _, _) in enumerate(tokens):
        if kind == "other" and value in OPEN:
            depth += 1
            if i and tokens[i - 1][1] == "DefineConstant":
                constants = depth
        elif kind == "other" and value in CLOSE:
            constants = 0 if depth == constants else constants
            depth -= 1
        before = tokens[i - 1][1] if i else ";"
        starts = before in ";}" if not depth else depth == constants and before in "[(,"
        if kind != "word" or not starts or [t[1] for t in tokens[i + 1 : i + 2]] != ["="]:
            continue
        end = _end(tokens, i + 2)
        if end > i + 2 and tokens[i + 2][1] != "=" and value not in places:
            first = tokens[i + 2]
            inner = tokens[i + 3] if first[1] == "{" and depth else first
            places[value] = _Place(
                first[2], tokens[end - 1][3], "string" if inner[0] == "string" else "number"
            )
    return places


def _end(tokens: list[tuple[str, str, int, int]], i: int) -> int:
    """Return the index of the token that ends the value beginning at token i."""
    depth = 0
    while i < len(tokens):
        kind, value = tokens[i][:2]
        if kind == "other" and value in OPEN:
            depth += 1
        elif kind == "other" and value in CLOSE:
            depth -= 1
        if depth < 0 or (not depth and kind == "other" and value in ";,"):
            return i
        i += 1
    return i


def _full_names(path: Path, text: str) -> list[tuple[int, int, str]]:
    """Return edits that give the files which a script reads by plain name in full."""
    edits = []
    tokens = _tokens(text)
    for i, (kind, value, _, _) in enumerate(tokens):
        if kind == "word" and value in FILES:
            after = tokens[i + 1 : i + 3]
            for k, (what, name, start, end) in enumerate(after):
                if what == "string" and (k == 0 or after[0][1] in "(["):
                    full = str(path.parent.resolve() / name[1:-1])
                    if '"' in full or not full.isprintable():
                        raise FileError(
                            f"{path}: no parameters can be given in a folder with quotes "
                            "in its name. Move the script."
                        )
                    check_string(path, f'"{full}"')
                    edits.append((start, end, f'"{_bytes(full)}"'))
                    break
    return edits
