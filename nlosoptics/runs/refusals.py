"""Checks that reject scenes for which no image can be computed."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from itertools import product

import numpy as np
import scipy  # its parts are loaded on first use
from numpy.typing import NDArray

from ..errors import NotWaveGradeError, SceneError, ValidityWarning
from ..imaging.detector import full_reading
from ..imaging.geometry import chief_rays, pixel_centres, wall_visibility
from ..imaging.image_fields import checked_places, picture_frame
from ..imaging.radiometry import (
    background_radiance,
    electrons_per_radiance,
    laser_spot,
    lit_patches,
)
from ..imaging.shadows import path_shares
from ..psf.pupil.exit_pupil import ExitPupil
from ..psf.pupil.obstruction import check_cone
from ..psf.pupil.wall_wavefront import check_wave_grade
from ..psf.walls.field import picture_nodes, picture_point
from ..scene import PlanarObject, Scene


def check_wave(scene: Scene) -> None:
    """Raise `NotWaveGradeError` if this wall admits no wave computation."""
    try:
        check_wave_grade(scene.wall, scene.laser.wavelength)
    except NotWaveGradeError as refusal:
        raise NotWaveGradeError(
            f"{refusal}; nlosoptics has no geometric method that works without the wave"
        ) from None


def check_laser(scene: Scene) -> None:
    """Raise `SceneError` if the laser is aimed outside the wall."""
    x, y, _ = scene.laser.aim
    if not scene.wall.contains(x, y):
        raise SceneError(
            f"laser.aim = {scene.laser.aim} m is off the wall, wall.size = {scene.wall.size} m; "
            "aim inside its edges"
        )


def check_sight(scene: Scene, pupil: ExitPupil) -> None:
    """Raise `SceneError` if the object's image misses the wall or the detector.

    The image is that of a flat wall.
    """
    camera, position = scene.camera, tuple(float(c) for c in scene.object_point)
    if pupil.vignetting == 1.0:
        raise SceneError(
            f"hidden.position = {position} m is not mirrored to the camera by any part of the "
            f"wall, wall.size = {scene.wall.size} m; enlarge the wall, or move object or camera"
        )
    line = scene.mirrored_object_point - np.array(camera.position)
    x, y, depth = (float(line @ axis) for axis in camera.frame)
    if depth <= 0:
        raise SceneError(
            f"camera.aim = {camera.aim} m points away from the mirrored object; aim at the wall "
            "point where it appears"
        )
    # a curved wall may magnify the image; allow a factor of 3
    extent = _half_extent(scene) * (1.0 if scene.wall.is_flat else 3.0)
    reach = np.array(camera.shape[::-1]) * camera.image_pitch / 2
    image = np.array([abs(x), abs(y)]) * scene.image_distance / depth
    outside = image - extent * scene.image_distance / depth - reach
    if outside.max() > 0:
        raise SceneError(
            f"hidden.position = {position} m is imaged at ({1e3 * image[0]:.3g}, "
            f"{1e3 * image[1]:.3g}) mm from the axis, off the detector of "
            f"+-({1e3 * reach[0]:.3g}, {1e3 * reach[1]:.3g}) mm; change camera.aim"
        )


def wall_pixels(scene: Scene, *, traced: bool = True) -> NDArray[np.bool_]:
    """Return which pixels see the wall with their whole cone of light; no others are compared.

    An occluder before the wall has light of its own, which no model of the wall describes. To find
    its pixels takes a second for 512 x 512; they count as seeing the wall if not ``traced``.
    """
    seen = wall_visibility(scene, chief_rays(scene, *pixel_centres(scene.camera))) > 0.999
    if not traced or (mesh := scene.occluding_mesh) is None:
        return seen
    # between the sampled paths of a pixel, an occluder's edge also covers paths of a neighbour
    open_view = path_shares(scene, mesh, None, seen)[1]
    return np.asarray(seen & (scipy.ndimage.minimum_filter(open_view, 3) == 1.0))


def overexposure(scene: Scene) -> str:
    """Return why no pixel will count, or an empty string: diffuse light alone fills all.

    The light is computed at nine places of the detector, without the shadows of occluders.
    """
    if scene.occluders:
        return ""
    # bound of the light: the spot's radiance, were all walls Lambertian, seen by way of the object
    near = math.dist(scene.laser.aim, tuple(scene.object_point)) - _half_extent(scene)
    bound = electrons_per_radiance(scene, np.ones(1), scene.camera.exposure)[0] * (
        scene.laser.power / (math.pi * max(near, 1e-6)) ** 2
    )
    if bound < full_reading(scene.camera):
        return ""
    y, x = (np.array([-0.45, 0.0, 0.45]) * n * scene.camera.image_pitch for n in scene.camera.shape)
    spot, rays = laser_spot(scene), chief_rays(scene, x, y)
    visible = wall_visibility(scene, rays)
    gain = electrons_per_radiance(scene, rays.cos_axis, scene.camera.exposure) * visible
    light = gain * background_radiance(scene, spot, lit_patches(scene, spot), rays, visible > 0)
    full = light[visible > 0] / full_reading(scene.camera)
    return _shorter(scene, float(full.max())) if full.size and full.min() > 1.0 else ""


def _shorter(scene: Scene, full: float) -> str:
    """Return the text on an exposure that fills pixels ``full`` times."""
    return (
        f"every pixel that sees the wall is saturated, the fullest {max(full, 1.0):.2g} times; use "
        f"camera.exposure = {0.5 * scene.camera.exposure / max(full, 1.0):.2g} s"
    )


def fillable(scene: Scene, electrons: NDArray[np.float64]) -> bool:
    """Return whether any pixel of an image counts; warn if none does."""
    if (electrons < full_reading(scene.camera)).any():
        return True
    text = f"no object is reconstructed: {_shorter(scene, 1.0)} or less"
    warnings.warn(text, ValidityWarning, stacklevel=4)
    return False


def check_errors(errors: Mapping[str, float], tol: float) -> None:
    """Warn of each estimated error of a run that exceeds the planned one."""
    for name, error in errors.items():
        if error > tol:
            warnings.warn(
                f"the error of the {name} is {error:.2g}, planned was tol = {tol:g}; use a smaller "
                "tol, and compare",
                ValidityWarning,
                stacklevel=4,
            )


def check_cones(scene: Scene, counts: list[int]) -> None:
    """Raise if occluders cut light from a corner or a used point of the object to the lens.

    These points are the nodes of the fields of point spreads to be computed, with ``counts`` nodes
    along each side, and the points between them at which the fields are checked.
    """
    if not (scene.occluders and isinstance(scene.hidden, PlanarObject)):
        return
    places = checked_places(picture_frame(scene))
    for count in counts:
        line = [-1.0, *picture_nodes(count).tolist(), 1.0]
        places += product(line, line)
    for x, y in dict.fromkeys(places):
        check_cone(scene, picture_point(scene.hidden, x, y))


def _half_extent(scene: Scene) -> float:
    """Largest distance of a point of the object from its reference point, m."""
    hidden = scene.hidden
    if isinstance(hidden, PlanarObject):
        return math.hypot(*hidden.size) / 2
    return float(np.linalg.norm(hidden.surface.vertices - scene.object_point, axis=1).max())
