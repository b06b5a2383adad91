"""Checking a gmsh script before gmsh sees it: scripts of others must not run code.

gmsh executes shell commands found in a script, and takes any file without a known header
for a script. The check follows the lexical rules of gmsh 4.15 (comments, strings without
escapes, keywords) and refuses what gmsh treats unlike a plain reading. It is the first of
two fences: what passes is opened in a child process that may write no file and start no
program (`foreign.py`, `fence.py`).
"""

import os
import re
from pathlib import Path

from plantsim.errors import FileError
from plantsim.paths import existing

# commands that run programs, write files, ask the user, end the process, or make names of
# strings
FORBIDDEN = frozenset(
    """SystemCall System NonBlockingSystemCall NonBlockingSystem OnelabRun OnelabAction
    SendToServer Solver ExternalProcess CommandLine Plugin Print Save CreateDir Exit Abort
    StringToName S2N GetEnv GetValue GetString GetStringValue ListFromFile""".split()
)
# of these, the ones that do harm wherever gmsh comes to read them
DEADLY = (
    b"SystemCall System OnelabRun OnelabAction SendToServer Solver ExternalProcess "
    b"CommandLine Plugin StringToName S2N"
).split()
FILES = frozenset("Include Merge MergeFile MergeWithBoundingBox Open ShapeFromFile".split())
READING = re.compile(rf"(?<![A-Za-z_])(?:{'|'.join(sorted(FILES))})(?!\w)", re.ASCII)
SPOKEN = re.compile(r"[ \t]+[A-Za-z]+[ \t]+[A-Za-z]")
SCRIPTS = (".geo", ".geo_unrolled", ".inc", ".txt", ".dat", ".pos")
CAD = (
    ".step",
    ".stp",
    ".brep",
    ".iges",
    ".igs",
    ".stl",
)  # gmsh goes by the exact suffix here
# gmsh passes over what an If, For or Macro leaves out by another scanner, which loses
# characters
SKIPPING = ("If", "For", "Macro", "Function", "Else", "ElseIf")
TOKEN = re.compile(
    r"""(?P<comment>//[^\n]*|/\*.*?\*/)|(?P<string>"[^"]*"|'[^']*')"""
    r"""|(?P<word>[A-Za-z_]\w*)|(?P<open>/\*|["'])|(?P<other>\s+|.)""",
    re.DOTALL | re.ASCII,
)
# printf-style conversions that take the doubles gmsh passes; others crash it
_CONVERSION = re.compile(r"%%|%[-+ 0#]?\d{0,2}(?:\.\d{0,2})?[gfeEG]")
_NAME = re.compile(r"[\w. /-]+", re.ASCII)  # of other letters gmsh takes the bytes, we not
# gmsh ends a statement at any other character outside of strings and comments, and goes on
# after it
PLAIN = frozenset(map(chr, range(32, 127))) | frozenset("\t\n\f")
LONGEST = 1000
HELD = 1023  # characters of a string that gmsh holds


def check_script(path: Path, folder: Path | None = None, depth: int = 0) -> None:
    """Raise FileError if the script, or one included, could run code or write files.

    Included files must be named by plain strings and lie in the folder of the first script.
    """
    folder = path.parent.resolve() if folder is None else folder
    if depth > 20:
        raise FileError(f"{path}: scripts include each other over 20 deep. Untangle them.")
    raw = path.read_bytes().replace(b"\r\n", b"\n")
    text = raw.decode("latin-1")
    if "\0" in text or "\r" in text:
        raise FileError(f"{path}: NUL or bare CR bytes, so no plain gmsh script. Clean it.")
    words: list[tuple[str, str]] = []
    starts = set()
    for token in TOKEN.finditer(text):
        kind, value = token.lastgroup or "", token.group()
        if kind == "open":
            raise FileError(f"{path}: a comment or string is never closed. Close it.")
        if kind == "string":
            check_string(path, value)
        elif kind == "other" and not PLAIN.issuperset(value):
            raise FileError(
                f"{path}: byte 0x{ord(value):02x} outside of strings and comments, so no "
                "plain gmsh script. Take it out."
            )
        if kind != "comment" and not value.isspace():
            words.append((kind, value))
            starts.add(token.start())
    if any(kind == "word" and value in SKIPPING for kind, value in words):
        for word in DEADLY:
            if word in raw:
                raise FileError(_refusal(path, f"{word.decode()} (if only in a comment)"))
        _check_hidden(path, text, starts)
    _check_words(path, folder, depth, words)


