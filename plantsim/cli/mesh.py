"""plantsim mesh: a skeleton, geometry or mesh -> a checked mesh: told, written, drawn."""

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

import plantsim as ps
from plantsim.cli.app import Json, Report, app, reporting, working
from plantsim.errors import ModelError
from plantsim.mesh.files import FORMATS
from plantsim.mesh.surfaces import SURFACES
from plantsim.paths import writable
from plantsim.view.style import FORMATS as PLOTS

SKELETONS = (".json", ".swc", ".csv")


@app.command()
def mesh(
    source: Annotated[
        Path,
        typer.Argument(
            help="A skeleton (.json, .swc, .csv), geometry (.geo, .step, .brep, .iges), "
            "closed surface (.stl, .obj, .ply) or mesh (.msh, .vtu, .npz)."
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            help="Write it here: .msh, .vtu, .npz; surface: .stl, .ply, .obj, .glb."
        ),
    ] = None,
    picture: Annotated[Path | None, typer.Option(help="Draw the mesh here: .png")] = None,
    quality: Annotated[
        Path | None,
        typer.Option(help="Draw the histogram of its quality here: .png, .svg."),
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
    kernel: Annotated[
        str, typer.Option(help="Of a skeleton's mesh: occ, union (extra fast).")
    ] = "occ",
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
    json: Json = False,
) -> None:
    """Mesh a skeleton or a geometry file, or read a mesh; check, describe, write, draw it.

    Example: plantsim mesh apple.json --out apple.msh --picture apple.png
    """
    with reporting(json) as report:
        # before the work, not after it
        kinds = ((out, (*FORMATS, *SURFACES)), (picture, (".png",)), (quality, PLOTS))
        for path, suffixes in kinds:
            if path is not None:
                writable(path, *suffixes)
        kind = source.suffix.lower()
        if kind in FORMATS:
            if size is not None or set_:
                raise ModelError(f"{source} is a mesh already. Leave --size and --set out.")
            found = ps.read_mesh(source, drop_unused=drop_unused)
            found = found if order is None else found.with_order(order)
        else:
            geometry: Path | ps.Solid = source
            options: dict[str, Any] = {"order": order or 2, "timeout": timeout}
            if kind in SKELETONS:
                geometry = ps.sweep(ps.read_skeleton(source), tips=tips)  # type: ignore[arg-type]
                options["kernel"] = kernel
            else:
                options |= {"trust": trust, "parameters": _parameters(set_ or [])}
            with working(f"meshing {source.name}") as step, _told(step):
                found = ps.tetrahedralize(geometry, size, **options)
        regions = np.bincount(np.asarray(found.region), minlength=len(found.region_names))
        limbs = {f"limb {name}" for name in found.region_names}
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
        report.tell(str(found.size_report()))
        _tell_attempts(report, found)
        for name, ids in found.sets.items():
            if name not in limbs:
                report.tell(f"  set {name}: {len(ids):,} vertices")
        if out is not None:
            report.wrote(ps.write_mesh(found, out))
        if picture is not None:
            with working("drawing"):
                report.wrote(found.plot(picture))
        if quality is not None:
            report.wrote(Path(ps.figure_quality(found, quality)))


def _tell_attempts(report: Report, mesh: ps.TetMesh) -> None:
    """Tell every attempt at a solid: its seconds by step, and why it failed if it did."""
    made = list((mesh.report or {}).get("attempts", ()))
    for i, note in enumerate(made):
        steps = ", ".join(f"{step} {s:.2f} s" for step, s in note["seconds"].items())
        filler = note.get("algorithm", "no filler yet")
        ended = f"; failed: {note['failure']}" if "failure" in note else ""
        report.tell(f"  attempt {i + 1}, {filler}: {steps}{ended}", attempts=made)


@contextmanager
def _told(step: Callable[[str], None]) -> Iterator[None]:
    """Show what the mesher says it does."""

    class Tell(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            step(f"meshing: {record.getMessage()}")

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
