"""Files of observations: HDF5 with units, or NPZ where h5py is not installed."""

import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from plantsim.arrays import Array
from plantsim.errors import DependencyError, EstimateError, FileError, checked_all
from plantsim.estimation.observation import Observation
from plantsim.hdf5 import h5py, lies_in, plain_array, plain_group
from plantsim.paths import existing, no_bomb, no_swelling, replacing, writable

FORMAT = "plantsim observations"
VERSION = 2
UNITS = {
    "moved": "vertex id, from 0",
    "move": "m",
    "seen": "vertex id, from 0",
    "displacement": "m",
    "displacement_noise": "m, one standard deviation",
    "force": "N",
    "force_noise": "N, one standard deviation",
    "wrench": "N, then N m about the mean of the moved vertices at rest",
    "wrench_noise": "N, then N m, one standard deviation",
    "loaded": "vertex id, from 0",
    "load": "N",
}
_HDF5 = (".h5", ".hdf5")


def write_observations(
    observations: Iterable[Observation], path: str | os.PathLike[str]
) -> Path:
    """Write observations to .h5 (HDF5, with units) or .npz, and return the path.

    One group an observation, "0", "1", ..., with the fields of `Observation` in SI units.
    HDF5 needs the extra `io`; DependencyError says so.
    """
    path = writable(path, *_HDF5, ".npz")
    touches = checked_all(observations, Observation, "write_observations", EstimateError)
    groups = [_fields(seen) for seen in touches]
    if not groups:
        raise EstimateError("no observations to write. Give at least one.")
    if path.suffix.lower() == ".npz":
        arrays: dict[str, Any] = {"format": np.array(f"{FORMAT} {VERSION}")}
        for i, fields in enumerate(groups):
            arrays |= {f"{i}/{name}": value for name, value in fields.items()}
        with replacing(path) as temporary, temporary.open("wb") as f:
            np.savez_compressed(f, **arrays)
        return path
    library = h5py("use .npz")
    with replacing(path) as temporary, library.File(temporary, "w") as file:
        file.attrs["format"], file.attrs["version"] = FORMAT, VERSION
        file.attrs["observations"] = len(groups)
        for i, fields in enumerate(groups):
            group = file.create_group(str(i))
            for name, value in fields.items():
                options = {"compression": "gzip"} if value.size > 100 else {}
                data = group.create_dataset(name, data=value, **options)
                data.attrs["units"] = UNITS[name]
    return path


def read_observations(path: str | os.PathLike[str]) -> tuple[Observation, ...]:
    """Return the observations in a .h5 or .npz file; FileError if broken or foreign.

    Nothing in the file is run.
    """
    path = existing(path)
    hdf5 = path.suffix.lower() in _HDF5
    if not hdf5 and path.suffix.lower() != ".npz":
        raise FileError(f"{path}: {path.suffix or 'no'} suffix; give a .h5 or .npz file.")
    try:
        version, data = _hdf5(path) if hdf5 else _npz(path)
        if version > VERSION:
            raise FileError(
                f"{path}: written by a later version (format {version}, this reads up to "
                f"{VERSION}). Upgrade plantsim."
            )
        count = len({name.split("/")[0] for name in data})
        return tuple(_observation(data, i) for i in range(count))
    except (DependencyError, FileError):
        raise
    except EstimateError as why:
        raise FileError(f"{path}: {why}") from None
    except Exception as why:  # zip, zlib, header, key, pickle and HDF5 errors
        raise FileError(
            f"{path}: not a file of observations, or cut short "
            f"({str(why).splitlines()[0] if str(why) else type(why).__name__}). Write it "
            "with write_observations."
        ) from None


def _fields(seen: Observation) -> dict[str, Array]:
    values = {name: getattr(seen, name) for name in UNITS}
    return {name: np.asarray(value) for name, value in values.items() if value is not None}


def _observation(data: dict[str, Array], i: int) -> Observation:
    fields = {name: data[f"{i}/{name}"] for name in UNITS if f"{i}/{name}" in data}
    if f"{i}/noise" in data:  # format 1
        fields["force_noise"], fields["displacement_noise"] = data[f"{i}/noise"]
    for name in ("moved", "move"):
        if name not in fields:
            raise KeyError(f"no {name!r} in observation {i}")
    return Observation(**fields)


def _npz(path: Path) -> tuple[int, dict[str, Array]]:
    no_bomb(path)
    with np.load(path, allow_pickle=False) as z:
        data = {name: z[name] for name in z.files}
    return _version(str(data.pop("format"))), data


def _hdf5(path: Path) -> tuple[int, dict[str, Array]]:
    found: dict[str, Any] = {}
    with h5py("use .npz").File(path, "r") as file:
        version = _version(f"{file.attrs['format']} {file.attrs['version']}")
        for i in range(int(file.attrs["observations"])):
            if not lies_in(file, str(i)):
                raise KeyError(f"observation {i} leads elsewhere")
            for name in UNITS:
                if name in plain_group(file, str(i)):
                    found[f"{i}/{name}"] = plain_array(file, f"{i}/{name}")
        no_swelling(path, sum(array.nbytes for array in found.values()))
        return version, {name: array[()] for name, array in found.items()}


def _version(text: str) -> int:
    name, _, version = text.rpartition(" ")
    if name != FORMAT:
        raise KeyError("format")
    return int(version)
