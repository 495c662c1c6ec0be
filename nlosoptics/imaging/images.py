"""Formation of the camera image, in electrons, from a scene and its point spread function."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._checks import expect, fits_memory, positive
from .._html import Figures, Shown
from .._nouns import Noun
from .._random import checked_seed
from .._xarray import Labelled, Labels, pixels, variable
from ..errors import SamplingError, SceneError
from ..psf import PointSpreadField, scene_point_spread
from ..psf.pupil.exit_pupil import working_f_number
from ..scene import MeshObject, PlanarObject, Scene
from ..scene.parts.hidden import checked_picture
from .detector import noise_variance, read_out, speckles_per_pixel
from .forward_model import ForwardModel
from .geometry import (
    ChiefRays,
    area_average,
    chief_rays,
    picture_coordinates,
    picture_points,
    picture_positions,
    pixel_centres,
    pixel_edges,
    wall_visibility,
)
from .objects import Patches, mesh_hits, plate
from .radiometry import (
    LaserSpot,
    ambient_radiance,
    background_radiance,
    electrons_per_joule,
    electrons_per_radiance,
    lit_patches,
    lit_spot,
    object_radiance,
    spot_power_through_lens,
)
from .shadows import SHADOW_BYTES, Shadows, cast_shadows, repainted
from .stray import spot_image

if TYPE_CHECKING:
    import trimesh

    from ..psf import PointSpread

Array = NDArray[np.float64]

BYTES_PER_PIXEL = 450  # peak memory, measured with a curved wall


@dataclass(frozen=True, eq=False, kw_only=True)
class SpeckleImage(Noun, Shown, Labelled):
    """Simulated camera image in electrons, with its components and noise.

    `form_image` computes it. The name refers to speckle, the granular noise of laser light, which
    is included. The arrays are read-only and ordered [y, x], with row 0 at the lowest y of the
    detector. The lens inverts the image, so that the scene appears upright if row 0 is drawn on
    top. The x and y axes of the detector are the first two rows of ``camera.frame``.

    Parameters
    ----------
    electrons : ndarray, (ny, nx)
        Reading of each image pixel with all noise, electrons. The offset of the
        analogue-to-digital converter is subtracted, so that dark pixels can be negative;
        background and dark current are included.
    expected : ndarray, (ny, nx)
        ``signal + background``, electrons: the mean over all noise, including speckle, if no pixel
        saturates. In repeated exposures of a static scene the speckle pattern stays the same, so
        that only the other noise averages out.
    signal : ndarray, (ny, nx)
        Expected electrons of the object's image that the mirror-like part of the wall's reflection
        forms, blurred by the point spread function; zero if the wall has no such part.
    ideal : ndarray, (ny, nx)
        Electrons of ``signal`` before the blur: the ground truth on the same pixels.
    background : ndarray, (ny, nx)
        Expected electrons that are not of the object's image: diffuse light of the wall, image of
        the laser spot, ambient light, glare (light scattered in the lens), and dark current.
    noise_sigma : ndarray, (ny, nx)
        Expected rms noise of photons, speckle, dark current, readout and digitisation, electrons.
    saturated_fraction : float
        Fraction of saturated image pixels.
    pitch : float
        Side of an image pixel, m: that of a detector pixel times ``camera.binning``.
    exposure : float
        Exposure time, s.
    speckle_contrast : float
        Speckle contrast (rms over mean) of an image pixel; 0 without speckle.
    seed : int
        Seed of the noise.
    ledger : mapping of str to float
        Expected electrons summed over the detector, by contribution. "ideal" is the object's image
        without blur. It is the sum of "signal", which stays on the detector; "beyond_window",
        which the point spread function sends outside the window on which it was computed; and
        "beyond_detector", which is blurred past the edges of the detector. "diffuse", "spot",
        "ambient", "glare" and "dark" form the background.

    See Also
    --------
    form_image : Image in electrons, with noise.
    CameraImage : Corrected camera image with its masked pixels.
    nlosoptics.views.image : Camera image.
    """

    electrons: Array
    expected: Array
    signal: Array
    ideal: Array
    background: Array
    noise_sigma: Array
    saturated_fraction: float
    pitch: float
    exposure: float
    speckle_contrast: float
    seed: int
    ledger: Mapping[str, float]

    def __post_init__(self) -> None:
        for name in ("electrons", "expected", "signal", "ideal", "background", "noise_sigma"):
            getattr(self, name).flags.writeable = False
        object.__setattr__(self, "ledger", MappingProxyType(dict(self.ledger)))

    def _figures(self) -> Figures:
        ny, nx = self.electrons.shape
        figures = {
            "electrons": f"{self.electrons.max():.3g} at most, mean {self.electrons.mean():.3g}",
            "of the object": f"{self.signal.max():.3g} at most, mean {self.signal.mean():.3g}",
            "noise": f"{self.noise_sigma.mean():.3g} electrons rms, on average",
            "speckle contrast": f"{self.speckle_contrast:.3g}",
            "full pixels": f"{100 * self.saturated_fraction:.3g} %",
            "exposure": f"{1e3 * self.exposure:.3g} ms, seed {self.seed}",
            "image": f"{nx} x {ny} pixels of {1e6 * self.pitch:.3g} µm",
        }
        alt = f"Camera image, {nx} x {ny} pixels, brighter where there are more electrons"
        return Figures("Speckle image", figures, alt)

    def _labels(self) -> Labels:
        names = {
            "electrons": "reading with all noise",
            "expected": "mean over all noise",
            "signal": "image of the object",
            "ideal": "image of the object before the blur",
            "background": "light and dark current beside the object's image",
            "noise_sigma": "rms noise",
        }
        arrays = {n: variable("yx", getattr(self, n), "electrons", m) for n, m in names.items()}
        values = {name: getattr(self, name) for name in ("pitch", "exposure", "seed")}
        return Labels(arrays, pixels(self.electrons.shape, self.pitch), values)


@dataclass(frozen=True, eq=False, kw_only=True)
class LightLevels:
    """Expected electrons in each image pixel by source, before the blur and without noise."""

    rays: ChiefRays  # Chief rays of the pixel centres
    visible: Array  # (ny, nx): Fraction of each pixel's light cone that comes from the wall
    ideal: Array  # (ny, nx): Electrons of the object's unblurred image
    # (ny, nx): Electrons of the wall's diffuse light and of the image of the laser spot
    diffuse: Array
    spot: Array
    ambient: Array  # (ny, nx): Electrons of ambient light that the wall reflects
    glare: float  # Electrons of the glare, uniform over the whole detector
    dark: float  # Dark electrons of one image pixel
    # Degrees of freedom of an image pixel's speckle, 1/contrast^2; None for no speckle
    freedom: float | None

    @property
    def stray(self) -> Array:
        """Electrons in each pixel that do not belong to the object's image, without dark ones."""
        return np.asarray(self.diffuse + self.spot + self.ambient + self.glare / self.ideal.size)


