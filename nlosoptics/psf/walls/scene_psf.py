"""Point spread function of a scene, including the choice of the pupil's sampling."""

from __future__ import annotations

from dataclasses import dataclass

from numpy.typing import ArrayLike

from ..._checks import fits_memory, in_range, one_of
from ..._nouns import Noun
from ..._progress import Progress
from ...scene import Scene
from ..pupil.exit_pupil import ExitPupil
from ..pupil.scene_optics import PointOptics, SceneOptics, optics_of
from ..pupil.wall_wavefront import AimedWave
from ..transform.models import MODELS, Model, check_scalar
from ..transform.point_spread import PointSpread
from ..wave.wavefront import Wavefront
from ..window.window import shape_of
from .lobe_psf import lobes_of
from .rough_wall import PupilField, rough_image, rough_window


@dataclass(frozen=True, eq=False, kw_only=True)
class ScenePointSpread(Noun):
    """Image of one object point by a scene (point spread), with the wave that forms it.

    Parameters
    ----------
    exit_pupil : ExitPupil
        Exit pupil of lens and wall.
    wavefront : Wavefront
        Wave in the exit pupil. For a rough wall there are two cases, and ``point_spread.reason``
        states which applies. If diffraction between wall and pupil is negligible, the aberration
        includes the heights of the wall. Otherwise the wave is that of the mean wall without
        roughness.
    point_spread : PointSpread
        Point spread, energy per pixel. It includes the blur by microfacets, if a mirror-like lobe
        of the wall's material has a ``slope_rms`` (their rms slope). If the scene has a roughness,
        it is the point spread of this rough wall, or the mean over all walls of this roughness.
    pupil_field : PupilField or None
        Amplitude and phase in the exit pupil behind a rough wall, if diffraction between wall and
        pupil was computed; None otherwise.

    See Also
    --------
    scene_point_spread : Wave and PSF of a scene.
    """

    exit_pupil: ExitPupil
    wavefront: Wavefront
    point_spread: PointSpread
    pupil_field: PupilField | None = None


