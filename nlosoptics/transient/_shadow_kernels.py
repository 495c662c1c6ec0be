"""What part of a triangle is seen from a point, compiled and exact: polygons cut by shadows.

Seen from a point, a triangle's shadow on a plane is a convex polygon. Points of a triangle with
corner o and sides a, b are written (u, v) with x = o + u a + v b, in which lines stay lines. Rows
of ``polygons`` hold up to `CORNERS` points (u, v); ``sizes`` their numbers.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

CORNERS = 16  # most corners of a polygon; it is halved before it would have more
PIECES = 2048  # most polygons of one triangle
OVERFLOW = -1
ROUNDING = 1e-12  # in (u, v), and of the scene's extent for heights


@njit(cache=True, error_model="numpy")
def _frame(row):
    """Normal (not a unit), and the vectors that give u and v of a point in the plane."""
    ax, ay, az, bx, by, bz = row[3], row[4], row[5], row[6], row[7], row[8]
    n = (ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx)
    s = n[0] * n[0] + n[1] * n[1] + n[2] * n[2]
    u = (by * n[2] - bz * n[1], bz * n[0] - bx * n[2], bx * n[1] - by * n[0])
    v = (n[1] * az - n[2] * ay, n[2] * ax - n[0] * az, n[0] * ay - n[1] * ax)
    return n, (u[0] / s, u[1] / s, u[2] / s), (v[0] / s, v[1] / s, v[2] / s)


@njit(cache=True, inline="always", error_model="numpy")
def _beyond(boxes, node, nx, ny, nz, d):
    """Largest n.x - d over a box."""
    x = boxes[node, 3] if nx > 0.0 else boxes[node, 0]
    y = boxes[node, 4] if ny > 0.0 else boxes[node, 1]
    z = boxes[node, 5] if nz > 0.0 else boxes[node, 2]
    return nx * x + ny * y + nz * z - d


@njit(cache=True, error_model="numpy")
def side_planes(row, n, away, p, planes):
    """Planes (normal, offset) that bound the room between a point and a triangle.

    The triangle's own, the parallel one through the point, and three through the point and a side;
    inside is where n.x - offset > 0. ``away`` is the sign of the point's height.
    """
    size = math.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
    f = away / size
    planes[0, 0], planes[0, 1], planes[0, 2] = n[0] * f, n[1] * f, n[2] * f
    planes[0, 3] = f * (n[0] * row[0] + n[1] * row[1] + n[2] * row[2])
    for k in range(3):
        planes[1, k] = -planes[0, k]
    planes[1, 3] = -f * (n[0] * p[0] + n[1] * p[1] + n[2] * p[2])
    for side in range(3):
        # corners o, o + a, o + b, and the one across
        i, j, k = side, (side + 1) % 3, (side + 2) % 3
        gx, gy, gz = _corner(row, i)
        hx, hy, hz = _corner(row, j)
        cx, cy, cz = _corner(row, k)
        gx, gy, gz = gx - p[0], gy - p[1], gz - p[2]
        hx, hy, hz = hx - p[0], hy - p[1], hz - p[2]
        x, y, z = gy * hz - gz * hy, gz * hx - gx * hz, gx * hy - gy * hx
        length = math.sqrt(x * x + y * y + z * z)
        if x * (cx - p[0]) + y * (cy - p[1]) + z * (cz - p[2]) < 0.0:
            length = -length
        if length == 0.0:
            planes[2 + side, :] = 0.0
            planes[2 + side, 3] = -1.0  # in line with the side: bounds nothing
            continue
        x, y, z = x / length, y / length, z / length
        planes[2 + side, 0], planes[2 + side, 1], planes[2 + side, 2] = x, y, z
        planes[2 + side, 3] = x * p[0] + y * p[1] + z * p[2]


@njit(cache=True, inline="always", error_model="numpy")
def _corner(row, i):
    if i == 0:
        return row[0], row[1], row[2]
    k = 3 * i
    return row[0] + row[k], row[1] + row[k + 1], row[2] + row[k + 2]


@njit(cache=True, error_model="numpy")
def _aside(row, planes, slack):
    """Whether a triangle lies outside one of the planes."""
    ox, oy, oz, ax, ay, az, bx, by, bz = (
        row[0],
        row[1],
        row[2],
        row[3],
        row[4],
        row[5],
        row[6],
        row[7],
        row[8],
    )
    for k in range(5):
        nx, ny, nz = planes[k, 0], planes[k, 1], planes[k, 2]
        h = nx * ox + ny * oy + nz * oz - planes[k, 3]
        if h <= slack:
            a, b = nx * ax + ny * ay + nz * az, nx * bx + ny * by + nz * bz
            if h + a <= slack and h + b <= slack:
                return True
    return False


@njit(cache=True, error_model="numpy")
def _shadow(other, row, frame, away, p, reach, shadow, work):
    """Corners, counter-clockwise in (u, v), of a triangle's shadow on another's plane; 0: none."""
    n, to_u, to_v = frame
    size = math.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
    f = away / size
    height = f * (n[0] * (p[0] - row[0]) + n[1] * (p[1] - row[1]) + n[2] * (p[2] - row[2]))
    top = height * (1.0 - 1e-9)  # what is level with the point throws its shadow to infinity
    highest = -math.inf
    for i in range(3):
        x, y, z = _corner(other, i)
        h = f * (n[0] * (x - row[0]) + n[1] * (y - row[1]) + n[2] * (z - row[2]))
        work[i, 0], work[i, 1], work[i, 2], work[i, 3] = x, y, z, h
        highest = max(highest, h)
    if highest <= ROUNDING * reach:
        return 0
    count = _between(work, 3, 0.0, 1.0)
    count = _between(work, count, top, -1.0)
    if count < 3:
        return 0
    for i in range(count):
        t = height / (height - work[i, 3])
        x = p[0] + t * (work[i, 0] - p[0]) - row[0]
        y = p[1] + t * (work[i, 1] - p[1]) - row[1]
        z = p[2] + t * (work[i, 2] - p[2]) - row[2]
        shadow[i, 0] = to_u[0] * x + to_u[1] * y + to_u[2] * z
        shadow[i, 1] = to_v[0] * x + to_v[1] * y + to_v[2] * z
    return _turned(shadow, count)


@njit(cache=True, error_model="numpy")
def _between(work, count, level, side):
    """Cut a polygon (x, y, z, height) in place to heights above (side 1) or below (-1) a level."""
    new = 8
    kept = 0
    for i in range(count):
        j = (i + 1) % count
        here, there = side * (work[i, 3] - level), side * (work[j, 3] - level)
        if here >= 0.0:
            work[new + kept] = work[i]
            kept += 1
        if (here > 0.0 and there < 0.0) or (here < 0.0 and there > 0.0):
            share = here / (here - there)
            for k in range(4):
                work[new + kept, k] = work[i, k] + share * (work[j, k] - work[i, k])
            work[new + kept, 3] = level
            kept += 1
    for i in range(kept):
        work[i] = work[new + i]
    return kept


@njit(cache=True, error_model="numpy")
def _distinct(corners, count):
    """Drop corners that repeat the one before, around the polygon; return how many are left."""
    kept = 0
    for i in range(count):
        x, y = corners[i, 0], corners[i, 1]
        if kept and abs(x - corners[kept - 1, 0]) + abs(y - corners[kept - 1, 1]) < ROUNDING:
            continue
        corners[kept, 0], corners[kept, 1] = x, y
        kept += 1
    while kept > 1 and (
        abs(corners[0, 0] - corners[kept - 1, 0]) + abs(corners[0, 1] - corners[kept - 1, 1])
        < ROUNDING
    ):
        kept -= 1
    return kept


@njit(cache=True, error_model="numpy")
def _turned(shadow, count):
    """Drop corners that repeat, and turn a polygon counter-clockwise; 0 if it has no area."""
    kept = _distinct(shadow, count)
    if kept < 3:
        return 0
    twice = 0.0
    for i in range(1, kept - 1):
        ux, uy = shadow[i, 0] - shadow[0, 0], shadow[i, 1] - shadow[0, 1]
        vx, vy = shadow[i + 1, 0] - shadow[0, 0], shadow[i + 1, 1] - shadow[0, 1]
        twice += ux * vy - uy * vx
    if abs(twice) < ROUNDING * ROUNDING:
        return 0
    if twice < 0.0:
        for i in range(kept // 2):
            j = kept - 1 - i
            for k in range(2):
                shadow[i, k], shadow[j, k] = shadow[j, k], shadow[i, k]
    return kept


@njit(cache=True, inline="always", error_model="numpy")
def _left_of(ax, ay, bx, by, x, y):
    """Distance of (x, y) to the left of the line from a to b."""
    ex, ey = bx - ax, by - ay
    return (ex * (y - ay) - ey * (x - ax)) / math.sqrt(ex * ex + ey * ey)


@njit(cache=True, error_model="numpy")
def _apart(polygon, size, shadow, count):
    """Whether a side of either of two convex polygons, counter-clockwise, parts them."""
    for i in range(count):
        j = (i + 1) % count
        most = -math.inf
        for k in range(size):
            d = _left_of(
                shadow[i, 0],
                shadow[i, 1],
                shadow[j, 0],
                shadow[j, 1],
                polygon[2 * k],
                polygon[2 * k + 1],
            )
            most = max(most, d)
        if most <= ROUNDING:
            return True
    for i in range(size):
        j = (i + 1) % size
        most = -math.inf
        for k in range(count):
            d = _left_of(
                polygon[2 * i],
                polygon[2 * i + 1],
                polygon[2 * j],
                polygon[2 * j + 1],
                shadow[k, 0],
                shadow[k, 1],
            )
            most = max(most, d)
        if most <= ROUNDING:
            return True
    return False


@njit(cache=True, error_model="numpy")
def _store(polygons, sizes, count, corners, size):
    """Append a convex polygon if it has an area; return the new number or OVERFLOW."""
    kept = _distinct(corners, size)
    if kept < 3:
        return count
    # in two halves while there is no room for another corner
    start = 1
    while start < kept - 1:
        stop = min(kept - 1, start + CORNERS - 3)
        twice = 0.0
        for i in range(start, stop):
            ux, uy = corners[i, 0] - corners[0, 0], corners[i, 1] - corners[0, 1]
            vx, vy = corners[i + 1, 0] - corners[0, 0], corners[i + 1, 1] - corners[0, 1]
            twice += ux * vy - uy * vx
        if twice > ROUNDING:
            if count == sizes.size:
                return OVERFLOW
            polygons[count, 0], polygons[count, 1] = corners[0, 0], corners[0, 1]
            size = 1
            for i in range(start, stop + 1):
                polygons[count, 2 * size], polygons[count, 2 * size + 1] = (
                    corners[i, 0],
                    corners[i, 1],
                )
                size += 1
            sizes[count] = size
            count += 1
        start = stop
    return count


@njit(cache=True, error_model="numpy")
def _without(polygons, sizes, count, shadow, n_shadow, room):
    """Take a convex shadow away from all polygons, in place; return their number or OVERFLOW."""
    more, more_sizes, left, out = room
    new = 0
    for m in range(count):
        size = sizes[m]
        if _apart(polygons[m], size, shadow, n_shadow):
            if new == more_sizes.size:
                return OVERFLOW
            more[new, : 2 * size] = polygons[m, : 2 * size]
            more_sizes[new] = size
            new += 1
            continue
        for k in range(size):
            left[k, 0], left[k, 1] = polygons[m, 2 * k], polygons[m, 2 * k + 1]
        for i in range(n_shadow):
            j = (i + 1) % n_shadow
            size, outside = _cut(left, size, shadow, i, j, out)
            new = _store(more, more_sizes, new, out, outside)
            if new == OVERFLOW:
                return OVERFLOW
            if size < 3:
                break
    for m in range(new):
        size = more_sizes[m]
        polygons[m, : 2 * size] = more[m, : 2 * size]
        sizes[m] = size
    return new


@njit(cache=True, error_model="numpy")
def _cut(left, size, shadow, i, j, out):
    """Part a polygon by a line: what is left of it stays, the rest goes to ``out``."""
    ax, ay, bx, by = shadow[i, 0], shadow[i, 1], shadow[j, 0], shadow[j, 1]
    first = 2 * CORNERS
    inside = outside = 0
    for k in range(size):
        m = (k + 1) % size
        here = _left_of(ax, ay, bx, by, left[k, 0], left[k, 1])
        there = _left_of(ax, ay, bx, by, left[m, 0], left[m, 1])
        if here >= 0.0:
            left[first + inside] = left[k]
            inside += 1
        if here <= 0.0:
            out[outside] = left[k]
            outside += 1
        if (here > 0.0 and there < 0.0) or (here < 0.0 and there > 0.0):
            share = here / (here - there)
            x = left[k, 0] + share * (left[m, 0] - left[k, 0])
            y = left[k, 1] + share * (left[m, 1] - left[k, 1])
            left[first + inside, 0], left[first + inside, 1] = x, y
            out[outside, 0], out[outside, 1] = x, y
            inside += 1
            outside += 1
    for k in range(inside):
        left[k] = left[first + k]
    return inside, outside


@njit(cache=True, error_model="numpy")
def see(rows, boxes, t, p, reach, polygons, sizes, count, room):
    """Leave of a triangle's polygons what a point sees; return their number or OVERFLOW.

    ``rows`` (n, 9) and ``boxes`` are a mesh's triangles and the tree over them.
    """
    row = rows[t]
    frame = _frame(row)
    n = frame[0]
    side = n[0] * (p[0] - row[0]) + n[1] * (p[1] - row[1]) + n[2] * (p[2] - row[2])
    away = 1.0 if side > 0.0 else -1.0
    cuts, planes, shadow, work, stack = room
    side_planes(row, n, away, p, planes)
    first_leaf = boxes.shape[0] // 2
    slack = ROUNDING * reach
    stack[0], top = 0, 1
    while top > 0:
        top -= 1
        node = stack[top]
        outside = False
        for k in range(5):
            most = _beyond(boxes, node, planes[k, 0], planes[k, 1], planes[k, 2], planes[k, 3])
            if most <= slack:
                outside = True
                break
        if outside:
            continue
        if node < first_leaf:
            stack[top], stack[top + 1] = 2 * node + 2, 2 * node + 1
            top += 2
            continue
        start = 4 * (node - first_leaf)
        for m in range(start, min(start + 4, rows.shape[0])):
            if m == t or _aside(rows[m], planes, slack):
                continue
            corners = _shadow(rows[m], row, frame, away, p, reach, shadow, work)
            if corners:
                count = _without(polygons, sizes, count, shadow, corners, cuts)
                if count <= 0:
                    return count
    return count


@njit(cache=True, error_model="numpy")
def shadow_room():
    """Arrays that `see` works in."""
    cuts = (
        np.empty((PIECES, 2 * CORNERS)),
        np.empty(PIECES, dtype=np.int64),
        np.empty((4 * CORNERS, 2)),
        np.empty((4 * CORNERS, 2)),
    )
    return (
        cuts,
        np.empty((5, 4)),
        np.empty((8, 2)),
        np.empty((16, 4)),
        np.empty(128, dtype=np.int64),
    )


@njit(cache=True, error_model="numpy")
def clear_sides(rows, reach):
    """Whether nothing stands above (column 0) and below (1) the plane of each triangle."""
    n = rows.shape[0]
    clear = np.ones((n, 2), dtype=np.bool_)
    for t in range(n):
        row = rows[t]
        normal = _frame(row)[0]
        size = math.sqrt(normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2)
        for m in range(n):
            for i in range(3):
                x, y, z = _corner(rows[m], i)
                h = normal[0] * (x - row[0]) + normal[1] * (y - row[1]) + normal[2] * (z - row[2])
                if h > ROUNDING * reach * size:
                    clear[t, 0] = False
                elif h < -ROUNDING * reach * size:
                    clear[t, 1] = False
            if not (clear[t, 0] or clear[t, 1]):
                break
    return clear
