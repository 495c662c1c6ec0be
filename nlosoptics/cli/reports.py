"""Command report."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from .._whole_files import RECORD, sweep, write_whole
from ..runs.record import PAGE, record_text
from .shell import Debug, app, check_file, errors_told, progress_bar


@app.command("report", short_help="Write one HTML page about a result folder.")
def report_command(
    folder: Annotated[
        Path,
        typer.Argument(
            metavar="RESULT_DIR",
            help="Folder written by run, reconstruct or image; for a "
            "study use nlosoptics study report.",
        ),
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

    The page contains all pictures and needs no network. Figures of a run that the folder lacks are
    drawn and added to it.

    Example: nlosoptics report corner --out corner.html
    """
    with errors_told(debug):
        from .. import report
        from ..report.pages import read_record

        file = folder / PAGE if out is None else out
        if file.suffix.lower() not in (".html", ".htm"):
            raise typer.BadParameter(
                f"{file} does not end in .html; give a name that does", param_hint="--out"
            )
        if not folder.exists():
            sweep(folder)  # a killed command may have moved it aside
        read_record(folder)  # check the input before the output path
        check_file(file)
        with progress_bar() as progress:
            progress("report", 0.0)
            text = report.page(folder, computed=three_d)
        page = text.encode()
        if file.resolve().parent == folder.resolve():
            _add(folder, {file.name: page})
        else:
            write_whole({file: page})
        typer.echo(f"{file}: {len(page) / 1e6:.2g} MB")


def _add(folder: Path, contents: dict[str, bytes]) -> None:
    """Write files to a result's folder, and to its list of files, so that it may be replaced."""
    record = json.loads((folder / RECORD).read_bytes())
    record["files"] = sorted({*record["files"], *contents})
    files = {folder / name: content for name, content in contents.items()}
    write_whole({folder / RECORD: record_text(record), **files})  # the list first
