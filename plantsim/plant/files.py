"""Skeletons in files: our JSON, SWC, and the cylinder CSV of structure models.

- .json: everything, exactly; one limb a line.
- .swc: id, type, x, y, z, radius, parent; one node a line. Ours has metres, the level + 5
  as type (5 and above are free for custom use), and a comment that tells where limbs begin;
  in others a limb goes on to the thickest child. Source: R. C. Cannon et al., J. Neurosci.
  Methods 84 (1998) 49-54.
- .csv, .txt: cylinders as TreeQSM and its relatives name them: radius, length, start, axis,
  parent, extension, branch, branch_order, position_in_branch. Ours also has the radii at
  both ends of a cylinder. Source: P. Raumonen et al., Remote Sensing 5 (2013) 491-520.
"""

import json
import os
from pathlib import Path
from typing import Any

import numpy as np

from plantsim.arrays import Array
from plantsim.errors import FileError, GeometryError, check_kind
from plantsim.paths import existing, named, replacing
from plantsim.plant.cylinders import read_cylinders, write_cylinders
from plantsim.plant.hung import Hung
from plantsim.plant.skeleton import Skeleton
from plantsim.plant.swc import read_swc, write_swc

FORMAT = "plantsim skeleton"
SUFFIXES = (".json", ".swc", ".csv")
READABLE = (*SUFFIXES, ".txt")


def read_skeleton(path: str | os.PathLike[str]) -> Skeleton:
    """Return the skeleton in a .json or .swc file, or a .csv or .txt of cylinders.

    Raises FileError with the line and what was expected there where the file is broken.
    What it holds may still not be fit for a mesh: ask `check()`, mend with `ready()`.
    """
    file = existing(path)
    kind = _kind(file, READABLE)
    try:
        text = file.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        raise FileError(f"{file}: not a text file. Name a {kind} file.") from None
    readers = {".json": _read_json, ".swc": read_swc}
    try:
        return readers.get(kind, read_cylinders)(text, str(file))
    except GeometryError as why:
        raise FileError(f"{file}: {why}") from None


def write_skeleton(skeleton: Skeleton, path: str | os.PathLike[str]) -> Path:
    """Write a skeleton to a .json, .swc or .csv file; return its path.

    The file is whole or not there. Only JSON keeps notes, leaves and fruit.
    """
    file = named(path)
    check_kind(skeleton, Skeleton, "write_skeleton", FileError)
    writers = {".json": _write_json, ".swc": write_swc}
    text = writers.get(_kind(file, SUFFIXES), write_cylinders)(skeleton)
    with replacing(file) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return file


def _kind(path: Path, known: tuple[str, ...]) -> str:
    kind = path.suffix.lower()
    if kind not in known:
        raise FileError(
            f"{path}: {kind or 'no'} suffix; skeletons are {', '.join(known)}. Rename it."
        )
    return kind


def _write_json(skeleton: Skeleton) -> str:
    joint = skeleton.parent[skeleton.first].tolist()
    lines = []
    for limb in skeleton.limbs:
        lines.append(
            json.dumps(
                {
                    "name": limb.name,
                    "level": limb.level,
                    "joint": joint[limb.index],
                    "points": limb.points.tolist(),
                    "radius": limb.radius.tolist(),
                }
            )
        )
    hung = skeleton.hung
    head = {"format": FORMAT, "version": 1, "unit": "m", "note": skeleton.note}
    tail = {
        "limb": hung.limb.tolist(),
        "fraction": hung.fraction.tolist(),
        "offset": hung.offset.tolist(),
        "mass": hung.mass.tolist(),
        "kind": list(hung.kind),
    }
    return (
        json.dumps(head)[:-1]
        + ',\n"limbs": [\n'
        + ",\n".join(lines)
        + '\n],\n"hung": '
        + json.dumps(tail)
        + "}\n"
    )


