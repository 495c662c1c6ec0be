"""Compiled quadrature of three bounces: intensity over path between two wall points.

The path r1 + r2 and the integrand F are nearly linear over a small triangle. The contribution of
the triangle up to a path t then has a closed form. For t below the path of the corner with the
middle value, it is the integral over the triangle that the line of equal path t cuts off: its area
a b A, where a and b are the fractions of the two sides cut off, times the mean of F at its corners.
"""

from __future__ import annotations

import math

import numpy as np
from numba import prange

from ...kernels.brdf import lobe, retroreflected
from ...kernels.codes import LAMBERT, RETROREFLECTOR
from ...kernels.compiling import njit
from ...kernels.parallel import threaded
from ._visibility_kernels import (
    CORNERS,
    OVERFLOW,
    PIECES,
    copy_row,
    frame,
    outline,
    outline_room,
    see,
    shadow_room,
)

# columns of the report on a pair
TOTAL, ERROR, LEAVES, PASSES, STATUS = range(5)
REPORT = 5
DONE, TOO_MANY, TOO_FINE = 0, 1, 2
ALL, PART, NOTHING = range(3)  # visibility of a triangle from a point
DEEPEST = 60  # largest number of successive bisections of a triangle
STEP = 8.0  # factor by which the error limit falls from pass to pass
# columns of a triangle on the stack, after nine for its corners
TAU, F, AREA, DEPTH = 9, 12, 15, 16
COLUMNS = 17


@njit(cache=True, error_model="numpy")
def _returned(angle, shift_sq, turn, sine_sq):
    """Return the density of a retroreflecting lobe blurred by a shift along the wall, 1/sr.

    The Gaussians of ``angle`` and shift are convolved. ``shift_sq`` is the squared angle of the
    shift seen from the surface, which an incidence of squared sine ``sine_sq`` on the wall makes
    narrower along one axis. ``turn`` is the difference of the unit vectors to laser and sensor.
    """
    across = angle * angle + shift_sq
    along = across - shift_sq * sine_sq
    square = turn[0] * turn[0] + turn[1] * turn[1] + turn[2] * turn[2]
    square = square / across + turn[2] * turn[2] * shift_sq / (across * along)
    peak = retroreflected(1.0, angle) * angle * angle / math.sqrt(across * along)
    return peak * math.exp(-0.5 * square)


@njit(cache=True, error_model="numpy")
def _node(x, y, z, pair, lobes):
    """Return path r1 + r2, integrand in 1/m^4, r1, r2 and the half vector's cosine at a point.

    ``pair`` holds x and y of laser and sensor point, and their heights above the triangle, m.
    """
    ax, ay, bx, by, h1, h2 = pair
    dx, dy, ex, ey = ax - x, ay - y, bx - x, by - y
    s1, s2 = dx * dx + dy * dy + z * z, ex * ex + ey * ey + z * z
    r1, r2 = math.sqrt(s1), math.sqrt(s2)
    both = s1 * s2
    f, half = 0.0, 1.0
    if len(lobes) == 1 and lobes[0, 0] == LAMBERT:
        f = lobes[0, 1] * lobes[0, 3] / math.pi
    else:
        mu1, mu2 = h1 / r1, h2 / r2
        between = (dx * ex + dy * ey + z * z) / (r1 * r2)
        for j in range(len(lobes)):
            if lobes[j, 0] == RETROREFLECTOR and lobes[j, 5] > 0.0:
                turn = (dx / r1 - ex / r2, dy / r1 - ey / r2, z / r1 - z / r2)
                sine_sq = 1.0 - (z / r1 + z / r2) ** 2 / (2.0 + 2.0 * between)
                p = _returned(lobes[j, 2], lobes[j, 5] ** 2 / (r1 * r2), turn, sine_sq)
                f += 2.0 * lobes[j, 1] * lobes[j, 3] * p / (mu1 + mu2)
            else:
                f += lobe(lobes, j, mu1, mu2, between)
        half = (mu1 + mu2) / math.sqrt(2.0 + 2.0 * between)
    return r1 + r2, z * z * (h1 * h2) * f / (both * both) / math.pi, r1, r2, half


