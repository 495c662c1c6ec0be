"""Compiled intersection of blocks of rays with curved relay walls.

Waves and bicubic surfaces are met by all rays of a block at once. What these leave open, and all
other walls, are searched ray by ray. The data of a block's rays, ``w``, are rows of BLOCK numbers.
Fixed distances between the rows and loops without branches let the compiler vectorise over rays.
The limits of the search are those of `_wall_kernels`.
"""

from __future__ import annotations

import math

import numpy as np
from numba import prange

from ...kernels.codes import GRID, WAVE
from ...kernels.compiling import njit
from ...kernels.heights import hermite
from ...kernels.parallel import threaded
from ._wall_kernels import HIT, OUTSIDE, ROUNDING, TOLERANCE, _unit, wall_hit

BLOCK = 64  # rays processed at once
OX, OY, OZ, DX, DY, DZ, T, HX, HY, MIDDLE, REACH, ERROR = range(0, 12 * BLOCK, BLOCK)
STEEP, SHARP, CUBE, F, X0, Y0, X1, Y1, X2, Y2 = range(12 * BLOCK, 22 * BLOCK, BLOCK)  # waves
LOW, HIGH, U, V, LEFT, SLOPE, NODES = range(12 * BLOCK, 19 * BLOCK, BLOCK)  # grids
ROWS = 34
STEPS = 5  # of the iteration for a block; rays that need more are searched one by one


@njit(cache=True, inline="always")
def _sin_cos(x):
    """Return sine and cosine without branches, accurate to about 1 ulp for |x| <= 1e5."""
    turns = math.floor(x * 0.6366197723675814 + 0.5)
    # pi/2 in three parts whose products with ``turns`` are exact (Cody and Waite, as in fdlibm)
    r = x - turns * 1.57079632673412561417e00
    r -= turns * 6.07710050630396597660e-11
    r -= turns * 2.02226624879595063154e-21
    z = r * r
    s = -2.50507602534068634195e-08 + z * 1.58969099521155010221e-10
    s = -1.98412698298579493134e-04 + z * (2.75573137070700676789e-06 + z * s)
    s = r + r * z * (-1.66666666666666324348e-01 + z * (8.33333333332248946124e-03 + z * s))
    c = 2.08757232129817482790e-09 - z * 1.13596475577881948265e-11
    c = 2.48015872894767294178e-05 + z * (-2.75573143513906633035e-07 + z * c)
    c = 4.16666666666666019037e-02 + z * (-1.38888888888741095749e-03 + z * c)
    c = 1.0 - 0.5 * z + z * z * c
    quarter = turns - 4.0 * math.floor(0.25 * turns)
    odd = quarter == 1.0 or quarter == 3.0
    sine = c if odd else s
    cosine = s if odd else c
    sine = -sine if quarter >= 2.0 else sine
    cosine = -cosine if (quarter == 1.0 or quarter == 2.0) else cosine
    return sine, cosine


@njit(cache=True)
def only_waves(terms):
    """Return whether a wall is a sum of waves, which `wave_hits` is made for."""
    for j in range(terms.shape[0]):
        if terms[j, 0] != WAVE:
            return False
    return terms.shape[0] > 0


