"""Compiled intersection of rays with curved relay walls.

Every ray is o + t d with unit d and t in m. The limits ``box``, ``slab`` and ``rim`` and the
curvature bounds ``grid_bounds`` are those of `intersections.search_bounds`, in m and 1/m.
"""

from __future__ import annotations

import math

from numba import prange

from ...kernels.codes import BUMPS, CYLINDER, EXTREME, FACETS, GRID, SPHERE, WAVE
from ...kernels.compiling import njit
from ...kernels.heights import partial_surface, tangent
from ...kernels.parallel import threaded
from ...kernels.relief import facet_edge

HIT, MISS, OUTSIDE, UNRESOLVED, BEHIND = 0, 1, 2, 3, 4
MAX_STEPS = 500
MAX_FACETS = 100_000  # facets that a grazing ray passes
BIG, HUGE = 2.0**400, 2.0**600
TOLERANCE = 1e-13  # height above the wall that counts as 0, relative to the ray's scale
ROUNDING = 1e-16  # error of a distance that counts as none, relative to the ray's coordinates


@njit(cache=True)
def conic_hit(row, box, o, d):
    """Return distance, m, and status of one ray at a wall that is a single sphere or cylinder.

    ``row`` is the wall's row of ``terms``, see `kernels.heights`. With curvature c, the surface is
    g = c |p|^2 - 2 z = 0, where p holds the curved coordinates and z. On the room side g < 0, so
    that the hit is the root at which g increases. This form does not lose accuracy for c -> 0.
    """
    curvature = row[1]
    oo, od, dd = o[2] * o[2], o[2] * d[2], d[2] * d[2]
    o_s, d_s = row[2] * o[0] + row[3] * o[1], row[2] * d[0] + row[3] * d[1]
    if row[0] == SPHERE:
        oo += o[0] * o[0] + o[1] * o[1]
        od += o[0] * d[0] + o[1] * d[1]
        dd = 1.0
    else:
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
    if c > slack:  # the start is behind the surface, or beyond the opening of a concave wall
        if curvature < 0.0:
            return math.nan, BEHIND
        if t < 0.0:
            return math.nan, BEHIND if within and curvature * o[2] < 1.0 else missed
        through_back = curvature * (o[2] + entry * d[2]) < 1.0
        x, y = o[0] + entry * d[0], o[1] + entry * d[1]
        if through_back and abs(x) <= box[0] and abs(y) <= box[1]:
            return math.nan, BEHIND
    if curvature * curvature * oo > 64.0:
        # at a distance of many radii the squares above cancel; a Newton step restores the accuracy
        z, across, along = o[2] + t * d[2], 0.0, 0.0
        if row[0] == SPHERE:
            x, y = o[0] + t * d[0], o[1] + t * d[1]
            across, along = x * x + y * y, x * d[0] + y * d[1]
        else:
            s = o_s + t * d_s
            across, along = s * s, s * d_s
        g = curvature * (across + z * z) - 2.0 * z
        t -= 0.5 * g / (curvature * (along + z * d[2]) - d[2])
    if t < -slack or curvature * (o[2] + t * d[2]) >= 1.0:
        return math.nan, missed
    x, y = o[0] + t * d[0], o[1] + t * d[1]
    if abs(x) > box[0] or abs(y) > box[1]:
        return math.nan, missed
    return max(t, 0.0), HIT


@njit(cache=True)
def _span(half, o, d, low, high):
    """Return the part of the interval [low, high] of t in which |o + t d| <= half."""
    if d == 0.0:
        return (low, high) if abs(o) <= half else (1.0, 0.0)
    first, last = (-half - o) / d, (half - o) / d
    return max(low, min(first, last)), min(high, max(first, last))


@njit(cache=True)
def _search_interval(box, slab, rim, o, d):
    """Return the interval of t, m, in which the ray is over the wall, within its heights."""
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
    """Return an upper bound, 1/m, on |d2h/dt2| of the wall's height h between t = low and high."""
    across = d[0] * d[0] + d[1] * d[1]
    bound = 0.0
    for i in range(terms.shape[0]):
        row = terms[i]
        if row[0] == WAVE:
            k = row[2] * d[0] + row[3] * d[1]
            bound += abs(row[1]) * k * k
        elif row[0] == GRID or row[0] == BUMPS:
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
def search(terms, grid_bounds, box, slab, rim, o, d):
    """Return the interval of t of a march, the bound on |d2h/dt2|, the tolerance and a status.

    The status is that of a ray without a hit. The interval is empty, low > high, for a ray that
    never is over the wall.
    """
    missed = OUTSIDE if d[2] < 0.0 else MISS
    low, high = _search_interval(box, slab, rim, o, d)
    if not low <= high:
        over = abs(o[0]) <= box[0] and abs(o[1]) <= box[1]
        return 1.0, 0.0, 0.0, 0.0, BEHIND if over and o[2] < slab[0] else missed
    bound = _curvature_bound(terms, grid_bounds, o, d, low, high)
    scale = TOLERANCE * max(math.sqrt(o[0] * o[0] + o[1] * o[1] + o[2] * o[2]), 1e-3)
    return low, high, bound, scale, missed


