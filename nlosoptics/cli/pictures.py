"""Commands that look: view."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .._progress import Progress
from .shell import (
    Debug,
    SceneFile,
    Seed,
    app,
    check_file,
    errors_told,
    load,
    progress_bar,
    require,
)

if TYPE_CHECKING:
    from ..scene import Scene

SUFFIXES = (".png", ".html", ".glb")
MOST_RAYS = 1 << 17  # that are traced to find paths of a rare kind


class Colour(StrEnum):
    """What the paths' colours stand for."""

    bounces = "bounces"
    path_length = "path_length"
    weight = "weight"
    aberration = "aberration"


@app.command("view")
def view_command(
    scene_file: SceneFile,
    out: Annotated[
        Path | None,
        typer.Option(help="File: .png, .html to turn in a browser, or .glb; a window by default."),
    ] = None,
    paths: Annotated[
        int, typer.Option(min=0, max=100_000, help="Light paths to draw; 0 for the room alone.")
    ] = 500,
    bounces: Annotated[
        int | None, typer.Option(min=1, max=64, help="Only paths of so many reflections.")
    ] = None,
    colour: Annotated[
        Colour,
        typer.Option(help="aberration draws the wave from the object's reference point."),
    ] = Colour.bounces,
    seed: Seed = 0,
    debug: Debug = False,
) -> None:
    """Show a scene and the light's paths through it in 3-D, in a window or a file."""
    with errors_told(debug):
        start = time.perf_counter()
        if out is not None:
            if out.suffix.lower() not in SUFFIXES:
                raise typer.BadParameter(
                    f"{out} is none of {', '.join(SUFFIXES)}", param_hint="--out"
                )
            check_file(out)
        require("pyvista", "views")
        from .. import views

        # some systems want windows in the main thread; a trial for a file waits on nothing
        plotter = views.window() if out is None else None
        with ThreadPoolExecutor(1) as beside:
            trial = beside.submit(_try_to_render, out)
            scene = load(scene_file, None)
            trial.result()
        with progress_bar() as progress:
            if paths:
                drawn = _drawn(scene, paths, bounces, colour, seed, progress)
                plotter = views.ray_paths(
                    scene=scene,
                    colour=colour.value,
                    n_bounces=bounces,
                    most=paths,
                    plotter=plotter,
                    **drawn,
                )
            else:
                plotter = views.scene_3d(scene, plotter=plotter)
            progress("drawing", 1.0)
            if out is not None:
                views.save(plotter, out)
        if out is None:
            plotter.show()
        else:
            size, spent = out.stat().st_size / 1e6, time.perf_counter() - start
            typer.echo(f"written to {out}, {size:.2f} MB, in {spent:.1f} s")


def _try_to_render(out: Path | None) -> None:
    """Raise where a PNG is wanted and nothing can be rendered."""
    from .. import views

    if out is not None and out.suffix.lower() == ".png":
        views.rendering_works()


def _drawn(
    scene: Scene,
    count: int,
    bounces: int | None,
    colour: Colour,
    seed: int,
    progress: Progress,
) -> dict[str, Any]:
    """Paths to draw, with the wave that colours them where it is asked for."""
    from ..errors import SceneError
    from ..raytrace import pupil_rays, trace

    if colour is Colour.aberration:
        from .. import psf

        found = pupil_rays(scene, n_rays=max(2 * count, 1024), seed=seed)
        wave = psf.wavefront_from_rays(found, psf.exit_pupil(scene), scene.laser.wavelength)
        return {"paths": found, "wavefront": wave}
    rays = max(256, 2 * count)
    while True:
        found = trace(
            scene,
            n_rays=rays,
            max_bounces=bounces or 5,
            keep_paths=True,
            seed=seed,
            progress=progress,
        )
        # those kept have been detected
        kept = int((found.n_bounces == bounces).sum()) if bounces else len(found.weight)
        if kept >= count or (kept and rays >= MOST_RAYS):
            return {"paths": found}
        if rays >= MOST_RAYS:
            kind = "" if bounces is None else f" with --bounces {bounces}"
            raise SceneError(
                f"no light path{kind} reaches the camera, of {rays} rays; --paths 0 draws the room "
                "alone"
            )
        rays = min(8 * rays, MOST_RAYS)
