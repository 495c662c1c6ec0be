"""Airy pattern: closed form for a round or annular pupil without aberration."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..wave.detilted import Residual
from ..window.error_bounds import ROUNDING
from ..window.window import Window

Array = NDArray[np.float64]


def disc_field(v: Array) -> Array:
    """Return ``2 J1(v)/v``, 1 at v = 0 (Born & Wolf, sec. 8.5.2)."""
    from scipy.special import j1  # here, since a plan needs none of scipy

    safe = np.maximum(np.abs(v), 1e-8)  # avoids 0/0; below 1e-8 the value is 1 to the last bit
    return np.asarray(2 * j1(safe) / safe)


def annulus_field(v: Array, obscuration: float = 0.0) -> Array:
    """Return the image field of an annular pupil, 1 at v = 0.

    ``v = pi r/(lambda N)`` with N of the outer rim; ``obscuration`` is the ratio of the radii.
    """
    if obscuration == 0.0:
        return disc_field(v)
    share = obscuration**2
    return (disc_field(v) - share * disc_field(obscuration * v)) / (1 - share)


def intensity(residual: Residual, window: Window) -> Array:
    """Return the image intensity (ny, nx) without aberration, shifted by the tilt; peak 1."""
    x, y = window.x - residual.shift[0], window.y - residual.shift[1]
    v = np.hypot(y[:, None], x) * (math.pi / residual.airy_unit)
    return np.square(annulus_field(v, residual.wavefront.obscuration))


def error_bound(residual: Residual) -> float:
    """Return an upper bound of the error of the closed form, relative to the peak.

    The closed form replaces the pupil function by its mean. The bound is infinite if not useful.

    Let c be the mean of P = A exp(ikW) and delta the mean of |P/c - 1|. Up to the factor c, the
    fields differ by at most delta times the ideal peak. The energy normalisation changes by
    s = |c|^2/mean A^2.
    """
    wave = residual.wavefront
    if wave.layout != "polar":
        return math.inf
    if residual.is_flat:
        return ROUNDING
    if float(np.ptp(residual.aberration)) * residual.wavenumber > 5:  # the bound would be useless
        return math.inf
    share = wave.weights / wave.weights.sum()
    pupil = wave.amplitude * np.exp(1j * residual.wavenumber * residual.aberration)
    mean = complex(np.sum(share * pupil))
    power = float(np.sum(share * wave.amplitude**2))
    if abs(mean) ** 2 < power / 4:
        return math.inf
    # The energy normalisation also covers "ideal-peak", whose reference is the mean amplitude.
    level = abs(mean) / float(np.sum(share * wave.amplitude))
    scale = min(abs(mean) ** 2 / power, level**2)
    delta = float(np.sum(share * np.abs(pupil / mean - 1))) + residual.truncation
    if delta > 0.4:
        return math.inf
    return ((1 - scale) + 2 * delta + delta**2) / (scale * (1 - delta) ** 2) + ROUNDING
