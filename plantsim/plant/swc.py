"""SWC text <-> Skeleton."""

from collections.abc import Sequence

import numpy as np

from plantsim.arrays import Array
from plantsim.errors import FileError
from plantsim.plant.skeleton import Polyline, Skeleton

LIMBS = "# limbs start at:"
CUSTOM = 5  # first type that the format leaves to its users


def write_swc(skeleton: Skeleton) -> str:
    """Return the SWC text of a skeleton."""
    assert skeleton.level is not None
    head = [
        "# plantsim skeleton, lengths in m; type = level + 5",
        "# id type x y z radius parent",
        f"{LIMBS} {' '.join(str(i + 1) for i in skeleton.first.tolist())}",
    ]
    kind = (skeleton.level[skeleton.limb] + CUSTOM).tolist()
    rows = zip(
        kind,
        skeleton.points.tolist(),
        skeleton.radius.tolist(),
        skeleton.parent.tolist(),
        strict=True,
    )
    for i, (t, (x, y, z), r, p) in enumerate(rows):
        head.append(f"{i + 1} {t} {x!r} {y!r} {z!r} {r!r} {p + 1 if p >= 0 else -1}")
    return "\n".join(head) + "\n"


def read_swc(text: str, name: str) -> Skeleton:
    """Return the skeleton in SWC text; FileError gives the line."""
    ids: list[int] = []
    rows: list[list[float]] = []
    lines: list[int] = []
    starts: list[str] | None = None
    told = 0
    for number, line in enumerate(text.splitlines(), start=1):
        if line.startswith(LIMBS):
            starts, told = line[len(LIMBS) :].split(), number
        words = line.split("#")[0].split()
        if not words:
            continue
        try:
            values = [float(word) for word in words]
            whole = [int(values[i]) == values[i] for i in (0, 1, 6)]
        except (ValueError, IndexError, OverflowError):
            values, whole = [], [False]
        if len(values) != 7 or not all(whole) or not np.isfinite(values).all():
            raise FileError(
                f"{name}, line {number}: {line.strip()[:60]!r}; expected 7 numbers: id "
                "type x y z radius parent (whole: id, type, parent). Mend that line."
            )
        if values[5] <= 0:
            raise FileError(
                f"{name}, line {number}: radius {values[5]}; expected more than 0 m. Mend "
                "it, or drop the node."
            )
        ids.append(int(values[0]))
        rows.append(values)
        lines.append(number)
    if len(rows) < 2:
        raise FileError(f"{name}: {len(rows)} nodes; expected at least 2. Add some.")
    place = {node: i for i, node in enumerate(ids)}
    if len(place) != len(ids):
        twice = next(i for i, node in enumerate(ids) if place[node] != i)
        raise FileError(
            f"{name}, line {lines[twice]}: id {ids[twice]} comes again on line "
            f"{lines[place[ids[twice]]]}; expected each once. Renumber one."
        )
    parent = np.full(len(ids), -1)
    for i, row in enumerate(rows):
        if row[6] >= 0:
            if int(row[6]) not in place:
                raise FileError(
                    f"{name}, line {lines[i]}: parent {int(row[6])}; expected the id of a "
                    "node, or -1 for a root. Mend it."
                )
            parent[i] = place[int(row[6])]
    order = _outwards(parent, lines, name)
    data = np.array(rows)
    if starts is not None and np.array_equal(order, np.arange(len(order))):
        where = f"{name}, line {told}"
        return _as_written(data, parent, _starts(starts, place, parent, where))
    return _traced(data[:, 2:5], data[:, 5], parent, order, name)


def _starts(words: list[str], place: dict[int, int], parent: Array, where: str) -> Array:
    """Return a mask of the nodes at which limbs start; FileError where they cannot."""
    out = np.zeros(len(parent), dtype=bool)
    for word in words:
        if not word.isdigit() or int(word) not in place:
            raise FileError(f"{where}: {word!r}; expected ids of nodes. Mend that comment.")
        out[place[int(word)]] = True
    follows = parent == np.arange(len(parent)) - 1
    follows[0] = False
    size = np.diff(np.append(np.flatnonzero(out), len(out)))
    if not out[0] or (~follows & ~out).any() or (size < 2).any():
        raise FileError(
            f"{where}: the nodes do not make limbs of two and more that start there; "
            "expected the first node of every limb. Drop that comment, and limbs go on to "
            "the thickest child."
        )
    return out


def _outwards(parent: Array, lines: Sequence[int], name: str) -> Array:
    """Return the nodes, parents before children; the file's order where it is that."""
    if (parent < np.arange(len(parent))).all():
        return np.arange(len(parent))
    depth = np.full(len(parent), -1)
    for i in range(len(parent)):
        path = []
        j = i
        while j >= 0 and depth[j] < 0:
            path.append(j)
            depth[j] = -2  # on this path
            j = int(parent[j])
            if j >= 0 and depth[j] == -2:
                raise FileError(
                    f"{name}, line {lines[i]}: its parents go round in a circle; expected "
                    "a way to a root (parent -1). Mend one of them."
                )
        base = -1 if j < 0 else int(depth[j])
        for k in reversed(path):
            base += 1
            depth[k] = base
    return np.argsort(depth, kind="stable")


def _as_written(data: Array, parent: Array, starts: Array) -> Skeleton:
    limb = np.cumsum(starts) - 1
    level = data[starts, 1].astype(int) - CUSTOM
    return Skeleton(data[:, 2:5], data[:, 5], parent, limb, np.maximum(level, 0))


def _traced(
    points: Array, radius: Array, parent: Array, order: Array, name: str
) -> Skeleton:
    """Return the skeleton whose limbs go on to the thickest child at every fork."""
    children: dict[int, list[int]] = {}
    for i in order.tolist():
        children.setdefault(int(parent[i]), []).append(i)
    limbs: list[Polyline] = []
    lone = 0
    todo = [(root, -1, -1) for root in children[-1]]  # node, its limb's parent, fork node
    while todo:
        node, above, fork = todo.pop(0)
        path = [node]
        while children.get(path[-1]):
            branches = sorted(children[path[-1]], key=lambda i: -radius[i])
            for side in branches[1:]:
                todo.append((side, len(limbs), path[-1]))
            path.append(branches[0])
        p, r = points[path], radius[path]
        if fork >= 0:  # begin on the parent, as thick as the limb itself
            p, r = np.vstack([points[fork], p]), np.append(r[0], r)
        step = np.linalg.norm(np.diff(p, axis=0), axis=1)
        keep = np.append(True, step > 0)
        if keep.sum() >= 2:
            limbs.append(Polyline(p[keep], r[keep], above))
        else:  # nothing but a doubled point; what hung there hangs on its parent
            todo = [(n, above if a == len(limbs) else a, f) for n, a, f in todo]
            lone += len(path)
    if not limbs:
        raise FileError(
            f"{name}: no node has another place than its parent; expected at least two "
            "nodes apart. Add some."
        )
    note = f"{lone} lone nodes left out" if lone else ""
    return Skeleton.from_limbs(limbs, note=note)
