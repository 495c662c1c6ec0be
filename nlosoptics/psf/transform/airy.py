"""Airy pattern: closed form for a round or annular pupil without aberration."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from ..._vectors import Array
from ..aperture.quadrature_nodes import frozen
from ..wave.detilted import Residual
from ..window.error_bounds import ROUNDING
from ..window.window import Window

#: Expansion points per radian of the table of Taylor series; truncation error 4e-17 with 9 terms.
STEPS = 8


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
    """Return the image intensity (ny, nx) without aberration, shifted by the tilt; peak 1.

    If the peak lies on a sample, one octant is computed from a table and reflected.
    """
    x, y = window.x - residual.shift[0], window.y - residual.shift[1]
    scale, obscuration = math.pi / residual.airy_unit, residual.wavefront.obscuration
    i, j = (int(np.abs(axis).argmin()) for axis in (x, y))
    (ny, nx), off = window.shape, max(abs(float(x[i])), abs(float(y[j])))
    side = max(i + 1, nx - i, j + 1, ny - j)
    far = math.sqrt(2) * side * scale * window.pitch
    # For a long window, or a peak near its edge, the quadrant has more samples than the window.
    if off > 1e-13 * (nx + ny) * window.pitch or far > 2048 or side**2 > nx * ny:
        return np.square(annulus_field(np.hypot(y[:, None], x) * scale, obscuration))
    from . import _transform_kernels

    quarter, whole = np.empty((side, side)), np.empty((ny, nx))
    table = _table(2 ** math.ceil(math.log2(max(far, 64.0))))
    _transform_kernels.airy_quarter(scale * window.pitch, obscuration, STEPS, table, quarter)
    rows = quarter[np.abs(np.arange(ny) - j)]
    whole[:, i:], whole[:, :i] = rows[:, : nx - i], rows[:, i:0:-1]
    return whole


@lru_cache(maxsize=8)
def _table(far: int) -> Array:
    """Return the read-only table of Taylor series of `disc_field` about points up to ``far``.

    Higher terms follow from the differential equation v f'' + 3 f' + v f = 0.
    """
    from scipy.special import jv

    v = np.arange(STEPS * far + 2) / STEPS
    table = np.zeros((v.size, 9))
    table[0, ::2] = [(-0.25) ** k / math.factorial(k) / math.factorial(k + 1) for k in range(5)]
    v, rest = v[1:], table[1:]
    rest[:, 0], rest[:, 1] = disc_field(v), -2 * jv(2, v) / v
    for n in range(7):
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
