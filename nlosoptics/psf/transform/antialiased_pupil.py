"""Polynomial form of polar waves, and error bounds for sampling them on a grid with soft rims.

A polynomial continues smoothly beyond the rim. With a rim softened for the grid
(`antialiased_disc`), the only error is therefore that of the kernel's far tails, and evaluating the
pupil takes a few nanoseconds per cell. `antialiased_fft` transforms it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..._vectors import read_only
from ..wave.detilted import Residual
from ..wave.polar_series import PolarSpectrum
from ..wave.pupil_polynomials import polynomial_of
from ..window import antialiased_disc, error_bounds
from ..window.window import Window

Array = NDArray[np.float64]
#: Arguments of `_antialiased_kernels.rim_errors` that depend on the wave, see `rim_of`.
Rim = tuple[float, float, Array, Array, float]

#: Largest relative amplitude variation for which this method is used.
UNEVEN = 0.3
#: Smallest ``tol`` for which single precision and shorter soft rims are used.
SINGLE = 1e-4
#: Distances, relative to the window's reach, at which the error is evaluated.
RINGS = np.linspace(0.0, 1.0, 17)
#: Distances outside the rim, cells, at which leakage is evaluated.
BEYOND = np.arange(1.5, antialiased_disc.REACH, 3.0)
#: Rows (distance, strength): each `BEYOND`, and the leakage from there times cells per radius.
ZONES = np.stack(
    [BEYOND, 6.0 * np.exp(-((math.pi * antialiased_disc.STEP * BEYOND) ** 2)) / (math.pi * BEYOND)],
    axis=1,
)
#: Radii, relative to the pupil's, and number of angles at which slopes are evaluated.
CIRCLES = np.concatenate([np.linspace(1.0, 1.5, 11), [1.75, 2.0, 3.0, 5.0]])
SPOKES = 24
COSINE, SINE = (wave(2 * math.pi * np.arange(SPOKES) / SPOKES) for wave in (np.cos, np.sin))
#: Blocks per side of a window, in each of which the error is bounded separately.
BLOCKS = 8
#: Fraction of ``tol`` for which the period is chosen, a margin since the peak is only predicted.
AIM = 0.5


@dataclass(frozen=True, eq=False)
class SoftWave:
    """Wave as polynomials of u/R and v/R, ``sum c[i, j] (u/R)^i (v/R)^j``.

    Parameters
    ----------
    aberration : ndarray, (n, n)
        Coefficients, m.
    amplitude : ndarray, (m, m)
        Coefficients, relative to the largest amplitude; (0, 0) for a uniform amplitude.
    misfit : float
        Largest error of the pupil function at a node, relative to the largest amplitude.
    strength : float
        Bound of the amplitude at the rims, relative to its mean.
    """

    aberration: Array
    amplitude: Array
    misfit: float
    strength: float


def soft_wave(residual: Residual, tol: float) -> SoftWave | None:
    """Fit polynomials to a polar wave without piston and tilt.

    Returns None if the wave is not polar, its amplitude varies by more than `UNEVEN`, or an
    intensity error of ``tol`` would need a degree above `pupil_polynomials.DEGREE`.
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
        fit = polynomial_of(series, residual.aberration, wave.obscuration, threshold)
    if fit is None:
        return None
    misfit = residual.wavenumber * fit[1]
    if residual.is_uniform:
        return SoftWave(fit[0], np.empty((0, 0)), misfit, 1.0)
    amplitude = wave.amplitude / float(wave.amplitude.max())
    if float(amplitude.min()) < 1 - UNEVEN:
        return None
    series = PolarSpectrum(amplitude, wave.pupil_radius, wave.obscuration)
    even = polynomial_of(series, amplitude, wave.obscuration, max(1e-3 * tol, 1e-14))
    if even is None:
        return None
    # Amplitudes lie in [1 - UNEVEN, 1] at the nodes. Outside, allow as much again above 1; the
    # mean is at least 1 - UNEVEN.
    strength = (1 + UNEVEN) / (1 - UNEVEN)
    return SoftWave(fit[0], even[0], misfit + even[1], strength)


def period_of(residual: Residual, rim: Rim, samples: Window, tol: float) -> float:
    """Return the image period, Airy units, with a predicted error of `AIM` times ``tol``.

    If no period reaches that error, the largest useful one is returned.
    """
    from . import _antialiased_kernels

    unit, reach = residual.airy_unit, residual.rays.reach / residual.airy_unit
    far = RINGS * (math.hypot(*samples.reach_from(residual.shift)) / unit)
    peak = predicted_peak(residual)
    # envelope of the field beyond the peak
    light = np.minimum(math.sqrt(peak), error_bounds.tail(np.maximum(far - reach, 0.0)))
    least = (max(samples.reach_from(residual.shift)) * 2 + samples.pitch) / unit
    widest = 6 * (least + reach) + 400
    goal = AIM * tol * peak
    return float(
        _antialiased_kernels.least_period(least, widest, light, goal, np.empty_like(far), far, *rim)
    )


