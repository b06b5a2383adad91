"""plantsim demo: the whole chain once."""

from pathlib import Path
from typing import Annotated

import typer

from plantsim.cli.app import Json, app, reporting, working


@app.command()
def demo(
    seed: Annotated[int, typer.Option(min=0, help="Seed of the plant.")] = 7,
    out: Annotated[Path, typer.Option(help="Folder for the files.")] = Path("demo"),
    json: Json = False,
) -> None:
    """Grow a plant, mesh it, push it, fit its stiffness, and draw it.

    Example: plantsim demo --seed 7 --out demo
    """
    from plantsim.demo import STAGES, Stage, run  # noqa: PLC0415  loads every library

    stages: list[Stage] = []
    with reporting(json) as report:
        with working("growing", STAGES) as step:

            def tell(stage: Stage) -> None:
                stages.append(stage)
                step(f"{stage.name} done")

            files = run(seed, out, tell)
        total = sum(stage.seconds for stage in stages)
        rows = [(s.name, s.made, _time(s.seconds), s.paper) for s in stages]
        rows.append(("all", f"{len(files)} files in {out}/", f"{total:.1f}", ""))
        report.table(
            "stages",
            f"plantsim demo, seed {seed}",
            ("stage", "what it made", "seconds", "paper"),
            rows,
            left=(0, 1, 3),
        )
        report.tell(files=[str(path) for path in files], seconds=total)


def _time(seconds: float) -> str:
    return f"{seconds:.2f}" if seconds > 0.1 else f"{seconds:.4f}"
