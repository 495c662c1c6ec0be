"""Second-order optics of a scene in closed form: no ray is aimed, no wave is sampled."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ...errors import SceneError
from ...scene import PlanarObject, Scene
from .exit_pupil import ExitPupil

Array = NDArray[np.float64]


def wave_bends(scene: Scene, points: Array) -> Array:
    """Second derivatives of W over the lens, for object points.

    Parameters
    ----------
    scene : Scene
    points : ndarray, (n, 3)
        World, m.

    Returns
    -------
    ndarray, (n, 2, 2)
        Along the camera's e1 and e2, 1/m: that of the wall, ``-(cos_i + cos_o) M_0^T K M``, and of
        the focus. M_0 is M of a flat wall. The wall is taken where it would be met if it were
        flat, so slopes of the mean wall are left out.
    """
    e1, e2, axis = scene.camera.frame
    lens = np.array(scene.camera.position)
    mirrored = points * (1.0, 1.0, -1.0)
    depth = (mirrored - lens) @ axis
    share = lens[2] / (lens[2] - mirrored[:, 2])
    hits = lens + share[:, None] * (mirrored - lens)
    legs = points - hits, lens - hits
    lengths = [np.linalg.norm(leg, axis=1) for leg in legs]
    units = [leg / length[:, None] for leg, length in zip(legs, lengths, strict=True)]
    cos_sum = units[0][:, 2] + units[1][:, 2]
    flat = np.zeros((len(points), 2, 2))
    for unit, length in zip(units, lengths, strict=True):
        inside = unit[:, :2]
        flat += (np.eye(2) - inside[:, :, None] * inside[:, None, :]) / length[:, None, None]
    axes = np.stack([e1, e2])
    across = axes - (units[1] @ axes.T)[:, :, None] * units[1][:, None, :]
    into = np.swapaxes(across[:, :, :2], 1, 2) / lengths[1][:, None, None]
    focus = (1 / depth - 1 / scene.focus_distance)[:, None, None] * np.eye(2)
    if scene.wall.is_flat:
        return np.asarray(focus)
    _, _, _, xx, xy, yy = scene.wall.derivatives(hits[:, 0], hits[:, 1]).T
    bend = np.stack([np.stack([xx, xy], axis=1), np.stack([xy, yy], axis=1)], axis=1)
    first = np.linalg.solve(flat, into)
    seen = np.linalg.solve(flat - cos_sum[:, None, None] * bend, into)
    wall = -cos_sum[:, None, None] * np.swapaxes(first, 1, 2) @ bend @ seen
    return np.asarray(wall + focus)


def change_over_object(scene: Scene, pupil: ExitPupil) -> float:
    """Bound of how much the point spread's pixels change over the picture, max |dI|/max I.

    Parameters
    ----------
    scene : Scene
        With a `PlanarObject` and a mirror-like lobe.
    pupil : ExitPupil
        Of the scene.

    Returns
    -------
    float
        From 0 to 1, of the camera's image pixels: the least of what the change of phase can do,
        what the diffraction tail within a pixel can, and what moves from pixel to pixel.
    """
    hidden = scene.hidden
    if not isinstance(hidden, PlanarObject):
        raise SceneError("scene.hidden is a mesh; point spreads over a picture need a PlanarObject")
    right, up, _ = hidden.axes
    width, height = hidden.size
    places = [(0.0, 0.0), *((x, y) for x in (-0.5, 0, 0.5) for y in (-0.5, 0, 0.5))]
    points = [scene.object_point + x * width * right + y * height * up for x, y in places]
    try:
        bends = wave_bends(scene, np.array(points))
    except SceneError:  # beyond the wall's rim
        return 1.0
    change = float(np.linalg.norm(bends - bends[0], 2, axis=(1, 2)).max())
    radius, distance = pupil.radius, abs(pupil.image_distance)
    core, pitch = scene.laser.wavelength * pupil.f_number, scene.camera.image_pitch
    slope = min((lobe.slope_rms for lobe in scene.wall_material.mirror_lobes), default=0.0)
    pixel = max(pitch, core) + slope * distance
    spot = radius * distance * float(np.linalg.norm(bends, 2, axis=(1, 2)).max())
    phase = math.pi / scene.laser.wavelength * change * radius**2
    within = 0.4 * core / pitch if spot < 0.3 * pixel else 1.0
    return min(2 * phase, within, 4 * radius * distance * change / pixel)
