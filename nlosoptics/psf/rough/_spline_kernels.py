"""Compiled evaluation of B-splines of order 5 on a lattice."""

from __future__ import annotations

import math

import numpy as np

from ...kernels.compiling import njit

TAPS = 6


@njit(cache=True)
def _weights(t, weights):
    """Fill ``weights`` (6,) with the B-spline's values at t + 2, t + 1, ..., t - 3; 0 <= t < 1."""
    for x, inner, middle, outer in ((t, 2, 1, 0), (1.0 - t, 3, 4, 5)):
        s, y = x * x, 1.0 + x
        weights[inner] = (66.0 - s * (60.0 - s * (30.0 - 10.0 * x))) / 120.0
        terms = y * (75.0 - y * (210.0 - y * (150.0 - y * (45.0 - 5.0 * y))))
        weights[middle] = (51.0 + terms) / 120.0
        weights[outer] = (1.0 - x) ** 5 / 120.0


@njit(cache=True)
def spline_values(coefficients, row, column, out):
    """Evaluate a spline at places in units of the lattice; 0 outside the lattice.

    ``coefficients`` (n, m) are those of `scipy.ndimage.spline_filter`, mirrored at the edges;
    ``row``, ``column`` and ``out`` have the shape (k,).
    """
    n, m = coefficients.shape
    down, across = np.empty(TAPS), np.empty(TAPS)
    for i in range(row.shape[0]):
        out[i] = 0.0
        if not (0.0 <= row[i] <= n - 1.0 and 0.0 <= column[i] <= m - 1.0):
            continue
        first, left = int(math.floor(row[i])), int(math.floor(column[i]))
        _weights(row[i] - first, down)
        _weights(column[i] - left, across)
        for k in range(TAPS):
            y = abs(first + k - 2)
            y = min(y, 2 * (n - 1) - y)
            along = 0.0 * out[i]
            for j in range(TAPS):
                x = abs(left + j - 2)
                along += across[j] * coefficients[y, min(x, 2 * (m - 1) - x)]
            out[i] += down[k] * along
