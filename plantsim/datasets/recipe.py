"""Recipe: what a data set is to hold, drawn from ranges; a frozen value, a TOML file."""

import hashlib
import json
import os
import tomllib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from functools import cached_property
from importlib import resources
from pathlib import Path
from typing import Any, Literal, Self, get_args, get_type_hints

import numpy as np

from plantsim.datasets.rules import (
    Span,
    known,
    number,
    one_of,
    refuse,
    settle,
    span,
    text,
    whole,
)
from plantsim.errors import DatasetError, FileError, GeometryError
from plantsim.paths import existing, replacing
from plantsim.plant.parameters import LEVELS, WeberPenn, species, species_names

SPLITS = ("train", "validation", "test")
WHOLE = ("shape", "levels", "base_splits", "branches", "curve_res")  # of the model
NO_NUMBERS = ("rules", "source", "tropism")
# what a recipe means where it does not say
DEPTH, LIMBS = Span(0.002, 0.02), Span(3, 8)
YOUNG, POISSON, DENSITY = Span(4e9, 9e9), Span(0.3, 0.4), Span(700.0, 1000.0)
SHARES = (("train", 0.8), ("validation", 0.1), ("test", 0.1))
Spans = tuple[tuple[str, tuple[Span, ...]], ...]  # name, one span or one a level


def _kernels(asked: str) -> tuple[str, ...]:
    """Return the kernels that the mesher has; gmsh is only loaded for another than occ."""
    if asked == "occ":
        return ("occ",)
    from plantsim.solid.tetrahedralize import tetrahedralize  # noqa: PLC0415  gmsh

    return get_args(get_type_hints(tetrahedralize)["kernel"])


@dataclass(frozen=True)
class Meshing:
    """How plants are meshed; `worst` is the smallest gamma that a check lets pass."""

    order: int = 2
    size: float = 1.25
    kernel: str = "occ"
    worst: float = 0.05

    def __post_init__(self) -> None:
        rules = {
            "order": one_of(1, 2),
            "size": number(0.1, 10),
            "kernel": one_of(*_kernels(self.kernel)),
            "worst": number(0, 1),
        }
        settle(self, "mesh.", rules)


@dataclass(frozen=True)
class Touching:
    """How plants are touched: rigid patches of vertices, pushed further step by step.

    A touch whose answer would turn some part of the plant by more than `max_rotation`
    degrees, or need more than `max_force` N, is made shallower until it does not: linear
    theory is exact in that.
    """

    touches: int = 10
    steps: int = 3
    vertices: int = 3
    depth: Span = DEPTH  # [m]
    direction: Literal["normal", "random", "down"] = "normal"
    max_rotation: float = 5.0  # degrees
    max_force: float = 50.0  # [N]
    seen: int = 300  # vertices whose displacement is seen, at most
    facing: bool = True  # of one side only, as a camera sees
    force_noise: float = 0.02  # [N], one standard deviation of each component
    displacement_noise: float = 1e-3  # [m]

    def __post_init__(self) -> None:
        rules = {
            "touches": whole(0, 10_000),
            "steps": whole(1, 1000),
            "vertices": whole(1, 100),
            "depth": span(0, 10, above=True),
            "direction": one_of("normal", "random", "down"),
            "max_rotation": number(0, 90, above=True),
            "max_force": number(0, 1e6, above=True),
            "seen": whole(1, 10**7),
            "facing": one_of(True, False),
            "force_noise": number(0, 1e6),
            "displacement_noise": number(0, 10),
        }
        settle(self, "touch.", rules)


