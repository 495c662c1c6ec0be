"""Airy pattern: closed form for a round or annular pupil without aberration."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
import scipy  # its parts are loaded on first use
from numpy.typing import NDArray

from ..aperture.quadrature_nodes import frozen
from ..wave.detilted import Residual
from ..window.error_bounds import ROUNDING
from ..window.window import Window

Array = NDArray[np.float64]

#: Expansion points per radian and terms of the table of Taylor series: truncation error 4e-17.
STEPS, TERMS = 8.0, 9
#: Largest radius in the table, in units of v, rad; the table then takes 1.2 MB.
FAR = 2048
#: Phase, rad peak to valley, above which the error bound is not evaluated, as it would be useless.
STEEP = 5.0


def disc_field(v: Array) -> Array:
    """Return ``2 J1(v)/v``, 1 at v = 0 (Born & Wolf, sec. 8.5.2)."""
    safe = np.maximum(np.abs(v), 1e-8)  # avoids 0/0; below 1e-8 the value is 1 to the last bit
    return np.asarray(2 * scipy.special.j1(safe) / safe)


def annulus_field(v: Array, obscuration: float = 0.0) -> Array:
    """Return the image field of an annular pupil, 1 at v = 0.

    ``v = pi r/(lambda N)`` with N of the outer rim; ``obscuration`` is the ratio of the radii.
    """
    if obscuration == 0.0:
        return disc_field(v)
    share = obscuration**2
    return (disc_field(v) - share * disc_field(obscuration * v)) / (1 - share)


def field(residual: Residual, window: Window) -> Array:
    """Return the image field (ny, nx) without aberration, shifted by the tilt; 1 at its peak."""
    x, y = window.x - residual.shift[0], window.y - residual.shift[1]
    v = np.hypot(y[:, None], x) * (math.pi / residual.airy_unit)
    return annulus_field(v, residual.wavefront.obscuration)


def intensity(residual: Residual, window: Window) -> Array:
    """Return the image intensity (ny, nx) without aberration, shifted by the tilt; peak 1.

    If the peak lies on a sample, one octant is computed from a table and reflected.
    """
    middles = [
        (shift - first) / window.pitch
        for first, shift in zip(window.first, residual.shift, strict=True)
    ]
    i, j = (round(middle) for middle in middles)
    ny, nx = window.shape
    off = max(abs(middles[0] - i), abs(middles[1] - j))
    side = max(i, nx - i, j, ny - j) + 1
    pitch = math.pi * window.pitch / residual.airy_unit
    far = math.sqrt(2) * side * pitch
    # For a long window, or a peak near its edge, the quadrant has more samples than the window.
    apart = off > 1e-13 * (nx + ny) or not (0 <= i < nx and 0 <= j < ny)
    if apart or far > FAR or side**2 > nx * ny:
        return np.square(field(residual, window))
    from . import _transform_kernels

    quarter, whole = np.empty((side, side)), np.empty(window.shape)
    table = _table(2 ** math.ceil(math.log2(max(far, 64.0))))
    obscuration = residual.wavefront.obscuration
    _transform_kernels.airy_quarter(pitch, obscuration, STEPS, table, quarter)
    _transform_kernels.mirrored(quarter, j, i, whole)
    return whole


@lru_cache(maxsize=8)
def _table(far: int) -> Array:
    """Return the read-only table of Taylor series of `disc_field` about points up to ``far``.

    Higher terms follow from the differential equation v f'' + 3 f' + v f = 0.
    """
    v = np.arange(int(STEPS) * far + 2) / STEPS
    table = np.zeros((v.size, TERMS))
    table[0, ::2] = [(-0.25) ** k / math.factorial(k) / math.factorial(k + 1) for k in range(5)]
    v, rest = v[1:], table[1:]
    rest[:, 0], rest[:, 1] = disc_field(v), -2 * scipy.special.jn(2, v) / v
    for n in range(TERMS - 2):
        rest[:, n + 2] = (n + 1) * (n + 3) * rest[:, n + 1] + v * rest[:, n]
        if n > 0:
            rest[:, n + 2] += rest[:, n - 1]
        rest[:, n + 2] /= -v * (n + 1) * (n + 2)
    return frozen(table)


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