@njit(cache=True, error_model="numpy")
def wave_hits(terms, box, w, state):
    """Fill distance, slopes and status of a block of rays at a sum of waves.

    Status -1 marks rays that must be searched one by one instead. ``w`` holds the data of the rays
    in rows of BLOCK numbers, OX to Y2. Fixed distances between the rows and loops without branches
    let the compiler vectorise over rays.

    Along a ray the height above the wall is f = z + t dz - sum a cos(p + t q). Its roots are within
    sum |a / dz| of the hit on the mean plane. The root found is the first one if f decreases
    throughout, since sum |a q| < |dz|, or by the criterion of `newton_hit`.
    """
    top = 0.0
    for j in range(terms.shape[0]):
        top += abs(terms[j, 1])
    for i in range(BLOCK):
        w[T + i] = w[MIDDLE + i] = -w[OZ + i] / w[DZ + i]
        w[REACH + i] = abs(top / w[DZ + i])
        w[STEEP + i] = w[SHARP + i] = w[CUBE + i] = w[ERROR + i] = 0.0
    for j in range(terms.shape[0]):
        a, kx, ky, phase = terms[j, 1], terms[j, 2], terms[j, 3], terms[j, 4]
        for i in range(BLOCK):
            q = kx * w[DX + i] + ky * w[DY + i]
            p = kx * w[OX + i] + ky * w[OY + i] + phase
            steep, error = abs(a * q), w[ERROR + i]
            w[STEEP + i] += steep
            w[SHARP + i] += steep * abs(q)
            w[CUBE + i] += steep * q * q
            far = abs(p) + abs(q * (w[MIDDLE + i] + w[REACH + i]))
            w[ERROR + i] = far if far > error else error
    for i in range(BLOCK):
        # rays for which no root can meet the criterion are not worth an attempt
        good = (w[DZ + i] < 0.0) & (w[OZ + i] > top) & (w[ERROR + i] < 1e5)
        good &= w[STEEP + i] < -2.0 * w[DZ + i]
        w[ERROR + i] = math.inf if good else -1.0
    for _ in range(STEPS):
        for i in range(BLOCK):
            w[F + i] = w[OZ + i] + w[T + i] * w[DZ + i]
            w[X0 + i] = w[Y0 + i] = w[X1 + i] = w[Y1 + i] = w[X2 + i] = w[Y2 + i] = 0.0
        for j in range(terms.shape[0]):
            a, kx, ky, phase = terms[j, 1], terms[j, 2], terms[j, 3], terms[j, 4]
            for i in range(BLOCK):
                q = kx * w[DX + i] + ky * w[DY + i]
                p = kx * w[OX + i] + ky * w[OY + i] + phase
                sine, cosine = _sin_cos(p + w[T + i] * q)
                sine, cosine = a * sine, a * cosine
                w[F + i] -= cosine
                # the slopes and their first and second derivatives along the ray
                w[X0 + i] -= kx * sine
                w[Y0 + i] -= ky * sine
                w[X1 + i] -= kx * q * cosine
                w[Y1 + i] -= ky * q * cosine
                w[X2 + i] += kx * q * q * sine
                w[Y2 + i] += ky * q * q * sine
        left = 0
        for i in range(BLOCK):
            t, f, dx, dy = w[T + i], w[F + i], w[DX + i], w[DY + i]
            slope = w[DZ + i] - w[X0 + i] * dx - w[Y0 + i] * dy
            bend = -w[X1 + i] * dx - w[Y1 + i] * dy
            middle, reach, error = w[MIDDLE + i], w[REACH + i], w[ERROR + i]
            limit = 1e-16 * (middle if middle > 1e-3 else 1e-3)
            # Halley's step, at most twice as long as Newton's
            square = slope * slope
            below = 2.0 * square - f * bend
            below = below if below > square else square
            aim = t - 2.0 * f * slope / below
            aim = middle - reach if aim < middle - reach else aim
            aim = middle + reach if aim > middle + reach else aim
            step, curved = aim - t, (aim - t) * bend / slope
            hx = w[X0 + i] + step * (w[X1 + i] + 0.5 * step * w[X2 + i])
            hy = w[Y0 + i] + step * (w[Y1 + i] + 0.5 * step * w[Y2 + i])
            # a converged ray stays unchanged while others of its block are iterated
            busy = error > limit
            w[T + i] = aim if busy else t
            w[HX + i] = hx if busy else w[HX + i]
            w[HY + i] = hy if busy else w[HY + i]
            # bound on the error after Halley's step, which converges with the cube of the step
            bound = abs(step) * (step * step * w[CUBE + i] / abs(slope) + curved * curved)
            w[ERROR + i] = bound if busy else error
            left += int(w[ERROR + i] > limit)
        if left == 0:
            break
    for i in range(BLOCK):
        t, dx, dy, dz = w[T + i], w[DX + i], w[DY + i], w[DZ + i]
        depth, slope = t - w[MIDDLE + i] + w[REACH + i], dz - w[HX + i] * dx - w[HY + i] * dy
        falling, error = w[STEEP + i] < -dz, w[ERROR + i]
        found = (error >= 0.0) & (error <= 1e-16 * max(w[MIDDLE + i], 1e-3))
        x, y = w[OX + i] + t * dx, w[OY + i] + t * dy
        within = (abs(x) <= box[0]) & (abs(y) <= box[1])
        # a ray that does not fall throughout may hit the wall after a crossing beyond its edges
        found &= falling | (within & (w[SHARP + i] * depth < -1.9 * slope))
        state[i] = (HIT if within else OUTSIDE) if found else -1