@dataclass(frozen=True)
class Kind:
    """One kind of plant: a species, what is varied about it, and its moduli.

    `times` multiplies and `parameters` replaces parameters of the model. The moduli of the
    limbs are a random field: log Young is normal about the log of the plant's own Young,
    with standard deviation `spread`, and the correlation of two limbs is `correlation` to
    the power of the number of joints between them.
    """

    name: str
    model: WeberPenn
    weight: float = 1.0
    levels: int = 2
    max_limbs: Span = LIMBS
    min_radius: float = 0.0  # [m]; 0: 2 % of the trunk's
    times: Spans = ()
    parameters: Spans = ()
    young: Span = YOUNG  # [Pa], the plant's, drawn evenly in its log
    poisson: Span = POISSON
    density: Span = DENSITY  # [kg/m^3]
    spread: float = 0.3
    correlation: float = 0.5

    def __post_init__(self) -> None:
        where = f"species {self.name!r}: "
        rules = {
            "name": text,
            "weight": number(0, 1e9, above=True),
            "levels": whole(1, 8),
            "max_limbs": span(1, 10_000, integers=True),
            "min_radius": number(0, 10),
            "young": span(1, 1e13),
            "poisson": span(0, 0.49),
            "density": span(1, 1e5),
            "spread": number(0, 3),
            "correlation": number(0, 1),
        }
        settle(self, where, rules)
        for part in ("times", "parameters"):
            object.__setattr__(self, part, _spans(getattr(self, part), f"{where}{part}."))
        for end in ("low", "high"):
            try:
                self.varied(lambda s, end=end: getattr(s, end))
            except GeometryError as why:
                raise DatasetError(f"{where}{why} (At the {end} ends.)") from None

    def varied(self, pick: Any) -> WeberPenn:
        """Return the model with `pick(span)` in the place of each range."""
        new: dict[str, Any] = {}
        for part in ("parameters", "times"):
            for name, spans in getattr(self, part):
                values = [pick(s) for s in spans]
                if part == "times":
                    old = np.atleast_1d(new.get(name, getattr(self.model, name)))
                    values = (old * values).tolist()
                if name in WHOLE:
                    values = [round(v) for v in values]
                new[name] = tuple(values) if len(values) > 1 else values[0]
        return self.model.with_(**new) if new else self.model

    def plain(self) -> dict[str, Any]:
        """Return the kind as a recipe writes it."""
        out = {f.name: getattr(self, f.name) for f in fields(self)}
        for name, value in out.items():
            if isinstance(value, Span):
                out[name] = value.plain()
        for part in ("times", "parameters"):
            rows = {k: [s.plain() for s in v] for k, v in out[part]}
            out[part] = {k: v if len(v) > 1 else v[0] for k, v in rows.items()}
        model = asdict(self.model)
        out["model"] = {k: v for k, v in model.items() if v is not None}
        return out


@dataclass(frozen=True)
class Recipe:
    """A data set to be: how many plants, of which kinds, how meshed and touched.

    `species` takes names too. The same recipe and seed give the same numbers; plant i
    depends on neither the number of plants nor the order they are made in. Raises
    DatasetError that names the entry which is wrong and what is allowed.

    >>> Recipe(plants=3, species=("apple", "maize")).species[1].name
    'maize'
    """

    seed: int = 7
    plants: int = 200
    species: tuple[Kind | str, ...] = field(default_factory=species_names)
    mesh: Meshing = Meshing()
    touch: Touching = Touching()
    split: tuple[tuple[str, float], ...] = SHARES
    timeout: float = 600.0  # [s] a plant

    def __post_init__(self) -> None:
        rules = {
            "seed": whole(0, 2**63),
            "plants": whole(1, 10**8),
            "timeout": number(0, 1e6, above=True),
            "split": _split,
        }
        settle(self, "", rules)
        if not isinstance(self.species, (list, tuple)) or not self.species:
            refuse("species", self.species, "at least one, as [[species]]")
        kinds = tuple(
            s if isinstance(s, Kind) else Kind(s, _species(s)) for s in self.species
        )
        object.__setattr__(self, "species", kinds)
        names = [k.name for k in self.kinds]
        for name in names:
            if names.count(name) > 1:
                refuse("species", name, "each name once: name one anew, with like=")

    @property
    def kinds(self) -> tuple[Kind, ...]:
        """The kinds of plant."""
        return tuple(k for k in self.species if isinstance(k, Kind))

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any], folder: Path = Path()) -> Self:
        """Return the recipe in a mapping, laid out as the TOML file is.

        Files of species are looked for from `folder`.
        """
        names = ("seed", "plants", "timeout", "split", "species", "grow", "material")
        table = known(values, (*names, "mesh", "touch"), "")
        grow = known(table.pop("grow", {}), GROW, "grow.")
        material = known(table.pop("material", {}), MATERIAL, "material.")
        kinds = table.pop("species", list(species_names()))
        if not isinstance(kinds, (list, tuple)):
            refuse("species", kinds, "a list of names, or tables as [[species]]")
        table["species"] = tuple(
            _kind(kind, {**grow, **material}, i, folder) for i, kind in enumerate(kinds)
        )
        for name, made in (("mesh", Meshing), ("touch", Touching)):
            part = known(table.pop(name, {}), [f.name for f in fields(made)], f"{name}.")
            table[name] = made(**part)
        if "split" in table:
            table["split"] = tuple(known(table["split"], SPLITS, "split.").items())
        return cls(**table)

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Self:
        """Return the recipe in a .toml or .json file; FileError says what is wrong."""
        file = existing(path)
        try:
            words = file.read_text(encoding="utf-8")
            plain = file.suffix.lower() == ".json"
            values = json.loads(words) if plain else tomllib.loads(words)
        except ValueError as why:  # of both, and of the encoding
            raise FileError(f"{file}: not a recipe ({why}). Mend that line.") from None
        try:
            return cls.from_mapping(values, file.parent)
        except DatasetError as why:
            raise FileError(f"{file}: {why}") from None

    def plain(self) -> dict[str, Any]:
        """Return the recipe whole, as numbers, texts, lists and tables."""
        touch = {**asdict(self.touch), "depth": self.touch.depth.plain()}
        return {
            "seed": self.seed,
            "plants": self.plants,
            "timeout": self.timeout,
            "split": dict(self.split),
            "mesh": asdict(self.mesh),
            "touch": touch,
            "species": [kind.plain() for kind in self.kinds],
        }

    @cached_property
    def fingerprint(self) -> str:
        """Sixteen hex digits of all that a plant depends on: not of how many there are."""
        plain = self.plain()
        for name in ("plants", "timeout"):
            del plain[name]
        packed = json.dumps(plain, sort_keys=True).encode()
        return hashlib.sha256(packed).hexdigest()[:16]


