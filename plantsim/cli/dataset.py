"""plantsim dataset: a recipe -> many plants with their touches; checks, a summary."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
from rich.table import Table

from plantsim.cli.app import Json, app, reporting
from plantsim.datasets.checks import Report, check_dataset
from plantsim.datasets.folder import SECONDS, STAGES
from plantsim.datasets.generate import Progress as Step
from plantsim.datasets.generate import dataset as made
from plantsim.datasets.reading import Dataset
from plantsim.datasets.recipe import Recipe, write_example
from plantsim.datasets.summary import summarise
from plantsim.errors import DatasetError

LOGGED = 30.0  # s between lines where there is no terminal


@app.command()
def dataset(
    recipe: Annotated[Path | None, typer.Argument(help="A recipe: .toml")] = None,
    out: Annotated[Path | None, typer.Option(help="Folder for the data set.")] = None,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Local processes; one a CPU if not given.")
    ] = None,
    scheduler: Annotated[
        str | None, typer.Option(help="Address of a running Dask scheduler.")
    ] = None,
    retry: Annotated[
        bool, typer.Option("--retry", help="Try failed plants again.")
    ] = False,
    check: Annotated[Path | None, typer.Option(help="Check the data set here.")] = None,
    summary: Annotated[
        Path | None, typer.Option(help="Write summary.html about the data set here.")
    ] = None,
    example: Annotated[
        Path | None, typer.Option(help="Write a recipe to start from here.")
    ] = None,
    json: Json = False,
) -> None:
    """Make many plants with their touches, or finish what an earlier run began.

    Example: plantsim dataset --example recipe.toml, then
    plantsim dataset recipe.toml --out plants, then plantsim dataset --summary plants
    """
    console = Console(stderr=json)
    sound = True
    with reporting(json) as report:
        if (recipe is None) != (out is None):
            raise DatasetError("give both a recipe and --out, or neither.")
        if all(given is None for given in (recipe, check, summary, example)):
            raise DatasetError("nothing to do: give a recipe and --out, or see --help.")
        if example is not None:
            report.wrote(write_example(example))
        if recipe is not None and out is not None:
            try:
                found = _generate(console, recipe, out, workers, scheduler, retry)
            except KeyboardInterrupt:
                typer.echo(
                    "plantsim: interrupted. The same command goes on from there.", err=json
                )
                raise typer.Exit(130) from None
            report.tell(
                repr(found), folder=out, made=len(found), failed=len(found.failures)
            )
            sound = bool(len(found))
        if check is not None:
            checked = _check(console, check)
            report.tell(sound=checked.sound, **vars(checked))
            sound = checked.sound and sound
        if summary is not None:
            report.wrote(summarise(summary))
    if not sound:
        raise typer.Exit(1)


def _generate(
    console: Console,
    recipe: Path,
    out: Path,
    workers: int | None,
    scheduler: str | None,
    retry: bool,
) -> Dataset:
    """Make a data set, showing plants a minute, failures and time left."""
    read = Recipe.read(recipe)
    with _bar(console, read.plants) as tell:
        found = made(
            read, out, workers=workers, scheduler=scheduler, retry=retry, tell=tell
        )
    table = Table(title="seconds a plant, by stage", title_justify="left")
    for name in ("stage", "mean", "most"):
        table.add_column(name, justify="left" if name == "stage" else "right")
    for stage, name in zip(STAGES, SECONDS, strict=True):
        spent = [row[name] for row in found.rows if name in row]
        if spent:
            table.add_row(stage, f"{sum(spent) / len(spent):.2f}", f"{max(spent):.2f}")
    console.print(table)
    return found


def _check(console: Console, folder: Path) -> Report:
    """Check a data set and print what was found."""
    with _bar(console, 0) as tell:
        began = time.monotonic()
        report = check_dataset(
            folder, lambda i, n: tell(Step(n, i, 0, i, time.monotonic() - began))
        )
    for problem in report.problems[:20]:
        console.print(f"  {problem}", markup=False, highlight=False, soft_wrap=True)
    if len(report.problems) > 20:
        console.print(f"  and {len(report.problems) - 20} more")
    console.print(
        f"{report.done} of {report.plants} plants are there, {report.failed} failed, "
        f"{report.missing} missing; worst gamma {report.worst_gamma:.3f}; "
        f"{len(report.problems)} problems"
    )
    return report


@contextmanager
def _bar(console: Console, plants: int) -> Iterator[Any]:
    """Yield what to tell steps to: a bar on a terminal, else a line now and then."""
    if not console.is_terminal:
        last = [-LOGGED]

        def log(step: Step) -> None:
            end = step.done + step.failed >= step.plants
            if step.made and (end or time.monotonic() - last[0] >= LOGGED):
                last[0] = time.monotonic()
                console.print(
                    f"{step.done + step.failed} of {step.plants}: {_words(step)}",
                    highlight=False,
                    soft_wrap=True,
                )

        yield log
        return
    columns = (BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[words]}"))
    with Progress(*columns, console=console) as progress:
        task = progress.add_task("plants", total=plants, words="starting the workers ...")

        def tell(step: Step) -> None:
            words = _words(step) if step.made else "starting the workers ..."
            settled = step.done + step.failed
            progress.update(task, completed=settled, total=step.plants, words=words)

        yield tell


def _words(step: Step) -> str:
    hours, rest = divmod(round(step.left), 3600)
    left = f"{hours}:{rest // 60:02d}:{rest % 60:02d}"
    return f"{step.per_minute:.1f} a minute, {step.failed} failed, {left} left"