@njit(cache=True, error_model="numpy")
def _cells(row, w, cells):
    """Find the cells of a grid over which the rays of a block are, and their places in these."""
    across, up, nx = 1.0 / row[3], 1.0 / row[4], int(row[5])
    for i in range(BLOCK):
        fx = (w[OX + i] + w[T + i] * w[DX + i] - row[1]) * across
        fy = (w[OY + i] + w[T + i] * w[DY + i] - row[2]) * up
        x, y = fx if fx > 0.0 else 0.0, fy if fy > 0.0 else 0.0
        x, y = x if x < row[5] - 2.0 else row[5] - 2.0, y if y < row[6] - 2.0 else row[6] - 2.0
        column, line = np.int32(x), np.int32(y)
        w[U + i], w[V + i] = fx - column, fy - line
        cells[i] = line * nx + column


@njit(cache=True, error_model="numpy")
def grid_hits(row, tables, bound, box, slab, w, state):
    """Fill distance, slopes and status of a block of rays at a bicubic surface by `newton_hit`."""
    cells, known = np.empty(BLOCK, dtype=np.int32), np.full(BLOCK, -1, dtype=np.int32)
    step_x, step_y, nx = row[3], row[4], int(row[5])
    channel, offset = nx * int(row[6]), int(row[7])
    middle, half = 0.5 * (slab[0] + slab[1]), 0.5 * (slab[1] - slab[0])
    for i in range(BLOCK):
        inverse = 1.0 / w[DX + i]
        near, far = (-box[0] - w[OX + i]) * inverse, (box[0] - w[OX + i]) * inverse
        low, high = near if near < far else far, far if near < far else near
        low = low if low > 0.0 else 0.0
        inverse = 1.0 / w[DY + i]
        near, far = (-box[1] - w[OY + i]) * inverse, (box[1] - w[OY + i]) * inverse
        first, last = near if near < far else far, far if near < far else near
        low, high = first if first > low else low, last if last < high else high
        inverse = 1.0 / w[DZ + i]
        first, last = (middle + half - w[OZ + i]) * inverse, (middle - half - w[OZ + i]) * inverse
        low, high = first if first > low else low, last if last < high else high
        t = (middle - w[OZ + i]) * inverse
        t = t if t > low else low
        w[T + i] = t if t < high else high
        w[LOW + i], w[HIGH + i] = low, high
        w[LEFT + i] = 2.0 if (w[DZ + i] < 0.0) & (low <= high) else -1.0
    for _ in range(STEPS + 1):
        _cells(row, w, cells)
        for i in range(BLOCK):
            if cells[i] != known[i]:
                known[i], start = cells[i], offset + cells[i]
                for k in range(4):
                    node = start + k * channel
                    w[NODES + 4 * k * BLOCK + i] = tables[node]
                    w[NODES + (4 * k + 1) * BLOCK + i] = tables[node + 1]
                    w[NODES + (4 * k + 2) * BLOCK + i] = tables[node + nx]
                    w[NODES + (4 * k + 3) * BLOCK + i] = tables[node + nx + 1]
        left = 0
        for i in range(BLOCK):
            bx, bx1, _ = hermite(w[U + i], step_x)
            by, by1, _ = hermite(w[V + i], step_y)
            h = hx = hy = 0.0
            for dy in range(2):
                for j in range(2):
                    node = NODES + (8 * dy + 2 * j) * BLOCK + i
                    v0, v1 = w[node], w[node + BLOCK]
                    s0, s1 = w[node + 4 * BLOCK], w[node + 5 * BLOCK]
                    c = v0 * bx[0] + v1 * bx[1] + s0 * bx[2] + s1 * bx[3]
                    c1 = v0 * bx1[0] + v1 * bx1[1] + s0 * bx1[2] + s1 * bx1[3]
                    b = j + 2 * dy
                    h += c * by[b]
                    hx += c1 * by[b]
                    hy += c * by1[b]
            t, low, high, todo = w[T + i], w[LOW + i], w[HIGH + i], w[LEFT + i]
            f = w[OZ + i] + t * w[DZ + i] - h
            slope = w[DZ + i] - hx * w[DX + i] - hy * w[DY + i]
            # a converged ray stays where it is, and has its slopes from there
            last, busy = todo == 1.0, todo == 2.0
            w[HX + i] = hx if last else w[HX + i]
            w[HY + i] = hy if last else w[HY + i]
            w[SLOPE + i] = slope if last else w[SLOPE + i]
            aim = t - f / slope
            aim = aim if aim > low else low
            aim = aim if aim < high else high
            step = aim - t
            scale = abs(w[OX + i]) + abs(w[OY + i]) + abs(w[OZ + i]) + aim
            close = bound * step * step <= -ROUNDING * scale * slope
            w[T + i] = aim if busy else t
            todo = (1.0 if close else 2.0) if busy else (0.0 if last else todo)
            w[LEFT + i] = todo
            left += int(todo > 0.0)
        if left == 0:
            break
    for i in range(BLOCK):
        t, dx, dy = w[T + i], w[DX + i], w[DY + i]
        margin = TOLERANCE * (abs(w[OX + i]) + abs(w[OY + i]) + abs(w[OZ + i]))
        first = (w[LOW + i] < t) & (t + margin < w[HIGH + i]) & (w[LEFT + i] == 0.0)
        across = dx * dx + dy * dy
        first &= bound * across * (t - w[LOW + i]) < -1.9 * w[SLOPE + i]
        state[i] = HIT if first else -1