MATERIAL = ("young", "poisson", "density", "spread", "correlation")
GROW = ("levels", "max_limbs", "min_radius", "times", "parameters")


def example() -> str:
    """Return the text of the recipe that plantsim ships."""
    file = resources.files("plantsim.datasets").joinpath("recipe.toml")
    return file.read_text(encoding="utf-8")


def write_example(path: str | os.PathLike[str]) -> Path:
    """Write that recipe to a new file; FileError where there is one already."""
    file = Path(path)
    if file.exists():
        raise FileError(f"{file}: it is there already. Name another file.")
    with replacing(file) as temporary:
        temporary.write_text(example(), encoding="utf-8")
    return file


def _kind(values: Any, shared: dict[str, Any], index: int, folder: Path) -> Kind:
    """Return one kind from its table, or its name, and what holds for all."""
    where = f"species {index + 1}: "
    table = {"name": values} if isinstance(values, str) else values
    names = ("name", "like", "file", "model", "weight", *GROW, *MATERIAL)
    table = known(table, names, where)
    file, model = table.pop("file", None), table.pop("model", None)
    like = table.pop("like", None)
    if sum(given is not None for given in (file, model, like)) > 1:
        refuse(f"{where}file", file, "one of file, like and model")
    try:
        if file is not None:
            if not isinstance(file, str):
                refuse(f"{where}file", file, "the path of a species' .toml")
            grown = WeberPenn.read(folder / file)
            table.setdefault("name", Path(file).stem)
        elif model is not None:
            grown = WeberPenn.from_mapping(known(model, model, f"{where}model."))
        elif like is not None:
            grown = _species(like, f"{where}like")
            table.setdefault("name", like)
        else:
            grown = _species(table.get("name"), f"{where}name")
    except (GeometryError, FileError) as why:
        raise DatasetError(f"{where}{why}") from None
    for part in ("times", "parameters"):
        both = [t.get(part, {}) for t in (shared, table)]
        for one in both:
            known(one, _numeric(), f"{where}{part}.")
        table[part] = tuple({**both[0], **both[1]}.items())
    return Kind(model=grown, **{**shared, **table})


def _species(name: Any, where: str = "species") -> WeberPenn:
    if not isinstance(name, str) or name not in species_names():
        want = f"one of {', '.join(species_names())}, or a file"
        refuse(where, name, want)
    return species(name)


def _numeric() -> list[str]:
    return [f.name for f in fields(WeberPenn) if f.name not in NO_NUMBERS]


def _spans(value: Any, where: str) -> Spans:
    """Settle ranges of the model's parameters, in the order of the model's fields."""
    rows = dict(known(dict(value), _numeric(), where))
    out = []
    rule = span(-1e6, 1e6)
    for f in fields(WeberPenn):
        if f.name not in rows:
            continue
        given, at = rows[f.name], f"{where}{f.name}"
        if isinstance(given, tuple) and given and isinstance(given[0], Span):
            spans = given
        elif isinstance(f.default, tuple):
            if not isinstance(given, (list, tuple)) or len(given) != LEVELS:
                want = f"a list of {LEVELS}, one a level, each a number or [low, high]"
                refuse(at, given, want)
            spans = tuple(rule(f"{at}[{i}]", v) for i, v in enumerate(given))
        else:
            spans = (rule(at, given),)
        out.append((f.name, spans))
    return tuple(out)


def _split(where: str, value: Any) -> tuple[tuple[str, float], ...]:
    shares = known(dict(value), SPLITS, f"{where}.")
    rule = number(0, 1)
    out = tuple((n, rule(f"{where}.{n}", shares.get(n, 0.0))) for n in SPLITS)
    if abs(sum(share for _, share in out) - 1) > 1e-9:
        refuse(where, dict(out), "shares that add up to 1")
    return out
