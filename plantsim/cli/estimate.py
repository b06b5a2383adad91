"""plantsim estimate: a mesh and touches -> the limbs' stiffness, and how sure it is."""

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

import plantsim as ps
from plantsim.cli.app import Json, app, ids_from, reporting, working
from plantsim.errors import ModelError
from plantsim.paths import writable


@app.command()
def estimate(
    source: Annotated[Path, typer.Argument(help="A mesh: .msh, .vtu or .npz.")],
    touches: Annotated[Path, typer.Argument(help="Observations: .h5 or .npz.")],
    parameters: Annotated[str, typer.Option(help="limb or element.")] = "limb",
    method: Annotated[str, typer.Option(help="map or force-balance.")] = "map",
    young: Annotated[float, typer.Option(help="The prior's Young's modulus [Pa].")] = 6e9,
    poisson: Annotated[float, typer.Option(help="The prior's Poisson's ratio.")] = 0.3,
    fixed: Annotated[
        str, typer.Option(help="Vertex ids with commas, or a set's name.")
    ] = "base",
    level: Annotated[
        float, typer.Option(help="Share of cases that the intervals hold.")
    ] = 0.9,
    out: Annotated[
        Path | None, typer.Option(help="Write the mesh with its moduli here: .vtu")
    ] = None,
    json: Json = False,
) -> None:
    """Estimate a plant's stiffness from touches, and say how sure it is.

    Example: plantsim estimate plant.msh touches.h5 --young 5e9 --out found.vtu
    """
    with reporting(json) as report:
        if out is not None:
            writable(out, ".vtu")
        kinds = {"limb": ps.per_limb(), "element": ps.per_element()}
        if parameters not in kinds:
            raise ModelError(f"--parameters {parameters!r}: give limb or element.")
        found = ps.read_mesh(source)
        prior = ps.ElasticModel(
            found, ps.Material(young, poisson), fixed=ids_from(fixed, "fixed", found)
        )
        with working("estimating") as step:
            result = ps.estimate(
                prior,
                ps.read_observations(touches),
                parameters=kinds[parameters],
                method=method,  # type: ignore[arg-type]
                progress=lambda now: step(
                    f"iteration {now.iteration}, cost {now.cost:.4g}"
                ),
            )
            sure = method == "map"
            bounds = result.interval(level) if sure else {}
            seen = result.identified if sure else {}
        report.tell(repr(result), method=method)
        rows = []
        for name, value in result.young().items():
            low, high = bounds.get(name, (np.nan, np.nan))
            known = (low / 1e9, high / 1e9, seen[name]) if sure else ("", "", "")
            rows.append((name, value / 1e9, *known))
        report.table(
            "limbs",
            f"Young's modulus by limb, GPa, with the bounds of {level:.0%}",
            ("limb", "estimate", "low", "high", "seen"),
            rows,
        )
        if out is not None:
            count = len(found.tets)
            data = {
                "young": np.broadcast_to(result.material.young, (count,)),
                "poisson": np.broadcast_to(result.material.poisson, (count,)),
            }
            if sure:
                data["young_std"] = result.tet_std
            report.wrote(ps.write_mesh(found, out, cell_data=data))
