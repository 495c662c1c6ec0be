"""Airy patterns by a table of their radial function."""

from __future__ import annotations

import math

from numba import njit


@njit(cache=True)
def _disc(v, steps, table):
    """2 J1(v)/v by the Taylor series about the nearest of ``steps`` points a radian."""
    row = int(v * steps + 0.5)
    t = v - row / steps
    value = table[row, table.shape[1] - 1]
    for k in range(table.shape[1] - 2, -1, -1):
        value = value * t + table[row, k]
    return value


@njit(cache=True)
def airy_quarter(pitch, obscuration, steps, table, out):
    """Fill ``out`` (n, n) with the intensity about the peak, at [0, 0], ``pitch`` rad a sample."""
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
def mirrored(quarter, row, column, out):
    """Fill ``out`` with a quarter of the plane and its reflections, its corner at a sample."""
    for j in range(out.shape[0]):
        line, source = out[j], quarter[abs(j - row)]
        for i in range(column):
            line[i] = source[column - i]
        for i in range(column, out.shape[1]):
            line[i] = source[i - column]