@njit(cache=True, error_model="numpy")
def spread(t0, t1, t2, f0, f1, f2, area, start, delta, bins):
    """Add a triangle's contribution to the bins; the first and last bin collect paths outside."""
    if t1 < t0:
        t0, t1, f0, f1 = t1, t0, f1, f0
    if t2 < t1:
        t1, t2, f1, f2 = t2, t1, f2, f1
    if t1 < t0:
        t0, t1, f0, f1 = t1, t0, f1, f0
    last = bins.size - 1
    i, j = _bin(t0, start, delta, last), _bin(t2, start, delta, last)
    whole = area * (f0 + f1 + f2) / 3.0
    if i == j:
        bins[i] += whole
        return
    # fraction of each side per path, from the corner of least path and from that of greatest
    per = 1.0 / (t2 - t0)
    low, high = 1.0 / (t1 - t0), 1.0 / (t2 - t1)
    rise = (low * (f1 - f0) + per * (f2 - f0)) / 3.0
    fall = (high * (f1 - f2) + per * (f0 - f2)) / 3.0
    low, high = area * low * per, area * high * per
    before = 0.0
    for k in range(i, j):
        t = start + k * delta
        # a bin edge can equal a corner's path up to rounding, where ``low`` or ``high`` is infinite
        if t <= t0:
            now = 0.0
        elif t >= t2:
            now = whole
        elif t < t1:
            t -= t0
            now = low * t * t * (f0 + t * rise)
        else:
            t = t2 - t
            now = whole - high * t * t * (f2 + t * fall)
        bins[k] += now - before
        before = now
    bins[j] += whole - before


@njit(cache=True, error_model="numpy")
def _bin(t, start, delta, last):
    """Return the bin of a path; bins 0 and ``last`` collect paths outside the window."""
    where = (t - start) / delta
    if where < 0.0:
        return 0
    if where >= last - 1:
        return last
    return 1 + int(where)


@njit(cache=True, error_model="numpy")
def _may_hide(light, tilt, turn, sharp, limit):
    """Whether a part may contribute more than ``limit`` where a narrow lobe peaks.

    ``light`` is the contribution estimated from the centroid, where the half vector has the angle
    ``tilt`` to the normal. ``turn`` bounds the change of this angle over the part. Lobes fall no
    faster than ``exp(-tan^2/sharp^2)``, with ``sharp`` the lobe's alpha.
    """
    least = max(tilt - turn, 0.0)
    if limit == math.inf:
        return least < 5.0 * sharp
    if light == 0.0:
        return least < 26.0 * sharp  # beyond, exp(-26^2) is below double precision
    here, there = math.tan(min(tilt, 1.5)) / sharp, math.tan(min(least, 1.5)) / sharp
    return light * math.exp(min((here - there) * (here + there), 700.0)) > limit


@njit(cache=True, error_model="numpy")
def _square(s, i, j):
    x, y, z = s[i] - s[j], s[i + 1] - s[j + 1], s[i + 2] - s[j + 2]
    return x * x + y * y + z * z