@njit(cache=True)
def _safe_step(f, slope, bound):
    """Return the step to the positive root s of f + slope s - bound s^2/2; inf without one."""
    root = math.sqrt(slope * slope + 2.0 * bound * f)
    if slope < 0.0:
        return 2.0 * f / (root - slope)
    return (slope + root) / bound if bound > 0.0 else math.inf


@njit(cache=True, error_model="numpy")
def newton_hit(terms, tables, slab, o, d, low, high, bound, scale):
    """Return distance and slopes of a root by Newton's method; NaN unless it is the first crossing.

    The last four arguments are those that `search` returns.

    Let f be the height of the ray above a smooth wall, M a bound on |f''|, and s < 0 the slope f'
    at the root. At a distance u before the root, f >= |s| u - M u^2/2. The root is therefore the
    first one if it is nearer than 2 |s| / M to the point where the ray enters the wall's height
    limits.
    """
    if not d[2] < 0.0:
        return math.nan, 0.0, 0.0
    start = abs(o[0]) + abs(o[1]) + abs(o[2])
    t = min(max((0.5 * (slab[0] + slab[1]) - o[2]) / d[2], low), high)
    for _ in range(8):
        h, hx, hy = tangent(terms, tables, o[0] + t * d[0], o[1] + t * d[1])
        f, slope = o[2] + t * d[2] - h, d[2] - hx * d[0] - hy * d[1]
        if not slope < 0.0:
            break
        aim = min(max(t - f / slope, low), high)
        if bound * (aim - low) > -8.0 * slope:
            break  # most likely the root will not prove to be the first
        step, t = aim - t, aim
        if bound * step * step <= ROUNDING * (start + t) * -slope:
            h, hx, hy = tangent(terms, tables, o[0] + t * d[0], o[1] + t * d[1])
            slope = d[2] - hx * d[0] - hy * d[1]
            # 1.9 instead of 2 allows for rounding; at the edges of the wall the march decides
            first = low < t and t + scale < high and bound * (t - low) < -1.9 * slope
            return t if first else math.nan, hx, hy
    return math.nan, 0.0, 0.0


@njit(cache=True)
def marched_hit(terms, tables, slab, o, d, low, high, bound, scale, missed):
    """Return distance and status of the first crossing with a smooth wall, by a safe march.

    The last five arguments are those that `search` returns.

    f is the height of the ray above the wall and M a bound on |f''|. The step to the root s of
    f + f' s - M s^2/2 cannot pass a root of f, and for f -> 0 it converges quadratically like
    Newton's method.
    """
    t = low
    for step in range(MAX_STEPS):
        h, hx, hy = tangent(terms, tables, o[0] + t * d[0], o[1] + t * d[1])
        f, slope = o[2] + t * d[2] - h, d[2] - hx * d[0] - hy * d[1]
        if not math.isfinite(f):
            return math.nan, UNRESOLVED
        if step == 0 and f < -scale:
            return math.nan, BEHIND if low == 0.0 or o[2] < slab[0] else missed
        if f <= scale:
            if slope < 0.0:
                return max(t - f / slope, 0.0), HIT
            if t > 0.0:
                return math.nan, UNRESOLVED  # the ray touches the wall without crossing it
            f = 0.0
        advance = _safe_step(f, slope, bound)
        if t >= high or advance == math.inf:
            return math.nan, missed
        if not t + advance > t:
            return math.nan, UNRESOLVED
        t = min(t + advance, high)
    return math.nan, UNRESOLVED


@njit(cache=True)
def _facet_end(terms, x, y, dx, dy, slack):
    """Return how far a ray at (x, y) can advance within all its facets, m."""
    end = math.inf
    for i in range(terms.shape[0]):
        if terms[i, 0] == FACETS:
            end = min(end, facet_edge(terms[i], x, y, dx, dy, slack))
    return end


