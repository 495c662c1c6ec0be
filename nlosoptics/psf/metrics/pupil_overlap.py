"""Optical transfer function of a wave on a round pupil: the overlap of two shifted pupils."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..aperture.quadrature_nodes import gauss_legendre
from ..wave.detilted import Residual
from ..wave.polar_series import values_at

Array = NDArray[np.float64]


def transfer(residual: Residual, frequency: float, azimuth: float) -> complex:
    """Return the transfer function of a polar wave without obscuration, 1 at frequency 0.

    ``H(f) = sum P(q - s/2) P*(q + s/2) / sum |P|^2`` with ``s = lambda d f`` (Goodman, Introduction
    to Fourier Optics, 3rd ed., sec. 6.3). The frequency is in cycles per m, along the azimuth.
    """
    wave = residual.wavefront
    if wave.wavelength * abs(wave.image_distance * frequency) >= 2 * wave.pupil_radius:
        return 0.0j
    v = 2 * residual.wavenumber * residual.rays.slope * wave.pupil_radius
    place = frequency * np.array([math.cos(azimuth), math.sin(azimuth)])
    phase, weight = overlap_nodes(residual, place[None], math.ceil(0.6 * v) + 32)
    turn = 2 * math.pi * float(place @ np.array(residual.shift))
    return complex(np.sum(weight * np.exp(1j * phase)) * np.exp(-1j * turn))


def overlap_nodes(residual: Residual, frequencies: Array, n: int) -> tuple[Array, Array]:
    """Return phase differences and weights at nodes of the overlaps of two shifted round pupils.

    At each frequency ``sum(weight * exp(1j * phase))`` is the transfer function without the image
    shift that is due to the wave's tilt.
    """
    wave = residual.wavefront
    a = wave.pupil_radius
    step = wave.wavelength * wave.image_distance * frequencies[:, :, None, None]
    shift = np.hypot(step[:, 0], step[:, 1])
    azimuth = np.arctan2(step[:, 1], step[:, 0])
    series, amplitude = residual.polar_series
    fraction, share = gauss_legendre(n)
    # Across: y = a sin t; along: half width a cos t - shift/2. Both are smooth up to the tips.
    widest = np.arccos(shift / (2 * a))
    t = widest * (2 * fraction[:, None] - 1)
    half = a * np.cos(t) - shift / 2
    along, across = half * (2 * fraction - 1), a * np.sin(t)
    weight = 2 * widest * share[:, None] * a * np.cos(t) * 2 * half * share
    c, s = np.cos(azimuth), np.sin(azimuth)
    sides = np.stack([along - shift / 2, along + shift / 2])
    u, v = c * sides - s * across, s * sides + c * across
    path, size = values_at(series, amplitude, u, v, 1e-13)
    phase = residual.wavenumber * (path[0] - path[1])
    if size is None:
        return phase, weight / (math.pi * a**2)
    return phase, weight * size[0] * size[1] / float(np.sum(wave.amplitude**2 * wave.weights))
