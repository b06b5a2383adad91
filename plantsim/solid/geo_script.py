"""Checking a gmsh script before gmsh sees it: scripts of others must not run code.

gmsh executes shell commands found in a script, and takes any file without a known header
for a script. The lexical rules followed here (comments, strings without escapes, keywords)
are those of gmsh 4.15's scanner; what it treats unlike a plain reading (strings over 1,023
characters, NUL bytes) is refused outright.
"""

import re
from pathlib import Path

from plantsim.errors import FileError
from plantsim.paths import existing

# commands that run programs, write files, end the process, or build names out of strings
FORBIDDEN = frozenset(
    "SystemCall System NonBlockingSystemCall NonBlockingSystem OnelabRun OnelabAction "
    "SendToServer Solver Plugin Print Save CreateDir Exit Abort StringToName S2N GetEnv "
    "ListFromFile".split()
)
FILES = frozenset("Include Merge MergeFile MergeWithBoundingBox Open ShapeFromFile".split())
GEOMETRY = (
    ".step",
    ".stp",
    ".brep",
    ".iges",
    ".igs",
    ".stl",
)  # gmsh goes by the suffix here
_TOKEN = re.compile(
    r"""(?P<comment>//[^\n]*|/\*.*?\*/)|(?P<string>"[^"]*"|'[^']*')"""
    r"""|(?P<word>[A-Za-z_]\w*)|(?P<open>/\*|["'])|(?P<other>\s+|.)""",
    re.DOTALL,
)
LONGEST = 1000


def check_script(path: Path, folder: Path | None = None, depth: int = 0) -> None:
    """Raise FileError if the script, or one included, could run code or write files.

    Included files must be named by plain strings and lie in the folder of the first script.
    """
    folder = path.parent.resolve() if folder is None else folder
    if depth > 20:
        raise FileError(
            f"{path}: scripts include each other more than 20 deep. Untangle them."
        )
    text = path.read_bytes().decode("latin-1").replace("\r\n", "\n")
    if "\0" in text or "\r" in text:
        raise FileError(f"{path}: NUL or bare CR bytes, so no plain gmsh script. Clean it.")
    words: list[tuple[str, str]] = []
    for token in _TOKEN.finditer(text):
        kind, value = token.lastgroup or "", token.group()
        if kind == "open":
            raise FileError(f"{path}: a comment or string is never closed. Close it.")
        if kind == "string" and (len(value) > LONGEST or "\n" in value):
            raise FileError(
                f"{path}: a string over {LONGEST} characters or lines. Shorten it."
            )
        if kind != "comment" and not value.isspace():
            words.append((kind, value))
    _check_words(path, folder, depth, words)


def _check_words(
    path: Path, folder: Path, depth: int, words: list[tuple[str, str]]
) -> None:
    printing = False
    for i, (kind, value) in enumerate(words):
        if value == ";":
            printing = False
        elif kind == "other" and value == ">" and printing:
            raise FileError(_refusal(path, "Printf to a file"))
        elif kind == "word":
            printing = printing or value in ("Printf", "Error", "Warning")
            if value in FORBIDDEN:
                raise FileError(_refusal(path, value))
            if value in FILES:
                _check_included(path, folder, depth, value, words[i + 1 : i + 3])


def _check_included(
    path: Path, folder: Path, depth: int, word: str, after: list[tuple[str, str]]
) -> None:
    kinds = [kind for kind, _ in after]
    bracket = len(after) == 2 and after[0][1] in "(["
    if kinds[:1] != ["string"] and not (bracket and kinds[1] == "string"):
        raise FileError(
            f"{path}: {word} of a computed file name; a plain string is needed to check "
            "it. Write the name out, or pass trust=True if you trust the script."
        )
    name = (after[1] if bracket else after[0])[1][1:-1]
    target = (path.parent / name).resolve()
    if not target.is_relative_to(folder):
        raise FileError(
            f"{path}: {word} {name!r} is outside the script's folder. Put the file beside "
            "the script, or pass trust=True if you trust it."
        )
    check_opened(existing(target), folder, depth + 1)


def check_opened(path: Path, folder: Path | None = None, depth: int = 0) -> None:
    """Raise FileError unless gmsh can open the file without running code."""
    if path.suffix.lower() in GEOMETRY:
        return
    with path.open("rb") as f:
        head = f.read(64).lstrip()
    if path.suffix.lower() == ".msh" and head.startswith(b"$MeshFormat"):
        return
    check_script(path, folder, depth)


def _refusal(path: Path, what: str) -> str:
    return (
        f"{path}: the script uses {what}, which can run programs or write files; nothing "
        "was run. Remove it, or pass trust=True if you trust the script."
    )
