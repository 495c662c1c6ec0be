"""Compiled kernels of the Airy pattern and the ray density."""

from __future__ import annotations

import math

from ...kernels.compiling import njit


@njit(cache=True)
def _disc(v, steps, table):
    """Return 2 J1(v)/v by the Taylor series about the nearest of ``steps`` points per radian."""
    row = int(v * steps + 0.5)
    t = v - row / steps
    value = table[row, table.shape[1] - 1]
    for k in range(table.shape[1] - 2, -1, -1):
        value = value * t + table[row, k]
    return value


@njit(cache=True)
def airy_quarter(pitch, obscuration, steps, table, out):
    """Fill ``out`` (n, n) with the Airy intensity of a quadrant, its peak at [0, 0].

    ``pitch`` is the step in v, rad, per sample.
    """
    n = out.shape[0]
    share = obscuration * obscuration
    for j in range(n):
        for i in range(j + 1):
            v = pitch * math.sqrt(float(i * i + j * j))
            field = _disc(v, steps, table)
            if obscuration > 0.0:
                field = (field - share * _disc(obscuration * v, steps, table)) / (1.0 - share)
            out[j, i] = field * field
            out[i, j] = field * field


@njit(cache=True)
def splat(x, y, width_x, width_y, energy, out):
    """Distribute the energy of boxes over the pixels ``out`` (ny, nx) by overlap area.

    Coordinates and widths (n,) are in pixels; pixel [0, 0] extends from 0 to 1. Parts of a box
    outside the image are dropped.
    """
    ny, nx = out.shape
    for i in range(x.shape[0]):
        wx, wy = max(width_x[i], 1e-9), max(width_y[i], 1e-9)
        left, low = x[i] - 0.5 * wx, y[i] - 0.5 * wy
        if left >= nx or low >= ny or left + wx <= 0.0 or low + wy <= 0.0:
            continue
        first_row, last_row = max(0, int(math.floor(low))), min(ny - 1, int(math.floor(low + wy)))
        first, last = max(0, int(math.floor(left))), min(nx - 1, int(math.floor(left + wx)))
        for row in range(first_row, last_row + 1):
            # differences of one monotonic function, so that the fractions add up to 1
            above = min(1.0, max(0.0, (row + 1 - low) / wy))
            below = min(1.0, max(0.0, (row - low) / wy))
            strength = energy[i] * (above - below)
            for column in range(first, last + 1):
                right = min(1.0, max(0.0, (column + 1 - left) / wx))
                out[row, column] += strength * (right - min(1.0, max(0.0, (column - left) / wx)))