@njit(cache=True, error_model="numpy")
def _piece(piece, pair, own, limit, time, bins, stack):
    """Add one triangle to the bins, bisected until parts err by at most ``limit``; count the parts.

    The error of a part is estimated from the difference between its centroid and the mean of its
    corners: of F, and of the path if that can move light to another bin. Both differences then
    correct the part, so that its remaining error is of the next order. ``sharp`` is the alpha of
    the narrowest lobe. An infinite limit only makes parts small compared with their distance and
    with that lobe.
    """
    (lobes, sharp), (start, delta) = own, time
    last = bins.size - 1
    leaves, top = 0, 1
    first = stack[0]
    for k in range(9):
        first[k] = piece[k]
    for k in range(3):
        x, y, z = first[3 * k], first[3 * k + 1], first[3 * k + 2]
        first[TAU + k], first[F + k], _, _, _ = _node(x, y, z, pair, lobes)
    first[AREA], first[DEPTH] = piece[9], 0.0
    nearest = min(piece[10], piece[11])
    while top > 0:
        top -= 1
        s = stack[top]
        x, y, z = (s[0] + s[3] + s[6]) / 3.0, (s[1] + s[4] + s[7]) / 3.0, (s[2] + s[5] + s[8]) / 3.0
        t, f, r1, r2, half = _node(x, y, z, pair, lobes)
        sides = (_square(s, 0, 3), _square(s, 3, 6), _square(s, 6, 0))
        longest = max(sides[0], sides[1], sides[2])
        shift = 0.75 * (t - (s[TAU] + s[TAU + 1] + s[TAU + 2]) / 3.0)
        lift = 0.75 * (f - (s[F] + s[F + 1] + s[F + 2]) / 3.0)
        area, depth = s[AREA], s[DEPTH]
        split = False
        if depth < DEEPEST:
            size = math.sqrt(longest)
            # no corner is farther from the centroid than two thirds of the longest side
            away = 0.67 * size
            if size > max(nearest, min(r1, r2) - away):
                split = True
            elif sharp < 1.0:
                turn = away * (1.0 / r1 + 1.0 / r2)
                tilt = math.acos(min(1.0, half))
                if 4.0 * turn > sharp:
                    split = _may_hide(f * area, tilt, turn, sharp, limit)
            if not split and limit < math.inf:
                wrong = area * abs(lift)
                low = min(s[TAU], s[TAU + 1], s[TAU + 2]) + min(shift, 0.0)
                high = max(s[TAU], s[TAU + 1], s[TAU + 2]) + max(shift, 0.0)
                if _bin(low, start, delta, last) != _bin(high, start, delta, last):
                    wrong += area * f * min(1.0, abs(shift) / delta)
                split = wrong > limit
        if not split:
            leaves += 1
            times = s[TAU] + shift, s[TAU + 1] + shift, s[TAU + 2] + shift
            values = s[F] + lift, s[F + 1] + lift, s[F + 2] + lift
            spread(*times, *values, area, start, delta, bins)
            continue
        i = 0 if sides[0] == longest else (1 if sides[1] == longest else 2)
        j = (i + 1) % 3
        x, y, z = (
            0.5 * (s[3 * i] + s[3 * j]),
            0.5 * (s[3 * i + 1] + s[3 * j + 1]),
            0.5 * (s[3 * i + 2] + s[3 * j + 2]),
        )
        t, f, _, _, _ = _node(x, y, z, pair, lobes)
        other = stack[top + 1]
        for k in range(COLUMNS):
            other[k] = s[k]
        s[AREA] = other[AREA] = 0.5 * area
        s[DEPTH] = other[DEPTH] = depth + 1.0
        s[3 * j], s[3 * j + 1], s[3 * j + 2], s[TAU + j], s[F + j] = x, y, z, t, f
        other[3 * i], other[3 * i + 1], other[3 * i + 2] = x, y, z
        other[TAU + i], other[F + i] = t, f
        top += 2
    return leaves


