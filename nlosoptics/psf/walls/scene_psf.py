"""Point spread function of a scene: all lobes of its wall, and the choice of the way."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from ..._checks import fits_memory, in_range, one_of
from ..._nouns import Noun
from ..._progress import Progress
from ..._vectors import Array
from ...errors import SamplingError
from ...scene import Scene
from ...scene.parts._material import MirrorLobe
from ..pupil.exit_pupil import ExitPupil
from ..pupil.scene_optics import PointOptics, SceneOptics, optics_of
from ..rough.mean import NO_CORE, detilted_mean
from ..rough.relief import ReliefView
from ..rough.roughness import Roughness
from ..rough.scattered_light import Scattering
from ..rough.source import rough_view
from ..rough.view import RoughView
from ..transform.models import MODELS, Model, check_scalar
from ..transform.point_spread import PointSpread
from ..transform.wide_pixels import detilted_wide_spread
from ..wave.detilted import Residual
from ..wave.wavefront import Wavefront
from ..window.window import Window, check_rays, middle, shape_of, window_side
from .rough_wall import HELD, Cost, Image, PupilField, WallImage, relief_image, roughness_view
from .scene_costs import smooth_cost

#: Rms phase s, rad, of the heights that represent a lobe. Its point spread then equals that of the
#: lobe's slopes up to a relative error of 1/s^2.
ROUGH: Final = 1e3
#: Most scales of the heights across the wall that the lens sees. Finer roughness scatters to angles
#: far outside any image.
MOST_ACROSS: Final = 2000


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
    aimed, spread, field = wall_image(seen, pitch, shape, tol, model).run()
    return ScenePointSpread(
        exit_pupil=optics.exit_pupil, wavefront=aimed.wave, point_spread=spread, pupil_field=field
    )


@dataclass(frozen=True, eq=False)
class Lobe:
    """Mirror-like lobe of a wall."""

    share: float  # Reflectance
    view: RoughView  # Heights that blur the reflection, or that represent the slopes of microfacets
    blur: float  # Rms blur of the image along its widest axis, m
    is_ggx: bool = False  # Whether the slopes have the distribution of GGX, not of Gauss

    def halo(self, tol: float) -> float:
        """Return the image distance, m, at which the blur falls to ``tol`` of its peak.

        Slopes t have the density exp(-t^2/(2 sigma^2)), or (1 + t^2/alpha^2)^-2 for GGX. They tilt
        the wave by (cos_i + cos_o) M^T t.
        """
        far = math.sqrt(2 * (tol**-0.5 - 1) if self.is_ggx else 2 * math.log(1 / tol))
        return far * self.blur


def smooth_lobe(share: float) -> Lobe:
    """Return a lobe without slopes."""
    return Lobe(share, RoughView(Roughness(0.0, 1.0), np.eye(2), 0.0), 0.0)


def mirror_lobes(seen: PointOptics) -> tuple[Lobe, ...]:
    """Return the mirror-like lobes of the wall's material; those without slope are one.

    The ``slope_rms`` of a lobe is the rms slope of its microfacets, which represent heights of many
    wavelengths. A lobe with a slope is therefore the limit of large heights.
    """
    lobes, smooth, wave = [], 0.0, seen.first.wave
    for lobe in seen.scene.mirror_lobes:
        share = lobe.specular_reflectance
        if lobe.slope_rms == 0:
            smooth += share
        elif share > 0:
            cosines = seen.view.cos_sum
            heights = lobe_roughness(lobe, ROUGH * wave.wavelength / (2 * math.pi * cosines))
            turn = cosines * float(np.linalg.norm(seen.view.footprint, 2)) * lobe.slope_rms
            view, blur = rough_view(wave, seen.view, heights), turn * abs(wave.image_distance)
            lobes.append(Lobe(share, view, blur, getattr(lobe, "distribution", "") == "ggx"))
    return (*lobes, smooth_lobe(smooth)) if smooth > 0 else tuple(lobes)


def lobe_roughness(lobe: MirrorLobe, height_rms: float) -> Roughness:
    """Return height statistics whose slopes are those of a lobe, in the limit of large heights.

    ``height_rms``, m, causes the rms phase s = `ROUGH`, rad. The autocorrelation is Gaussian except
    for GGX, whose slopes have the characteristic function x K1(x), x = alpha times the wave number,
    so that C = 1 + ln(x K1(x))/s^2.
    """
    length = math.sqrt(2) * height_rms / lobe.slope_rms
    if getattr(lobe, "distribution", "beckmann") == "beckmann":
        return Roughness(height_rms, length)

    def correlation(lags: Array) -> Array:
        from scipy.special import k1e

        # alpha = sqrt(2) slope_rms, and s/height_rms is the wave number times both cosines
        x = np.maximum(2 * ROUGH * np.asarray(lags) / length, 1e-12)
        fall = np.log(x * k1e(x)) - x
        return np.where(np.asarray(lags) == 0, 1.0, np.maximum(1 + fall / ROUGH**2, 0))

    return Roughness(height_rms, length, correlation)


@dataclass(frozen=True, eq=False)
class ByMean(WallImage):
    """Sum of all lobes, each the mean over walls of its heights in closed form."""

    lobes: tuple[Lobe, ...]
    model: Model = "scalar"

    @property
    def reason(self) -> str:
        """Way in words."""
        return "mean over all walls in closed form"

    def cost(self, cells: int = 0) -> Cost:
        """Predict the cost of the halo of each lobe, and of the image that all share."""
        residual, window = self.seen.first.residual, Window.centred(self.pitch, self.shape)
        rough = [lobe.view for lobe in self.lobes if lobe.view.rayleigh_parameter > 0]
        halos = [Scattering(residual, view, window, True, self.tol) for view in rough]
        found = [Cost(halo.seconds(cells), halo.n_bytes(cells)) for halo in halos]
        if any(lobe.view.coherent_fraction > NO_CORE for lobe in self.lobes):
            found.append(smooth_cost(residual, self.pitch, self.shape, self.tol, cells))
        return Cost(sum(c.seconds for c in found), HELD + max(c.n_bytes for c in found))

    def run(self) -> Image:
        """Compute wave and image, with as many pupil nodes as ``tol`` requires."""
        return *self.seen.refined(lambda aimed: self._image(aimed.residual)), None

    def _image(self, residual: Residual) -> PointSpread:
        """Compute the image of all lobes, integrated over pixels, from the smooth wave."""
        pitch, shape, tol = self.pitch, self.shape, self.tol
        if self.seen.scene.wall_roughness is not None:
            check_scalar(self.model, "roughness")
            view = self.lobes[0].view
            return detilted_mean(residual, view, tol, pitch, shape, pixel_integrated=True)
        if all(lobe.view.rayleigh_parameter == 0 for lobe in self.lobes):
            return detilted_wide_spread(residual, pitch, shape, tol, self.model)
        check_scalar(self.model, "a lobe with a slope")
        check_rays(residual, pitch, shape)
        return _together([(lobe.share, self._part(residual, lobe.view)) for lobe in self.lobes])

    def _part(self, residual: Residual, view: RoughView) -> PointSpread:
        """Compute the image of one lobe; that of a smooth one is 0 where it is below ``tol``."""
        pitch, shape, tol = self.pitch, self.shape, self.tol
        if view.rayleigh_parameter > 0:
            return detilted_mean(residual, view, tol, pitch, shape, pixel_integrated=True)
        side = window_side(residual, pitch, tol)
        ny, nx = (min(n, side + (n - side) % 2) for n in shape)
        core = detilted_wide_spread(residual, pitch, (ny, nx), tol)
        intensity = np.zeros(shape)
        intensity[middle(shape, core.shape)] = core.intensity
        return replace(core, intensity=intensity)


def scene_lobes(seen: PointOptics) -> tuple[Lobe, ...]:
    """Return the lobes of a scene's wall: its roughness, or those of its material, or a mirror."""
    if seen.scene.wall_roughness is not None:
        view = roughness_view(seen)
        return (Lobe(1.0, view, view.halo(seen.first.wave) / 3),)
    return mirror_lobes(seen) or (smooth_lobe(1.0),)


