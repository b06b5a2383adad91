"""WeberPenn: the parameters of the tree model under their published names."""

import difflib
import os
import re
import tomllib
from collections.abc import Mapping
from dataclasses import Field, dataclass, fields, replace
from functools import cache, cached_property
from importlib import resources
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np

from plantsim.errors import FileError, GeometryError
from plantsim.paths import existing, replacing

LEVELS = 4  # deeper levels reuse the values of the last
Four = tuple[float, float, float, float]
Rules = Literal["auto", "published", "tree-gen"]
TREE_GEN = {"g_scale": "scale", "g_scale_v": "scale_v"}  # that program's other names
# what that program takes where a file of its own leaves a name out, if not as we do
TREE_GEN_DEFAULTS: dict[str, Any] = {
    "base_size": (0.3, 0.02, 0.02, 0.02),
    "curve_res": (5, 5, 3, 1),
    "split_angle": (40.0, 0.0, 0.0, 0.0),
    "split_angle_v": (5.0, 0.0, 0.0, 0.0),
    "bend_v": (0.0, 50.0, 0.0, 0.0),
}
FOLIAGE = ("leaf_", "blossom_", "leaves", "bevel_res")  # pictures only, no stems
RULES = ("auto", "published", "tree-gen")


@dataclass(frozen=True)
class WeberPenn:
    """Parameters of the model under their published names in snake case.

    Lengths in m, angles in degrees; a name with `_v` is a half-width of uniform variation.
    Four values in a tuple are for the trunk, its branches, their branches, and all deeper
    levels; a shorter list is continued with its last value, a number stands for all four.

    The last block is of the reference program tree-gen, not of the paper. `rules` says
    whose rules hold where the two differ otherwise (docs/plants.md has the table):
    "published", "tree-gen", or "auto": tree-gen's when one of its own parameters is given
    (`tropism`, `bend_v`, `branch_dist`, `radius_mod`, or `base_size` by level).

    Raises GeometryError that names the value that is wrong and what is allowed.
    Source: J. Weber, J. Penn, "Creation and Rendering of Realistic Trees", SIGGRAPH 1995.

    >>> WeberPenn(scale=8, levels=2).with_(ratio=0.02).ratio
    0.02
    """

    shape: int = 7  # crown profile: 0 conical ... 7 tend flame, 8 pruning envelope
    scale: float = 13.0
    scale_v: float = 3.0
    levels: int = 3
    ratio: float = 0.015  # trunk radius / length
    ratio_power: float = 1.2
    flare: float = 0.6
    base_size: float | Four = 0.4  # bare fraction at the trunk's base; by level: tree-gen
    base_splits: int = 0
    scale0: float = 1.0  # "0Scale": trunk thickness
    scale0_v: float = 0.0
    z_scale: float = 1.0  # all heights times this
    z_scale_v: float = 0.0
    lobes: int = 0  # of the trunk's section, which stays round: docs/plants.md
    lobe_depth: float = 0.0  # their amplitude over the radius
    attraction_up: float = 0.5
    length: Four = (1.0, 0.3, 0.6, 0.0)
    length_v: Four = (0.0, 0.0, 0.0, 0.0)
    taper: Four = (1.0, 1.0, 1.0, 1.0)
    branches: Four = (1, 50, 30, 10)
    down_angle: Four = (0.0, 60.0, 45.0, 45.0)
    down_angle_v: Four = (0.0, -50.0, 10.0, 10.0)
    rotate: Four = (0.0, 140.0, 140.0, 77.0)
    rotate_v: Four = (0.0, 0.0, 0.0, 0.0)
    seg_splits: Four = (0.0, 0.0, 0.0, 0.0)
    split_angle: Four = (0.0, 0.0, 0.0, 0.0)
    split_angle_v: Four = (0.0, 0.0, 0.0, 0.0)
    curve_res: Four = (3, 5, 3, 1)
    curve: Four = (0.0, -40.0, -40.0, 0.0)
    curve_back: Four = (0.0, 0.0, 0.0, 0.0)
    curve_v: Four = (20.0, 50.0, 75.0, 0.0)
    prune_ratio: float = 0.0
    prune_width: float = 0.5
    prune_width_peak: float = 0.5
    prune_power_low: float = 0.5
    prune_power_high: float = 0.5
    tropism: tuple[float, float, float] | None = None  # takes attraction_up's place
    bend_v: Four = (0.0, 0.0, 0.0, 0.0)
    branch_dist: Four = (0.0, 0.0, 0.0, 0.0)  # 0 alternate, 1 opposite, above 1 whorls
    radius_mod: Four = (1.0, 1.0, 1.0, 1.0)
    rules: Rules = "auto"
    source: str = ""

    def __post_init__(self) -> None:
        for f in fields(self):
            if f.name not in ("rules", "source"):
                value = _whole(_checked(f, getattr(self, f.name)), f.type is int)
                object.__setattr__(self, f.name, value)
        for name, good, want in _allowed(self):
            if not good:
                raise GeometryError(
                    f"{name} is {getattr(self, name)!r}: allowed is {want}."
                )

    @cached_property
    def published(self) -> bool:
        """Whether the published rules hold, not the reference program's."""
        if self.rules != "auto":
            return self.rules == "published"
        return not (
            self.tropism is not None
            or any(self.bend_v)
            or any(self.branch_dist)
            or any(m != 1 for m in self.radius_mod)
            or isinstance(self.base_size, tuple)
        )

    @cached_property
    def bare(self) -> Four:
        """Bare fraction at a stem's base, by level; published: the trunk's only."""
        if isinstance(self.base_size, tuple):
            return self.base_size
        return (self.base_size, 0.0, 0.0, 0.0)

    def with_(self, **values: Any) -> Self:
        """Return the same parameters with some replaced."""
        return replace(self, **values)

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any]) -> Self:
        """Return the parameters in a mapping, by our names or tree-gen's.

        `g_scale` and `g_scale_v` are taken as `scale` and `scale_v`, `floor_splits` as so
        many trunks more than one, and what is for pictures only (leaves, blossoms, bevels)
        is passed over. A mapping with `g_scale` is that program's own: what it leaves out
        is as there. Raises GeometryError on a name that is not known, with the nearest that
        is.
        """
        known = {f.name for f in fields(cls)}
        out: dict[str, Any] = dict(TREE_GEN_DEFAULTS) if "g_scale" in values else {}
        extra = values.get("floor_splits", 0)
        if isinstance(extra, bool) or extra not in range(100):
            raise GeometryError(
                f"floor_splits is {extra!r}: allowed is a whole number from 0 to 99."
            )
        for name, value in values.items():
            own = TREE_GEN.get(name, name)
            if own in known:
                out[own] = tuple(value) if isinstance(value, (list, tuple)) else value
            elif name != "floor_splits" and not name.startswith(FOLIAGE):
                near = difflib.get_close_matches(name, known, 1)
                hint = f"; did you mean {near[0]}?" if near else "."
                raise GeometryError(
                    f"{name} is not a parameter of the model{hint} There are: "
                    f"{', '.join(sorted(known))}."
                )
        found = cls(**out)
        if extra:
            found = found.with_(branches=(1 + int(extra), *found.branches[1:]))
        return found

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Self:
        """Return the parameters in a TOML file; FileError says what is wrong in it."""
        file = existing(path)
        try:
            text = file.read_text(encoding="utf-8-sig")
            values = tomllib.loads(text)
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as why:
            raise FileError(f"{file}: not TOML ({why}). Mend that line.") from None
        try:
            return cls.from_mapping(values)
        except GeometryError as why:
            name = str(why).split(" ", 1)[0]
            names = "|".join([name, *(k for k, v in TREE_GEN.items() if v == name)])
            here = re.search(rf"^[ \t\[]*(?:{names})\b", text, re.MULTILINE)
            line = f", line {text.count(chr(10), 0, here.start()) + 1}" if here else ""
            raise FileError(f"{file}{line}: {why}") from None

    def write(self, path: str | os.PathLike[str]) -> Path:
        """Write the parameters to a TOML file that `read` takes; return its path."""
        lines = []
        for f in fields(self):
            value = getattr(self, f.name)
            if value is not None:
                lines.append(f"{f.name} = {_toml(value)}\n")
        with replacing(path) as temporary:
            temporary.write_text("".join(lines), encoding="utf-8")
        return Path(path)


