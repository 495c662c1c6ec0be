"""Command materials."""

from __future__ import annotations

from typing import Annotated

import typer

from .shell import Debug, app, errors_told


@app.command("materials", short_help="List wall materials by name, with values and sources.")
def materials_command(
    name: Annotated[
        str | None, typer.Argument(metavar="NAME", help="Material to show with its sources.")
    ] = None,
    debug: Debug = False,
) -> None:
    """List the materials that a scene file may name, or show one with ranges and sources.

    A scene file names one by material = "whiteboard" in its table [wall] or [hidden].
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