def light_levels(
    scene: Scene, *, exposure: float | None = None, shadows: Shadows | None = None
) -> LightLevels:
    """Compute the expected electrons of an image by source, without a point spread."""
    camera = scene.camera
    exposure = positive("exposure", camera.exposure if exposure is None else exposure, unit="s")
    spot, rays, visible, gain = _view(scene, exposure)
    shadows = _shadows(scene, shadows)
    ideal = gain * _mirrored_radiance(scene, spot, rays, visible > 0)
    patches = lit_patches(scene, spot)
    diffuse = gain * background_radiance(scene, spot, patches, rays, visible > 0)
    ambient = gain * ambient_radiance(scene, rays, visible > 0)
    direct = spot_power_through_lens(scene, spot) * exposure * electrons_per_joule(scene)
    if shadows is not None:
        ambient *= shadows.view
        ideal *= shadows.image
        diffuse *= shadows.view * shadows.veil
        direct *= shadows.spot
    glare = camera.glare_fraction * direct
    return LightLevels(
        rays=rays,
        visible=visible,
        ideal=ideal,
        diffuse=diffuse,
        spot=0.0 * gain
        if spot is None or direct <= glare
        else (direct - glare) * spot_image(scene, spot),
        ambient=ambient,
        glare=glare,
        dark=camera.dark_current * exposure * camera.binning**2,
        freedom=_speckle_freedom(scene),
    )


