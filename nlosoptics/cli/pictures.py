"""Command view."""

from __future__ import annotations

import time
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .._checks import lasting
from .._progress import Progress
from .shell import (
    Changes,
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

MOST_RAYS = 1 << 17  # limit of the rays traced in search of rare paths


class Colour(StrEnum):
    """Quantity that colours the paths."""

    bounces = "bounces"
    path_length = "path_length"
    weight = "weight"
    aberration = "aberration"


@app.command("view", short_help="Show a scene and its light paths in 3-D.")
def view_command(
    scene_file: SceneFile,
    changes: Changes = None,
    out: Annotated[
        Path | None,
        typer.Option(
            help="File to write: .png, .html (can be turned in a browser) or .glb (3-D model). "
            "Without it, a window opens."
        ),
    ] = None,
    paths: Annotated[
        int,
        typer.Option(min=0, max=100_000, help="Number of light paths; 0 draws the scene alone."),
    ] = 500,
    bounces: Annotated[
        int | None,
        typer.Option(min=1, max=64, help="Draw only paths of this many reflections; default: all."),
    ] = None,
    colour: Annotated[
        Colour,
        typer.Option(
            help="Quantity shown by the colour of the paths: number of reflections (bounces), "
            "length, or power (weight). aberration draws rays from the middle of the object to the "
            "lens, coloured by their wave aberration."
        ),
    ] = Colour.bounces,
    seed: Seed = 0,
    debug: Debug = False,
) -> None:
    """Show a scene and its light paths in 3-D, in a window or a file.

    Example: nlosoptics view corner --out room.png
    """
    with errors_told(debug):
        start = time.perf_counter()
        if out is not None:
            check_file(out, ".png", ".html", ".glb")
        require("pyvista", "views")
        from .. import views
        from ..views.stages import rendering_works, window

        plotter = window() if out is None else None
        if out is not None and out.suffix.lower() == ".png":
            rendering_works()  # before any work is done
        scene = load(scene_file, None, changes)
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
            size, spent = out.stat().st_size / 1e6, lasting(time.perf_counter() - start)
            typer.echo(f"written to {out}, {size:.2f} MB, in {spent}")


def _drawn(
    scene: Scene,
    count: int,
    bounces: int | None,
    colour: Colour,
    seed: int,
    progress: Progress,
) -> dict[str, Any]:
    """Return the paths to draw, and for ``Colour.aberration`` the wave that colours them."""
    from ..errors import SceneError
    from ..raytrace import pupil_rays, trace

    if colour is Colour.aberration:
        from .. import psf

        found = pupil_rays(scene, n_rays=max(2 * count, 1024), seed=seed)
        wave = psf.wavefront_from_rays(found, psf.exit_pupil(scene), scene.laser.wavelength)
        return {"paths": found, "wavefront": wave}
    options: dict[str, Any] = {"keep_paths": True, "seed": seed, "progress": progress}
    rays = max(256, 2 * count)
    while True:
        found = trace(scene, n_rays=rays, max_bounces=bounces or 5, **options)
        # only detected paths are kept; stray light is drawn if the hidden object's paths are few
        wanted = found.n_bounces == bounces if bounces else found.n_bounces > 0
        kept = int((wanted & found.met_object).sum())
        if kept >= count or (wanted.any() and rays >= MOST_RAYS):
            return {"paths": found}
        if rays >= MOST_RAYS:
            kind = "" if bounces is None else f" with --bounces {bounces}"
            raise SceneError(
                f"none of {rays} traced rays reaches the camera{kind}; --paths 0 draws the scene "
                "alone"
            )
        rays = min(8 * rays, MOST_RAYS)
