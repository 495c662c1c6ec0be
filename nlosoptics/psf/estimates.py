"""Bounds of what a transform may err by, max |dI|/max I."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from .pupil_grids import PupilGrid
from .residuals import Residual

Array = NDArray[np.float64]

#: Of any of the transforms.
ROUNDING = 1e-13


def intensity_error(
    intensity: Array,
    field_error: Array | float,
    energy_error: float,
    *,
    pixel: float,
    level: float,
) -> float:
    """Error of an intensity from that of its field.

    Parameters
    ----------
    intensity : ndarray
        1 at the ideal peak; means over pixels if ``pixel`` is above 0.
    field_error : ndarray or float
        Bound of the field's error, 1 at the ideal peak.
    energy_error : float
        Bound of the erring field's energy, as a share of the whole.
    pixel : float
        Pixel side in Airy units, lambda N; 0 for point samples.
    level : float
        Share of the whole energy that a pixel of mean 1 would hold.
    """
    error = np.square(field_error)
    cross = 1.0
    if pixel > 0:
        error = np.minimum(error, energy_error / level)
        # The cross term beats over about lambda N, and a wide pixel averages the beats. Measured
        # on defocus, the aberration with the most regular beats; others stay well below.
        cross = min(1.0, 0.8 / pixel)
    difference = 2 * cross * np.sqrt(intensity * error) + error
    return float(np.max(difference) / np.max(intensity)) + ROUNDING


def edge_errors(residual: Residual, grid: PupilGrid, x: Array, y: Array) -> tuple[Array, float]:
    """Field and energy error of a sampled pupil edge, for `intensity_error`.

    Cells cut by the rim act from their centre. Their weights are the rim convolved with a cell, so
    the light that the rim sends a distance s from where its rays land is damped by sinc(s/P), P the
    period of the image, 1 - sinc <= 1.65 (s/P)^2, and its repeats come in with the same weight.
    """
    wave = residual.wavefront
    n = 2 * wave.pupil_radius / grid.pitch
    rims = 1 / (1 - wave.obscuration)  # length of both rims over area
    period = wave.wavelength * abs(wave.image_distance) / grid.pitch
    shift = residual.shift
    s = np.hypot((y - shift[1])[:, None], x - shift[0])
    v = np.maximum(math.pi * s / residual.airy_unit, 1.0)
    tail = np.minimum(1.0, np.sqrt(8 / (math.pi * v**3)))
    steep = 2 * math.pi * grid.jump
    field = rims * (1.65 * (s / period) ** 2 * tail + steep / (2 * n))
    return field, rims * 0.02 * steep**2 / n


def damping_error(residual: Residual, grid: PupilGrid, pixel: float) -> float:
    """Relative loss of a pixel of side ``pixel``, m, that holds the spot, for the sinc above.

    The mean of ``3.3 (s/P)^2`` times the Airy tail over the pixel, over the pixel's energy.
    """
    wave = residual.wavefront
    period = wave.wavelength * abs(wave.image_distance) / grid.pitch
    return 1.34 * residual.airy_unit * pixel / period**2 / (1 - wave.obscuration)
