"""Polynomial form of polar waves, and error bounds for sampling them on a grid with soft rims.

A polynomial continues smoothly beyond the rim. With a rim softened for the grid
(`antialiased_disc`), the only error is therefore that of the kernel's far tails, and evaluating the
pupil takes a few nanoseconds per cell. `antialiased_fft` transforms it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.polynomial import polynomial

from ..._vectors import Array
from ..wave.detilted import Residual
from ..wave.polar_series import PolarSpectrum
from ..wave.pupil_polynomials import polynomial_of
from ..window import error_bounds
from ..window.window import Window
from .quadrature import predicted_peak

#: Largest relative amplitude variation for which this method is used.
UNEVEN = 0.3
#: Distances, relative to the window's reach, at which the error is evaluated.
RINGS = np.linspace(0.0, 1.0, 17)
#: Radii, relative to the pupil's, at which slopes are evaluated.
CIRCLES = np.concatenate([np.linspace(1.0, 1.5, 11), [1.75, 2.0, 3.0, 5.0]])


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

    Returns None if its amplitude varies by more than `UNEVEN`, or an
    intensity error of ``tol`` would need a degree above that of `polynomial_of`.
    """
    wave = residual.wavefront
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


class Rim(NamedTuple):
    """Quantities that the error of a softened rim depends on; image lengths are in Airy units.

    Attributes
    ----------
    reach : float
        Reach of the rays.
    edges : float
        The rims' length over the pupil's area, relative to a clear disc, times
        `SoftWave.strength`.
    landing : ndarray, (2, n)
        The radii `CIRCLES` outside the rim and the landing distance of rays from there, where a
        polynomial is steeper.
    """

    reach: float
    edges: float
    landing: Array

    def errors(self, distance: Array, period: float) -> Array:
        """Bound the field's error within each of the increasing distances, for an image period.

        The error of truncating the kernel is not included, see `antialiased_fft.Grid.error`.
        """
        from . import _antialiased_kernels

        error = np.empty_like(distance)
        _antialiased_kernels.rim_errors(distance, period, *self, error)
        return error


def rim_of(residual: Residual, wave: SoftWave) -> Rim:
    """Return what the error of a wave's softened rim depends on."""
    pupil = residual.wavefront
    angle = 2 * math.pi * np.arange(24) / 24
    n = len(wave.aberration) - 1
    u, v = (polynomial.polyvander(np.outer(CIRCLES, f(angle)), n) for f in (np.cos, np.sin))
    factor = np.arange(1.0, n + 1)
    slopes = [
        np.sum((u[..., :-1] @ (factor[:, None] * wave.aberration[1:])) * v, axis=-1),
        np.sum((u @ (factor * wave.aberration[:, 1:])) * v[..., :-1], axis=-1),
    ]
    steepest = np.abs(slopes).max(axis=(0, 2))
    landing = np.stack([CIRCLES, 2 / pupil.wavelength * steepest])
    edges = wave.strength / (1 - pupil.obscuration)
    reach = residual.rays.reach / residual.airy_unit
    return Rim(reach, edges, landing)


def period_of(
    residual: Residual, rim: Rim, samples: Window, tol: float, pixel: float, most: float
) -> float:
    """Return the least image period, Airy units, with a predicted error of half ``tol``.

    It is found within 1 %. If no period reaches that error, the largest useful one is returned.
    ``pixel`` is the pixel's side, Airy units (0 for points), and ``most`` a bound of its mean.
    """
    from . import _antialiased_kernels

    unit, reach = residual.airy_unit, rim.reach
    far = RINGS * (math.hypot(*samples.reach_from(residual.shift)) / unit)
    peak = min(predicted_peak(residual), most)
    # envelope of the field beyond the peak
    light = np.minimum(math.sqrt(peak), error_bounds.tail(np.maximum(far - reach, 0.0)))
    light *= error_bounds.beat(pixel)
    least = (max(samples.reach_from(residual.shift)) * 2 + samples.pitch) / unit
    widest, goal = 6 * (least + reach) + 400, tol / 2 * peak
    work = np.empty_like(far)
    return float(_antialiased_kernels.least_period(least, widest, light, goal, work, far, *rim))
