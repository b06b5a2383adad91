"""Cylinder tables of quantitative structure models <-> Skeleton.

Read are those of TreeQSM and its port PyTLidar (cylinder_*.txt since version 2.4: tabs,
thirteen headings over seventeen columns; before, cyl_data_*.txt without headings), of
SimpleForest (.csv, which CanoPyHydro, the companion of pyQSM, reads too), of aRchi and
rTwig, and ours.
"""

import csv
import io
from collections.abc import Sequence
from itertools import islice

import numpy as np

from plantsim.arrays import Array
from plantsim.errors import FileError
from plantsim.plant.skeleton import Polyline, Skeleton

COLUMNS = (
    "radius,length,start_x,start_y,start_z,axis_x,axis_y,axis_z,parent,extension,branch,"
    "branch_order,position_in_branch,start_radius,end_radius"
).split(",")
# names that programs give them, without case, units, underscores and blanks
ALIASES = {
    "radius": ("radius", "r", "radiusm", "radiuscyl"),
    "length": ("length", "lengthm", "len"),
    "start_x": (
        "startx",
        "start1",
        "startpointx",
        "startpoint1",
        "startpoint",
        "x0",
        "xstart",
    ),
    "start_y": ("starty", "start2", "startpointy", "startpoint2", "y0", "ystart"),
    "start_z": ("startz", "start3", "startpointz", "startpoint3", "z0", "zstart"),
    "axis_x": ("axisx", "axis1", "axisdirectionx", "axisdirection1", "axisdirection"),
    "axis_y": ("axisy", "axis2", "axisdirectiony", "axisdirection2"),
    "axis_z": ("axisz", "axis3", "axisdirectionz", "axisdirection3"),
    "end_x": ("endx", "end1", "x1", "xend"),
    "end_y": ("endy", "end2", "y1", "yend"),
    "end_z": ("endz", "end3", "z1", "zend"),
    "parent": ("parent", "parentid", "parentcyl", "parentcylinder", "parentcylinderid"),
    "extension": ("extension", "extensionid", "extensioncyl"),
    "id": ("id", "cylinderid", "cylid", "index"),
    "branch": ("branch", "branchid", "axisid"),
    "branch_order": ("branchorder", "branchingorder", "order"),
    "position_in_branch": ("positioninbranch", "position"),
    "start_radius": ("startradius",),
    "end_radius": ("endradius",),
}
BARE = COLUMNS[:10]  # what TreeQSM writes first where it names no columns
TRIPLE = ("startpoint", "axisdirection")
NEEDED = ("radius", "start_x", "start_y", "start_z", "parent")


def write_cylinders(skeleton: Skeleton) -> str:
    """Return the table of a skeleton: a cylinder a segment, rows numbered from 1."""
    out = io.StringIO()
    table = csv.writer(out, lineterminator="\n")
    table.writerow(COLUMNS)
    joint = skeleton.parent[skeleton.first]
    row_of = np.arange(len(skeleton.points)) - skeleton.limb  # of the segment after a node
    for limb in skeleton.limbs:
        p, r = limb.points, limb.radius
        way = np.diff(p, axis=0)
        length = np.linalg.norm(way, axis=1)
        first = int(row_of[skeleton.first[limb.index]])
        above = 0
        if limb.parent >= 0:
            last = int(row_of[skeleton.last[limb.parent]]) - 1
            above = min(int(row_of[joint[limb.index]]), last) + 1
        for k in range(len(length)):
            row = first + k
            table.writerow(
                [
                    repr(float((r[k] + r[k + 1]) / 2)),
                    repr(float(length[k])),
                    *(repr(float(v)) for v in p[k]),
                    *(repr(float(v)) for v in way[k] / length[k]),
                    row if k else above,
                    row + 2 if k + 1 < len(length) else 0,
                    limb.index + 1,
                    limb.level,
                    k + 1,
                    repr(float(r[k])),
                    repr(float(r[k + 1])),
                ]
            )
    return out.getvalue()


