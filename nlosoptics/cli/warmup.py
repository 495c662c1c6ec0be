"""Command warmup."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer

from .shell import Debug, app, errors_told, load, progress_bar


@app.command("warmup", short_help="Compile in advance, for a fast first run.")
def warmup_command(
    scene_files: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="[SCENE...]",
            help="Scene files for whose runs to compile; by default walls of all kinds.",
        ),
    ] = None,
    debug: Debug = False,
) -> None:
    """Compile the functions that a run uses, so that the first run is as fast as later ones.

    The compiled code is kept on the disk. A run compiles by itself what is missing.
    """
    with errors_told(debug):
        start = time.perf_counter()
        from ..runs.warmup import warm_up

        scenes = [load(path, None, None) for path in scene_files or ()]
        with progress_bar() as progress:
            warm_up(scenes, progress)
        typer.echo(f"compiled functions are ready, {time.perf_counter() - start:.1f} s")
