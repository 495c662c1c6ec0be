"""Polynomial form of polar waves, and error bounds for sampling them on a grid with soft rims.

A polynomial continues smoothly beyond the rim. With a rim softened for the grid
(`antialiased_disc`), the only error is therefore that of the kernel's far tails, and evaluating the
pupil takes a few nanoseconds per cell. `antialiased_fft` transforms it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ..wave.detilted import Residual
from ..wave.polar_series import PolarSpectrum
from ..wave.pupil_polynomials import polynomial_of, polynomial_slopes
from ..window import antialiased_disc, error_bounds
from ..window.window import Window

Array = NDArray[np.float64]

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

    Returns None if the wave is not polar, its amplitude varies by more than `UNEVEN`, or an
    intensity error of ``tol`` would need a degree above that of `polynomial_of`.
    """
    wave = residual.wavefront
    if wave.layout != "polar":
        return None
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


@dataclass(frozen=True, eq=False)
class Rim:
    """What the error of a softened rim depends on; lengths in the image are in Airy units.

    Parameters
    ----------
    reach : float
        Reach of the rays.
    edges : float
        The rims' length over the pupil's area, relative to a clear disc, times
        `SoftWave.strength`.
    landing : ndarray, (n,)
        Landing distance of rays from the radii `CIRCLES` outside the rim, where a polynomial is
        steeper.
    """

    reach: float
    edges: float
    landing: Array

    def errors(self, distance: Array, period: float) -> Array:
        """Bound the field's error within each of the increasing distances, for an image period.

        The error of truncating the kernel is not included, see `antialiased_fft.Grid.error`.
        """
        cells = period / 2
        focus = 2 * antialiased_disc.leak(np.asarray(self.reach / period))
        least = float(focus) / max(math.pi * self.reach, 1.0) * self.edges
        # leakage from the cells beyond the rim, which falls with the distance from it
        beyond = np.arange(1.5, antialiased_disc.REACH, 3.0)
        strength = np.exp(-((math.pi * antialiased_disc.STEP * beyond) ** 2)) / beyond
        lands = np.interp(1 + beyond / cells, CIRCLES, self.landing)
        leaks = antialiased_disc.leak(lands / period)
        least += 6 / (math.pi * cells) * float(np.sum(strength * leaks))
        far = distance + self.reach
        field = 3 * antialiased_disc.leak(far / period) * error_bounds.tail(far) * self.edges
        return np.asarray(np.maximum.accumulate(field) + least)


def rim_of(residual: Residual, wave: SoftWave) -> Rim:
    """Return what the error of a wave's softened rim depends on."""
    pupil = residual.wavefront
    angle = 2 * math.pi * np.arange(24) / 24
    u, v = (CIRCLES[:, None] * part for part in (np.cos(angle), np.sin(angle)))
    du, dv = polynomial_slopes(wave.aberration, u, v)
    steepest = np.maximum(np.abs(du), np.abs(dv)).max(axis=1)
    edges = wave.strength / (1 - pupil.obscuration)
    return Rim(residual.rays.reach / residual.airy_unit, edges, 2 / pupil.wavelength * steepest)


def period_of(residual: Residual, rim: Rim, samples: Window, tol: float) -> float:
    """Return the least image period, Airy units, with a predicted error of half ``tol``.

    It is found within 1 %. If no period reaches that error, the largest useful one is returned.
    """
    unit, reach = residual.airy_unit, residual.rays.reach / residual.airy_unit
    far = RINGS * (math.hypot(*samples.reach_from(residual.shift)) / unit)
    peak = predicted_peak(residual)
    # envelope of the field beyond the peak
    light = np.minimum(math.sqrt(peak), error_bounds.tail(np.maximum(far - reach, 0.0)))
    low = least = (max(samples.reach_from(residual.shift)) * 2 + samples.pitch) / unit
    high, period = 6 * (least + reach) + 400, least
    while True:
        error = rim.errors(far, period)
        if np.all(2 * light * error + error**2 < tol / 2 * peak):
            high = period
        else:
            low = period
        if high <= 1.01 * low or high == least:
            return high
        period = math.sqrt(low * high)


def predicted_peak(residual: Residual) -> float:
    """Predict the largest intensity from the rms aberration and the rays, 1 at the ideal peak."""
    rms = residual.heights.rms * residual.wavenumber
    rays, unit = residual.rays, residual.airy_unit
    side = max(rays.reach / 10, 1.25 * unit)
    densest = rays.densest(side) / side**2
    return max(math.exp(-(rms**2)), densest * 4 / math.pi * unit**2)


def block_maxima(
    residual: Residual, window: Window, intensity: Array, half: float
) -> tuple[Array, Array]:
    """Return the largest intensity in each of 8 x 8 blocks of a window, and their distances.

    Parameters
    ----------
    residual : Residual
        Wave without piston and tilt.
    window : Window
        Image points.
    intensity : ndarray, (ny, nx)
        Image in the window.
    half : float
        Half a pixel's side, m, since errors are largest at its far edge; 0 for points.

    Returns
    -------
    strongest, far : ndarray, (blocks, blocks)
        At most 8 per side; ``far`` is a block's largest distance from the tilt's image point, m.
    """
    away, edges = [], []
    for n, axis, shift in zip(
        window.shape, (window.y, window.x), residual.shift[::-1], strict=True
    ):
        edges.append(np.arange(min(n, 8) + 1) * n // min(n, 8))
        away.append(np.maximum.reduceat(np.abs(axis - shift), edges[-1][:-1]) + half)
    rows = [intensity[a:b].max(axis=0) for a, b in pairwise(edges[0])]
    strongest = np.maximum.reduceat(rows, edges[1][:-1], axis=1)
    return strongest, np.hypot(away[0][:, None], away[1])
