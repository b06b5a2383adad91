"""plantsim grow: a species and a seed, or a file of parameters -> a skeleton."""

from pathlib import Path
from typing import Annotated

import typer

import plantsim as ps
from plantsim.cli.app import Json, app, reporting, species_like, working
from plantsim.paths import writable
from plantsim.view.skeletons import contact_sheet
from plantsim.view.style import FORMATS as PLOTS


@app.command()
def grow(
    species: Annotated[
        str,
        typer.Argument(help="A species, or a .toml file.", autocompletion=species_like),
    ] = "apple",
    seed: Annotated[int, typer.Option(min=0, help="Seed of the plant.")] = 7,
    levels: Annotated[int | None, typer.Option(help="Levels; 1: the trunk.")] = None,
    whole: Annotated[
        bool, typer.Option("--whole", help="All that the model grows, unfit to be meshed.")
    ] = False,
    out: Annotated[
        Path | None, typer.Option(help="Write the skeleton here: .json, .swc or .csv.")
    ] = None,
    picture: Annotated[
        Path | None,
        typer.Option(help="Draw it here: .png, .svg, .pdf; with --list, all of them."),
    ] = None,
    list_: Annotated[bool, typer.Option("--list", help="Show the species.")] = False,
    json: Json = False,
) -> None:
    """Grow a plant's skeleton, describe it, write it, draw it.

    Example: plantsim grow apple --seed 7 --out apple.json --picture apple.png
    """
    with reporting(json) as report:
        # before the work, not after it
        if out is not None:
            writable(out, ".json", ".swc", ".csv")
        if picture is not None:
            writable(picture, *PLOTS)
        if list_:
            with working("growing", len(ps.species_names())) as step:
                rows, plants = [], []
                for name in ps.species_names():
                    found = ps.weber_penn(name, rng=seed)
                    thin = 1e3 * float(found.radius.min())
                    rows.append((name, found.height, len(found.first), thin))
                    plants.append((name, found))
                    step(name)
            columns = ("species", "height, m", "limbs", "thinnest radius, mm")
            report.table("species", f"species, grown with seed {seed}", columns, rows)
            if picture is not None:
                report.wrote(contact_sheet(plants, picture))
            return
        toml = species.lower().endswith(".toml")
        model = ps.WeberPenn.read(species) if toml else ps.species(species)
        with working(f"growing {species}"):
            found = ps.weber_penn(model, rng=seed, levels=levels, ready=not whole)
        report.tell(
            repr(found),
            limbs=len(found.first),
            nodes=len(found.points),
            height=found.height,
            thinnest_radius=float(found.radius.min()),
        )
        if out is not None:
            report.wrote(ps.write_skeleton(found, out))
        if picture is not None:
            report.wrote(found.plot(picture))
