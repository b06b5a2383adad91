"""plantsim push: vertices of a mesh moved -> the force that takes."""

from pathlib import Path
from typing import Annotated

import typer

import plantsim as ps
from plantsim.cli.app import Json, app, ids_from, numbers, reporting, working
from plantsim.mesh.surfaces import SURFACES
from plantsim.paths import writable


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
    kinematics: Annotated[
        str, typer.Option(help="linear, or corotational for large rotations.")
    ] = "linear",
    out: Annotated[
        Path | None,
        typer.Option(help="Write the state here: .vtu; deformed surface: .stl .."),
    ] = None,
    picture: Annotated[Path | None, typer.Option(help="Draw the state here: .png")] = None,
    json: Json = False,
) -> None:
    """Move vertices of a plant and tell the force that takes.

    Example: plantsim push plant.msh --moved 120,121,122 --by 0,0,-0.02 --out pushed.vtu
    """
    with reporting(json) as report:
        # before the work, not after it
        if out is not None:
            writable(out, ".vtu", *SURFACES)
        if picture is not None:
            writable(picture, ".png")
        found = ps.read_mesh(source)
        model = ps.ElasticModel(
            found,
            ps.Material(young, poisson),
            fixed=ids_from(fixed, "fixed", found),
            solver=solver,  # type: ignore[arg-type]
            kinematics=kinematics,  # type: ignore[arg-type]
        )
        with working(f"bending {source.name}"):
            state = model.solve(
                ps.move(ids_from(moved, "moved", found), numbers(by, "by", 3))
            )
        total = state.force[state.moved].sum(axis=0)
        report.tell(
            repr(state),
            force=total,
            energy=state.energy,
            max_rotation=state.max_rotation,
            unknowns=state.stats.unknowns,
            solver=state.stats.solver,
            backward_error=state.stats.backward_error,
            seconds=state.stats.seconds,
        )
        report.tell(
            f"force on the moved vertices in all: {total[0]:.4g} {total[1]:.4g} "
            f"{total[2]:.4g} N"
        )
        if out is not None:
            report.wrote(ps.write_state(state, out))
        if picture is not None:
            with working("drawing"):
                report.wrote(ps.figure_deformation(state, picture))