def mirror_image(scene: Scene, shadows: Shadows | None = None) -> tuple[ChiefRays, Array]:
    """Return the chief rays, and the electrons (ny, nx) of mirror-like light without blur."""
    spot, rays, visible, gain = _view(scene, scene.camera.exposure)
    shadows = _shadows(scene, shadows)
    ideal = gain * _mirrored_radiance(scene, spot, rays, visible > 0)
    return rays, ideal if shadows is None else ideal * shadows.image


def form_image(
    scene: Scene,
    point_spread: PointSpread | PointSpreadField | None = None,
    object_image: ArrayLike | None = None,
    *,
    exposure: float | None = None,
    seed: int = 0,
    shadows: Shadows | None = None,
) -> SpeckleImage:
    """Compute the camera image of the hidden object in one exposure, in electrons and with noise.

    Parameters
    ----------
    scene : Scene
        Scene to image.
    point_spread : PointSpread or PointSpreadField, optional
        Point spread function from the same scene, with ``normalisation="unit-sum"`` and the pitch
        of the camera's image pixels. Its values are fractions of the energy, so that their sum is 1
        minus the fraction outside the window on which it was computed. A field gives the function
        for every point of a planar object. By default that of the object's reference point, or
        none for a wall without a mirror-like lobe.
    object_image : array_like, (rows, columns), optional
        Reflectances, 0 to 1, that replace the image on a planar object, row 0 on top. The object's
        size is unchanged. None: the scene's own.
    exposure : float, optional
        Exposure time, s; by default the camera's.
    seed : int, default 0
        Seed of the noise. The same seed gives bit-identical results.
    shadows : Shadows, optional
        Result of `cast_shadows` for this scene. None: computed if the scene has occluders.

    Returns
    -------
    SpeckleImage
        Electrons of each pixel with noise, [y, x] with row 0 at the lowest y, and their parts:
        object, diffuse light of the wall, glare. Speckle is included if the scene has
        ``laser.independent_patterns``.

    Raises
    ------
    SamplingError
        If the point spread's pitch or normalisation does not fit, or it has negative values.
    SceneError
        If the laser beam misses the wall, meets it at grazing incidence or is cut by an occluder,
        if laser, camera or object are behind the wall, or if an argument is out of range.
    MemoryLimitError
        If the image would not fit in memory.

    See Also
    --------
    nlosoptics.psf.scene_point_spread : Compute the point spread.
    cast_shadows : Fractions of light that occluders let through.

    Notes
    -----
    Rays through the centre of the lens (chief rays) are traced from the corners of each pixel via
    the wall to the object, to find the area that the pixel sees. The unblurred image is
    proportional to a product of three factors: the mean reflectance of that area, the radiance that
    a white object would have where the chief ray of the pixel's centre meets it, and the
    reflectance of the mirror-like part of the wall's material. The camera's lens, exposure time and
    quantum efficiency convert this radiance to electrons.

    The unblurred image is convolved with the point spread function. Energy that this function sends
    outside its window is lost; ``SpeckleImage.ledger`` lists it as "beyond_window".

    The object is lit by the laser's spot and by ambient light, and may be luminous. Ambient light
    comes from all sides, and no occluder shades wall or object from it. Its mirror-like reflection
    by the wall is left out.

    Two more effects are neglected: blurred light from parts of the object outside the field of
    view, and the laser beam that a perfectly smooth wall reflects into the room. Occluders dim the
    light by the fractions in `Shadows`, but the point spread function remains that of an
    unobstructed pupil.

    Examples
    --------
    >>> from nlosoptics import Scene, imaging, psf
    >>> scene = Scene.load("examples/scenes/letter_flat.toml").resized(32)
    >>> spread = psf.scene_point_spread(scene, tol=1e-2).point_spread
    >>> image = imaging.form_image(scene, spread, seed=0)
    >>> image.electrons.shape, image.saturated_fraction
    ((32, 32), 0.0)
    """
    scene = expect("scene", scene, "Scene")
    seed = checked_seed(seed)
    camera = scene.camera
    exposure = positive("exposure", camera.exposure if exposure is None else exposure, unit="s")
    if point_spread is None and scene.wall_material.specular_reflectance > 0.0:
        point_spread = scene_point_spread(scene).point_spread
    if point_spread is not None:
        expect("point_spread", point_spread, "PointSpread", "PointSpreadField", having="pitch")
        _check_pitch(point_spread, camera.image_pitch)
        if not isinstance(point_spread, PointSpreadField):
            _check_energy(scene, point_spread)
    if object_image is not None:
        scene = _with_picture(scene, object_image)
    levels = light_levels(scene, exposure=exposure, shadows=shadows)
    ideal, stray, dark, freedom = levels.ideal, levels.stray, levels.dark, levels.freedom
    signal, kept = ideal.copy(), 1.0
    if point_spread is not None:
        model, kept = _blur(scene, point_spread, levels.rays, ideal)
        # the FFT leaves rounding errors of either sign in dark regions
        signal = np.maximum(model.forward(ideal), 0.0)
    light = signal + stray
    room = np.minimum(room_light(scene, exposure), light)
    laser, other = light - room, dark + room
    electrons, saturated = read_out(camera, laser, other, freedom=freedom, seed=seed)
    total = float(ideal.sum())
    return SpeckleImage(
        electrons=electrons,
        expected=light + dark,
        signal=signal,
        ideal=ideal,
        background=stray + dark,
        noise_sigma=np.sqrt(noise_variance(camera, laser, other, freedom)),
        saturated_fraction=saturated,
        pitch=camera.image_pitch,
        exposure=exposure,
        speckle_contrast=0.0 if freedom is None else freedom**-0.5,
        seed=seed,
        ledger={
            "ideal": total,
            "signal": float(signal.sum()),
            "beyond_window": total * (1.0 - kept),
            "beyond_detector": total * kept - float(signal.sum()),
            "diffuse": float(levels.diffuse.sum()),
            "spot": float(levels.spot.sum()),
            "ambient": float(levels.ambient.sum()),
            "glare": levels.glare,
            "dark": dark * ideal.size,
        },
    )


