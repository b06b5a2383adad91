"""Plants in HDF5 files, whole or absent; read without trust.

A file is packed in memory and written by ourselves: the same numbers give the same bytes,
and a full disk is an OSError, not a half-written file.
"""

import hashlib
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from plantsim.arrays import Array
from plantsim.errors import FileError
from plantsim.hdf5 import PLAIN, h5py, lies_in, plain_array, plain_group
from plantsim.paths import existing, replacing

FORMAT = "plantsim plant"
SCHEMA = 1
MOST = 2**33  # bytes that a file's arrays may unpack to
COMPRESSED = 4096  # bytes from which an array is compressed


Run = Callable[[], Mapping[str, Any]]


def write(
    path: Path, arrays: Mapping[str, Array], facts: Mapping[str, Any], run: Run
) -> str:
    """Write a plant: arrays, facts, and what is of this run alone; return its digest.

    `run` is called when all else is packed. The file is whole or not there, and on the disk
    when this returns.
    """
    image, digest = packed(arrays, facts, run)
    with replacing(path) as temporary, temporary.open("wb") as f:
        f.write(image)
        f.flush()
        os.fsync(f.fileno())
    return digest


def packed(
    arrays: Mapping[str, Array], facts: Mapping[str, Any], run: Run
) -> tuple[bytes, str]:
    """Return the bytes of a plant's file, and the digest of all in it but `run`."""
    digest = digest_of(arrays, facts)
    with h5py().File("plant.h5", "w", driver="core", backing_store=False) as f:
        f.attrs["format"], f.attrs["schema"] = np.bytes_(FORMAT), SCHEMA
        for name, value in facts.items():
            f.attrs[name] = _plain(value)
        f.attrs["digest"] = np.bytes_(digest)
        for name, value in arrays.items():
            more = (
                {"compression": "gzip", "compression_opts": 1, "shuffle": True}
                if value.nbytes >= COMPRESSED
                else {}
            )
            f.create_dataset(name, data=value, track_times=False, **more)
        f.flush()
        group = f.create_group("run")
        for name, value in run().items():
            group.attrs[name] = _plain(value)
        f.flush()
        return f.id.get_file_image(), digest


def digest_of(arrays: Mapping[str, Array], facts: Mapping[str, Any]) -> str:
    """Return a SHA-256 over names, types, shapes and values, in the order of names."""
    total = hashlib.sha256()
    for name in sorted(arrays):
        value = np.ascontiguousarray(arrays[name])
        total.update(f"{name}|{value.dtype.str}|{value.shape}|".encode())
        total.update(value.tobytes())
    for name in sorted(facts):
        total.update(f"{name}={np.asarray(_plain(facts[name])).tolist()!r};".encode())
    return total.hexdigest()


@contextmanager
def opened(path: str | os.PathLike[str]) -> Iterator[Any]:
    """Yield an open file of a plant; FileError where it is broken or foreign."""
    file = existing(path)
    try:
        with h5py().File(file, "r") as f:
            mark = f.attrs.get("format")
            if not isinstance(mark, (bytes, np.bytes_)) or mark != FORMAT.encode():
                raise FileError(f"{file}: HDF5, but no plant of a data set. Name another.")
            if f.attrs.get("schema") != SCHEMA:
                raise FileError(
                    f"{file}: schema {f.attrs.get('schema')!r}; this plantsim reads "
                    f"{SCHEMA}. Use the version that wrote it."
                )
            yield f
    except FileError:
        raise
    except (OSError, KeyError, RuntimeError, ValueError, TypeError, OverflowError) as why:
        words = " ".join(str(why).split())[:120]
        raise FileError(
            f"{file}: broken or no HDF5 file ({words}). Delete it and run the same "
            "command again."
        ) from None


def read_array(f: Any, name: str) -> Array:
    """Return one array of an open file, read-only; FileError where it is not plain."""
    return _read(f, name, _dataset(f, name))


def read(path: str | os.PathLike[str]) -> tuple[dict[str, Array], dict[str, Any]]:
    """Return all arrays and the facts of a file."""
    with opened(path) as f:
        found = {name: _dataset(f, name) for name in names(f)}
        size = sum(d.nbytes for d in found.values())
        if size > MOST:
            raise FileError(f"{path}: {size:,} bytes of arrays; at most {MOST:,}.")
        return {name: _read(f, name, d) for name, d in found.items()}, facts(f)


def facts(f: Any) -> dict[str, Any]:
    """Return the facts of an open file: numbers and texts."""
    return {
        name: value
        for name, value in _attributes(f).items()
        if name not in ("format", "schema", "digest")
    }


def digest(f: Any) -> str:
    """Return the digest that the file says it has."""
    return str(_attributes(f).get("digest", ""))


def run(f: Any) -> dict[str, Any]:
    """Return what is of the run that wrote the file: seconds by stage."""
    group = f.get("run", getlink=False)
    return {} if group is None else _attributes(group)


def names(f: Any) -> list[str]:
    """Return the names of the arrays of an open file."""
    return [
        f"{group}/{name}"
        for group in f
        if group != "run" and _hard(f, group)
        for name in _group(f, group)
    ]


def _group(f: Any, name: str) -> Any:
    with _told(f):
        return plain_group(f, name)


def _dataset(f: Any, name: str) -> Any:
    """Return a data set that lies in the file itself and holds plain values."""
    with _told(f):
        found = plain_array(f, name)
    if found.nbytes > MOST:
        raise FileError(f"{f.filename}: {name} has {found.nbytes:,} bytes. {_FOREIGN}")
    return found


@contextmanager
def _told(f: Any) -> Iterator[None]:
    """Say of what file it is that something in it is not plain."""
    try:
        yield
    except KeyError as why:
        raise FileError(f"{f.file.filename}: {why.args[0]}. {_FOREIGN}") from None


def _read(f: Any, name: str, found: Any) -> Array:
    try:
        value = found[()]
    except (OSError, RuntimeError) as why:
        words = " ".join(str(why).split())[:120]
        raise FileError(
            f"{f.filename}: {name} cannot be read ({words}). Delete the file and run the "
            "same command again."
        ) from None
    value = np.asarray(value)
    value.flags.writeable = False
    return value


def _hard(group: Any, name: str) -> bool:
    """Return whether a name is there and no link to another place or file."""
    with _told(group):
        return lies_in(group, name)


def _attributes(f: Any) -> dict[str, Any]:
    out: dict[str, Any] = {}
    for name in f.attrs:
        if f.attrs.get_id(name).dtype.kind not in PLAIN:
            raise FileError(f"{f.file.filename}: {name} is no plain value. {_FOREIGN}")
        value = f.attrs[name]
        if isinstance(value, (bytes, np.bytes_)):
            out[name] = bytes(value).decode("utf-8", errors="replace")
        else:
            out[name] = value.item() if np.ndim(value) == 0 else np.asarray(value)
    return out


_FOREIGN = "It was not written by plantsim: delete it and run the same command again."


def _plain(value: Any) -> Any:
    return np.bytes_(value.encode()) if isinstance(value, str) else value
