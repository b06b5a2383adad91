"""The command line: thin; every command calls a function that Python users call too."""

import sys
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import Console
from rich.table import Table

import plantsim as ps
from plantsim.doctor import examine, missing_packages
from plantsim.errors import DatasetError, ModelError, PlantsimError
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
    source: Annotated[Path, typer.Argument(help=".geo, .step, .brep, .msh, .vtu or .npz")],
    out: Annotated[
        Path | None, typer.Option(help="Write the mesh here: .msh, .vtu or .npz.")
    ] = None,
    order: Annotated[
        int | None, typer.Option(help="1 or 2; geometry: 2, mesh: as it is.")
    ] = None,
    size: Annotated[
        float | None, typer.Option(help="Scales a geometry's mesh sizes.")
    ] = None,
    drop_unused: Annotated[
        bool, typer.Option("--drop-unused", help="Drop vertices that are in no tet.")
    ] = False,
    trust: Annotated[
        bool, typer.Option("--trust", help="Run a script even if it could run programs.")
    ] = False,
) -> None:
    """Mesh a geometry file, or read a mesh; check it, describe it, write it.

    Example: plantsim mesh plant.geo --order 2 --out plant.msh
    """
    if out is not None:
        writable(out, ".msh", ".vtu", ".npz")
    if source.suffix.lower() in (".msh", ".vtu", ".npz"):
        if size is not None:
            raise ModelError(f"--size {size}: {source} is a mesh already. Leave it out.")
        found = ps.read_mesh(source, drop_unused=drop_unused)
        found = found if order is None else found.with_order(order)
    else:
        found = ps.tetrahedralize(
            source, size, order=2 if order is None else order, trust=trust
        )
    typer.echo(repr(found))
    for i, name in enumerate(found.region_names):
        typer.echo(f"  region {name}: {int((found.region == i).sum()):,} tets")
    for name, ids in found.sets.items():
        typer.echo(f"  set {name}: {len(ids):,} vertices")
    if out is not None:
        typer.echo(f"wrote {ps.write_mesh(found, out)}")


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
) -> None:
    """Make many plants with their touches, or finish what an earlier run began.

    Example: plantsim dataset --example recipe.toml, then
    plantsim dataset recipe.toml --out plants, then plantsim dataset --summary plants
    """
    from plantsim.datasets import command  # noqa: PLC0415

    if (recipe is None) != (out is None):
        raise DatasetError("give both a recipe and --out, or neither.")
    if all(given is None for given in (recipe, check, summary, example)):
        raise DatasetError("nothing to do: give a recipe and --out, or see --help.")
    if example is not None:
        typer.echo(f"wrote {command.write_example(example)}")
    sound = True
    if recipe is not None and out is not None:
        try:
            found = command.generate(console, recipe, out, workers, scheduler, retry)
        except KeyboardInterrupt:
            typer.echo("plantsim: interrupted. The same command goes on from there.")
            raise typer.Exit(130) from None
        typer.echo(repr(found))
        sound = bool(len(found))
    if check is not None:
        sound = command.check(console, check).sound and sound
    if summary is not None:
        typer.echo(f"wrote {command.summarise(summary)}")
    if not sound:
        raise typer.Exit(1)


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