def diffuse_background(
    scene: Scene,
    object_image: ArrayLike | None = None,
    *,
    exposure: float | None = None,
    shadows: Shadows | None = None,
) -> Array:
    """Compute the part of the camera image that the wall reflects diffusely, in electrons.

    This is light from the laser spot via the hidden object, without blur, glare, dark current and
    noise. Its distribution over the image hardly depends on what the object shows. If the object is
    unknown, the distribution for a white object is a good approximation.

    Parameters
    ----------
    scene : Scene
        Scene to image.
    object_image, exposure, shadows
        As in `form_image`. What ``object_image`` changes in ``shadows`` is computed again.

    Returns
    -------
    ndarray, (ny, nx)
        Expected electrons in each image pixel, row 0 at the lowest y of the detector.

    Raises
    ------
    SceneError
        If the laser beam misses the wall or is cut by an occluder, or an argument is out of range.
    MemoryLimitError
        If the image would not fit in memory.

    See Also
    --------
    form_image : Image in electrons, with noise.
    cast_shadows : Fractions of light that occluders let through.

    Examples
    --------
    >>> from nlosoptics import Scene, imaging
    >>> scene = Scene.load("examples/scenes/letter_flat.toml").resized(16)
    >>> imaging.diffuse_background(scene).shape
    (16, 16)
    """
    scene = expect("scene", scene, "Scene")
    exposure = positive("exposure", scene.camera.exposure if exposure is None else exposure)
    if object_image is not None:
        scene = _with_picture(scene, object_image)
        shadows = None if shadows is None else repainted(shadows, scene)
    spot, rays, visible, gain = _view(scene, exposure)
    patches = lit_patches(scene, spot)
    diffuse = gain * background_radiance(scene, spot, patches, rays, visible > 0)
    shadows = _shadows(scene, shadows)
    if shadows is not None:
        diffuse *= shadows.view * shadows.veil
    return np.asarray(diffuse)