@njit(cache=True)
def faceted_hit(terms, tables, top, slab, o, d, low, high, bound, scale, missed):
    """Return distance and status of the first crossing with a wall that has facets.

    The last five arguments are those that `search` returns.

    M of `marched_hit` does not hold across the edges of facets, so that steps end there. Above all
    facets, by more than their largest height ``top``, only the smooth terms count.
    """
    t, turns = low, 0
    for step in range(MAX_FACETS):
        x, y = o[0] + t * d[0], o[1] + t * d[1]
        h, hx, hy, _, _, _ = partial_surface(terms, tables, x, y, True, False)
        f, slope = o[2] + t * d[2] - h, d[2] - hx * d[0] - hy * d[1]
        # roundings of a point on the ray; an edge passed by less could be met again
        slack = 4e-16 * (abs(o[0]) + abs(o[1]) + t)
        end = max(_facet_end(terms, x, y, d[0], d[1], slack), 4e-16 * t)
        leap = _safe_step(f - top, slope, bound) if f > top else 0.0
        if leap < end or leap == 0.0:
            h, hx, hy, _, _, _ = partial_surface(terms, tables, x, y, False, True)
            f, slope = f - h, slope - hx * d[0] - hy * d[1]
            if not math.isfinite(f):
                return math.nan, UNRESOLVED
            if step == 0 and f < -scale:
                return math.nan, BEHIND if low == 0.0 or o[2] < slab[0] else missed
            if f <= scale:
                if slope < 0.0:
                    return max(t - f / slope, 0.0), HIT
                if f < -scale:
                    return math.nan, UNRESOLVED
                f = 0.0  # it starts here, or touches an edge
            leap = _safe_step(f, slope, bound)
            turns += 1 if leap <= end else 0
            leap = min(leap, end)
        if t >= high or leap == math.inf:
            return math.nan, missed
        if turns == MAX_STEPS or not t + leap > t:
            return math.nan, UNRESOLVED
        t = min(t + leap, high)
    return math.nan, UNRESOLVED


@njit(cache=True, forceinline=True, error_model="numpy")
def _unit(d):
    """Return the unit vector along d, of any finite length; NaN for a zero vector."""
    largest = max(abs(d[0]), abs(d[1]), abs(d[2]))
    # powers of two scale without rounding, so that the squares neither overflow nor underflow
    scale = HUGE if largest < 1.0 / BIG else 1.0
    scale = 1.0 / HUGE if largest > BIG else scale
    x, y, z = scale * d[0], scale * d[1], scale * d[2]
    norm = math.sqrt(x * x + y * y + z * z)
    return x / norm, y / norm, z / norm


@njit(cache=True)
def wall_hit(terms, tables, grid_bounds, box, slab, rim, o, d):
    """Return distance (m), status and the wall's slopes dh/dx, dh/dy at the first hit of a ray.

    ``grid_bounds`` is None for a single sphere or cylinder, and ``tables`` without grids and
    reliefs. Then numba does not compile the march, or the search of facets, which takes seconds.
    """
    if grid_bounds is None:
        t, condition = conic_hit(terms[0], box, o, d)
    else:
        low, high, bound, scale, missed = search(terms, grid_bounds, box, slab, rim, o, d)
        if low > high:
            return math.nan, missed, 0.0, 0.0
        top = 0.0
        if tables is not None:
            for i in range(terms.shape[0]):
                if terms[i, 0] == FACETS:
                    top += EXTREME * terms[i, 2]
            if top > 0.0:
                t, condition = faceted_hit(
                    terms, tables, top, slab, o, d, low, high, bound, scale, missed
                )
        if top == 0.0:
            t, hx, hy = newton_hit(terms, tables, slab, o, d, low, high, bound, scale)
            if t >= 0.0:
                return t, HIT, hx, hy
            t, condition = marched_hit(terms, tables, slab, o, d, low, high, bound, scale, missed)
    hx = hy = 0.0
    if condition == HIT:
        _, hx, hy = tangent(terms, tables, o[0] + t * d[0], o[1] + t * d[1])
        if not math.isfinite(hx):
            condition = UNRESOLVED
    return t, condition, hx, hy


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
    """Fill distance (n,), points and normals (n, 3) and status (n,) with the first hits.

    Directions may have any length. Returns the number of invalid rays: those with NaN, infinity or
    a zero direction. ``tables`` and ``grid_bounds`` may be None as in `wall_hit`.
    """
    bad = 0
    for i in prange(distance.size):
        o = (origins[i, 0], origins[i, 1], origins[i, 2])
        d = _unit((directions[i, 0], directions[i, 1], directions[i, 2]))
        bad += 0 if math.isfinite(o[0] + o[1] + o[2] + d[0] + d[1] + d[2]) else 1
        t, condition, hx, hy = wall_hit(terms, tables, grid_bounds, box, slab, rim, o, d)
        norm = 1.0 / math.sqrt(1.0 + hx * hx + hy * hy)
        if condition != HIT:
            t = norm = math.nan
        distance[i], status[i] = t, condition
        for k in range(3):
            points[i, k] = o[k] + t * d[k]
        normals[i, 0], normals[i, 1], normals[i, 2] = -hx * norm, -hy * norm, norm
    return bad
