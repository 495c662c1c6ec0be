"""Command verify."""

from __future__ import annotations

import platform
from pathlib import Path
from typing import Annotated

import typer

from .._checks import lasting
from .shell import DONE, FAILED, Debug, app, errors_told, progress_bar


@app.command("verify", short_help="Check the library on this machine.")
def verify_command(
    zernikes: Annotated[
        Path | None,
        typer.Option(
            metavar="TABLE",
            help="Zernike coefficients that a design program wrote, to compare its rms as well. "
            "Lines such as '# ordering: fringe', '# unit: waves' and '# sign: excess' in it tell "
            "their meaning.",
        ),
    ] = None,
    rms: Annotated[
        float | None,
        typer.Option(metavar="WAVES", help="Rms aberration that the program prints for TABLE."),
    ] = None,
    debug: Debug = False,
) -> None:
    """Compare results on this machine with closed forms, published values and invariants.

    Each line gives passed or FAILED, the error, the largest error that rounding, quadrature or
    chance may cause, the quantity, and where the expected value comes from. The exit code is 1 if
    an error is larger. The checks take about 15 s.
    A table of Zernike coefficients is compared by --zernikes zernikes.txt --rms 0.0714.

    Example: nlosoptics verify
    """
    with errors_told(debug):
        from ..runs.record import versions
        from ..verification import verify

        with progress_bar(width=32) as progress:
            checks = verify(progress, zernikes=zernikes, rms=rms)
        for check in checks:
            verdict = "passed" if check.passed else "FAILED"
            where = check.reason or check.source
            typer.echo(f"{verdict} {check.error:8.1e} of {check.limit:7.1e}  {check.name}: {where}")
        failed = sum(not check.passed for check in checks)
        took = lasting(sum(check.seconds for check in checks))
        typer.echo(f"{len(checks) - failed} of {len(checks)} checks passed in {took}")
        typer.echo(", ".join(f"{name} {version}" for name, version in versions().items()))
        typer.echo(platform.platform())
    raise typer.Exit(FAILED if failed else DONE)
