"""Command materials."""

from __future__ import annotations

from typing import Annotated

import typer

from .shell import Debug, app, errors_told


@app.command("materials", short_help="List wall materials by name, with their values.")
def materials_command(
    name: Annotated[
        str | None,
        typer.Argument(
            metavar="NAME",
            help="Material to show with the range and source of each value; by default list all.",
        ),
    ] = None,
    debug: Debug = False,
) -> None:
    """List the wall materials that a scene file may name, or show one of them in detail.

    A scene file names a material by a line such as material = "whiteboard" in the table [wall] or
    [hidden].
    """
    with errors_told(debug):
        from ..scene.parts.library import entry, material_library

        if name is not None:
            typer.echo(str(entry(name)))
            return
        for material in material_library().values():
            values = ", ".join(f"{v.key} {v.value:.3g}" for v in material.values)
            told = " (estimates)" if material.is_estimate else ""
            typer.echo(f"{material.name:26s} {values}{told}")
