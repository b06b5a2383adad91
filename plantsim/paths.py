"""Files that are either whole or absent, and readers that trust nothing."""

import base64
import os
import tempfile
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from plantsim.errors import FileError

MODEST = 2**28  # bytes that the arrays of any file may take
SWELL = 100  # times the file's own bytes that they may take beyond that


def named(path: str | os.PathLike[str]) -> Path:
    """Return `path` as a Path, or raise FileError for what names no file."""
    if isinstance(path, (str, os.PathLike)):
        return Path(path)
    raise FileError(f"a {type(path).__name__} where a file's name is wanted. Give a path.")


def existing(path: str | os.PathLike[str]) -> Path:
    """Return `path` as a Path to a readable, non-empty file, or raise FileError."""
    path = named(path)
    if not path.exists():
        raise FileError(f"{path}: no such file. Check the path.")
    if not path.is_file():
        raise FileError(f"{path}: not a file. Name a file.")
    if path.stat().st_size == 0:
        raise FileError(f"{path}: the file is empty. Write it again.")
    return path


def writable(path: str | os.PathLike[str], *suffixes: str) -> Path:
    """Return `path` if it has one of the suffixes and its folder exists, or FileError."""
    path = named(path)
    if path.suffix.lower() not in suffixes:
        raise FileError(
            f"{path}: {path.suffix or 'no'} suffix; this can be written as "
            f"{', '.join(suffixes)}."
        )
    if not path.parent.is_dir():
        raise FileError(f"{path}: its folder does not exist. Make {path.parent} first.")
    return path


def no_bomb(path: Path) -> None:
    """Raise FileError for a zip archive that unpacks to far more than it holds."""
    try:
        with zipfile.ZipFile(path) as z:
            unpacked = sum(entry.file_size for entry in z.infolist())
    except (zipfile.BadZipFile, OSError):
        return  # for its reader to refuse
    no_swelling(path, unpacked)


def no_swelling(path: Path, unpacked: int) -> None:
    """Raise FileError where a file's arrays take far more bytes than it has itself."""
    packed = path.stat().st_size
    if unpacked > max(MODEST, SWELL * packed):
        raise FileError(
            f"{path}: {packed:,} bytes that unpack to {unpacked:,}; up to {SWELL} times as "
            "many are read. It is no honest file of arrays: write it again."
        )


@contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary path with the same suffix; move it onto `path` on success.

    On any error nothing is left behind and an older file at `path` is untouched.
    """
    path = writable(path, Path(path).suffix.lower())
    handle, name = tempfile.mkstemp(
        dir=path.parent, prefix=f".{path.stem}-", suffix=path.suffix
    )
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o666 & ~umask)  # mkstemp's 0600 is for secrets
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


KINDS = {
    ".png": "image/png",
    ".gif": "image/gif",
    ".svg": "image/svg+xml",
    ".mp4": "video/mp4",
}


class Picture(type(Path())):
    """The path of a picture that was drawn; a notebook shows the picture itself."""

    def _repr_mimebundle_(self, **_: object) -> dict[str, str]:
        kind = KINDS.get(self.suffix.lower())
        if kind is None or not self.is_file():
            return {"text/plain": str(self)}
        code = base64.b64encode(self.read_bytes()).decode()
        element = "video controls loop autoplay muted" if kind == "video/mp4" else "img"
        tag = f'<{element} style="max-width:100%" src="data:{kind};base64,{code}">'
        tag += "</video>" if kind == "video/mp4" else ""
        return {"text/plain": str(self), "text/html": tag}