def point_background(scene: Scene, points: Array, area: float) -> Array:
    """Return electrons (n, ny, nx) of diffuse light from white pieces of the picture's plane.

    They are at ``points`` (n, 3), m, and each has the ``area``, m^2. Occluders are left out.
    """
    spot, rays, visible, gain = _view(scene, scene.camera.exposure)
    normal, seen = plate(scene)[1][2][None], visible > 0
    pieces = [Patches(points=p[None], normals=normal, areas=np.array([area])) for p in points]
    return np.stack([gain * background_radiance(scene, spot, p, rays, seen) for p in pieces])


def room_light(scene: Scene, exposure: float | None = None) -> Array | float:
    """Return electrons of all light but the laser's, before the blur, (ny, nx); 0 for none.

    It comes from many independent sources, so that it has no speckle.
    """
    if scene.ambient_irradiance == 0.0 and getattr(scene.hidden, "luminous", None) is None:
        return 0.0
    unlit = replace(scene, laser=replace(scene.laser, power=0.0))
    levels = light_levels(unlit, exposure=exposure)
    return levels.ideal + levels.stray


def reading_noise(scene: Scene, light: Array, room: Array | float = 0.0) -> Array:
    """Return the rms noise of pixels at the camera's exposure time, electrons.

    Returns noise of photons, speckle, dark current, readout and digitisation. Of all ``light``,
    that of the ``room`` has no speckle.
    """
    camera = scene.camera
    dark = camera.dark_current * camera.exposure * camera.binning**2
    room = np.minimum(room, light)
    return np.sqrt(noise_variance(camera, light - room, dark + room, _speckle_freedom(scene)))


def _shadows(scene: Scene, given: Shadows | None) -> Shadows | None:
    """Return checked or newly computed shadows; None without occluders."""
    if given is None:
        return cast_shadows(scene) if scene.occluders else None
    if expect("shadows", given, "Shadows", having="image").image.shape != scene.camera.shape:
        raise SceneError(
            f"shadows are of {given.image.shape} pixels, the camera has {scene.camera.shape}; give "
            "the result of cast_shadows for this scene"
        )
    return given


def _view(scene: Scene, exposure: float) -> tuple[LaserSpot | None, ChiefRays, Array, Array]:
    """Return laser spot, chief rays, visible fraction of the wall, and electrons per radiance."""
    ny, nx = scene.camera.shape
    fits_memory(
        f"an image of {nx} x {ny} pixels (camera.pixels, camera.binning)",
        (BYTES_PER_PIXEL + (SHADOW_BYTES if scene.occluders else 0)) * nx * ny,
        "read fewer pixels or bin more",
    )
    scene.check_black_occluders()
    scene.check_in_front()
    spot = lit_spot(scene)
    rays = chief_rays(scene, *pixel_centres(scene.camera))
    visible = wall_visibility(scene, rays)
    gain = electrons_per_radiance(scene, rays.cos_axis, exposure) * visible
    return spot, rays, visible, gain


def _blur(
    scene: Scene, point_spread: PointSpread | PointSpreadField, rays: ChiefRays, ideal: Array
) -> tuple[ForwardModel, float]:
    """Return the image model, and the fraction of light that its PSF windows contain.

    ``ideal`` (ny, nx) is the image before blurring; with a field it weights the windows.
    """
    shape = scene.camera.shape
    if not isinstance(point_spread, PointSpreadField):
        return ForwardModel(point_spread, shape=shape), float(point_spread.intensity.sum())
    if not isinstance(scene.hidden, PlanarObject):
        raise SceneError(
            "point_spread is a field over a picture, but scene.hidden is a mesh; give one "
            "PointSpread"
        )
    across, up = picture_positions(scene.hidden, rays)
    model = ForwardModel(point_spread, shape=shape, at=(across, up))
    sums = np.tensordot(point_spread.modes.sum(axis=(1, 2)), point_spread.at(across, up), 1)
    total = float(ideal.sum())
    return model, float((sums * ideal).sum()) / total if total > 0.0 else 1.0


def _check_pitch(point_spread: PointSpread | PointSpreadField, pitch: float) -> None:
    if abs(point_spread.pitch - pitch) > 1e-9 * pitch:
        raise SamplingError(
            f"point_spread.pitch = {point_spread.pitch:g} m, camera pixels are {pitch:g} m; "
            f"compute it with psf.point_spread(..., pitch={pitch!r})"
        )


