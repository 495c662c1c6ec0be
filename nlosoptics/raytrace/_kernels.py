"""Where rays meet curved relay walls, compiled.

Every ray is o + t d with unit d and t in m. ``box`` holds the half sizes in x and y that bound a
search, inf where there is no bound.
"""

from __future__ import annotations

import math

from numba import njit, prange

from ..scene._kernels import CYLINDER, GRID, SPHERE, WAVE, surface

HIT, MISS, OUTSIDE, UNRESOLVED, BEHIND = 0, 1, 2, 3, 4
MAX_STEPS = 500
TOLERANCE = 1e-13  # of the height above the wall, relative to the ray's scale


@njit(cache=True)
def _conic(row, box, o, d):
    """Distance and status of one ray at a single sphere or cylinder.

    The surface is g = c |p|^2 - 2 z = 0 in the coordinates that are curved, with g < 0 on the room
    side, so the wanted root is the one at which g rises. In this form c -> 0 loses no digits.
    """
    curvature = row[1]
    oo, od, dd = o[2] * o[2], o[2] * d[2], d[2] * d[2]
    if row[0] == SPHERE:
        oo += o[0] * o[0] + o[1] * o[1]
        od += o[0] * d[0] + o[1] * d[1]
        dd = 1.0
    else:
        o_s, d_s = row[2] * o[0] + row[3] * o[1], row[2] * d[0] + row[3] * d[1]
        oo += o_s * o_s
        od += o_s * d_s
        dd += d_s * d_s
    a, b, c = curvature * dd, curvature * od - d[2], curvature * oo - 2.0 * o[2]
    within = abs(o[0]) <= box[0] and abs(o[1]) <= box[1]
    slack = TOLERANCE * (1.0 + abs(curvature) * oo + abs(o[2]))
    missed = OUTSIDE if d[2] < 0.0 else MISS
    discriminant = b * b - a * c
    if not discriminant > 0.0 or a == 0.0:
        return math.nan, missed
    root = math.sqrt(discriminant)
    if b > 0.0:
        t, entry = -c / (b + root), -(b + root) / a
    else:
        t, entry = (root - b) / a, c / (root - b)
    if c > slack:  # not on the room side of the surface, or above a hollow's opening
        if curvature < 0.0:
            return math.nan, BEHIND
        if t < 0.0:
            return math.nan, BEHIND if within and curvature * o[2] < 1.0 else missed
        through_back = curvature * (o[2] + entry * d[2]) < 1.0
        x, y = o[0] + entry * d[0], o[1] + entry * d[1]
        if through_back and abs(x) <= box[0] and abs(y) <= box[1]:
            return math.nan, BEHIND
    if t < -slack or curvature * (o[2] + t * d[2]) >= 1.0:
        return math.nan, missed
    x, y = o[0] + t * d[0], o[1] + t * d[1]
    if abs(x) > box[0] or abs(y) > box[1]:
        return math.nan, missed
    return max(t, 0.0), HIT


@njit(cache=True)
def _span(half, o, d, low, high):
    """Part of [low, high] in which |o + t d| <= half."""
    if d == 0.0:
        return (low, high) if abs(o) <= half else (1.0, 0.0)
    first, last = (-half - o) / d, (half - o) / d
    return max(low, min(first, last)), min(high, max(first, last))


@njit(cache=True)
def _search_interval(box, slab, rim, o, d):
    """Interval of t in which the ray is over the wall and between its height limits."""
    low, high = 0.0, math.inf
    for i in range(2):
        if box[i] < math.inf:
            low, high = _span(box[i], o[i], d[i], low, high)
    if rim < math.inf:
        across = d[0] * d[0] + d[1] * d[1]
        b, c = o[0] * d[0] + o[1] * d[1], o[0] * o[0] + o[1] * o[1] - rim * rim
        if across > 0.0:
            discriminant = b * b - across * c
            if discriminant <= 0.0:
                return 1.0, 0.0
            root = math.sqrt(discriminant)
            low, high = max(low, (-b - root) / across), min(high, (-b + root) / across)
        elif c > 0.0:
            return 1.0, 0.0
    middle = 0.5 * (slab[0] + slab[1])
    return _span(0.5 * (slab[1] - slab[0]), o[2] - middle, d[2], low, high)


