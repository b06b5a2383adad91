"""plantsim doctor: what of the environment is missing and how to mend it."""

from typing import Annotated

import typer

from plantsim.cli.app import Json, app, reporting
from plantsim.doctor import examine, missing_packages


@app.command()
def doctor(
    packages: Annotated[
        bool, typer.Option("--packages", help="Print missing Debian packages only.")
    ] = False,
    json: Json = False,
) -> None:
    """Say what of the environment is missing and how to mend it.

    Exit code 1 where something that plantsim cannot do without is missing.

    Example: plantsim doctor
    """
    if packages:
        typer.echo(" ".join(missing_packages()))
        return
    checks = []
    with reporting(json) as report:
        for check in examine():
            checks.append(check)
            mark = "ok  " if not check.mend else ("MISS" if check.needed else "opt ")
            mend = f"  -> {check.mend}" if check.mend else ""
            report.tell(f"{mark} {check.name}: {check.found}{mend}")
        sick = any(check.mend and check.needed for check in checks)
        report.tell(healthy=not sick, checks=[vars(check) for check in checks])
    if sick:
        raise typer.Exit(1)
