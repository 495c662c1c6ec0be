"""Heights of relay walls as compiled scalar functions.

A wall is given by two float64 arrays. ``terms`` (n, 8) has one row per summand: its kind in column
0, then its parameters in SI units. ``tables`` is a flat array with the samples of gridded summands,
or None as `tables_for` returns it: numba then compiles only spheres, cylinders and waves.
"""

from __future__ import annotations

import math
from typing import Any

from .codes import (
    BUMPS,
    CYLINDER,
    FACETS,
    GRID,
    SPHERE,
    WAVE,
)
from .compiling import njit
from .relief import bumps, facets


def tables_for(terms: Any, tables: Any) -> Any:
    """Return ``tables``, or None if all terms are planes, spheres, cylinders and waves."""
    return tables if (terms[:, 0] >= GRID).any() else None


@njit(cache=True, forceinline=True, error_model="numpy")
def hermite(t, step):
    """Return the cubic Hermite basis at t in [0, 1] and its first and second x derivatives.

    The order is: values at nodes 0 and 1, slopes at nodes 0 and 1; ``step`` is the node distance.
    """
    t2 = t * t
    t3 = t2 * t
    values = (1 - 3 * t2 + 2 * t3, 3 * t2 - 2 * t3, (t - 2 * t2 + t3) * step, (t3 - t2) * step)
    first = ((6 * t2 - 6 * t) / step, (6 * t - 6 * t2) / step, 1 - 4 * t + 3 * t2, 3 * t2 - 2 * t)
    second = (
        (12 * t - 6) / (step * step),
        (6 - 12 * t) / (step * step),
        (6 * t - 4) / step,
        (6 * t - 2) / step,
    )
    return values, first, second


@njit(cache=True, forceinline=True)
def _grid(row, tables, x, y):
    """Return height and derivatives of a bicubic Hermite surface at (x, y); NaN off its grid.

    ``row`` is (kind, x0, y0, step_x, step_y, n_x, n_y, offset). From the offset on, ``tables``
    holds h, dh/dx, dh/dy and d2h/dxdy at all nodes, each as (n_y, n_x).
    """
    step_x, step_y = row[3], row[4]
    n_x, n_y, offset = int(row[5]), int(row[6]), int(row[7])
    fx, fy = (x - row[1]) / step_x, (y - row[2]) / step_y
    if not (-1e-9 <= fx <= n_x - 1 + 1e-9 and -1e-9 <= fy <= n_y - 1 + 1e-9):
        return math.nan, math.nan, math.nan, math.nan, math.nan, math.nan
    ix, iy = min(int(max(fx, 0.0)), n_x - 2), min(int(max(fy, 0.0)), n_y - 2)
    bx, bx1, bx2 = hermite(fx - ix, step_x)
    by, by1, by2 = hermite(fy - iy, step_y)
    h = hx = hy = hxx = hxy = hyy = 0.0
    channel = n_x * n_y
    for dy in range(2):
        for j in range(2):
            # along x first: height, slope and curvature on a line of nodes, or their y derivatives
            node = offset + (iy + j) * n_x + ix + 2 * channel * dy
            v0, v1 = tables[node], tables[node + 1]
            s0, s1 = tables[node + channel], tables[node + channel + 1]
            c = v0 * bx[0] + v1 * bx[1] + s0 * bx[2] + s1 * bx[3]
            c1 = v0 * bx1[0] + v1 * bx1[1] + s0 * bx1[2] + s1 * bx1[3]
            c2 = v0 * bx2[0] + v1 * bx2[1] + s0 * bx2[2] + s1 * bx2[3]
            b = j + 2 * dy
            h += c * by[b]
            hx += c1 * by[b]
            hy += c * by1[b]
            hxx += c2 * by[b]
            hxy += c1 * by1[b]
            hyy += c * by2[b]
    return h, hx, hy, hxx, hxy, hyy


