"""plantsim mesh: a geometry or a mesh -> a checked mesh, described and written."""

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

import plantsim as ps
from plantsim.cli.app import Json, app, reporting, working
from plantsim.errors import ModelError
from plantsim.mesh.files import FORMATS
from plantsim.mesh.surfaces import SURFACES
from plantsim.paths import writable


@app.command()
def mesh(
    source: Annotated[Path, typer.Argument(help=".geo, .step, .brep, .msh, .vtu or .npz")],
    out: Annotated[
        Path | None,
        typer.Option(
            help="Write it here: .msh, .vtu, .npz; surface: .stl, .ply, .obj, .glb."
        ),
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
    json: Json = False,
) -> None:
    """Mesh a geometry file, or read a mesh; check it, describe it, write it.

    Example: plantsim mesh plant.geo --order 2 --out plant.msh
    """
    with reporting(json) as report:
        if out is not None:
            writable(out, *FORMATS, *SURFACES)
        if source.suffix.lower() in FORMATS:
            if size is not None:
                raise ModelError(
                    f"--size {size}: {source} is a mesh already. Leave it out."
                )
            found = ps.read_mesh(source, drop_unused=drop_unused)
            found = found if order is None else found.with_order(order)
        else:
            with working(f"meshing {source.name}"):
                found = ps.tetrahedralize(
                    source, size, order=2 if order is None else order, trust=trust
                )
        regions = np.bincount(np.asarray(found.region), minlength=len(found.region_names))
        report.tell(
            repr(found),
            order=found.order,
            vertices=len(found.points),
            tets=len(found.tets),
            volume=found.volume,
            worst_gamma=float(found.quality.min()),
            regions=dict(zip(found.region_names, regions.tolist(), strict=True)),
            sets={name: len(ids) for name, ids in found.sets.items()},
        )
        for name, count in zip(found.region_names, regions, strict=True):
            report.tell(f"  region {name}: {count:,} tets")
        for name, ids in found.sets.items():
            report.tell(f"  set {name}: {len(ids):,} vertices")
        if out is not None:
            report.wrote(ps.write_mesh(found, out))
