"""plantsim view: a plant on a local page, to be dragged with the mouse."""

import contextlib
import faulthandler
import signal
import webbrowser
from pathlib import Path
from typing import Annotated

import typer

import plantsim as ps
from plantsim.cli.app import Json, app, ids_from, reporting, species_like, working
from plantsim.errors import DependencyError, ModelError
from plantsim.paths import writable


@app.command()
def view(
    source: Annotated[
        Path | None, typer.Argument(help="A mesh: .msh, .vtu or .npz; else grow one.")
    ] = None,
    species: Annotated[
        str, typer.Option(help="What to grow.", autocompletion=species_like)
    ] = "apple",
    seed: Annotated[int, typer.Option(min=0, help="Seed of the plant.")] = 7,
    limbs: Annotated[int, typer.Option(min=1, help="Limbs to keep of what grows.")] = 12,
    fixed: Annotated[
        str, typer.Option(help="Vertex ids with commas, or a set's name.")
    ] = "base",
    young: Annotated[float, typer.Option(help="Young's modulus [Pa].")] = 6e9,
    poisson: Annotated[float, typer.Option(help="Poisson's ratio.")] = 0.35,
    density: Annotated[float, typer.Option(help="Density [kg/m^3].")] = 900.0,
    touches: Annotated[
        Path | None, typer.Option(help="Write recorded touches here.")
    ] = None,
    host: Annotated[
        str, typer.Option(help="Address to listen on; any but loopback has no password.")
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="0: any free one.")] = 8080,
    open_: Annotated[bool, typer.Option("--open", help="Open it in the browser.")] = False,
    json: Json = False,
) -> None:
    """Show a plant on a local page: drag it, feel the force, learn its stiffness.

    Ctrl-C ends it.

    Example: plantsim view --species apple --seed 7 --open
    """
    try:
        from plantsim.view.app import Viewer  # noqa: PLC0415  an extra
    except ImportError as why:
        raise DependencyError(
            f"no viewer: {why.name} is not installed. Run: pip install 'plantsim[view]'"
        ) from None
    if touches is not None:
        # a wrong suffix is told now, not on the page
        writable(touches, ".h5", ".hdf5", ".npz")
    material = ps.Material(young, poisson, density)
    if source is not None and str(source) in ps.species_names() and not source.exists():
        raise ModelError(
            f"{source} is a species, and here a mesh's file is asked for. To grow one: "
            f"plantsim view --species {source}"
        )
    if source is not None:
        mesh, name, masses = ps.read_mesh(source), source.name, None
    else:
        from plantsim.view.plants import potted  # noqa: PLC0415

        with working(f"growing and meshing {species} {seed}"):
            pot = potted(species, seed, limbs)
        mesh, name, masses = pot.mesh, pot.name, pot.masses
    with working("preparing the model"):
        viewer = Viewer(
            mesh,
            material,
            name=name,
            masses=masses,
            fixed=ids_from(fixed, "fixed", mesh),
            host=host,
            port=port,
            touches=touches,
        )
    # Ctrl-C is the way to end it, from the moment that it is told of
    with contextlib.suppress(RuntimeError, ValueError, OSError):  # there is no stderr
        faulthandler.enable()  # else a crash in C would end it without a word
    with viewer, contextlib.suppress(KeyboardInterrupt):
        signal.signal(signal.SIGTERM, signal.default_int_handler)
        with reporting(json) as report:
            told = f"{name} is on {viewer.url} (Ctrl-C ends it)"
            report.tell(told, name=name, url=viewer.url)
        if host not in ("127.0.0.1", "localhost", "::1"):
            typer.echo("anyone who reaches this address may use the page", err=True)
        if open_:
            webbrowser.open(viewer.url)
        viewer.wait()
    if not json:
        typer.echo("closed")
