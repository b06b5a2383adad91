"""The command line: thin; every command calls a function that Python users call too."""

import logging
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Console
from rich.status import Status
from rich.table import Table

import plantsim as ps
from plantsim.doctor import examine, missing_packages
from plantsim.errors import ModelError, PlantsimError
from plantsim.paths import writable

app = typer.Typer(
    help="Grow plants, make them solid, bend them, and learn their stiffness from touches.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)
console = Console()


@app.callback(invoke_without_command=True)
def plantsim(
    version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
) -> None:
    """Grow plants, make them solid, bend them, and learn their stiffness from touches."""
    if version:
        typer.echo(ps.__version__)
        raise typer.Exit


@app.command()
def demo(
    seed: Annotated[int, typer.Option(min=0, help="Seed of the plant.")] = 7,
    out: Annotated[Path, typer.Option(help="Folder for the files.")] = Path("demo"),
) -> None:
    """Grow a plant, mesh it, push it, fit its stiffness, and draw it.

    Example: plantsim demo --seed 7 --out demo
    """
    from plantsim.demo import Stage, run  # noqa: PLC0415  loads every library

    table = Table(title=f"plantsim demo, seed {seed}", title_justify="left")
    for column in ("stage", "what it made", "seconds", "paper"):
        table.add_column(column, justify="right" if column == "seconds" else "left")
    total = 0.0
    with console.status("growing ...") as status:

        def tell(stage: Stage) -> None:
            nonlocal total
            total += stage.seconds
            seconds = (
                f"{stage.seconds:.2f}" if stage.seconds > 0.1 else f"{stage.seconds:.4f}"
            )
            table.add_row(stage.name, stage.made, seconds, stage.paper)
            status.update(f"{stage.name} done, {total:.0f} s ...")

        files = run(seed, out, tell)
    table.add_row("all", f"{len(files)} files in {out}/", f"{total:.1f}", "")
    console.print(table)


@app.command()
def grow(
    species: Annotated[str, typer.Argument(help="A species, or a .toml file.")] = "apple",
    seed: Annotated[int, typer.Option(min=0, help="Seed of the plant.")] = 7,
    levels: Annotated[int | None, typer.Option(help="Levels; 1: the trunk.")] = None,
    whole: Annotated[
        bool, typer.Option("--whole", help="All that the model grows, unfit to be meshed.")
    ] = False,
    out: Annotated[
        Path | None, typer.Option(help="Write the skeleton here: .json, .swc or .csv.")
    ] = None,
    picture: Annotated[Path | None, typer.Option(help="Draw it here: .png")] = None,
    list_: Annotated[bool, typer.Option("--list", help="Show the species.")] = False,
) -> None:
    """Grow a plant's skeleton, describe it, write it, draw it.

    Example: plantsim grow apple --seed 7 --out apple.json --picture apple.png
    """
    if list_:
        table = Table(title=f"species, grown with seed {seed}", title_justify="left")
        for column in ("species", "height, m", "limbs", "thinnest radius, mm"):
            table.add_column(column, justify="left" if column == "species" else "right")
        for name in ps.species_names():
            found = ps.weber_penn(name, rng=seed)
            thin = 1e3 * float(found.radius.min())
            table.add_row(name, f"{found.height:.2f}", f"{len(found.first)}", f"{thin:.2f}")
        console.print(table)
        return
    toml = species.lower().endswith(".toml")
    model = ps.WeberPenn.read(species) if toml else ps.species(species)
    found = ps.weber_penn(model, rng=seed, levels=levels, ready=not whole)
    typer.echo(repr(found))
    if out is not None:
        typer.echo(f"wrote {ps.write_skeleton(found, out)}")
    if picture is not None:
        typer.echo(f"wrote {found.plot(picture)}")


@app.command()
def mesh(
    source: Annotated[
        Path,
        typer.Argument(
            help="A skeleton (.json, .swc, .csv), geometry (.geo, .step, .brep, .iges) or "
            "mesh (.msh, .vtu, .npz)."
        ),
    ],
    out: Annotated[
        Path | None, typer.Option(help="Write the mesh here: .msh, .vtu or .npz.")
    ] = None,
    picture: Annotated[Path | None, typer.Option(help="Draw the mesh here: .png")] = None,
    quality: Annotated[
        Path | None, typer.Option(help="Draw the histogram of its quality here: .png")
    ] = None,
    order: Annotated[
        int | None, typer.Option(help="1 or 2; geometry: 2, mesh: as it is.")
    ] = None,
    size: Annotated[
        float | None,
        typer.Option(help="Skeleton: edge over radius. Geometry: scales its mesh sizes."),
    ] = None,
    tips: Annotated[
        str, typer.Option(help="Of a skeleton's limbs: round, flat.")
    ] = "round",
    set_: Annotated[
        list[str] | None,
        typer.Option("--set", help="A parameter of a .geo script: L=2.0; may be repeated."),
    ] = None,
    timeout: Annotated[
        float | None, typer.Option(help="Longest that meshing may take [s].")
    ] = None,
    drop_unused: Annotated[
        bool, typer.Option("--drop-unused", help="Drop vertices that are in no tet.")
    ] = False,
    trust: Annotated[
        bool, typer.Option("--trust", help="Run a script even if it could run programs.")
    ] = False,
) -> None:
    """Mesh a skeleton or a geometry file, or read a mesh; check, describe, write, draw it.

    Example: plantsim mesh apple.json --out apple.msh --picture apple.png
    """
    # before the work, not after it
    for path, suffixes in (
        (out, (".msh", ".vtu", ".npz")),
        (picture, (".png",)),
        (quality, (".png",)),
    ):
        if path is not None:
            writable(path, *suffixes)
    kind = source.suffix.lower()
    if kind in (".msh", ".vtu", ".npz"):
        if size is not None or set_:
            raise ModelError(f"{source} is a mesh already. Leave --size and --set out.")
        found = ps.read_mesh(source, drop_unused=drop_unused)
        found = found if order is None else found.with_order(order)
    else:
        geometry: Path | ps.Solid = source
        options: dict[str, Any] = {"order": order or 2, "timeout": timeout}
        if kind in (".json", ".swc", ".csv"):
            geometry = ps.sweep(ps.read_skeleton(source), tips=tips)  # type: ignore[arg-type]
        else:
            options |= {"trust": trust, "parameters": _parameters(set_ or [])}
        with console.status("meshing ...") as status, _steps(status):
            found = ps.tetrahedralize(geometry, size, **options)
    typer.echo(repr(found))
    typer.echo(str(found.size_report()))
    for name, ids in found.sets.items():
        if name.removeprefix("limb ") not in found.region_names:
            typer.echo(f"  set {name}: {len(ids):,} vertices")
    if out is not None:
        typer.echo(f"wrote {ps.write_mesh(found, out)}")
    if picture is not None:
        typer.echo(f"wrote {found.plot(picture)}")
    if quality is not None:
        typer.echo(f"wrote {ps.figure_quality(found, quality)}")


@contextmanager
def _steps(status: Status) -> Iterator[None]:
    """Show what the mesher says it does."""

    class Tell(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            status.update(f"meshing: {record.getMessage()}")

    logger, tell = logging.getLogger("plantsim.solid"), Tell(logging.INFO)
    before = logger.level
    logger.addHandler(tell)
    logger.setLevel(logging.INFO)
    try:
        yield
    finally:
        logger.removeHandler(tell)
        logger.setLevel(before)


def _parameters(given: list[str]) -> dict[str, float | str]:
    """Return NAME=VALUE options as a dict, numbers where they are numbers."""
    out: dict[str, float | str] = {}
    for text in given:
        name, equals, value = text.partition("=")
        if not equals:
            raise ModelError(f"--set {text!r}: give NAME=VALUE, as L=2.0.")
        try:
            out[name.strip()] = float(value)
        except ValueError:
            out[name.strip()] = value
    return out


@app.command()
def push(
    source: Annotated[Path, typer.Argument(help="A mesh: .msh, .vtu or .npz.")],
    moved: Annotated[str, typer.Option(help="Vertex ids with commas, or a set's name.")],
    by: Annotated[str, typer.Option(help="Displacement in m: x,y,z.")] = "0,0,-0.01",
    fixed: Annotated[
        str, typer.Option(help="Vertex ids with commas, or a set's name.")
    ] = "base",
    young: Annotated[float, typer.Option(help="Young's modulus [Pa].")] = 6e9,
    poisson: Annotated[float, typer.Option(help="Poisson's ratio.")] = 0.3,
    solver: Annotated[str, typer.Option(help="auto, direct or multigrid.")] = "auto",
    out: Annotated[Path | None, typer.Option(help="Write the state here: .vtu")] = None,
    picture: Annotated[Path | None, typer.Option(help="Draw the state here: .png")] = None,
) -> None:
    """Move vertices of a plant and tell the force that takes.

    Example: plantsim push plant.msh --moved 120,121,122 --by 0,0,-0.02 --out pushed.vtu
    """
    # before the work, not after it
    for path, suffix in ((out, ".vtu"), (picture, ".png")):
        if path is not None:
            writable(path, suffix)
    found = ps.read_mesh(source)
    model = ps.ElasticModel(
        found,
        ps.Material(young, poisson),
        fixed=_ids(fixed, "fixed", found),
        solver=solver,  # type: ignore[arg-type]
    )
    state = model.solve(ps.move(_ids(moved, "moved", found), _numbers(by, "by", 3)))
    typer.echo(repr(state))
    total = state.force[state.moved].sum(axis=0)
    typer.echo(
        f"force on the moved vertices in all: {total[0]:.4g} {total[1]:.4g} "
        f"{total[2]:.4g} N"
    )
    if out is not None:
        from plantsim.demo import write_state  # noqa: PLC0415

        typer.echo(f"wrote {write_state(state, out)}")
    if picture is not None:
        typer.echo(f"wrote {ps.figure_deformation(state, picture)}")


@app.command()
def doctor(
    packages: Annotated[
        bool, typer.Option("--packages", help="Print missing Debian packages only.")
    ] = False,
) -> None:
    """Say what of the environment is missing and how to mend it.

    Example: plantsim doctor
    """
    if packages:
        typer.echo(" ".join(missing_packages()))
        return
    sick = False
    for check in examine():
        mark = "ok  " if not check.mend else ("MISS" if check.needed else "opt ")
        sick = sick or (bool(check.mend) and check.needed)
        mend = f"  -> {check.mend}" if check.mend else ""
        typer.echo(f"{mark} {check.name}: {check.found}{mend}")
    if sick:
        raise typer.Exit(1)


def _ids(text: str, what: str, mesh: ps.TetMesh) -> str | list[int]:
    """Return a set's name, or the vertex ids in a list with commas."""
    if text in mesh.sets or any(c.isalpha() for c in text):
        return text
    try:
        return [int(part) for part in text.split(",")]
    except ValueError:
        raise ModelError(
            f"--{what} {text!r}: give vertex ids with commas, or a set."
        ) from None


def _numbers(text: str, what: str, count: int) -> np.ndarray:
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) != count:
        raise ModelError(f"--{what} {text!r}: give {count} numbers with commas.")
    return np.array(values)


def main() -> None:
    """Run the command line; an error of ours is one sentence on stderr and exit code 1."""
    try:
        app()
    except PlantsimError as why:
        typer.echo(f"plantsim: {why}", err=True)
        sys.exit(1)
    except OSError as why:  # no room, no permission, a folder in a file's place
        typer.echo(f"plantsim: {why.filename or 'file'}: {why.strerror or why}.", err=True)
        sys.exit(1)