def predicted_peak(residual: Residual) -> float:
    """Predict the largest intensity from the rms aberration and the rays, 1 at the ideal peak."""
    rms = residual.heights.rms * residual.wavenumber
    return max(math.exp(-(rms**2)), _densest(residual) * 4 / math.pi * residual.airy_unit**2)


def _densest(residual: Residual) -> float:
    """Return the largest ray density, 1/m^2, in bins of a tenth of the rays' reach."""
    from . import _antialiased_kernels

    rays, unit = residual.rays, residual.airy_unit
    side = max(rays.reach / 10, 1.25 * unit)
    x, y, energy = rays.x.ravel(), rays.y.ravel(), rays.energy.ravel()
    n = int(2.0 * rays.reach / side + 0.5) + 2
    bins = np.zeros((n, n))
    return float(_antialiased_kernels.densest(x, y, energy, rays.reach, side, bins)) / side**2


def rim_of(residual: Residual, wave: SoftWave) -> Rim:
    """Return the wave's arguments of `_antialiased_kernels.rim_errors`, in Airy units.

    These are: the reach of the rays; the rims' length over the pupil's area, relative to a clear
    disc, times `SoftWave.strength`; `ZONES`; the landing distance of rays from outside the rim,
    where a polynomial is steeper; the width of the kernel's step.
    """
    from ..wave import _wave_kernels

    pupil = residual.wavefront
    du, dv = np.empty((2, CIRCLES.size, SPOKES))
    places = read_only(CIRCLES), read_only(COSINE), read_only(SINE)
    _wave_kernels.slopes(wave.aberration, *places, np.empty((4, SPOKES)), du, dv)
    steepest = np.maximum(np.abs(du), np.abs(dv)).max(axis=1)
    landing = np.stack([CIRCLES, 2 / pupil.wavelength * steepest])
    # total length of both rims over the pupil's area, relative to a clear disc
    edges = wave.strength / (1 - pupil.obscuration)
    return residual.rays.reach / residual.airy_unit, edges, ZONES, landing, antialiased_disc.STEP


def _field_error(residual: Residual, rim: Rim, distance: Array, period: float) -> Array:
    """Bound the field error within increasing distances, m, from the tilt's shift.

    The error of truncating the kernel is not included, see `antialiased_fft.Grid.error`.
    """
    from . import _antialiased_kernels

    unit = residual.airy_unit
    error = np.empty_like(distance)
    _antialiased_kernels.rim_errors(distance / unit, period / unit, *rim, error)
    return error


def block_errors(
    residual: Residual, rim: Rim, window: Window, intensity: Array, period: float, half: float
) -> tuple[Array, Array]:
    """Return the largest intensity and a bound of the field error in each block of a window.

    Parameters
    ----------
    residual : Residual
        Wave without piston and tilt.
    rim : Rim
        From `rim_of`.
    window : Window
        Image points.
    intensity : ndarray, (ny, nx)
        Image in the window.
    period : float
        Image period, m.
    half : float
        Half a pixel's side, m, since the error is largest at the far edge; 0 for points.

    Returns
    -------
    strongest, error : ndarray, (blocks, blocks)
        At most `BLOCKS` per side.
    """
    strongest, far = block_maxima(residual, window, intensity, half)
    rings = RINGS * far.max()
    ring = np.minimum(np.searchsorted(rings, far), RINGS.size - 1)
    return strongest, _field_error(residual, rim, rings, period)[ring]


def block_maxima(
    residual: Residual, window: Window, intensity: Array, half: float
) -> tuple[Array, Array]:
    """Return the largest intensity in each block of a window, and the block's largest distance.

    The parameters are those of `block_errors`. Distances are from the tilt's image point, m.
    """
    from . import _antialiased_kernels

    ny, nx = window.shape
    strongest = np.empty((min(ny, BLOCKS), min(nx, BLOCKS)))
    far = np.empty_like(strongest)
    first = tuple(a - b for a, b in zip(window.first, residual.shift, strict=True))
    _antialiased_kernels.block_maxima(intensity, first, window.pitch, np.empty(nx), strongest, far)
    return strongest, far + math.sqrt(2) * half
