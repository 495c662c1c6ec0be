"""Closed form of a round or annular pupil without aberration."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
import scipy  # loads scipy.special on first use, a tenth of a second
from numpy.typing import NDArray

from .estimates import ROUNDING
from .nodes import frozen
from .residuals import Residual
from .windows import Window

Array = NDArray[np.float64]

#: Widest window, samples, whose eighth is kept for the next one, 3 MB.
KEPT = 1024
#: Phase from peak to valley, rad, from which the mean says nothing of use.
STEEP = 5.0


def disc_field(v: Array) -> Array:
    """2 J1(v)/v, 1 at v = 0 (Born & Wolf, sec. 8.5.2)."""
    safe = np.maximum(np.abs(v), 1e-8)  # below, it is 1 to the last bit
    return np.asarray(2 * scipy.special.j1(safe) / safe)


def annulus_field(v: Array, obscuration: float = 0.0) -> Array:
    """The same for an annulus, v = pi r/(lambda N) of the outer rim."""
    if obscuration == 0.0:
        return disc_field(v)
    share = obscuration**2
    return (disc_field(v) - share * disc_field(obscuration * v)) / (1 - share)


def field(residual: Residual, window: Window) -> Array:
    """Image field of the clear pupil, at the place where the tilt puts it; 1 at its peak.

    Where that place is a sample, an eighth of the plane gives the rest.
    """
    obscuration = residual.wavefront.obscuration
    per_metre = math.pi / residual.airy_unit
    middles = [
        (shift - first) / window.pitch
        for first, shift in zip(window.first, residual.shift, strict=True)
    ]
    i, j = (round(middle) for middle in middles)
    ny, nx = window.shape
    off = max(abs(middles[0] - i), abs(middles[1] - j))
    if off > 1e-13 * (nx + ny) or not (0 <= i < nx and 0 <= j < ny) or max(nx, ny) > KEPT:
        x, y = window.x - residual.shift[0], window.y - residual.shift[1]
        return annulus_field(np.hypot(y[:, None], x) * per_metre, obscuration)
    side = max(i, nx - i, j, ny - j) + 1
    rows, columns, distance = _eighth(side)
    eighth = annulus_field(distance * (window.pitch * per_metre), obscuration)
    quarter = np.empty((side, side))
    quarter[rows, columns] = eighth
    quarter[columns, rows] = eighth
    half = np.concatenate([quarter[:, i:0:-1], quarter[:, : nx - i]], axis=1)
    return np.concatenate([half[j:0:-1], half[: ny - j]])


@lru_cache(maxsize=4)
def _eighth(side: int) -> tuple[NDArray[np.intp], NDArray[np.intp], Array]:
    """Row, column and distance from [0, 0] of the lower triangle of a square, at most `KEPT`."""
    rows, columns = np.tril_indices(side)
    return rows, columns, frozen(np.sqrt(rows * rows + columns * columns))


def error_bound(residual: Residual) -> float:
    """Upper bound of max |dI|/max I when the pupil function is replaced by its mean.

    With c the mean of P = A exp(ikW) and delta the mean of |P/c - 1|, the fields, c apart, differ
    by at most delta of the ideal peak; the energy normalisation changes by s = |c|^2/mean A^2.
    """
    wave = residual.wavefront
    if wave.layout != "polar":
        return math.inf
    if residual.is_uniform and not np.any(residual.aberration):
        return ROUNDING
    if float(np.ptp(residual.aberration)) * residual.wavenumber > STEEP:
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
