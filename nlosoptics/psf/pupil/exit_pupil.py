"""Exit pupil of a scene: the image of its aperture stop as seen from the detector."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..._checks import expect
from ..._nouns import Noun
from ..._vectors import Array
from ...errors import SceneError
from ...scene import Scene


@dataclass(frozen=True, eq=False, kw_only=True)
class ExitPupil(Noun):
    """Exit pupil of a scene: the image of its aperture stop as seen from the detector.

    The aperture stop limits the cone of light from an object point, via the wall, to the detector.
    It is the lens, or the edge of a small wall.

    Parameters
    ----------
    centre : ndarray, (3,)
        Centre of the pupil in world coordinates, m. If the lens is the stop, it is the centre of
        the lens. If the wall is the stop, it is the centre of the image of the wall, which lies on
        the detector's side of the lens.
    radius : float
        Radius of the pupil, m. If the rectangular wall is the stop, it is the radius of the largest
        circle inside the image of the wall.
    image_distance : float
        Distance from the pupil to the detector, m; negative if the pupil lies beyond the detector.
    f_number : float
        Working F-number N, ``|image_distance|/(2 radius)``. The pupil's radius is measured on the
        reference sphere, which is the sphere about the image point on the axis through the pupil's
        centre. N is therefore ``1/(2 sin(alpha))``, with alpha the half angle of the cone of light
        at the detector.
    stop : {"lens", "wall"}
        Element that is the aperture stop.
    entrance_radius : float
        Radius of the cone of light on the lens, m.
    vignetting : float
        Fraction of the cone of light that misses the wall, 0 to 1. It is computed for a flat wall
        of the same size and for rays from the hidden object's reference point, that is the centre
        of a planar object or the centroid of a mesh.

    See Also
    --------
    exit_pupil : Exit pupil of a scene.
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
        """Suitable arrangement of pupil samples: rings ("polar") or a square grid ("grid").

        It is "polar" if the lens alone limits the light, so that the pupil is round. It is "grid"
        if the wall's edge is the stop or cuts off a part of the cone of light.
        """
        return "polar" if self.stop == "lens" and self.vignetting == 0.0 else "grid"


def exit_pupil(scene: Scene) -> ExitPupil:
    """Compute position and size of a scene's exit pupil from the thin-lens equation.

    Parameters
    ----------
    scene : Scene
        Scene with the camera, the wall and the hidden object.

    Returns
    -------
    ExitPupil
        Exit pupil as seen from the centre of the detector: position, radius, distance to the
        detector, F-number and kind of stop.

    Raises
    ------
    SceneError
        If the camera's axis misses the wall; if the mirrored object is within the focal length of
        the lens, so that it cannot be focused; if the wall is the stop and within the focal length;
        or if the cone at the detector has an F-number of 0.5 or less.

    See Also
    --------
    wavefront : Wave in this pupil.

    Notes
    -----
    The lens is thin, with focal length f and radius r. Along the camera's axis the wall is at the
    distance d2 from the lens, and the plane in focus at d1 + d2, counted along the reflected path.
    The lens is the stop unless the wall's edge is closer to the axis than ``r d1/(d1 + d2)``. If
    the wall is the stop, its image lies ``d2 f/(d2 - f)`` behind the lens, magnified by
    ``f/(d2 - f)``. This function returns the largest circle inside that image, while `wavefront`
    follows the wall's true outline.

    Examples
    --------
    Aperture stop, radius and F-number of an example scene:

    >>> from nlosoptics import Scene, psf
    >>> pupil = psf.exit_pupil(Scene.load("examples/scenes/letter_flat.toml"))
    >>> print(f"{pupil.stop}, {1e3 * pupil.radius:.1f} mm, F/{pupil.f_number:.2f}")
    lens, 12.5 mm, F/2.08
    """
    scene = expect("scene", scene, "Scene")
    camera, image_distance = scene.camera, scene.image_distance
    position, axis = np.array(camera.position), camera.axis
    d2 = -float(position[2] / axis[2])
    d1 = scene.focus_distance - d2
    lens_radius = camera.stop_diameter / 2
    edge = math.inf
    if scene.wall.size is not None:
        hit = position + d2 * axis
        # Distance between the axis and each edge's line, along their common perpendicular.
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
    stop: Literal["lens", "wall"] = "lens"
    centre, radius, distance, entrance = position, lens_radius, image_distance, lens_radius
    if d1 > 0 and edge < lens_radius * d1 / (d1 + d2):
        f = camera.focal_length
        if d2 <= f:
            raise SceneError(
                f"the wall is {d2:g} m from the lens, within its focal length {f:g} m; "
                "move the camera back"
            )
        behind = d2 * f / (d2 - f)
        stop, centre, radius = "wall", position - behind * axis, edge * f / (d2 - f)
        distance, entrance = image_distance - behind, edge * (d1 + d2) / d1
    return ExitPupil(
        centre=centre,
        radius=radius,
        image_distance=distance,
        f_number=working_f_number(radius, distance),
        stop=stop,
        entrance_radius=entrance,
        vignetting=_vignetting(scene, entrance),
    )


def working_f_number(radius: float, distance: float) -> float:
    """Return a cone's F-number ``|distance|/(2 radius)``, which is 1/(2 sin) of its half angle.

    The radius is that on the sphere about the image point, as in `point_spread`.
    """
    found = abs(distance) / (2 * radius)
    if found <= 0.5:
        raise SceneError(
            f"the cone of light has a radius of {radius:.4g} m at {abs(distance):.4g} m from the "
            f"detector, F/{found:.3g}, limit F/0.5, where it fills the half space; use a smaller "
            "camera.stop_diameter or a longer camera.focal_length"
        )
    return found


def _vignetting(scene: Scene, radius: float) -> float:
    """Fraction of the lens disc whose rays to the mirrored object miss a flat wall of this size."""
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