def scene_point_spread(
    scene: Scene | SceneOptics,
    tol: float = 1e-3,
    *,
    object_point: ArrayLike | None = None,
    pitch: float | None = None,
    shape: int | tuple[int, int] | None = None,
    model: Model = "scalar",
    progress: Progress | None = None,
) -> ScenePointSpread:
    """Compute the point spread function (PSF) of a scene, with its wave and its exit pupil.

    The PSF is the image of one object point by way of the wall's mirror-like reflection.

    Parameters
    ----------
    scene : Scene or SceneOptics
        Scene to image, or a `SceneOptics` made from it, which stores exit pupil and wave for
        further calls. A wall material without any mirror-like part is treated as a smooth mirror.
    tol : float
        Largest permitted error of the PSF relative to its peak, 1e-12 to 1.
    object_point : array_like, (3,), optional
        Object point in world coordinates, m. Default: the hidden object's reference point, that is
        the centre of a planar object or the centroid of a mesh.
    pitch : float, optional
        Pixel side, 1e-15 to 1e3 m; by default that of the camera's image. Values are integrals over
        pixels.
    shape : int or (int, int), optional
        Pixels (ny, nx); one number means a square. By default a square that contains all pixels
        above ``tol`` times the peak.
    model : {"scalar", "auto", "high-aperture"}
        ``scalar`` is scalar diffraction at small angles. ``high-aperture`` is the vector
        diffraction of unpolarised light by a fast lens; it takes longer, and is available only for
        smooth walls: without ``Scene.wall_roughness``, and with ``slope_rms`` = 0 in every
        mirror-like lobe (part) of the wall's material. ``auto`` uses it for such walls if the
        scalar model's error exceeds ``tol``.
    progress : callable(str, float), optional
        Called with "wave aberration" and "point spread" when these stages begin; the number is 0.

    Returns
    -------
    ScenePointSpread
        Exit pupil, wave in it, and point spread (ny, nx) in energy per pixel, with the
        normalisation "unit-sum": a smooth wall's whole image plane has the energy 1, whatever its
        reflectance. The point spread includes the blur by ``slope_rms``; lobes are
        weighted by their reflectances.

    Raises
    ------
    CausticError, NotWaveGradeError
        If the wave's aberration has no single value, or a mesh wall is not accurate enough for
        waves.
    SamplingError
        If ``tol`` cannot be reached within a predicted run time of a minute.
    SceneError
        If an option is out of range, or occluders cut off a part of the cone of light.

    See Also
    --------
    point_spread : PSF of a given wave.

    Notes
    -----
    The wave is sampled on rings if the lens alone limits the cone of light, and on a square grid if
    the wall's edge does. Samples are added until ``tol`` is reached. `simulate` uses the scalar
    model; `plan` says if its error exceeds ``tol``.

    For a wall with `Scene.wall_roughness` one of three methods is used; ``point_spread.reason``
    states which.

    1. If the roughness has the realisation "mean", the mean over all walls of this roughness is
       computed in closed form.
    2. Otherwise, if diffraction between wall and pupil changes the result by less than ``tol``,
       rays reflected by the rough surface give the wave aberration.
    3. Otherwise the complex field on the wall is propagated to the pupil. Walls so steep that this
       would take more than a minute are refused; `raytrace.trace_image` traces rays on them.

    Examples
    --------
    Image of the centre of the hidden object, on the camera's pixels:

    >>> from nlosoptics import Scene, psf
    >>> scene = Scene.load("examples/scenes/letter_flat.toml")
    >>> found = psf.scene_point_spread(scene, tol=1e-2)
    >>> found.wavefront.layout, found.point_spread.pitch == scene.camera.image_pitch
    ('polar', True)
    """
    optics = optics_of(scene)
    in_range("tol", tol, 1e-12, 1.0)
    one_of("model", model, MODELS)
    if pitch is None:
        pitch = optics.scene.camera.image_pitch
    pitch = in_range("pitch", pitch, 1e-15, 1e3, unit="m")
    if shape is not None:
        shape = shape_of(shape)
    if progress is not None:
        progress("wave aberration", 0.0)
    seen = optics.at(object_point)
    if progress is not None:
        progress("point spread", 0.0)
    remedy = "use a smaller shape"
    if shape is None:
        side = point_window(seen, pitch, tol)
        shape, remedy = (side, side), "use a larger tol, a wider pitch or a shape"
    ny, nx = shape
    fits_memory(f"a point spread of {ny:.3g} x {nx:.3g} pixels", 32.0 * ny * nx, remedy)
    if optics.scene.wall_roughness is None:
        aimed, spread = point_image(seen, pitch, shape, tol, model)
        field = None
    else:
        check_scalar(model, "roughness")
        aimed, spread, field = rough_image(seen, pitch, shape, tol)
    return ScenePointSpread(
        exit_pupil=optics.exit_pupil, wavefront=aimed.wave, point_spread=spread, pupil_field=field
    )


def point_window(seen: PointOptics, pitch: float, tol: float) -> int:
    """Return the odd side, pixels, of a window outside which an image is below ``tol``."""
    if seen.scene.wall_roughness is not None:
        return rough_window(seen, pitch, tol)
    lobes = lobes_of(seen.scene, lambda: seen.view)
    return lobes.window(seen.first.residual, pitch, tol, seen.first.outline)


def point_image(
    seen: PointOptics,
    pitch: float,
    shape: tuple[int, int],
    tol: float,
    model: Model = "scalar",
) -> tuple[AimedWave, PointSpread]:
    """Compute wave and image of an object point, with as many pupil nodes as ``tol`` requires."""
    if seen.scene.wall_roughness is not None:
        return rough_image(seen, pitch, shape, tol)[:2]
    lobes = lobes_of(seen.scene, lambda: seen.view)
    return seen.refined(lambda aimed: lobes.point_spread(aimed.residual, pitch, shape, tol, model))
