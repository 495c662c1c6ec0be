"""Three-dimensional views of a scene or volume: an embedded page and a still picture."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import MissingExtraError
from ..scene import Scene
from .folders import Folder

RAYS = 4096  # rays traced, in about a second
MOST = 300  # largest number of drawn paths
SURFACE = 0.25  # level of the drawn surface relative to the brightest voxel


@dataclass(frozen=True)
class Room:
    """Three-dimensional view.

    Parameters
    ----------
    document : str
        Complete HTML page with a view that can be rotated.
    picture : bytes or None
        PNG for print and for browsers without scripts; None if this machine cannot render.
    told : str
        Caption: what is drawn and how it was computed.
    """

    document: str
    picture: bytes | None
    told: str


def room(held: Folder) -> Room | None:
    """Draw the scene of a folder with its light paths, or its volume, in three dimensions.

    Parameters
    ----------
    held : Folder
        Folder of a run.

    Returns
    -------
    Room or None
        View; None if the folder has neither scene nor volume.

    Raises
    ------
    NlosError
        If the view cannot be drawn.
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
            f"None of {RAYS} rays, traced for this page with seed {seed}, reached the camera.",
        )
    return _drawn(
        views.ray_paths(paths, scene, most=MOST),
        f"{min(MOST, len(paths.weight))} light paths that reach the camera, from {RAYS} rays "
        f"traced for this page with seed {seed}. Paths via the hidden object are drawn first, and "
        "the density of lines is proportional to their power.",
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
        f"Surface at {SURFACE:g} of the brightest voxel, coloured by distance from the wall. The "
        "initial view is from the far end of the room, from where letters appear mirror-reversed.",
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