def _check_hidden(path: Path, text: str, starts: set[int]) -> None:
    """Raise FileError where a comment or string could come to read a file.

    `starts`: where the words begin that a plain reading sees. English goes on after such a
    word with two words more, and no file is called as what follows a quote in it.
    """
    for found in READING.finditer(text):
        if found.start() in starts or SPOKEN.match(text, found.end()):
            continue
        rest = text[found.end() :].lstrip()
        if rest[:1] in ("'", '"'):
            name = rest[1:].split(rest[0])[0][:HELD].encode("latin-1")
            if not os.path.exists(os.path.join(os.fsencode(path.parent), name)):
                continue
        raise FileError(
            f"{path}: {found.group()} in a comment or string beside If, For or Macro, "
            "where gmsh might run it. Take it out, or pass trust=True if you trust it."
        )


def check_string(path: Path, value: str) -> None:
    """Raise FileError for a string, with its quotes, that gmsh could stumble over."""
    if len(value) > LONGEST or "\n" in value:
        raise FileError(f"{path}: a string over {LONGEST} characters or lines. Shorten it.")
    if "%" in _CONVERSION.sub("", value):
        raise FileError(
            f"{path}: the string {value[:40]} has a conversion other than %g, %f or %e, "
            "which can crash gmsh. Take it out."
        )


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
            if value in ("Printf", "Sprintf") and not _literal(words[i + 1 : i + 3]):
                raise FileError(_refusal(path, f"{value} of a computed format"))
            if value in FILES:
                _check_included(path, folder, depth, value, words[i + 1 : i + 3])


def _literal(after: list[tuple[str, str]]) -> bool:
    return len(after) == 2 and after[0][1] in "([" and after[1][0] == "string"


def _check_included(
    path: Path, folder: Path, depth: int, word: str, after: list[tuple[str, str]]
) -> None:
    if not _literal(after) and [kind for kind, _ in after][:1] != ["string"]:
        raise FileError(
            f"{path}: {word} of a computed file name; a plain string is needed to check "
            "it. Write the name out, or pass trust=True if you trust the script."
        )
    name = (after[1] if _literal(after) else after[0])[1][1:-1]
    target = (path.parent / name).resolve()
    if not _NAME.fullmatch(name) or not target.is_relative_to(folder):
        raise FileError(
            f"{path}: {word} {name!r} is outside the script's folder, or no plain name. "
            "Put the file beside the script, or pass trust=True if you trust it."
        )
    if target.suffix not in (*SCRIPTS, *CAD, ".msh"):
        raise FileError(
            f"{path}: {word} {name!r}: {target.suffix or 'no'} suffix; only "
            f"{', '.join((*SCRIPTS, '.msh', *CAD))} in small letters are read. Rename the "
            "file."
        )
    check_opened(existing(path.parent / name), folder, depth + 1)


def check_opened(path: Path, folder: Path | None = None, depth: int = 0) -> None:
    """Raise FileError unless gmsh can open the file without running code.

    Beside any file of whatever kind gmsh reads FILE.opt, a script, if there is one.
    """
    for name in {path, path.resolve()}:
        options = name.with_name(name.name + ".opt")
        if options.exists():
            if depth > 20:
                raise FileError(f"{options}: over 20 files deep. Remove it.")
            check_script(options, folder, depth + 1)
            check_opened(options, folder, depth + 1)
    if path.suffix == ".opt":
        return
    if path.suffix in CAD:
        return
    with path.open("rb") as f:
        head = f.read(64)
    if path.suffix == ".msh" and head.startswith(b"$MeshFormat"):
        return
    check_script(path, folder, depth)


def _refusal(path: Path, what: str) -> str:
    return (
        f"{path}: the script uses {what}, which can run programs, write files or wait for "
        "input; nothing was run. Remove it, or pass trust=True if you trust the script."
    )