def _check_energy(scene: Scene, point_spread: PointSpread) -> None:
    if point_spread.normalisation != "unit-sum":
        raise SamplingError(
            f"point_spread.normalisation = {point_spread.normalisation!r}, must be 'unit-sum' "
            "(energy per pixel); compute it with normalisation='unit-sum'"
        )
    lowest, highest = float(point_spread.intensity.min()), float(point_spread.intensity.max())
    if lowest < -1e-9 * highest:  # rounding of the pixel filter
        raise SamplingError(
            f"point_spread is negative, down to {lowest:g} with a peak of {highest:g}; "
            "give energy per pixel, at least 0"
        )
    total = float(point_spread.intensity.sum())
    # one rough wall may focus more light into the lens than a smooth one reflects into it
    focuses = scene.wall_roughness is not None and point_spread.pixel_integrated
    if total > 1.01 and not focuses:
        raise SamplingError(
            f"point_spread sums to {total:g}, limit 1: point samples are too coarse for its peak; "
            "compute it with pixel_integrated=True"
        )


def _with_picture(scene: Scene, object_image: ArrayLike) -> Scene:
    if not isinstance(scene.hidden, PlanarObject):
        raise SceneError(
            "object_image is given, but scene.hidden is a mesh and carries no picture; "
            "leave it out or use a PlanarObject"
        )
    if getattr(getattr(object_image, "dtype", None), "kind", None) in ("i", "u"):
        object_image = np.asarray(object_image, dtype=np.float64)  # 1 is white, not 255
    picture = checked_picture("object_image", object_image)
    return replace(scene, hidden=replace(scene.hidden, image=picture))


def _speckle_freedom(scene: Scene) -> float | None:
    """Degrees of freedom 1/contrast^2 of an image pixel's speckle, with two polarisations."""
    patterns = scene.laser.independent_patterns
    if patterns is None or scene.laser.power == 0.0:
        return None
    f_number = working_f_number(scene.camera.stop_diameter / 2, scene.image_distance)
    pixel = scene.camera.image_pitch
    return 2.0 * patterns * speckles_per_pixel(pixel, scene.laser.wavelength, f_number)


def _mirrored_radiance(
    scene: Scene, spot: LaserSpot | None, rays: ChiefRays, seen: NDArray[np.bool_]
) -> Array:
    """Mean radiance over each pixel of the object mirrored by the wall, W/(m^2 sr)."""
    result = np.zeros(seen.shape)
    reflectance = scene.wall_material.specular_reflectance
    if reflectance == 0.0:
        return result
    if isinstance(scene.hidden, MeshObject):
        scene.check_laser_light()
        assert spot is not None  # checked above
        return reflectance * _mesh_radiance(scene, scene.hidden.surface, spot, seen)
    hidden = scene.hidden
    corners = chief_rays(scene, *pixel_edges(scene.camera))
    average = area_average(hidden.reflectance, *picture_coordinates(hidden, corners))
    column, row = picture_coordinates(hidden, rays)
    lit = seen & (average > 0.0) & np.isfinite(column)
    points = picture_points(hidden, column[lit], row[lit])
    white = object_radiance(scene, spot, points, hidden.axes[2], -rays.reflected[lit])
    result[lit] = reflectance * white * average[lit]
    return result


def _mesh_radiance(
    scene: Scene, mesh: trimesh.Trimesh, spot: LaserSpot, seen: NDArray[np.bool_]
) -> Array:
    """Mean radiance of the mesh over each pixel, from a few chief rays per pixel."""
    x, y = pixel_centres(scene.camera)
    steps = scene.camera.image_pitch * np.array([-0.25, 0.25])
    total = np.zeros(seen.shape)
    for dy in steps:
        for dx in steps:
            rays = chief_rays(scene, x + dx, y + dy)
            use = seen & np.isfinite(rays.distance)
            points, normals, lit = mesh_hits(
                mesh, spot.point, rays.points[use], rays.reflected[use]
            )
            light = np.zeros(len(lit))
            toward = -rays.reflected[use][lit]
            light[lit] = object_radiance(scene, spot, points[lit], normals[lit], toward)
            total[use] += light
    return total / 4.0