def _read_json(text: str, name: str) -> Skeleton:
    try:
        data = json.loads(text)
    except json.JSONDecodeError as why:
        raise FileError(
            f"{name}, line {why.lineno}: not JSON ({why.msg}). Write the file again."
        ) from None
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        raise FileError(
            f'{name}, line 1: expected "format": "{FORMAT}". Name a file that '
            "ps.write_skeleton wrote."
        )
    if data.get("version") != 1 or data.get("unit", "m") != "m":
        raise FileError(
            f"{name}, line 1: version {data.get('version')!r}, unit {data.get('unit')!r}; "
            "expected version 1 in m. Convert it."
        )
    limbs = data.get("limbs")
    if not isinstance(limbs, list) or not limbs:
        raise FileError(
            f'{name}, line 1: expected "limbs", a list of at least one. Add them.'
        )
    points, radius, parent, label, level = [], [], [], [], []
    count = 0
    for i, limb in enumerate(limbs):
        where = f"{name}, line {_line(text, limb, i)}: limb {i}"
        p, r, joint, depth = _json_limb(limb, where)
        if not -1 <= joint < count:
            raise FileError(
                f"{where}: joint {joint}; expected -1 for a trunk, or one of the {count} "
                "nodes before it. Mend it."
            )
        points.append(p)
        radius.append(r)
        parent.append(np.r_[joint, np.arange(count, count + len(p) - 1)])
        label.append(np.full(len(p), i))
        level.append(depth)
        count += len(p)
    hung = data.get("hung") or {}
    try:
        load = Hung(
            np.array(hung.get("limb", []), dtype=int),
            np.array(hung.get("fraction", []), dtype=float),
            np.array(hung.get("offset", []), dtype=float).reshape(-1, 3),
            np.array(hung.get("mass", []), dtype=float),
            tuple(hung.get("kind", ())),
        )
        if ((load.limb < 0) | (load.limb >= len(limbs))).any():
            raise ValueError(f"limbs are 0 to {len(limbs) - 1}, got {load.limb.tolist()}")
    except (AttributeError, TypeError, ValueError) as why:
        line = text.count("\n", 0, max(text.find('"hung"'), 0)) + 1
        raise FileError(
            f"{name}, line {line}: hung: {str(why).rstrip('.')}; expected limb, fraction, "
            "offset, mass and kind of as many leaves and fruit. Mend or drop that part."
        ) from None
    return Skeleton(
        np.concatenate(points),
        np.concatenate(radius),
        np.concatenate(parent),
        np.concatenate(label),
        np.array(level),
        note=str(data.get("note", "")),
        hung=load,
    )


def _json_limb(limb: Any, where: str) -> tuple[Array, Array, int, int]:
    """Return the points, radii, joint and level of a limb; FileError says what is wrong."""
    form = "points (k x 3 numbers), radius (k numbers), joint and level (whole numbers)"
    if not isinstance(limb, dict):
        raise FileError(f"{where}: {str(limb)[:40]!r}; expected {form} by name. Mend it.")
    missing = [k for k in ("points", "radius", "joint", "level") if k not in limb]
    if missing:
        raise FileError(f"{where}: no {', '.join(missing)}; expected {form}. Add it.")
    joint, depth = limb["joint"], limb["level"]
    for key, value in (("joint", joint), ("level", depth)):
        if not isinstance(value, int) or isinstance(value, bool) or value < -1:
            raise FileError(
                f"{where}: {key} {value!r}; expected a whole number from -1. Mend it."
            )
    try:
        p = np.array(limb["points"], dtype=float)
        r = np.array(limb["radius"], dtype=float)
    except (TypeError, ValueError) as why:
        raise FileError(f"{where}: {why}; expected {form}. Mend it.") from None
    if p.ndim != 2 or p.shape[1:] != (3,) or r.shape != p.shape[:1] or len(p) < 2:
        raise FileError(
            f"{where}: points {p.shape}, radius {r.shape}; expected (k, 3) and (k,) "
            "with k at least 2. Mend it."
        )
    for bad, what, want in (
        (~np.isfinite(p).all(axis=1), "point", "finite numbers"),
        (~((r > 0) & np.isfinite(r)), "radius", "more than 0 m"),
        (np.append(False, (np.diff(p, axis=0) == 0).all(axis=1)), "point", "another place"
         " than the one before"),
    ):  # fmt: skip
        if bad.any():
            k = int(bad.argmax())
            got = (p if what == "point" else r)[k].tolist()
            raise FileError(f"{where}: {what} {k} is {got}; expected {want}. Mend it.")
    return p, r, joint, depth


def _line(text: str, limb: object, index: int) -> int:
    """Return the line of a limb: where its name stands, else that of our own layout."""
    if isinstance(limb, dict) and "name" in limb:
        at = text.find(f'"name": {json.dumps(limb["name"])}')
        if at >= 0:
            return text.count("\n", 0, at) + 1
    return index + 3