def _toml(value: Any) -> str:
    if isinstance(value, tuple):
        return "[" + ", ".join(_toml(v) for v in value) + "]"
    if isinstance(value, str):
        text = value.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
        return f'"{text}"'
    return repr(value)


def _checked(f: Field[Any], value: Any) -> Any:
    """Return a field's number, or its numbers as a tuple."""
    if f.name == "tropism":
        return None if value is None else _numbers(f.name, value, 3, 3)
    if isinstance(f.default, tuple) or (f.name == "base_size" and np.ndim(value) > 0):
        return _numbers(f.name, value, 1, LEVELS)
    return _numbers(f.name, value, 1, 1)[0]


def _whole(value: Any, wanted: bool) -> Any:
    """Return 3 for 3.0 where a whole number is wanted."""
    good = wanted and isinstance(value, float) and value.is_integer()
    return int(value) if good else value


def _numbers(name: str, value: Any, least: int, most: int) -> tuple[Any, ...]:
    """Return `most` finite numbers, the last one repeated; whole ones stay whole."""
    several = list(value) if isinstance(value, (list, tuple, np.ndarray)) else [value]
    good = all(
        isinstance(v, (int, float, np.integer, np.floating))
        and not isinstance(v, bool)
        and np.isfinite(v)
        for v in several
    )
    if not good or not least <= len(several) <= most:
        want = "a finite number" if most == 1 else f"{most} finite numbers"
        each = ", one a level (or one for all)" if most == LEVELS else ""
        raise GeometryError(f"{name} is {value!r}: allowed is {want}{each}.")
    several = [int(v) if isinstance(v, (int, np.integer)) else float(v) for v in several]
    return tuple(several + several[-1:] * (most - len(several)))


