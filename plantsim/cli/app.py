"""The application that commands join: their report, their progress, their common options.

Exit codes: 0 done; 1 something is wrong, and one sentence on stderr says what and what to
do; 2 the command line itself is wrong; 130 stopped by Ctrl-C.
"""

import json as js
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.table import Table

import plantsim as ps
from plantsim.errors import ModelError, PlantsimError

app = typer.Typer(
    help="Grow plants, make them solid, bend them, and learn their stiffness from touches.",
    epilog="Exit codes: 0 done, 1 wrong input or surroundings (a sentence on stderr says "
    "what to do), 2 wrong usage, 130 stopped by Ctrl-C. To have your shell complete "
    "commands, options and species: plantsim --install-completion",
    no_args_is_help=True,
    add_completion=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)

Json = Annotated[bool, typer.Option("--json", help="Print one JSON object, for machines.")]


@app.callback(invoke_without_command=True)
def plantsim(
    version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
) -> None:
    """Grow plants, make them solid, bend them, and learn their stiffness from touches."""
    if version:
        typer.echo(ps.__version__)
        raise typer.Exit


class Report:
    """What a command found: lines for people, or one object for machines."""

    def __init__(self, json: bool) -> None:
        self.json = json
        self.values: dict[str, Any] = {}

    def tell(self, line: str = "", **values: Any) -> None:
        """Print the line to people; keep the values for machines."""
        self.values |= values
        if line and not self.json:
            typer.echo(line)

    def wrote(self, path: Path) -> None:
        """Tell of a file that was written."""
        self.tell(f"wrote {path}", files=[*self.values.get("files", []), str(path)])

    def table(
        self,
        name: str,
        title: str,
        columns: Sequence[str],
        rows: Iterable[Sequence[Any]],
        *,
        left: Sequence[int] = (0,),
    ) -> None:
        """Print a table, columns `left` to the left; for machines a list of objects."""
        rows = [list(row) for row in rows]
        self.values[name] = [dict(zip(columns, row, strict=True)) for row in rows]
        if self.json:
            return
        table = Table(title=title, title_justify="left")
        for i, column in enumerate(columns):
            table.add_column(column, justify="left" if i in left else "right")
        for row in rows:
            table.add_row(*(f"{x:.4g}" if isinstance(x, float) else str(x) for x in row))
        Console().print(table)


@contextmanager
def reporting(json: bool) -> Iterator[Report]:
    """Yield a Report; with `json`, print what it holds at the end, or the error."""
    report = Report(json)
    try:
        yield report
    except (PlantsimError, OSError) as why:
        if json:
            kind = type(why).__name__
            typer.echo(js.dumps({"error": sentence(why), "kind": kind}))
        raise
    if json:
        typer.echo(js.dumps(report.values, default=_plain))


def _plain(value: Any) -> Any:
    """Return what JSON can say: lists for arrays, text for paths."""
    return value.tolist() if isinstance(value, (np.ndarray, np.generic)) else str(value)


def sentence(why: PlantsimError | OSError) -> str:
    """Return an error as one sentence."""
    if isinstance(why, OSError):  # no room, no permission, a folder in a file's place
        return f"{why.filename or 'file'}: {why.strerror or why}."
    return str(why)


@contextmanager
def working(what: str, total: int | None = None) -> Iterator[Callable[[str], None]]:
    """Show progress on stderr, if a person looks: a clock, or a bar of `total` steps.

    Yields a function that tells the next step and ends the one before.
    """
    bar = [] if total is None else [BarColumn(bar_width=24)]
    console = Console(stderr=True)
    with Progress(
        SpinnerColumn(),
        TextColumn("{task.description}"),
        *bar,
        TimeElapsedColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,
    ) as progress:
        task = progress.add_task(what, total=total)
        yield lambda step: progress.update(task, description=step, advance=1)


def ids_from(text: str, what: str, mesh: ps.TetMesh) -> str | list[int]:
    """Return a set's name, or the vertex ids in a list with commas."""
    if text in mesh.sets or any(c.isalpha() for c in text):
        return text
    try:
        return [int(part) for part in text.split(",")]
    except ValueError:
        raise ModelError(
            f"--{what} {text!r}: give vertex ids with commas, or a set."
        ) from None


def numbers(text: str, what: str, count: int) -> np.ndarray:
    """Return so many numbers from a list with commas."""
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) != count:
        raise ModelError(f"--{what} {text!r}: give {count} numbers with commas.")
    return np.array(values)


def species_like(incomplete: str) -> list[str]:
    """Return the species that begin so, for the shell's completion."""
    return [name for name in ps.species_names() if name.startswith(incomplete)]


def main() -> None:
    """Run the command line; an error of ours is one sentence on stderr and exit code 1."""
    try:
        app()
    except (PlantsimError, OSError) as why:
        typer.echo(f"plantsim: {sentence(why)}", err=True)
        sys.exit(1)
