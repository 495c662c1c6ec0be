"""What there is in three dimensions, as a page of its own and as a picture."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import MissingExtraError
from ..scene import Scene
from .folders import Folder

RAYS = 4096  # traced; a second's work
MOST = 300  # paths that are drawn
SURFACE = 0.25  # of the brightest voxel


@dataclass(frozen=True)
class Room:
    """A view in three dimensions.

    Parameters
    ----------
    document : str
        HTML page of its own that can be turned.
    picture : bytes or None
        PNG for paper and for where scripts do not run; None where nothing can be rendered.
    told : str
        What is drawn, and how it was found.
    """

    document: str
    picture: bytes | None
    told: str


def room(held: Folder) -> Room | None:
    """What a folder shows in three dimensions: a scene and its light, or a volume.

    Parameters
    ----------
    held : Folder

    Returns
    -------
    Room or None
        None where the folder has neither.

    Raises
    ------
    NlosError
        If there is something to draw and it cannot be drawn.
    """
    if (scene := held.scene()) is not None:
        return _scene(scene, held.record.seed or 0)
    return _volume(held)


def _scene(scene: Scene, seed: int) -> Room:
    from .. import raytrace, views

    paths = raytrace.trace(scene, n_rays=RAYS, keep_paths=True, seed=seed)
    if not len(paths.weight):
        return _drawn(
            views.scene_3d(scene),
            f"None of {RAYS} rays, traced anew for this page with seed {seed}, met the camera.",
        )
    return _drawn(
        views.ray_paths(paths, scene, most=MOST),
        f"{min(MOST, len(paths.weight))} light paths that reach the camera, of {RAYS} rays traced "
        f"anew for this page with seed {seed}; lines are as dense as the light.",
    )


def _volume(held: Folder) -> Room | None:
    found = held.arrays("volume.npz", "intensity", "x", "y", "z")
    if found is None:
        return None
    from .. import views
    from ..transient import Volume, VolumeImage

    volume = Volume(x=found["x"], y=found["y"], z=found["z"])
    image = VolumeImage(intensity=found["intensity"], volume=volume, method="phasor_image")
    return _drawn(
        views.phasor_volume(image, threshold=SURFACE),
        f"Surface around the voxels above {SURFACE:g} of the brightest, coloured by its distance "
        "from the wall. It opens as seen from the far end of the room, where letters are reversed.",
    )


def _drawn(plotter: Any, told: str) -> Room:
    from .. import views

    try:
        return Room(views.html_page(plotter), _still(plotter), told)
    finally:
        plotter.close()


def _still(plotter: Any) -> bytes | None:
    from .. import views

    with tempfile.TemporaryDirectory() as kept:
        file = Path(kept) / "room.png"
        try:
            views.save(plotter, file)
        except MissingExtraError:
            return None
        return file.read_bytes()