def _allowed(m: WeberPenn) -> list[tuple[str, bool, str]]:
    """Return (name, whether its value is allowed, what is allowed)."""
    used = range(min(m.levels if isinstance(m.levels, int) else 1, LEVELS))
    return [
        ("rules", m.rules in RULES, ", ".join(RULES)),
        ("source", isinstance(m.source, str), "a text"),
        ("shape", m.shape in range(9), "a whole number from 0 to 8"),
        ("scale", m.scale > 0, "more than 0 m"),
        ("scale_v", 0 <= m.scale_v < m.scale, "from 0 to below scale"),
        ("levels", m.levels in range(1, 9), "a whole number from 1 to 8"),
        ("ratio", 0 < m.ratio < 0.5, "above 0 and below 0.5"),
        ("ratio_power", -10 <= m.ratio_power <= 10, "from -10 to 10"),
        ("flare", -0.9 <= m.flare <= 20, "from -0.9 to 20"),
        ("base_size", all(0 <= b < 1 for b in m.bare), "from 0 to below 1"),
        ("base_splits", isinstance(m.base_splits, int), "a whole number"),
        ("scale0", m.scale0 > 0, "more than 0"),
        ("scale0_v", 0 <= m.scale0_v < m.scale0, "from 0 to below scale0"),
        ("z_scale", m.z_scale > 0, "more than 0"),
        ("z_scale_v", 0 <= m.z_scale_v < m.z_scale, "from 0 to below z_scale"),
        ("lobes", m.lobes in range(100), "a whole number from 0 to 99"),
        ("lobe_depth", 0 <= m.lobe_depth < 1, "from 0 to below 1"),
        ("length", m.length[0] > 0 and min(m.length) >= 0, "0 or more, the trunk's above"),
        ("length_v", abs(m.length_v[0]) < m.length[0], "below length for the trunk"),
        ("taper", all(0 <= t <= 3 for t in m.taper), "from 0 to 3"),
        ("branches", 0 <= m.branches[0] <= 100, "at most 100 trunks (0 stands for 1)"),
        (
            "curve_res",
            all(m.curve_res[i] in range(1, 1001) for i in used),
            "a whole number from 1 to 1000 at every level that is grown",
        ),
        ("seg_splits", all(0 <= s <= 10 for s in m.seg_splits), "from 0 to 10"),
        ("curve_v", all(v > -90 for v in m.curve_v), "above -90 (negative: a helix)"),
        ("branch_dist", all(b >= 0 for b in m.branch_dist), "0 or more"),
        ("radius_mod", all(r > 0 for r in m.radius_mod), "more than 0"),
        ("prune_ratio", 0 <= m.prune_ratio <= 1, "from 0 to 1"),
        ("prune_width", m.prune_width > 0, "more than 0"),
        ("prune_width_peak", 0 <= m.prune_width_peak < 1, "from 0 to below 1"),
        ("prune_power_low", m.prune_power_low >= 0, "0 or more"),
        ("prune_power_high", m.prune_power_high >= 0, "0 or more"),
    ]


def species_names() -> tuple[str, ...]:
    """Return the names of the species that plantsim ships."""
    files = resources.files("plantsim.plant").joinpath("species").iterdir()
    return tuple(sorted(f.name[:-5] for f in files if f.name.endswith(".toml")))


@cache
def species(name: str) -> WeberPenn:
    """Return the parameters of a species; GeometryError lists those there are.

    >>> species("quaking_aspen").levels
    3
    """
    if name not in species_names():
        raise GeometryError(
            f"species {name!r} is not known; there are: {', '.join(species_names())}. "
            "Take one of them, or give a WeberPenn."
        )
    file = resources.files("plantsim.plant").joinpath("species", f"{name}.toml")
    return WeberPenn.from_mapping(tomllib.loads(file.read_text(encoding="utf-8")))