@njit(cache=True, error_model="numpy")
def _seen(mesh, clear, p, q, outlined, known, known_is_q, room, pieces):
    """Cut the triangles to the pieces that p and q both see on one side; return them and count.

    ``outlined`` holds the outlines seen from p and from q. ``known`` is the kept visibility from
    one of the points, q if ``known_is_q``: ALL, NOTHING or PART for each triangle, the range of its
    polygons, and the polygons. Rows of ``pieces`` are three corners, area, heights of both points
    above the triangle, and index of the triangle. The count is OVERFLOW if there are too many.
    """
    polygons, sizes, shadows = room
    how, ends, kept, kept_sizes = known
    rows, reach = mesh[0], mesh[2]
    count = 0
    for t in range(rows.shape[0]):
        row = rows[t]
        n = frame(row)[0]
        size = math.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
        h1 = (n[0] * (p[0] - row[0]) + n[1] * (p[1] - row[1]) - n[2] * row[2]) / size
        h2 = (n[0] * (q[0] - row[0]) + n[1] * (q[1] - row[1]) - n[2] * row[2]) / size
        tiny = 1e-12 * reach
        if not (h1 > tiny and h2 > tiny) and not (h1 < -tiny and h2 < -tiny):
            continue
        if how[t] == NOTHING:
            continue
        _whole(polygons, sizes)
        left = 1
        if not clear[t, 0 if h1 > 0.0 else 1]:
            begin, end = ends[t], ends[t + 1]
            if end > begin and not known_is_q:
                left = end - begin
                for m in range(left):
                    polygons[m], sizes[m] = kept[begin + m], kept_sizes[begin + m]
            elif known_is_q or how[t] != ALL:
                left = see(mesh, t, p, outlined[0], polygons, sizes, left, shadows)
            same = p[0] == q[0] and p[1] == q[1]
            if left > 0 and not same and not (known_is_q and how[t] == ALL):
                left = see(mesh, t, q, outlined[1], polygons, sizes, left, shadows)
            if left == OVERFLOW:
                return pieces, OVERFLOW
        for m in range(left):
            for k in range(1, sizes[m] - 1):
                if count == pieces.shape[0]:
                    longer = np.empty((2 * count, 13))
                    for i in range(count):
                        copy_row(pieces, i, longer, i)
                    pieces = longer
                corners = polygons[m]
                u0, v0 = corners[0], corners[1]
                u1, v1 = corners[2 * k], corners[2 * k + 1]
                u2, v2 = corners[2 * k + 2], corners[2 * k + 3]
                for axis in range(3):
                    o, a, b = row[axis], row[3 + axis], row[6 + axis]
                    pieces[count, axis] = o + u0 * a + v0 * b
                    pieces[count, 3 + axis] = o + u1 * a + v1 * b
                    pieces[count, 6 + axis] = o + u2 * a + v2 * b
                share = (u1 - u0) * (v2 - v0) - (v1 - v0) * (u2 - u0)
                pieces[count, 9] = 0.5 * size * share
                pieces[count, 10], pieces[count, 11] = abs(h1), abs(h2)
                pieces[count, 12] = t
                count += 1
    return pieces, count


@threaded(error_model="numpy")
def sights(mesh, clear, points, out, ends, kept, kept_sizes):
    """Fill ``out`` (points, triangles) with ALL, PART or NOTHING for each point and triangle.

    With an empty ``kept``, ``ends`` (points, triangles + 1) gets at t + 1 the number of visible
    polygons of a partly visible triangle t. In a second call, with ``ends`` summed cumulatively by
    the caller, the polygons are stored in ``kept`` from ``ends[t]`` on.
    """
    rows = mesh[0]
    for i in prange(points.shape[0]):
        polygons = np.empty((PIECES, 2 * CORNERS))
        sizes = np.empty(PIECES, dtype=np.int64)
        shadows = shadow_room()
        p = points[i]
        outlined = outline(mesh, p, outline_room(mesh))
        for t in range(rows.shape[0]):
            row = rows[t]
            n = frame(row)[0]
            h = n[0] * (p[0] - row[0]) + n[1] * (p[1] - row[1]) - n[2] * row[2]
            begin, end = ends[i, t], ends[i, t + 1]
            if kept.size:
                if end == begin:
                    continue
            else:
                out[i, t] = ALL
                if clear[t, 0 if h > 0.0 else 1]:
                    continue
            _whole(polygons, sizes)
            left = see(mesh, t, p, outlined, polygons, sizes, 1, shadows)
            if kept.size:
                for m in range(left):
                    kept[begin + m], kept_sizes[begin + m] = polygons[m], sizes[m]
            elif left == 0:
                out[i, t] = NOTHING
            elif left != 1 or not _is_whole(polygons[0], sizes[0]):
                out[i, t] = PART
                ends[i, t + 1] = max(left, 0)  # OVERFLOW counts as none


@njit(cache=True, error_model="numpy")
def _whole(polygons, sizes):
    """Set the first polygon to the whole triangle."""
    polygons[0, 0], polygons[0, 1], polygons[0, 2] = 0.0, 0.0, 1.0
    polygons[0, 3], polygons[0, 4], polygons[0, 5] = 0.0, 0.0, 1.0
    sizes[0] = 3


@njit(cache=True, error_model="numpy")
def _is_whole(polygon, size):
    """Whether a polygon is the whole triangle."""
    first = polygon[0] == 0.0 and polygon[1] == 0.0 and polygon[2] == 1.0
    return size == 3 and first and polygon[3] == 0.0 and polygon[4] == 0.0 and polygon[5] == 1.0


