"""Polar waves whose aberration and amplitude are polynomials, and what a softened grid errs by.

A polynomial goes on smoothly beyond the rim, so that a rim softened for the grid
(`antialiased_disc`) leaves no error but the far tails of its kernel, and the pupil costs a few
nanoseconds a cell. `antialiased_fft` transforms it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..wave.detilted import Residual
from ..wave.polar_series import PolarSpectrum
from ..wave.pupil_polynomials import fitted
from ..window import antialiased_disc, error_bounds
from ..window.window import Window

Array = NDArray[np.float64]
#: What `_antialiased_kernels.rim_errors` takes of a wave, see `rim_of`.
Rim = tuple[float, float, Array, Array, float]

#: Highest degree taken; beyond, a polynomial swings too wildly outside the rim.
DEGREE = 10
#: Largest relative amplitude variation for which this method is used.
UNEVEN = 0.3
#: Least ``tol`` for single precision and its short rims.
SINGLE = 1e-4
#: Shares of a window's reach at which errors are looked up.
RINGS = np.linspace(0.0, 1.0, 17)
#: Cells beyond the rim, and radii and angles of circles, at which slopes are looked up there.
BEYOND = np.arange(1.5, antialiased_disc.REACH, 3.0)
#: The same, and the share of a ray's light there, times cells a radius.
ZONES = np.stack(
    [BEYOND, 6.0 * np.exp(-((math.pi * antialiased_disc.STEP * BEYOND) ** 2)) / (math.pi * BEYOND)],
    axis=1,
)
CIRCLES = np.concatenate([np.linspace(1.0, 1.5, 11), [1.75, 2.0, 3.0, 5.0]])
SPOKES = 24
COSINE, SINE = (wave(2 * math.pi * np.arange(SPOKES) / SPOKES) for wave in (np.cos, np.sin))
#: Blocks a side of a window of which the strongest and the farthest samples are looked up.
BLOCKS = 8
#: Share of ``tol`` that a period is chosen for: what it leaves is only known with the image.
AIM = 0.5


@dataclass(frozen=True, eq=False)
class SoftWave:
    """A wave as polynomials of u/R and v/R, ``sum c[i, j] (u/R)^i (v/R)^j``.

    Parameters
    ----------
    aberration : ndarray
        m.
    amplitude : ndarray
        Relative to the largest; of no terms where it is the same everywhere.
    misfit : float
        Largest error of the pupil function at a node, over the largest amplitude.
    strength : float
        Bound of the amplitude at the rims over its mean.
    """

    aberration: Array
    amplitude: Array
    misfit: float
    strength: float


def soft_wave(residual: Residual, tol: float) -> SoftWave | None:
    """Polynomials of a polar wave without its piston and tilt.

    None for a wave that is not polar, whose amplitude varies by more than `UNEVEN`, or of too high
    a degree for an intensity error of ``tol``.
    """
    wave = residual.wavefront
    if wave.layout != "polar":
        return None
    if residual.low is not None:
        fit: tuple[Array, float] | None = residual.low.powers, residual.low.misfit
    else:
        rounding = 1e-14 * float(np.abs(residual.aberration).max())
        threshold = max(1e-3 * tol / residual.wavenumber, rounding)
        series = residual.polar_series[0]
        fit = _polynomial(series, residual.aberration, wave.obscuration, threshold)
    if fit is None:
        return None
    misfit = residual.wavenumber * fit[1]
    if residual.is_uniform:
        return SoftWave(fit[0], np.empty((0, 0)), misfit, 1.0)
    amplitude = wave.amplitude / float(wave.amplitude.max())
    if float(amplitude.min()) < 1 - UNEVEN:
        return None
    series = PolarSpectrum(amplitude, wave.pupil_radius, wave.obscuration)
    even = _polynomial(series, amplitude, wave.obscuration, max(1e-3 * tol, 1e-14))
    if even is None:
        return None
    # the nodes' range, as far again beyond it, over a mean that is no less than its low end
    strength = (1 + UNEVEN) / (1 - UNEVEN)
    return SoftWave(fit[0], even[0], misfit + even[1], strength)


def _polynomial(
    series: PolarSpectrum, values: Array, obscuration: float, threshold: float
) -> tuple[Array, float] | None:
    """Powers of values on polar nodes and the most they err by; None where the degree is too high.

    ``series`` tells the degree, by its terms above the threshold.
    """
    radial, angular = series.degrees(threshold)
    degree = max(2 * radial + 1, angular)
    return None if degree > DEGREE else fitted(values, obscuration, degree)


def period_of(residual: Residual, rim: Rim, samples: Window, tol: float) -> float:
    """Period, Airy units, that is expected to leave an error of `AIM` times ``tol``.

    The widest that is of any use where none does.
    """
    from . import _antialiased_kernels

    unit, reach = residual.airy_unit, residual.rays.reach / residual.airy_unit
    far = RINGS * (math.hypot(*samples.reach_from(residual.shift)) / unit)
    # The spot's peak by its rms aberration or its spread, and what is left of it farther out.
    rms = residual.heights.rms * residual.wavenumber
    peak = max(math.exp(-(rms**2)), _densest(residual) * 4 / math.pi * unit**2)
    light = np.minimum(math.sqrt(peak), error_bounds.tail(np.maximum(far - reach, 0.0)))
    least = (max(samples.reach_from(residual.shift)) * 2 + samples.pitch) / unit
    widest = 6 * (least + reach) + 400
    goal = AIM * tol * peak
    return float(_antialiased_kernels.least_period(least, widest, light, goal, far, *rim))


def _densest(residual: Residual) -> float:
    """Largest density of the rays, 1/m^2, in bins of a tenth of their reach."""
    from . import _antialiased_kernels

    rays, unit = residual.rays, residual.airy_unit
    side = max(rays.reach / 10, 1.25 * unit)
    x, y, energy = rays.x.ravel(), rays.y.ravel(), rays.energy.ravel()
    return float(_antialiased_kernels.densest(x, y, energy, rays.reach, side)) / side**2


def rim_of(residual: Residual, wave: SoftWave) -> Rim:
    """Return the inputs of `_antialiased_kernels.rim_errors` for a wave, in Airy units.

    To the error of the rim is added what leaks from beyond it, where a polynomial is steeper and
    the softened rim, its kernel cut at each of `BEYOND`, is weaker.
    """
    from ..wave import _wave_kernels

    pupil = residual.wavefront
    du, dv = np.empty((2, CIRCLES.size, SPOKES))
    _wave_kernels.slopes(wave.aberration, CIRCLES, COSINE, SINE, du, dv)
    steepest = np.maximum(np.abs(du), np.abs(dv)).max(axis=1)
    landing = np.stack([CIRCLES, 2 / pupil.wavelength * steepest])
    # length of both rims over area
    edges = wave.strength / (1 - pupil.obscuration)
    return residual.rays.reach / residual.airy_unit, edges, ZONES, landing, antialiased_disc.STEP


def _field_error(residual: Residual, rim: Rim, distance: Array, period: float) -> Array:
    """Bound of the field's error up to each of the rising distances from the tilt's point, m.

    What the cut of the kernel adds is known to the grid.
    """
    from . import _antialiased_kernels

    unit = residual.airy_unit
    error = np.empty_like(distance)
    _antialiased_kernels.rim_errors(distance / unit, period / unit, *rim, error)
    return error


def block_errors(
    residual: Residual, rim: Rim, window: Window, intensity: Array, period: float, half: float
) -> tuple[Array, Array]:
    """Largest intensity and bound of the field's error in blocks of a window, of one shape.

    ``half`` is half a pixel's side, m, whose far edge errs the most; 0 for points.
    """
    from . import _antialiased_kernels

    ny, nx = window.shape
    strongest = np.empty((min(ny, BLOCKS), min(nx, BLOCKS)))
    far = np.empty_like(strongest)
    first = tuple(a - b for a, b in zip(window.first, residual.shift, strict=True))
    _antialiased_kernels.block_maxima(intensity, first, window.pitch, strongest, far)
    far += math.sqrt(2) * half
    rings = RINGS * far.max()
    ring = np.minimum(np.searchsorted(rings, far), RINGS.size - 1)
    return strongest, _field_error(residual, rim, rings, period)[ring]
