"""Exit pupil: what limits the cone of light, imaged toward the detector."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..._nouns import Noun
from ...errors import SceneError
from ...scene import Scene

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, kw_only=True)
class ExitPupil(Noun):
    """Image of the aperture stop by all that follows it toward the detector.

    Parameters
    ----------
    centre : ndarray, (3,)
        World, m; behind the lens when the wall is the stop.
    radius : float
        m; of the inscribed circle when the wall, a rectangle, is the stop.
    image_distance : float
        From pupil to detector, m, signed: negative when the pupil lies behind the detector.
    f_number : float
        Working F-number, |image_distance|/(2 radius); faster than F/1 by the sine of the cone.
    stop : {"lens", "wall"}
        What limits the cone.
    entrance_radius : float
        Radius of the cone on the lens, m.
    vignetting : float
        Share of that cone, drawn to the object's reference point by a flat wall of this size, that
        misses the wall, 0 to 1.
    """

    centre: Array
    radius: float
    image_distance: float
    f_number: float
    stop: str
    entrance_radius: float
    vignetting: float

    @property
    def layout(self) -> Literal["polar", "grid"]:
        """Layout of the pupil nodes that follow the rim of the light.

        ``polar`` where the rim is the lens stop's circle; ``grid`` where the wall's edge is the
        stop or vignettes a part of the cone.
        """
        return "polar" if self.stop == "lens" and self.vignetting == 0.0 else "grid"


def exit_pupil(scene: Scene) -> ExitPupil:
    """Exit pupil of lens and relay wall, by reverse trace from the axial detector point.

    Parameters
    ----------
    scene : Scene

    Returns
    -------
    ExitPupil

    Raises
    ------
    SceneError
        If the camera's axis misses the wall, or the object cannot be focused.

    Notes
    -----
    Thin lens of focal length f, in-focus plane d1 + d2 in front of it, wall at d2: the lens limits
    unless the wall's edge, at a from the axis, is within ``r_lens d1/(d1 + d2)``. The wall's image
    then lies ``d2 f/(d2 - f)`` behind the lens, magnified by ``f/(d2 - f)``; it is the inscribed
    circle that is reported, while `wavefront` follows the wall's true outline.
    """
    camera, image_distance = scene.camera, scene.image_distance
    position, axis = np.array(camera.position), camera.axis
    d2 = -float(position[2] / axis[2])
    d1 = scene.focus_distance - d2
    lens_radius = camera.stop_diameter / 2
    edge = math.inf
    if scene.wall.size is not None:
        hit = position + d2 * axis
        # distance from the axis to the nearest edge, seen across the axis
        # common perpendicular of the axis and each edge's line
        gaps = [
            (side / 2 - abs(float(hit[i]))) * abs(float(axis[2])) / math.hypot(axis[i], axis[2])
            for i, side in enumerate(scene.wall.size)
        ]
        edge = min(gaps)
        if edge <= 0:
            raise SceneError(
                f"the camera's axis meets the wall plane at x = {hit[0]:g} m, y = {hit[1]:g} m, "
                f"outside wall.size = {scene.wall.size} m; change camera.aim or enlarge the wall"
            )
    if d1 > 0 and edge < lens_radius * d1 / (d1 + d2):
        f = camera.focal_length
        if d2 <= f:
            raise SceneError(
                f"the wall is {d2:g} m from the lens, within its focal length {f:g} m; "
                "move the camera back"
            )
        behind = d2 * f / (d2 - f)
        radius = edge * f / (d2 - f)
        distance = image_distance - behind
        return ExitPupil(
            centre=position - behind * axis,
            radius=radius,
            image_distance=distance,
            f_number=working_f_number(radius, distance),
            stop="wall",
            entrance_radius=edge * (d1 + d2) / d1,
            vignetting=_vignetting(scene, edge * (d1 + d2) / d1),
        )
    return ExitPupil(
        centre=position,
        radius=lens_radius,
        image_distance=image_distance,
        f_number=working_f_number(lens_radius, image_distance),
        stop="lens",
        entrance_radius=lens_radius,
        vignetting=_vignetting(scene, lens_radius),
    )


def working_f_number(radius: float, distance: float) -> float:
    """F-number of a cone: |distance|/(2 radius), beyond F/1 by the sine of its half angle."""
    paraxial = abs(distance) / (2 * radius)
    if paraxial >= 1:
        return paraxial
    return 0.5 / math.sin(math.atan(radius / abs(distance)))


def _vignetting(scene: Scene, radius: float) -> float:
    """Share of the lens that sees the mirrored object past the wall's edge, as for a flat wall."""
    if scene.wall.size is None:
        return 0.0
    r, angle = np.meshgrid(
        radius * np.sqrt((np.arange(32) + 0.5) / 32), 2 * math.pi * np.arange(64) / 64
    )
    e1, e2, _ = scene.camera.frame
    nodes = np.array(scene.camera.position) + np.stack(
        [r * np.cos(angle), r * np.sin(angle)], axis=-1
    ) @ np.stack([e1, e2])
    o = scene.object_point
    share = o[2] / (o[2] + nodes[..., 2])
    hits = o + share[..., None] * (nodes - o)
    return 1.0 - float(scene.wall.contains(hits[..., 0], hits[..., 1]).mean())