@njit(cache=True, error_model="numpy")
def _pass(pieces, count, p, q, world, limit, most, time, bins, stack):
    """Fill the bins by one pass over all pieces; return the number of parts.

    The pass is abandoned as soon as the number exceeds ``most``.
    """
    lobes, spans, sharp = world
    bins[:] = 0.0
    leaves = 0
    for i in range(count):
        piece = pieces[i]
        t = int(piece[12])
        pair = (p[0], p[1], q[0], q[1], piece[10], piece[11])
        own = lobes[spans[t, 0] : spans[t, 1]], sharp[t]
        leaves += _piece(piece, pair, own, limit, time, bins, stack)
        if leaves > most:
            return leaves
    return leaves


@njit(cache=True, error_model="numpy")
def _pair(pieces, count, p, q, world, limits, start, work, report):
    """Integrate one pair of points, by passes with falling error limit until two agree to ``tol``.

    ``work`` is (bins, before, stack), where bins are filled like ``report``.
    """
    (tol, most, delta), (bins, before, stack) = limits, work
    time = start, delta
    report[STATUS], report[ERROR] = DONE, 0.0
    leaves = _pass(pieces, count, p, q, world, math.inf, most, time, bins, stack)
    strict = 0.5 * tol
    for number in range(1, 40):
        total = bins.sum()
        report[TOTAL], report[LEAVES], report[PASSES] = total, leaves, number
        if total <= 0.0:
            return
        within = total - bins[0] - bins[bins.size - 1]
        before[:] = bins
        fewer = leaves
        # errors are relative to the contribution within the window, unless it is negligible
        scale = within if within > 1e-6 * total else total
        leaves = _pass(pieces, count, p, q, world, strict * scale, most, time, bins, stack)
        if leaves > most:
            bins[:] = before
            report[STATUS] = TOO_MANY
            return
        change = 0.0
        for k in range(bins.size):
            change += abs(bins[k] - before[k])
        report[TOTAL], report[ERROR] = bins.sum(), change
        report[LEAVES], report[PASSES] = leaves, number + 1
        # passes with almost equal parts agree trivially, so require 1.5 times as many parts
        if change <= tol * scale and leaves >= 1.5 * fewer:
            return
        strict /= STEP


@threaded(error_model="numpy")
def three_bounces(mesh, clear, world, pairs, known, limits, blocks, out, report):
    """Fill ``out`` (pairs, bins + 2) with G of each pair and ``report`` (pairs, REPORT).

    ``pairs`` is (lasers, sensors, turned, sight, starts) and ``limits`` (tol, most parts, delta).
    The first and last of the bins collect paths outside the window. Block i consists of the pairs
    ``blocks[i]`` to ``blocks[i + 1] - 1``. Row ``sight[i]`` of ``known`` is the visibility from the
    laser point of pair i; the last element of ``known`` tells whether this is complete. If
    ``turned[i]``, shadows of the sensor point are cut out first. Each pair is summed by one thread,
    so that results do not depend on the number of threads.
    """
    lasers, sensors, turned, sight, starts = pairs
    for block in prange(blocks.size - 1):
        room = np.empty((PIECES, 2 * CORNERS)), np.empty(PIECES, dtype=np.int64), shadow_room()
        first, second = outline_room(mesh), outline_room(mesh)
        pieces = np.empty((mesh[0].shape[0] + 16, 13))
        before = np.empty(out.shape[1])
        stack = np.empty((DEEPEST + 4, COLUMNS))
        for i in range(blocks[block], blocks[block + 1]):
            p, q = lasers[i], sensors[i]
            if turned[i]:
                p, q = q, p
            how, ends, kept, kept_sizes, told = known
            seen = how[sight[i]], ends[sight[i]], kept, kept_sizes
            if turned[i] or not told:
                first = outline(mesh, p, first)
            if p[0] != q[0] or p[1] != q[1]:
                second = outline(mesh, q, second)
            both = first, second
            pieces, count = _seen(mesh, clear, p, q, both, seen, turned[i], room, pieces)
            out[i, :] = 0.0
            report[i, :] = 0.0
            if count == OVERFLOW:
                report[i, STATUS] = TOO_FINE
                continue
            bins = out[i], before, stack
            _pair(pieces, count, p, q, world, limits, starts[i], bins, report[i])
