"""Heights of relay walls as compiled scalar functions.

A wall is given by two float64 arrays. ``terms`` (n, 8) has one row per summand: its kind in column
0, then its parameters in SI units. ``tables`` is a flat array with the samples of gridded summands.
"""

from __future__ import annotations

import math

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


@njit(cache=True, inline="always")
def _hermite(t, step):
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


@njit(cache=True)
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
    ix = min(max(int(math.floor(fx)), 0), n_x - 2)
    iy = min(max(int(math.floor(fy)), 0), n_y - 2)
    bx, bx1, bx2 = _hermite(fx - ix, step_x)
    by, by1, by2 = _hermite(fy - iy, step_y)
    h = hx = hy = hxx = hxy = hyy = 0.0
    channel = n_x * n_y
    for j in range(2):
        for i in range(2):
            node = offset + (iy + j) * n_x + ix + i
            for dy in range(2):
                for dx in range(2):
                    c = tables[node + channel * (dx + 2 * dy)]
                    a, b = i + 2 * dx, j + 2 * dy
                    h += c * bx[a] * by[b]
                    hx += c * bx1[a] * by[b]
                    hy += c * bx[a] * by1[b]
                    hxx += c * bx2[a] * by[b]
                    hxy += c * bx1[a] * by1[b]
                    hyy += c * bx[a] * by2[b]
    return h, hx, hy, hxx, hxy, hyy


@njit(cache=True)
def surface(terms, tables, x, y):
    """Return the wall's height and derivatives (h, hx, hy, hxx, hxy, hyy) at (x, y), in m.

    All are NaN where the wall has no height; callers convert that to a status.
    """
    return partial_surface(terms, tables, x, y, True, True)


@njit(cache=True)
def partial_surface(terms, tables, x, y, smooth, creased):
    """Return `surface` of the smooth terms, of those with creases, or of both."""
    h = hx = hy = hxx = hxy = hyy = 0.0
    for i in range(terms.shape[0]):
        row = terms[i]
        kind = int(row[0])
        if not (creased if kind == FACETS else smooth):
            continue
        if kind == SPHERE:
            c = row[1]  # signed curvature, positive if the rim rises toward the room
            root_sq = 1.0 - c * c * (x * x + y * y)
            if not root_sq > 0.0:
                return math.nan, math.nan, math.nan, math.nan, math.nan, math.nan
            root = math.sqrt(root_sq)
            # this form of the sag keeps its relative accuracy near the vertex
            h += c * (x * x + y * y) / (1.0 + root)
            hx += c * x / root
            hy += c * y / root
            cube = root * root_sq
            hxx += c * (1.0 - c * c * y * y) / cube
            hyy += c * (1.0 - c * c * x * x) / cube
            hxy += c * c * c * x * y / cube
        elif kind == CYLINDER:
            c, ax, ay = row[1], row[2], row[3]  # (ax, ay): unit vector across the axis
            t = ax * x + ay * y
            root_sq = 1.0 - c * c * t * t
            if not root_sq > 0.0:
                return math.nan, math.nan, math.nan, math.nan, math.nan, math.nan
            root = math.sqrt(root_sq)
            first, second = c * t / root, c / (root * root_sq)
            h += c * t * t / (1.0 + root)
            hx += first * ax
            hy += first * ay
            hxx += second * ax * ax
            hxy += second * ax * ay
            hyy += second * ay * ay
        elif kind == WAVE:
            a, kx, ky, phase = row[1], row[2], row[3], row[4]
            cosine, sine = math.cos(kx * x + ky * y + phase), math.sin(kx * x + ky * y + phase)
            h += a * cosine
            hx -= a * kx * sine
            hy -= a * ky * sine
            hxx -= a * kx * kx * cosine
            hxy -= a * kx * ky * cosine
            hyy -= a * ky * ky * cosine
        elif kind == GRID:
            g = _grid(row, tables, x, y)
            h += g[0]
            hx += g[1]
            hy += g[2]
            hxx += g[3]
            hxy += g[4]
            hyy += g[5]
        elif kind == FACETS:
            f = facets(row, x, y)
            h += f[0]
            hx += f[1]
            hy += f[2]
        elif kind == BUMPS:
            g = bumps(row, tables, x, y)
            h += g[0]
            hx += g[1]
            hy += g[2]
            hxx += g[3]
            hxy += g[4]
            hyy += g[5]
    return h, hx, hy, hxx, hxy, hyy


@njit(cache=True)
def surfaces(terms, tables, x, y, out):
    """Fill ``out`` (n, 6) with `surface` at every (x, y)."""
    for i in range(x.size):
        out[i, 0], out[i, 1], out[i, 2], out[i, 3], out[i, 4], out[i, 5] = surface(
            terms, tables, x[i], y[i]
        )