@njit(cache=True, forceinline=True)
def _summand(row, tables, x, y):
    """Return height and derivatives (h, hx, hy, hxx, hxy, hyy) of one term at (x, y), in m.

    Inlined, so that the compiler drops what a caller does not use.
    """
    kind = int(row[0])
    h = hx = hy = hxx = hxy = hyy = 0.0
    if kind == SPHERE:
        c = row[1]  # signed curvature, positive if the rim rises toward the room
        root_sq = 1.0 - c * c * (x * x + y * y)
        root = math.sqrt(root_sq) if root_sq > 0.0 else math.nan
        # this form of the sag keeps its relative accuracy near the vertex
        h = c * (x * x + y * y) / (1.0 + root)
        hx, hy = c * x / root, c * y / root
        cube = root * root_sq
        hxx = c * (1.0 - c * c * y * y) / cube
        hyy = c * (1.0 - c * c * x * x) / cube
        hxy = c * c * c * x * y / cube
    elif kind == CYLINDER:
        c, ax, ay = row[1], row[2], row[3]  # (ax, ay): unit vector across the axis
        t = ax * x + ay * y
        root_sq = 1.0 - c * c * t * t
        root = math.sqrt(root_sq) if root_sq > 0.0 else math.nan
        first, second = c * t / root, c / (root * root_sq)
        h = c * t * t / (1.0 + root)
        hx, hy = first * ax, first * ay
        hxx, hxy, hyy = second * ax * ax, second * ax * ay, second * ay * ay
    elif kind == WAVE:
        a, kx, ky, phase = row[1], row[2], row[3], row[4]
        cosine, sine = math.cos(kx * x + ky * y + phase), math.sin(kx * x + ky * y + phase)
        h, hx, hy = a * cosine, -a * kx * sine, -a * ky * sine
        hxx, hxy, hyy = -a * kx * kx * cosine, -a * kx * ky * cosine, -a * ky * ky * cosine
    if tables is not None:
        if kind == GRID:
            h, hx, hy, hxx, hxy, hyy = _grid(row, tables, x, y)
        elif kind == FACETS:
            h, hx, hy = facets(row, x, y)
        elif kind == BUMPS:
            h, hx, hy, hxx, hxy, hyy = bumps(row, tables, x, y)
    return h, hx, hy, hxx, hxy, hyy


@njit(cache=True)
def surface(terms, tables, x, y):
    """Return the wall's height and derivatives (h, hx, hy, hxx, hxy, hyy) at (x, y), in m.

    All are NaN where the wall has no height; callers convert that to a status. A flat wall may have
    None for its terms.
    """
    if terms is None:
        return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    return partial_surface(terms, tables, x, y, True, True)


@njit(cache=True)
def partial_surface(terms, tables, x, y, smooth, creased):
    """Return `surface` of the smooth terms, of those with creases, or of both."""
    h = hx = hy = hxx = hxy = hyy = 0.0
    for i in range(terms.shape[0]):
        if creased if int(terms[i, 0]) == FACETS else smooth:
            g = _summand(terms[i], tables, x, y)
            h += g[0]
            hx += g[1]
            hy += g[2]
            hxx += g[3]
            hxy += g[4]
            hyy += g[5]
    return h, hx, hy, hxx, hxy, hyy


@njit(cache=True)
def tangent(terms, tables, x, y):
    """Return the wall's height (m) and slopes (h, hx, hy) at (x, y), NaN where it has no height."""
    h = hx = hy = 0.0
    for i in range(terms.shape[0]):
        g = _summand(terms[i], tables, x, y)
        h += g[0]
        hx += g[1]
        hy += g[2]
    return h, hx, hy


@njit(cache=True)
def surfaces(terms, tables, x, y, out):
    """Fill ``out`` (n, 6) with `surface` at every (x, y)."""
    for i in range(x.size):
        out[i, 0], out[i, 1], out[i, 2], out[i, 3], out[i, 4], out[i, 5] = surface(
            terms, tables, x[i], y[i]
        )