def read_cylinders(text: str, name: str) -> Skeleton:
    """Return the skeleton in a table of cylinders; FileError gives the line."""
    head, rows = _rows(text)
    column = _header(head, name)
    values: dict[str, list[float]] = {key: [] for key in column}
    lines = []
    for number, row in rows:
        for key, i in column.items():
            try:
                value = float(row[i])
            except (ValueError, IndexError):
                value = np.nan
            whole = key not in ("parent", "extension", "id") or value % 1 == 0
            if not np.isfinite(value) or not whole:
                got = row[i].strip()[:40] if i < len(row) else "nothing"
                raise FileError(
                    f"{name}, line {number}: {head[i].strip() or key} is {got!r}; expected "
                    f"a {'' if key in BARE[:8] else 'whole '}number. Mend that line."
                )
            values[key].append(value)
        lines.append(number)
    if not lines:
        raise FileError(f"{name}: no cylinders under the header; expected some. Add rows.")
    data = {key: np.array(v) for key, v in values.items()}
    bad = np.flatnonzero(data["radius"] <= 0)
    if len(bad):
        raise FileError(
            f"{name}, line {lines[bad[0]]}: radius {data['radius'][bad[0]]}; expected more "
            "than 0 m. Drop that cylinder."
        )
    parent = _parents(data, lines, name)
    after = _successors(data)
    start = np.stack([data[f"start_{k}"] for k in "xyz"], axis=1)
    if "end_x" in data:
        end = np.stack([data[f"end_{k}"] for k in "xyz"], axis=1)
    else:
        axis = np.stack([data[f"axis_{k}"] for k in "xyz"], axis=1)
        size = np.linalg.norm(axis, axis=1)
        bad = np.flatnonzero((size <= 0) | (data["length"] <= 0))
        if len(bad):
            raise FileError(
                f"{name}, line {lines[bad[0]]}: length {data['length'][bad[0]]}, axis of "
                f"length {size[bad[0]]}; expected more than 0. Drop that cylinder."
            )
        end = start + axis * (data["length"] / size)[:, None]
    bad = np.flatnonzero((start == end).all(axis=1))
    if len(bad):
        raise FileError(
            f"{name}, line {lines[bad[0]]}: starts where it ends; expected a length above "
            "0. Drop that cylinder."
        )
    return _chained(data, parent, after, start, end)


def _rows(text: str) -> tuple[Sequence[str], list[tuple[int, list[str]]]]:
    """Return the headings, and the other rows with their line numbers."""
    first = next((line for line in text.splitlines() if line.strip()), "")
    mark = max(",;\t", key=first.count)
    if first.count(mark):
        reader = csv.reader(io.StringIO(text), delimiter=mark)
        rows = [(reader.line_num, row) for row in reader]
    else:  # blanks
        rows = list(enumerate((line.split() for line in text.splitlines()), start=1))
    rows = [(n, row) for n, row in rows if any(cell.strip() for cell in row)]
    head = rows[0][1] if rows else []
    if len(head) >= len(BARE) and all(_number(cell) for cell in head):
        return list(BARE), rows
    width = max((len(row) for _, row in islice(rows, 1, 2)), default=0)
    if width == len(head) + 4:  # TreeQSM: start_point and axis_direction have three each
        head = [
            c
            for cell in head
            for c in ([cell, "", ""] if _plain(cell) in TRIPLE else [cell])
        ]
    return head, rows[1:]


def _number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _plain(cell: str) -> str:
    """Return a heading without case, unit, underscores and blanks."""
    return "".join(c for c in cell.lower().split("(")[0] if c.isalnum())


def _header(cells: Sequence[str], name: str) -> dict[str, int]:
    """Return the place of every column that is known."""
    plain = [_plain(cell) for cell in cells]
    found = {}
    for key, names in ALIASES.items():
        for alias in names:
            if alias in plain and key not in found:
                found[key] = plain.index(alias)
    for key in ("start", "axis"):  # one heading over three columns
        i = found.get(f"{key}_x")
        if i is not None and f"{key}_y" not in found and not any(plain[i + 1 : i + 3]):
            found[f"{key}_y"], found[f"{key}_z"] = i + 1, i + 2
    ends = all(f"end_{k}" in found for k in "xyz")
    axes = "length" in found and all(f"axis_{k}" in found for k in "xyz")
    missing = [key for key in NEEDED if key not in found]
    if missing or not (ends or axes):
        raise FileError(
            f"{name}, line 1: columns {', '.join(cells)[:80]!r}; expected radius, length, "
            "start_x/y/z, axis_x/y/z (or end_x/y/z) and parent, missing "
            f"{', '.join(missing) or 'length and axis, or end'}. Name them in line 1."
        )
    if not ends:
        found = {k: v for k, v in found.items() if k not in ("end_x", "end_y", "end_z")}
    return found


