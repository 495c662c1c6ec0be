"""Encircled energy of a wave on cells: its image times softened discs.

An intensity is band-limited. If it is sampled well above its band, a disc may be softened beyond
the band without a change of the integral over it, and then needs no finer samples.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..transform import quadrature
from ..wave.detilted import Residual
from ..window import antialiased_disc
from ..window.window import Window

Array = NDArray[np.float64]

#: Band of the intensity, cycles per sample; `antialiased_disc.leak` is 2e-11 there.
BAND = 0.125


def energy_on_cells(residual: Residual, radii: Array) -> Array:
    """Return the fraction of the transmitted energy within circles about the reference point.

    ``radii``, m, has any shape, which is that of the result.
    """
    wave, values = residual.wavefront, np.zeros(radii.shape)
    if not radii.size or float(radii.max()) == 0:
        return values
    band = 2 * residual.aperture.bounding_radius / (wave.wavelength * abs(wave.image_distance))
    pitch = BAND / band
    half = math.ceil(float(radii.max()) / pitch) + antialiased_disc.REACH + 1
    window = Window.centred(pitch, (2 * half + 1, 2 * half + 1))
    field = quadrature.field(residual, window)
    intensity = field.real**2 + field.imag**2
    away = np.hypot(np.arange(-half, half + 1.0), np.arange(-half, half + 1.0)[:, None])
    for place, radius in np.ndenumerate(radii):
        if radius > 0:
            disc = antialiased_disc.SoftDisc(float(radius) / pitch)
            values[place] = np.sum(intensity * disc(away))
    return values * residual.pixel_share(pitch)
