"""Second-order wave optics of a scene in closed form, without ray aiming or sampling."""

from __future__ import annotations

import math

import numpy as np

from ..._vectors import Array
from ...errors import SceneError
from ...scene import PlanarObject, Scene
from .exit_pupil import ExitPupil
from .wall_view import first_order


def wave_bends(scene: Scene, points: Array) -> Array:
    """Return the second derivatives of W over the lens for object points (n, 3), m: (n, 2, 2), 1/m.

    They are along the camera's axes e1 and e2: the sum of the wall's part,
    ``-(cos_i + cos_o) M_0^T K M``, and of the defocus, with the matrices of `WallView` and M_0 that
    of a flat wall. The wall's curvature K is taken at the point that a flat wall would reflect
    from, and its slope there is neglected.
    """
    lens = np.array(scene.camera.position)
    mirrored = points * (1.0, 1.0, -1.0)
    depth = (mirrored - lens) @ scene.camera.axis
    focus = (1 / depth - 1 / scene.focus_distance)[:, None, None] * np.eye(2)
    if scene.wall.is_flat:
        return np.asarray(focus)
    share = lens[2] / (lens[2] - mirrored[:, 2])
    hits = lens + share[:, None] * (mirrored - lens)
    cos_sum, flat, into = first_order(scene, points, hits, np.eye(3)[:2], np.eye(3)[2])
    _, _, _, xx, xy, yy = scene.wall.derivatives(hits[:, 0], hits[:, 1]).T
    bend = np.stack([np.stack([xx, xy], axis=1), np.stack([xy, yy], axis=1)], axis=1)
    first = np.linalg.solve(flat, into)
    seen = np.linalg.solve(flat - cos_sum[:, None, None] * bend, into)
    wall = -cos_sum[:, None, None] * np.swapaxes(first, 1, 2) @ bend @ seen
    return np.asarray(wall + focus)


def change_over_object(scene: Scene, pupil: ExitPupil) -> float:
    """Return an upper bound of the change of the point spread over a planar object.

    The change is relative to the peak.
    """
    hidden = scene.hidden
    if not isinstance(hidden, PlanarObject):
        raise SceneError("scene.hidden is a mesh; a field of point spreads needs a PlanarObject")
    right, up, _ = hidden.axes
    width, height = hidden.size
    places = [(0.0, 0.0), *((x, y) for x in (-0.5, 0, 0.5) for y in (-0.5, 0, 0.5))]
    points = [scene.object_point + x * width * right + y * height * up for x, y in places]
    try:
        bends = wave_bends(scene, np.array(points))
    except SceneError:  # a point is reflected outside the wall's domain
        return 1.0
    change = float(np.linalg.norm(bends - bends[0], 2, axis=(1, 2)).max())
    radius, distance = pupil.radius, abs(pupil.image_distance)
    core, pitch = scene.laser.wavelength * pupil.f_number, scene.camera.image_pitch
    slope = min(scene.mirror_slopes, default=0.0)
    pixel = max(pitch, core) + slope * distance
    spot = radius * distance * float(np.linalg.norm(bends, 2, axis=(1, 2)).max())
    phase = math.pi / scene.laser.wavelength * change * radius**2
    within = 0.4 * core / pitch if spot < 0.3 * pixel else 1.0
    return min(2 * phase, within, 4 * radius * distance * change / pixel)