def wall_image(
    seen: PointOptics,
    pitch: float,
    shape: tuple[int, int],
    tol: float,
    model: Model = "scalar",
) -> WallImage:
    """Return the way to the image of an object point, integrated over pixels.

    The optics store it, so that a plan and its run share it.
    """

    def chosen() -> WallImage:
        lobes = scene_lobes(seen)
        view = lobes[0].view
        if isinstance(view, ReliefView):
            check_scalar(model, "roughness")
            return relief_image(seen, pitch, shape, tol, view)
        return ByMean(seen, pitch, shape, tol, lobes, model)

    return seen.once(("wall image", pitch, shape, tol, model), chosen)


def point_window(seen: PointOptics, pitch: float, tol: float) -> int:
    """Return the odd side, pixels, of a window outside which an image is below ``tol``.

    ``tol`` is relative to the peak. Raises `SamplingError` if the wall's roughness is so fine that
    the window would be too wide.
    """
    residual, lobes = seen.first.residual, scene_lobes(seen)
    wave = residual.wavefront
    side = window_side(residual, pitch, tol, seen.first.outline)
    view = lobes[0].view
    if seen.scene.wall_roughness is not None and view.rayleigh_parameter > 0:
        patch = 2 * wave.pupil_radius * float(np.linalg.norm(view.footprint, 2))
        if patch > MOST_ACROSS * view.length:
            raise SamplingError(
                f"the wall's roughness changes over {view.length:.3g} m, {patch / view.length:.3g} "
                f"times within the {patch:.3g} m that the lens sees, limit {MOST_ACROSS}; use a "
                "larger cell or correlation_length, or a mirror-like lobe with slope_rms instead"
            )
    return side + 2 * math.ceil(max(lobe.halo(tol) for lobe in lobes) / pitch)


def error_of_sum(parts: Sequence[tuple[float, PointSpread]], error: str, peak: float) -> float:
    """Return an error of a sum of (weight, point spread) pairs, relative to its peak."""
    peaks = [weight * float(part.intensity.max() / peak) for weight, part in parts]
    return sum((n * getattr(part, error) for n, (_, part) in zip(peaks, parts, strict=True)), 0.0)


def _together(parts: list[tuple[float, PointSpread]]) -> PointSpread:
    """Return the weighted mean of (weight, point spread) pairs on the same pixels."""
    total = sum(share for share, _ in parts)
    intensity = np.sum([share / total * part.intensity for share, part in parts], axis=0)
    first, peak = parts[0][1], total * float(intensity.max())
    return PointSpread(
        intensity=intensity,
        pitch=first.pitch,
        method=" + ".join(dict.fromkeys(part.method for _, part in parts)),
        error_estimate=error_of_sum(parts, "error_estimate", peak),
        model_error=error_of_sum(parts, "model_error", peak),
        normalisation=first.normalisation,
        wavelength=first.wavelength,
        f_number=first.f_number,
        pixel_integrated=True,
        enclosed_energy=float(intensity.sum()),
        regime=first.regime,
        reason="; ".join(dict.fromkeys(part.reason for _, part in parts)),
    )
