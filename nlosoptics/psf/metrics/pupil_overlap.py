"""Optical transfer function of a wave on a round pupil: the overlap of two shifted pupils."""

from __future__ import annotations

import math

import numpy as np

from ..aperture.quadrature_nodes import gauss_legendre
from ..wave.detilted import Residual
from ..wave.polar_series import values_at


def transfer(residual: Residual, frequency: float, azimuth: float) -> complex:
    """Return the transfer function of a polar wave without obscuration, 1 at frequency 0.

    ``H(f) = sum P(q - s/2) P*(q + s/2) / sum |P|^2`` with ``s = lambda d f`` (Goodman, Introduction
    to Fourier Optics, 3rd ed., sec. 6.3). The frequency is in cycles per m, along the azimuth.
    """
    wave, a = residual.wavefront, residual.wavefront.pupil_radius
    if wave.wavelength * abs(wave.image_distance * frequency) >= 2 * a:
        return 0.0j
    place = frequency * np.array([math.cos(azimuth), math.sin(azimuth)])
    step = wave.wavelength * wave.image_distance * place
    shift, along_step = np.hypot(*step), np.arctan2(step[1], step[0])
    v = 2 * residual.wavenumber * residual.rays.slope * a
    fraction, share = gauss_legendre(math.ceil(0.6 * v) + 32)
    # Across: y = a sin t; along: half width a cos t - shift/2. Both are smooth up to the tips.
    widest = np.arccos(shift / (2 * a))
    t = widest * (2 * fraction[:, None] - 1)
    half = a * np.cos(t) - shift / 2
    along, across = half * (2 * fraction - 1), a * np.sin(t)
    weight = 2 * widest * share[:, None] * a * np.cos(t) * 2 * half * share
    c, s = np.cos(along_step), np.sin(along_step)
    sides = np.stack([along - shift / 2, along + shift / 2])
    u, v = c * sides - s * across, s * sides + c * across
    path, size = values_at(*residual.polar_series, u, v, 1e-13)
    if size is None:
        weight = weight / (math.pi * a**2)
    else:
        weight = weight * size[0] * size[1] / residual.energy
    # the wave's tilt shifts the image
    turn = 2 * math.pi * float(place @ np.array(residual.shift))
    phase = residual.wavenumber * (path[0] - path[1])
    return complex(np.sum(weight * np.exp(1j * phase)) * np.exp(-1j * turn))