def _parents(data: dict[str, Array], lines: list[int], name: str) -> Array:
    """Return the row of each cylinder's parent, -1 for a root."""
    many = len(lines)
    raw = data["parent"].astype(int)
    if "id" in data:
        ids, count = np.unique(data["id"], return_counts=True)
        if (count > 1).any():
            twice = data["id"] == ids[count > 1][0]
            first, again = np.flatnonzero(twice)[:2]
            raise FileError(
                f"{name}, line {lines[again]}: id {data['id'][again]:g} is that of line "
                f"{lines[first]} too; expected each once. Renumber one."
            )
        place = {int(v): i for i, v in enumerate(data["id"])}
        parent = np.array([place.get(int(v), -1) for v in raw])
        lost = np.flatnonzero((parent < 0) & (raw > 0) & (raw != data["id"]))
    else:  # TreeQSM counts from 1 with 0 for none, its Python kin from 0 with -1
        parent = raw if (raw < 0).any() else raw - 1
        lost = np.flatnonzero(parent >= many)
    if len(lost):
        raise FileError(
            f"{name}, line {lines[lost[0]]}: parent {raw[lost[0]]}; expected one of the "
            f"{many} cylinders, or 0 for a root. Mend it."
        )
    parent = np.where(parent == np.arange(many), -1, parent)
    seen = np.zeros(many, dtype=int)
    for i in range(many):
        j, trail = i, []
        while j >= 0 and not seen[j]:
            seen[j] = 1
            trail.append(j)
            j = int(parent[j])
        if j >= 0 and seen[j] == 1:
            raise FileError(
                f"{name}, line {lines[i]}: its parents go round in a circle; expected "
                "a way to a root (parent 0). Mend one of them."
            )
        seen[trail] = 2
    return parent


def _successors(data: dict[str, Array]) -> Array | None:
    """Return the row in which each cylinder's branch goes on, -1 for none, if told."""
    if "branch" in data or "extension" not in data:
        return None
    raw = data["extension"].astype(int)
    if "id" in data:
        place = {int(v): i for i, v in enumerate(data["id"])}
        return np.array([place.get(int(v), -1) for v in raw])
    return raw if (data["parent"] < 0).any() else raw - 1


def _chained(
    data: dict[str, Array],
    parent: Array,
    after: Array | None,
    start: Array,
    end: Array,
) -> Skeleton:
    """Return the skeleton of cylinders in chains.

    By branch, else by `after`, the row in which it goes on, else by the thickest child.
    """
    many = len(parent)
    children: dict[int, list[int]] = {}
    for i in range(many):
        children.setdefault(int(parent[i]), []).append(i)
    branch = data.get("branch")
    r0 = data.get("start_radius", data["radius"])
    r1 = data.get("end_radius", data["radius"])
    limbs: list[Polyline] = []
    order: list[tuple[int, int]] = [(i, -1) for i in children.get(-1, [])]
    while order:
        # the smallest first row first, so that limbs keep the order of the file
        order.sort(key=lambda pair: -pair[0])
        head, above = order.pop()
        chain = [head]
        while nexts := children.get(chain[-1]):
            if branch is not None:
                own = [i for i in nexts if branch[i] == branch[chain[-1]]]
            elif after is not None:
                own = [i for i in nexts if after[chain[-1]] == i]
            else:
                own = [max(nexts, key=lambda i: data["radius"][i])]
            order += [(i, len(limbs)) for i in nexts if i not in own[:1]]
            if not own:
                break
            chain.append(own[0])
        points = np.vstack([start[chain], end[chain[-1]]])
        radius = np.append(r0[chain], r1[chain[-1]])
        keep = np.append(True, np.linalg.norm(np.diff(points, axis=0), axis=1) > 0)
        level = int(data["branch_order"][head]) if "branch_order" in data else None
        limbs.append(Polyline(points[keep], radius[keep], above, level))
    return Skeleton.from_limbs(limbs)
