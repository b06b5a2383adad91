"""HDF5 files: the home of h5py, and what is trusted in a file of somebody else.

No pickles (objects), no arrays that lie in other files, no filters that would load
plug-ins.
"""

from typing import Any

from plantsim.errors import needs

PLAIN = "biufS"  # kinds of numbers and fixed texts; no objects, so nothing to unpickle
FILTERS = {1, 2, 3}  # deflate, shuffle, checksum: others would load a plug-in


def h5py(instead: str = "") -> Any:
    """Return h5py; DependencyError where it is absent, with what to do `instead`."""
    return needs("h5py", "io", instead)


def lies_in(group: Any, name: str) -> bool:
    """Return whether a name is no link to another place or file; KeyError if missing."""
    link = group.get(name, getlink=True)
    if link is None:
        raise KeyError(f"{name} is missing")
    return isinstance(link, h5py().HardLink)


def plain_group(f: Any, name: str) -> Any:
    """Return a group of an open file; KeyError where it is none."""
    found = f[name]
    if not isinstance(found, h5py().Group):
        raise KeyError(f"{name} is no group")
    return found


def plain_array(f: Any, name: str) -> Any:
    """Return the data set "group/leaf" that lies in the file itself, of plain values.

    Raises KeyError, saying what it is, for any other.
    """
    group, _, leaf = name.partition("/")
    if not (lies_in(f, group) and lies_in(plain_group(f, group), leaf)):
        raise KeyError(f"{name} leads elsewhere")
    found = f[group][leaf]
    if not isinstance(found, h5py().Dataset):
        raise KeyError(f"{name} is no array")
    plan = found.id.get_create_plist()
    filters = {plan.get_filter(i)[0] for i in range(plan.get_nfilters())}
    away = plan.get_external_count() or plan.get_layout() == h5py().h5d.VIRTUAL
    if found.dtype.kind not in PLAIN or found.dtype.fields or away or filters - FILTERS:
        raise KeyError(f"{name} is no plain array")
    return found
