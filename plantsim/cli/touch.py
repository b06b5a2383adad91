"""plantsim touch: what a robot would see and feel of a plant, simulated, to a file."""

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

import plantsim as ps
from plantsim.cli.app import Json, app, ids_from, numbers, reporting, working
from plantsim.paths import writable


@app.command()
def touch(
    source: Annotated[Path, typer.Argument(help="A mesh: .msh, .vtu or .npz.")],
    out: Annotated[Path, typer.Option(help="Write the touches here: .h5 or .npz.")],
    moved: Annotated[
        str | None,
        typer.Option(help="Vertex ids with commas, or a set; else drawn at random."),
    ] = None,
    by: Annotated[str, typer.Option(help="Displacement in m: x,y,z.")] = "0,0,-0.01",
    shots: Annotated[int, typer.Option(min=1, help="Touches drawn at random.")] = 5,
    fixed: Annotated[
        str, typer.Option(help="Vertex ids with commas, or a set's name.")
    ] = "base",
    young: Annotated[float, typer.Option(help="Young's modulus [Pa].")] = 6e9,
    scatter: Annotated[
        float, typer.Option(min=0, help="Of the limbs' log Young's moduli.")
    ] = 0.0,
    poisson: Annotated[float, typer.Option(help="Poisson's ratio.")] = 0.3,
    camera: Annotated[
        str | None, typer.Option(help="Only what is seen from here [m]: x,y,z.")
    ] = None,
    displacement_noise: Annotated[float, typer.Option(help="[m]")] = 0.0,
    force_noise: Annotated[float, typer.Option(help="[N]")] = 0.0,
    seed: Annotated[int, typer.Option(min=0, help="Of touches, noise and scatter.")] = 0,
    json: Json = False,
) -> None:
    """Simulate what a robot sees and feels when it touches a plant.

    Example: plantsim touch plant.msh --shots 5 --displacement-noise 0.001 --out touches.h5
    """
    with reporting(json) as report:
        writable(out, ".h5", ".hdf5", ".npz")
        found = ps.read_mesh(source)
        rng = np.random.default_rng(seed)
        limbs = young * np.exp(scatter * rng.normal(size=len(found.region_names)))
        material = ps.Material(limbs[np.asarray(found.region)], poisson)
        model = ps.ElasticModel(found, material, fixed=ids_from(fixed, "fixed", found))
        push = numbers(by, "by", 3)
        if moved is not None:
            loads = [ps.move(ids_from(moved, "moved", found), push)]
        else:
            depth = float(np.linalg.norm(push))
            drawn = ps.sample_touches(model, shots, direction=push, depth=depth, rng=rng)
            loads = [one.last for one in drawn]
        view = None
        if camera is not None:
            view = ps.visible_vertices(found, numbers(camera, "camera", 3))
        seen = []
        with working("touching", len(loads)) as step:
            for i, load in enumerate(loads, 1):
                step(f"touch {i} of {len(loads)}")
                seen.append(
                    ps.observe(
                        model,
                        load,
                        seen=view,
                        displacement_noise=displacement_noise,
                        force_noise=force_noise,
                        rng=rng,
                    )
                )
        for one in seen:
            report.tell(repr(one))
        report.tell(touches=len(seen), vertices_seen=[len(one.seen) for one in seen])
        report.wrote(ps.write_observations(seen, out))
