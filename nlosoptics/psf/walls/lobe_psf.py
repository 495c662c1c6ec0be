"""Point spread function of a wall material's mirror-like lobes."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ...scene import Scene
from ...scene.parts._material import MirrorLobe
from ..aperture.aperture import Aperture
from ..pupil.wall_view import WallView
from ..rough.mean import detilted_mean
from ..rough.roughness import Roughness
from ..rough.source import rough_view
from ..rough.view import RoughView
from ..transform.models import Model, check_scalar
from ..transform.point_spread import PointSpread
from ..transform.wide_pixels import detilted_wide_spread
from ..wave.detilted import Residual
from ..wave.wavefront import Wavefront
from ..window.window import check_rays, middle, window_side

Array = NDArray[np.float64]
#: Rms phase s, rad, of the heights that represent a lobe. Its point spread then equals that of the
#: lobe's slopes up to a relative error of 1/s^2.
ROUGH: Final = 1e3


def lobe_roughness(lobe: MirrorLobe, rayleigh_parameter: float, height_rms: float) -> Roughness:
    """Return height statistics whose slopes are those of a lobe, in the limit of large heights.

    ``height_rms``, m, causes the rms phase ``rayleigh_parameter``, rad, much larger than 1. The
    autocorrelation is Gaussian except for GGX, whose slopes have the characteristic function x
    K1(x), x = alpha times the wave number, so that C = 1 + ln(x K1(x))/s^2.
    """
    length = math.sqrt(2) * height_rms / lobe.slope_rms
    if getattr(lobe, "distribution", "beckmann") == "beckmann":
        return Roughness(height_rms, length)

    def correlation(lags: Array) -> Array:
        from scipy.special import k1e

        # alpha = sqrt(2) slope_rms, and s/height_rms is the wave number times both cosines
        x = np.maximum(2 * rayleigh_parameter * np.asarray(lags) / length, 1e-12)
        fall = np.log(x * k1e(x)) - x
        return np.where(np.asarray(lags) == 0, 1.0, np.maximum(1 + fall / rayleigh_parameter**2, 0))

    return Roughness(height_rms, length, correlation)


def halo_radius(lobe: MirrorLobe, view: WallView, wave: Wavefront, tol: float) -> float:
    """Return the image distance, m, at which the blur by a lobe falls to ``tol`` of its peak.

    Slopes t have the density exp(-t^2/(2 sigma^2)), or (1 + t^2/alpha^2)^-2 for GGX. They tilt the
    wave by (cos_i + cos_o) M^T t.
    """
    far = math.sqrt(2 * math.log(1 / tol))
    if getattr(lobe, "distribution", "") == "ggx":
        far = math.sqrt(2 * (tol**-0.5 - 1))
    turn = view.cos_sum * float(np.linalg.norm(view.footprint, 2)) * lobe.slope_rms
    return far * turn * abs(wave.image_distance)


@dataclass(frozen=True, eq=False)
class MirrorLobes:
    """Mirror-like lobes of a wall and the geometry in which the pupil sees the wall."""

    rough: list[MirrorLobe]  # Lobes with a slope
    smooth: float  # Total reflectance of the lobes without slope
    view: WallView | None  # Geometry of wall and pupil; None if no lobe has a slope

    def window(
        self, residual: Residual, pitch: float, tol: float, outline: Aperture | None = None
    ) -> int:
        """Return the odd side, pixels, of a window outside which the image is below ``tol``.

        ``tol`` is relative to the peak. ``outline`` is the pupil's, if the wave does not hold it.
        """
        side = window_side(residual, pitch, tol, outline)
        if self.view is None:
            return side
        wave = residual.wavefront
        halo = max(halo_radius(lobe, self.view, wave, tol) for lobe in self.rough)
        return side + 2 * math.ceil(halo / pitch)

    def views(self, residual: Residual) -> list[RoughView]:
        """Return a roughness view for each lobe with a slope, in the limit of large heights."""
        if self.view is None:
            return []
        wave = residual.wavefront
        height = ROUGH * wave.wavelength / (2 * math.pi * self.view.cos_sum)
        return [rough_view(wave, self.view, lobe_roughness(r, ROUGH, height)) for r in self.rough]

    def point_spread(
        self,
        residual: Residual,
        pitch: float,
        shape: tuple[int, int],
        tol: float,
        model: Model = "scalar",
    ) -> PointSpread:
        """Compute the point spread of all lobes, integrated over pixels, from the smooth wave.

        The ``slope_rms`` of a lobe is the rms slope of its microfacets, which represent heights of
        many wavelengths. A lobe with a slope above 0 is therefore computed as the limit of
        `mean_point_spread` for large heights. Lobes are weighted by their reflectances.
        """
        if self.view is None:
            return detilted_wide_spread(residual, pitch, shape, tol, model)
        check_scalar(model, "a lobe with a slope")
        check_rays(residual, pitch, shape)
        parts: list[tuple[float, PointSpread]] = []
        for lobe, seen in zip(self.rough, self.views(residual), strict=True):
            mean = detilted_mean(residual, seen, tol, pitch, shape, pixel_integrated=True)
            parts.append((lobe.specular_reflectance, mean))
        if self.smooth > 0:
            parts.append((self.smooth, _within(residual, pitch, shape, tol)))
        return _together(parts)


def lobes_of(scene: Scene, view: Callable[[], WallView]) -> MirrorLobes:
    """Return the mirror-like lobes of a scene's wall."""
    rough, smooth = split_lobes(scene)
    return MirrorLobes(rough, smooth, view() if rough else None)


def _within(residual: Residual, pitch: float, shape: tuple[int, int], tol: float) -> PointSpread:
    """Return the smooth wall's point spread, set to 0 where it is below ``tol`` of its peak."""
    side = window_side(residual, pitch, tol)
    ny, nx = (min(n, side + (n - side) % 2) for n in shape)
    core = detilted_wide_spread(residual, pitch, (ny, nx), tol)
    intensity = np.zeros(shape)
    intensity[middle(shape, core.shape)] = core.intensity
    return replace(core, intensity=intensity)


def split_lobes(scene: Scene) -> tuple[list[MirrorLobe], float]:
    """Return the mirror-like lobes with a slope, and the total reflectance of those without."""
    lobes = scene.mirror_lobes
    smooth = sum(lobe.specular_reflectance for lobe in lobes if lobe.slope_rms == 0)
    return [lobe for lobe in lobes if lobe.slope_rms > 0], smooth


def _together(parts: list[tuple[float, PointSpread]]) -> PointSpread:
    """Return the weighted mean of (weight, point spread) pairs on the same pixels."""
    total = sum(share for share, _ in parts)
    intensity = np.sum([share / total * part.intensity for share, part in parts], axis=0)
    first = parts[0][1]
    peaks = [share * float(part.intensity.max()) for share, part in parts]
    peak = total * float(intensity.max())
    return PointSpread(
        intensity=intensity,
        pitch=first.pitch,
        method=" + ".join(dict.fromkeys(part.method for _, part in parts)),
        error_estimate=sum(n * p.error_estimate for n, (_, p) in zip(peaks, parts, strict=True))
        / peak,
        model_error=sum(n * p.model_error for n, (_, p) in zip(peaks, parts, strict=True)) / peak,
        normalisation=first.normalisation,
        wavelength=first.wavelength,
        f_number=first.f_number,
        pixel_integrated=True,
        enclosed_energy=float(intensity.sum()),
        regime=first.regime,
        reason="; ".join(dict.fromkeys(part.reason for _, part in parts)),
    )
