"""The scene in three dimensions: its light traced anew, as a page of its own and as a picture."""

from __future__ import annotations

import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from ..scene import Scene
from .elements import seconds

RAYS = 4096  # traced; a second's work
MOST = 300  # paths that are drawn


@dataclass(frozen=True)
class Room:
    """A scene in three dimensions.

    Parameters
    ----------
    document : str
        HTML page of its own that can be turned.
    picture : bytes
        PNG, for paper and where scripts do not run.
    told : str
        What is drawn, and how it was found.
    """

    document: str
    picture: bytes
    told: str


def room(scene: Scene, seed: int) -> Room:
    """Draw a scene with light paths of a seed.

    Raises
    ------
    MissingExtraError
        If nothing can be drawn in three dimensions here.
    """
    from .. import raytrace, views

    views.rendering_works()
    began = time.perf_counter()
    paths = raytrace.trace(scene, n_rays=RAYS, keep_paths=True, seed=seed)
    took = time.perf_counter() - began
    if len(paths.weight):
        plotter = views.ray_paths(paths, scene, most=MOST)
        told = (
            f"The {min(MOST, len(paths.weight))} strongest light paths that reach the camera, "
            f"of {RAYS} rays traced anew for this page with seed {seed} in {seconds(took)}"
        )
    else:
        plotter = views.scene_3d(scene)
        told = f"None of {RAYS} rays, traced anew for this page with seed {seed}, met the camera"
    try:
        with tempfile.TemporaryDirectory() as kept:
            file = Path(kept) / "room.png"
            views.save(plotter, file)
            picture = file.read_bytes()
        return Room(views.html_page(plotter), picture, told)
    finally:
        plotter.close()
