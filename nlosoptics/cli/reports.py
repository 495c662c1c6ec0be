"""Command report."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from .._whole_files import write_whole
from ..runs.record import PAGE
from .shell import Debug, app, check_file, errors_told, progress_bar


@app.command("report", short_help="Write one HTML page about a result folder.")
def report_command(
    folder: Annotated[
        Path,
        typer.Argument(metavar="RESULT_DIR", help="Folder written by run, reconstruct or phasor."),
    ],
    out: Annotated[
        Path | None, typer.Option(help=f"HTML file to write; by default RESULT_DIR/{PAGE}.")
    ] = None,
    three_d: Annotated[
        bool, typer.Option("--3d/--no-3d", help="Include a 3-D view that can be rotated.")
    ] = True,
    debug: Debug = False,
) -> None:
    """Write one HTML page about a result folder, for screen and print.

    The page contains all pictures and needs no network.
    """
    with errors_told(debug):
        from .. import report
        from ..report.pages import read_record

        file = folder / PAGE if out is None else out
        if file.suffix.lower() not in (".html", ".htm"):
            raise typer.BadParameter(
                f"{file} does not end in .html; give a name that does", param_hint="--out"
            )
        read_record(folder)  # check the input before the output path
        check_file(file)
        with progress_bar() as progress:
            progress("report", 0.0)
            text = report.page(folder, computed=three_d)
        page, contents = text.encode(), {}
        if file.resolve().parent == folder.resolve():
            # first, so that a page is in the list whenever the process is killed
            contents[folder / "result.json"] = _owning(folder, file.name)
        write_whole(contents | {file: page})
        typer.echo(f"{file}: {len(page) / 1e6:.2g} MB")


def _owning(folder: Path, name: str) -> bytes:
    """Return the folder's record with the file ``name`` added to its list of files.

    A later run may then replace the folder.
    """
    record = json.loads((folder / "result.json").read_bytes())
    record["files"] = sorted({*record["files"], name})
    return (json.dumps(record, indent=2, allow_nan=False) + "\n").encode()