@njit(cache=True)
def block_hits(terms, tables, grid_bounds, box, slab, w, state):
    """Fill distance, slopes and status of a block of rays by the method for this kind of wall."""
    state[:] = -1
    if only_waves(terms):
        wave_hits(terms, box, w, state)
    if tables is not None and terms.shape[0] == 1 and terms[0, 0] == GRID:
        grid_hits(terms[0], tables, grid_bounds[0], box, slab, w, state)


@threaded(error_model="numpy")
def intersect(
    terms,
    tables,
    grid_bounds,
    box,
    slab,
    rim,
    origins,
    directions,
    distance,
    points,
    normals,
    status,
):
    """Fill distance (n,), points and normals (n, 3) and status (n,) with the first hits."""
    count = distance.size
    bad = 0
    for block in prange((count + BLOCK - 1) // BLOCK):
        start = block * BLOCK
        n = min(BLOCK, count - start)
        w, state = np.zeros(ROWS * BLOCK), np.full(BLOCK, -1)
        for i in range(n):
            j = start + i
            x, y, z = origins[j, 0], origins[j, 1], origins[j, 2]
            dx, dy, dz = _unit((directions[j, 0], directions[j, 1], directions[j, 2]))
            bad += 0 if math.isfinite(x + y + z + dx + dy + dz) else 1
            w[OX + i], w[OY + i], w[OZ + i] = x, y, z
            w[DX + i], w[DY + i], w[DZ + i] = dx, dy, dz
        if grid_bounds is not None:
            block_hits(terms, tables, grid_bounds, box, slab, w, state)
        for i in range(n):
            o, d = (w[OX + i], w[OY + i], w[OZ + i]), (w[DX + i], w[DY + i], w[DZ + i])
            t, condition, hx, hy = w[T + i], state[i], w[HX + i], w[HY + i]
            if condition < 0:
                t, condition, hx, hy = wall_hit(terms, tables, grid_bounds, box, slab, rim, o, d)
            norm = 1.0 / math.sqrt(1.0 + hx * hx + hy * hy)
            if condition != HIT:
                t = norm = math.nan
            j = start + i
            distance[j], status[j] = t, condition
            for k in range(3):
                points[j, k] = o[k] + t * d[k]
            normals[j, 0], normals[j, 1], normals[j, 2] = -hx * norm, -hy * norm, norm
    return bad
