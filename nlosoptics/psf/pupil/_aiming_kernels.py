"""Compiled ray aiming by the relay wall: stationary paths, path excess and ray-tube spreading."""

from __future__ import annotations

import math

from numba import prange

from ...kernels.compiling import njit
from ...kernels.heights import surface
from ...kernels.parallel import threaded

ROUNDED = 1e-11  # gradient of the path at which a point counts as stationary


@njit(cache=True)
def _stationarity(o, p, x, y, s):
    """Gradient and Hessian over (x, y) of the path |O - X| + |X - p|, X on the surface.

    ``s`` holds the surface's height and its derivatives hx, hy, hxx, hxy, hyy at (x, y).
    """
    ax, ay, az = x - o[0], y - o[1], s[0] - o[2]
    bx, by, bz = p[0] - x, p[1] - y, p[2] - s[0]
    d1, d2 = math.sqrt(ax * ax + ay * ay + az * az), math.sqrt(bx * bx + by * by + bz * bz)
    ax, ay, az = ax / d1, ay / d1, az / d1
    bx, by, bz = bx / d2, by / d2, bz / d2
    kx, ky, kz = ax - bx, ay - by, az - bz
    gx, gy = kx + kz * s[1], ky + kz * s[2]
    # Components of both legs along the tangents (1, 0, hx) and (0, 1, hy).
    a1, a2 = ax + az * s[1], ay + az * s[2]
    b1, b2 = bx + bz * s[1], by + bz * s[2]
    i1, i2 = 1.0 / d1, 1.0 / d2
    t11, t12, t22 = 1.0 + s[1] * s[1], s[1] * s[2], 1.0 + s[2] * s[2]
    hxx = i1 * (t11 - a1 * a1) + i2 * (t11 - b1 * b1) + kz * s[3]
    hxy = i1 * (t12 - a1 * a2) + i2 * (t12 - b1 * b2) + kz * s[4]
    hyy = i1 * (t22 - a2 * a2) + i2 * (t22 - b2 * b2) + kz * s[5]
    return gx, gy, hxx, hxy, hyy


@njit(cache=True)
def stationary_point(terms, tables, o, p, x, y):
    """Find a wall point at which the path from O by the wall to p is stationary.

    Newton's method with backtracking on the path's gradient, from the start (x, y). A start beyond
    the rim of the surface is moved toward its vertex, the origin. Returns (x, y), and whether the
    path is stationary there.
    """
    s = surface(terms, tables, x, y)
    while math.isnan(s[0]) and abs(x) + abs(y) > 0.0:
        x, y, s = 0.25 * x, 0.25 * y, surface(terms, tables, 0.25 * x, 0.25 * y)
    gx, gy, hxx, hxy, hyy = _stationarity(o, p, x, y, s)
    norm = math.hypot(gx, gy)
    for _ in range(60):
        if norm == 0.0:
            return x, y, True
        det = hxx * hyy - hxy * hxy
        scale = max(abs(hxx), abs(hyy), abs(hxy))
        if abs(det) < 1e-14 * scale * scale:
            return x, y, False
        dx, dy = -(hyy * gx - hxy * gy) / det, -(hxx * gy - hxy * gx) / det
        length = 1.0
        moved = False
        # Near the solution the full step is taken or none: shorter ones would only try roundings.
        for _ in range(1 if norm < ROUNDED else 40):
            xn, yn = x + length * dx, y + length * dy
            sn = surface(terms, tables, xn, yn)
            if not math.isnan(sn[0]):
                trial = _stationarity(o, p, xn, yn, sn)
                norm_n = math.hypot(trial[0], trial[1])
                if norm_n < norm:
                    moved = True
                    break
            length *= 0.5
        if not moved:
            # Rounding stopped the descent. The error of the path is of second order in the rest.
            return x, y, norm < ROUNDED
        x, y, s, norm = xn, yn, sn, norm_n
        gx, gy, hxx, hxy, hyy = trial
    return x, y, norm < ROUNDED


@njit(cache=True, error_model="numpy")  # the spreading is infinite at a focus of the wall
def _describe(o, p, x, y, s, axis, row):
    """Fill a row of `aim`, except its last column, at the stationary point (x, y)."""
    row[0], row[1], row[2] = x, y, s[0]
    _, _, hxx, hxy, hyy = _stationarity(o, p, x, y, s)
    det = hxx * hyy - hxy * hxy
    row[5] = det
    row[6] = 0.5 * (hxx + hyy - math.hypot(hxx - hyy, 2.0 * hxy))
    # With A = H - O' and B = p - H, compute |A| + |B| - |A + B| without cancellation.
    ax, ay, az = x - o[0], y - o[1], s[0] + o[2]
    bx, by, bz = p[0] - x, p[1] - y, p[2] - s[0]
    a, b = math.sqrt(ax * ax + ay * ay + az * az), math.sqrt(bx * bx + by * by + bz * bz)
    cx, cy, cz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    dot = ax * bx + ay * by + az * bz
    c = math.sqrt((ax + bx) ** 2 + (ay + by) ** 2 + (az + bz) ** 2)
    bend = 2.0 * (cx * cx + cy * cy + cz * cz) / ((a * b + dot) * (a + b + c))
    a_true = math.sqrt(ax * ax + ay * ay + (s[0] - o[2]) ** 2)
    row[3] = bend - 4.0 * o[2] * s[0] / (a_true + a)
    # The van Vleck determinant of the reduced path gives the spreading of a ray tube.
    along_1 = abs(-s[1] * ax - s[2] * ay + (s[0] - o[2])) / a_true
    along_2 = abs(-s[1] * bx - s[2] * by + bz) / b
    cos_pupil = abs(bx * axis[0] + by * axis[1] + bz * axis[2]) / b
    row[4] = along_1 * along_2 * cos_pupil / (a_true * a_true * b * b * abs(det))


@threaded()
def aim(terms, tables, o, nodes, starts, axis, out):
    """Fill ``out`` (n, 8) with the stationary paths from O by the wall to each node (n, 3).

    Columns: wall point x, y, z, m; path excess over |O' - p|, m; spreading (irradiance on the
    pupil plane per radiant intensity at O, 1/m^2); determinant and smaller eigenvalue of the path's
    Hessian; 1 if the path is stationary, else 0. ``axis`` is the unit normal of the pupil plane.
    """
    for i in prange(nodes.shape[0]):
        p = nodes[i]
        x, y, found = stationary_point(terms, tables, o, p, starts[i, 0], starts[i, 1])
        s = surface(terms, tables, x, y)
        out[i, 0], out[i, 1], out[i, 2] = x, y, s[0]
        if found:
            _describe(o, p, x, y, s, axis, out[i])
        out[i, 7] = found


@njit(cache=True)
def stationarities(o, nodes, points, surfaces, out):
    """Fill ``out`` (n, 5) with the path's gradient and Hessian at wall points (n, 2)."""
    for i in range(nodes.shape[0]):
        s = surfaces[i]
        out[i, 0], out[i, 1], out[i, 2], out[i, 3], out[i, 4] = _stationarity(
            o, nodes[i], points[i, 0], points[i, 1], s
        )


@njit(cache=True)
def describe(o, nodes, points, surfaces, axis, out):
    """Fill rows (n, 8) of `aim`, except their last column, at stationary points (n, 2)."""
    for i in range(nodes.shape[0]):
        _describe(o, nodes[i], points[i, 0], points[i, 1], surfaces[i], axis, out[i])