@njit(cache=True)
def _curvature_bound(terms, grid_bounds, o, d, low, high):
    """Bound on |d2 h/dt2| along the ray between t = low and high."""
    across = d[0] * d[0] + d[1] * d[1]
    bound = 0.0
    for i in range(terms.shape[0]):
        row = terms[i]
        if row[0] == WAVE:
            k = row[2] * d[0] + row[3] * d[1]
            bound += abs(row[1]) * k * k
        elif row[0] == GRID:
            bound += grid_bounds[i] * across
        elif row[0] == SPHERE or row[0] == CYLINDER:
            far = 0.0
            for t in (low, high):
                x, y = o[0] + t * d[0], o[1] + t * d[1]
                s = row[2] * x + row[3] * y
                far = max(far, x * x + y * y if row[0] == SPHERE else s * s)
            s = row[2] * d[0] + row[3] * d[1]
            root = math.sqrt(max(1.0 - row[1] * row[1] * far, 1e-6))
            bound += abs(row[1]) / root**3 * (across if row[0] == SPHERE else s * s)
    return bound


@njit(cache=True)
def _march(terms, tables, grid_bounds, box, slab, rim, o, d):
    """Distance and status of the first crossing with any wall, never overshot.

    With M a bound on |f''|, f has no root nearer than that of f + f' s - M s^2/2: the step is safe
    as a bracket and, as f -> 0, quadratic as Newton's.
    """
    missed = OUTSIDE if d[2] < 0.0 else MISS
    low, high = _search_interval(box, slab, rim, o, d)
    if not low <= high:
        over = abs(o[0]) <= box[0] and abs(o[1]) <= box[1]
        return math.nan, BEHIND if over and o[2] < slab[0] else missed
    bound = _curvature_bound(terms, grid_bounds, o, d, low, high)
    scale = TOLERANCE * max(math.sqrt(o[0] * o[0] + o[1] * o[1] + o[2] * o[2]), 1e-3)
    t = low
    for step in range(MAX_STEPS):
        h, hx, hy, _, _, _ = surface(terms, tables, o[0] + t * d[0], o[1] + t * d[1])
        f, slope = o[2] + t * d[2] - h, d[2] - hx * d[0] - hy * d[1]
        if not math.isfinite(f):
            return math.nan, UNRESOLVED
        if step == 0 and f < -scale:
            return math.nan, BEHIND if low == 0.0 or o[2] < slab[0] else missed
        if f <= scale:
            if slope < 0.0:
                return max(t - f / slope, 0.0), HIT
            if t > 0.0:
                return math.nan, UNRESOLVED  # touches, without going through
            f = 0.0
        if t >= high:
            return math.nan, missed
        root = math.sqrt(slope * slope + 2.0 * bound * f)
        if slope < 0.0:
            advance = 2.0 * f / (root - slope)
        elif bound > 0.0:
            advance = (slope + root) / bound
        else:
            return math.nan, missed
        if not t + advance > t:
            return math.nan, UNRESOLVED
        t = min(t + advance, high)
    return math.nan, UNRESOLVED


@njit(cache=True, parallel=True)
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
    """Fill distance (n,), points and normals (n, 3) and status (n,) for unit directions."""
    closed = terms.shape[0] == 1 and (terms[0, 0] == SPHERE or terms[0, 0] == CYLINDER)
    for i in prange(distance.size):
        o, d = origins[i], directions[i]
        if closed:
            t, state = _conic(terms[0], box, o, d)
        else:
            t, state = _march(terms, tables, grid_bounds, box, slab, rim, o, d)
        if state == HIT:
            x, y = o[0] + t * d[0], o[1] + t * d[1]
            _, hx, hy, _, _, _ = surface(terms, tables, x, y)
            if math.isfinite(hx):
                norm = math.sqrt(1.0 + hx * hx + hy * hy)
                distance[i] = t
                points[i, 0], points[i, 1], points[i, 2] = x, y, o[2] + t * d[2]
                normals[i, 0], normals[i, 1], normals[i, 2] = -hx / norm, -hy / norm, 1.0 / norm
            else:
                state = UNRESOLVED
        status[i] = state
