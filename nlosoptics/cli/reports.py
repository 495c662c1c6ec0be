"""The command that shows a run: report."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from .._whole_files import write_whole
from ..runs.record import PAGE
from .shell import Debug, app, check_file, errors_told, progress_bar


@app.command("report")
def report_command(
    folder: Annotated[
        Path,
        typer.Argument(metavar="RESULT_DIR", help="What run, reconstruct or phasor wrote."),
    ],
    out: Annotated[
        Path | None, typer.Option(help=f"HTML file; RESULT_DIR/{PAGE} by default.")
    ] = None,
    three_d: Annotated[
        bool, typer.Option("--3d/--no-3d", help="Show the scene in three dimensions.")
    ] = True,
    debug: Debug = False,
) -> None:
    """Make one HTML page about a run: all in one file, for screens and paper."""
    with errors_told(debug):
        from .. import report

        file = folder / PAGE if out is None else out
        if file.suffix.lower() not in (".html", ".htm"):
            raise typer.BadParameter(f"{file} does not end in .html", param_hint="--out")
        report.Folder.read(folder)  # refused before a place for the page is looked for
        check_file(file)
        with progress_bar() as progress:
            progress("report", 0.0)
            text = report.page(folder, interactive=three_d)
        contents = {file: text.encode()}
        if file.resolve().parent == folder.resolve():
            contents[folder / "result.json"] = _owning(folder, file.name)
        write_whole(contents)
        typer.echo(f"{file}: {len(contents[file]) / 1e6:.2g} MB")


def _owning(folder: Path, name: str) -> bytes:
    """The folder's record with one more file of its own, so that a later run may replace it."""
    record = json.loads((folder / "result.json").read_bytes())
    record["files"] = sorted({*record["files"], name})
    return (json.dumps(record, indent=2, allow_nan=False) + "\n").encode()
