"""Compiled kernel of the ray density."""

from __future__ import annotations

import math

from ...kernels.compiling import njit


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
