"""Compiled B-splines of order 5 on a lattice: coefficients, and values at any place."""

from __future__ import annotations

import math

import numpy as np

from ...kernels.compiling import njit

TAPS = 6
#: Poles of the filter from values to coefficients (Unser, Aldroubi and Eden, 1993).
_INNER, _OUTER = math.sqrt(67.5 - math.sqrt(4436.25)), math.sqrt(67.5 + math.sqrt(4436.25))
POLES = (_INNER + math.sqrt(26.25) - 6.5, _OUTER - math.sqrt(26.25) - 6.5)
HORIZON = 50  # powers of the larger pole fall below 1e-18
STRIP = 64  # columns that are filtered together, so that they stay in the cache


@njit(cache=True)
def spline_filter(values):
    """Replace values (n, m) by the coefficients of splines along the first axis, n >= 2.

    The values are mirrored about their first and last row, without repeating these.
    """
    n, m = values.shape
    for left in range(0, m, STRIP):
        strip = values[:, left : min(left + STRIP, m)]
        for z in POLES:
            strip *= (1.0 - z) * (1.0 - 1.0 / z)
            # all mirrored values on the left of the first
            last = min(n - 1, HORIZON)
            first = strip[0].copy()
            for i in range(1, last + 1):
                share = z**i
                if last == n - 1 and i < n - 1:
                    share += z ** (2 * n - 2 - i)
                for j in range(strip.shape[1]):
                    first[j] += share * strip[i, j]
            strip[0] = first / (1.0 - z ** (2 * n - 2))
            for i in range(1, n):
                for j in range(strip.shape[1]):
                    strip[i, j] += z * strip[i - 1, j]
            for j in range(strip.shape[1]):
                end = strip[n - 1, j] + z * strip[n - 2, j]
                strip[n - 1, j] = z / (z * z - 1.0) * end
            for i in range(n - 2, -1, -1):
                for j in range(strip.shape[1]):
                    strip[i, j] = z * (strip[i + 1, j] - strip[i, j])


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

    ``coefficients`` (n, m) are those of `spline_filter` along both axes;
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
