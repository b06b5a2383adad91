"""Frozen, shape-checked arrays: the one door through which data enters a value."""

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from plantsim.errors import ModelError, PlantsimError

Array = NDArray[Any]
Random = int | np.random.Generator


def frozen(
    x: ArrayLike,
    shape: tuple[int | None, ...],
    dtype: type = float,
    *,
    name: str,
    error: type[PlantsimError],
) -> Array:
    """Return a read-only copy of `x` with the given shape (None: any) and finite entries.

    >>> frozen([[1, 2, 3]], (None, 3), name="points", error=ModelError).shape
    (1, 3)
    """
    try:
        raw = np.asarray(x)
    except ValueError as why:
        raise error(f"{name}: not a rectangular array ({why}). Pass equal rows.") from None
    wanted = "(" + ", ".join("any" if n is None else str(n) for n in shape) + ")"
    if raw.ndim != len(shape) or any(
        n is not None and n != m for n, m in zip(shape, raw.shape, strict=True)
    ):
        raise error(f"{name}: shape {raw.shape}, wanted {wanted}. Reshape it.")
    if raw.dtype.kind not in "biuf":
        raise error(f"{name}: {raw.dtype} data, wanted numbers. Convert it first.")
    if raw.dtype.kind == "f" and not np.isfinite(raw).all():
        bad = np.flatnonzero(~np.isfinite(raw))
        raise error(
            f"{name}: {bad.size} entries are NaN or infinite, first at flat index "
            f"{bad[0]}. Replace or drop them."
        )
    if np.issubdtype(dtype, np.integer) and raw.dtype.kind == "f" and (raw % 1).any():
        raise error(f"{name}: fractional numbers where integers are wanted. Round them.")
    out = np.array(raw, dtype=dtype, order="C")
    out.flags.writeable = False
    return out


def few(values: Iterable[Any], count: int = 5) -> str:
    """Return the first few values for a message.

    >>> few(range(9))
    '0, 1, 2, 3, 4, ...'
    """
    values = list(values)
    return ", ".join(str(v) for v in values[:count]) + (
        ", ..." if len(values) > count else ""
    )


def vertex_ids(ids: ArrayLike, count: int, what: str) -> Array:
    """Return distinct vertex ids, read-only, checked against `count` vertices.

    A boolean mask over all vertices is taken as the ids where it is true.
    """
    raw = np.asarray(ids)
    if raw.dtype == bool and raw.shape == (count,):
        raw = np.flatnonzero(raw)
    if raw.size == 0:
        raw = raw.astype(int)
    out = frozen(np.atleast_1d(raw), (None,), np.int64, name=what, error=ModelError)
    bad = out[(out < 0) | (out >= count)]
    if bad.size:
        raise ModelError(
            f"{what}: {bad.size} vertex ids out of range ({few(bad)}); the mesh has "
            f"{count} vertices, so use 0 to {count - 1}."
        )
    values, times = np.unique(out, return_counts=True)
    if (times > 1).any():
        raise ModelError(
            f"{what}: vertex ids repeated ({few(values[times > 1])}). Name each vertex "
            "once."
        )
    return out


def generator(rng: Random | None) -> np.random.Generator:
    """Return a numpy Generator from an int seed or a Generator; never an unseeded one."""
    if isinstance(rng, np.random.Generator):
        return rng
    if isinstance(rng, (int, np.integer)) and rng >= 0:
        return np.random.default_rng(int(rng))
    raise ModelError(
        f"rng is {rng!r}, wanted a non-negative int seed or a numpy.random.Generator. "
        "Pass for example rng=7, so that the result can be had again."
    )


def pieces(count: int, pairs: Array) -> Array:
    """Return the label (count,), from 0, of the connected piece of each of `count` things.

    `pairs` (k, 2): which are joined.

    >>> pieces(4, np.array([[0, 2], [2, 3]])).tolist()
    [0, 1, 0, 0]
    """
    graph = coo_array((np.ones(len(pairs)), np.asarray(pairs).T), shape=(count, count))
    return connected_components(graph, directed=False)[1]


def repeated(each: Array) -> tuple[Array, Array]:
    """Return every i, `each[i]` times, and the count 0, 1, ... within each.

    >>> [part.tolist() for part in repeated(np.array([2, 0, 3]))]
    [[0, 0, 2, 2, 2], [0, 1, 0, 1, 2]]
    """
    i = np.repeat(np.arange(len(each)), each)
    return i, np.arange(len(i)) - np.repeat(np.cumsum(each) - each, each)
