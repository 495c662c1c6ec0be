"""Closed form of a round or annular pupil without aberration."""

from __future__ import annotations

import math

import numpy as np
import scipy  # loads scipy.special on first use, a tenth of a second
from numpy.typing import NDArray

from .estimates import ROUNDING
from .residuals import Residual
from .windows import Window

Array = NDArray[np.float64]


def disc_field(v: Array) -> Array:
    """2 J1(v)/v, 1 at v = 0 (Born & Wolf, sec. 8.5.2)."""
    small = np.abs(v) < 1e-8  # there it is 1 to the last bit
    safe = np.where(small, 1.0, v)
    return np.where(small, 1.0, 2 * scipy.special.j1(safe) / safe)


def annulus_field(v: Array, obscuration: float = 0.0) -> Array:
    """The same for an annulus, v = pi r/(lambda N) of the outer rim."""
    if obscuration == 0.0:
        return disc_field(v)
    share = obscuration**2
    return (disc_field(v) - share * disc_field(obscuration * v)) / (1 - share)


def field(residual: Residual, window: Window) -> Array:
    """Image field of the clear pupil, at the place where the tilt puts it; 1 at its peak."""
    x = window.x - residual.shift[0]
    y = window.y - residual.shift[1]
    v = np.hypot(y[:, None], x) * (math.pi / residual.airy_unit)
    return annulus_field(v, residual.wavefront.obscuration)


def error_bound(residual: Residual) -> float:
    """Upper bound of max |dI|/max I when the pupil function is replaced by its mean.

    With c the mean of P = A exp(ikW) and delta the mean of |P/c - 1|, the fields, c apart, differ
    by at most delta of the ideal peak; the energy normalisation changes by s = |c|^2/mean A^2.
    """
    wave = residual.wavefront
    if wave.layout != "polar":
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
