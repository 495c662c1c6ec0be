"""Compiled visibility of triangles from a point, exact up to rounding.

Seen from a point, shadows are bounded by outlines: sides of triangles without a neighbour, and
sides between a triangle that faces the point and one that does not. A triangle is cut into convex
polygons along the shadows of the outlines in front of it and along its intersections with other
triangles. Each polygon is then either entirely visible or entirely hidden, which one ray decides.

Points of a triangle with corner o and sides a, b are written (u, v) with x = o + u a + v b. In
these coordinates straight lines remain straight. Rows of ``polygons`` hold up to `CORNERS` points
(u, v); ``sizes`` holds their numbers.
"""

from __future__ import annotations

import math

import numpy as np

from ...kernels.compiling import njit
from ...raytrace.intersection._triangle_kernels import after
from ._sight_kernels import blocked

CORNERS = 16  # largest number of corners of a polygon; larger ones are split in two
PIECES = 4096  # largest number of polygons of one triangle
OVERFLOW = -1  # returned instead of a number of polygons if there are too many
ROUNDING = 1e-12  # tolerance in (u, v), and for heights relative to the scene's extent
# codes of the neighbour across a side: its index n >= 0 if both triangles are oriented alike,
# FLIPPED - n if they are oriented oppositely, ALONE if there is none
ALONE, FLIPPED = -1, -2


@njit(cache=True, error_model="numpy")
def frame(row):
    """Return the unnormalised normal, and the vectors whose products with x - o are u and v."""
    ax, ay, az, bx, by, bz = row[3], row[4], row[5], row[6], row[7], row[8]
    n = (ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx)
    s = n[0] * n[0] + n[1] * n[1] + n[2] * n[2]
    u = (by * n[2] - bz * n[1], bz * n[0] - bx * n[2], bx * n[1] - by * n[0])
    v = (n[1] * az - n[2] * ay, n[2] * ax - n[0] * az, n[0] * ay - n[1] * ax)
    return n, (u[0] / s, u[1] / s, u[2] / s), (v[0] / s, v[1] / s, v[2] / s)


@njit(cache=True, error_model="numpy")
def _corner(row, i):
    if i == 0:
        return row[0], row[1], row[2]
    k = 3 * i
    return row[0] + row[k], row[1] + row[k + 1], row[2] + row[k + 2]


@njit(cache=True, error_model="numpy")
def outline(mesh, p, outlined):
    """Project all outlines seen from a point onto the triangles behind them.

    Fills and returns ``outlined``, which stores the lines of each triangle as a linked list: first
    line of each triangle, -1 for none; next line of the same triangle for each line; lines
    (u, v, u, v); working arrays. The arrays of lines are replaced by longer ones if needed.
    """
    rows, _, _, mates, _, _ = mesh
    heads, links, lines, work = outlined
    faces, sector = work
    for t in range(rows.shape[0]):
        row = rows[t]
        n = frame(row)[0]
        h = n[0] * (p[0] - row[0]) + n[1] * (p[1] - row[1]) + n[2] * (p[2] - row[2])
        faces[t] = h > 0.0
        heads[t] = -1
    count = 0
    for t in range(rows.shape[0]):
        for k in range(3):
            mate = mates[t, k]
            # a side that two triangles share is handled with the one of lower index
            if mate >= 0:
                drawn = t < mate and faces[t] != faces[mate]
            elif mate <= FLIPPED:
                drawn = t < FLIPPED - mate and faces[t] == faces[FLIPPED - mate]
            else:
                drawn = True
            if not drawn:
                continue
            a, b = _corner(rows[t], k), _corner(rows[t], (k + 1) % 3)
            if _sector(p, a, b, sector):
                links, lines, count = _throw(mesh, p, a, b, sector, heads, links, lines, count)
    return heads, links, lines, work


@njit(cache=True, error_model="numpy")
def _sector(p, a, b, planes):
    """Fill ``planes`` (4, 4) with unit normal and offset of the region that a segment hides.

    The region is a part of the plane through the point and the segment, the first of the planes.
    The other three bound it, with n.x - offset > 0 inside: through the point and either end, and
    through the segment. Returns False if the segment is seen end-on and hides nothing.
    """
    ax, ay, az = a[0] - p[0], a[1] - p[1], a[2] - p[2]
    bx, by, bz = b[0] - p[0], b[1] - p[1], b[2] - p[2]
    x, y, z = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    size = math.sqrt(x * x + y * y + z * z)
    if size == 0.0:
        return False
    x, y, z = x / size, y / size, z / size
    planes[0, 0], planes[0, 1], planes[0, 2] = x, y, z
    planes[0, 3] = x * p[0] + y * p[1] + z * p[2]
    for i in range(1, 4):
        # normals lie in the plane, perpendicular to the ray to either end and to the segment
        if i == 1:
            ex, ey, ez = ax, ay, az
        elif i == 2:
            ex, ey, ez = -bx, -by, -bz
        else:
            ex, ey, ez = ax - bx, ay - by, az - bz
        ux, uy, uz = y * ez - z * ey, z * ex - x * ez, x * ey - y * ex
        size = math.sqrt(ux * ux + uy * uy + uz * uz)
        planes[i, 0], planes[i, 1], planes[i, 2] = ux / size, uy / size, uz / size
        planes[i, 3] = planes[i, 0] * p[0] + planes[i, 1] * p[1] + planes[i, 2] * p[2]
    planes[3, 3] += planes[3, 0] * ax + planes[3, 1] * ay + planes[3, 2] * az
    return True


@njit(cache=True, error_model="numpy")
def _box_outside(box, planes, slack):
    """Whether a box lies entirely outside the region of `_sector`."""
    for k in range(4):
        x, y, z = planes[k, 0], planes[k, 1], planes[k, 2]
        most = x * (box[3] if x > 0.0 else box[0]) + y * (box[4] if y > 0.0 else box[1])
        most += z * (box[5] if z > 0.0 else box[2]) - planes[k, 3]
        if most < -slack:
            return True
        if k == 0:
            least = x * (box[0] if x > 0.0 else box[3]) + y * (box[1] if y > 0.0 else box[4])
            least += z * (box[2] if z > 0.0 else box[5]) - planes[k, 3]
            if least > slack:
                return True
    return False


@njit(cache=True, error_model="numpy")
def _aside(row, planes, slack):
    """Whether a triangle lies entirely outside the region of `_sector`."""
    for k in range(4):
        x, y, z = planes[k, 0], planes[k, 1], planes[k, 2]
        o = x * row[0] + y * row[1] + z * row[2] - planes[k, 3]
        a = o + x * row[3] + y * row[4] + z * row[5]
        b = o + x * row[6] + y * row[7] + z * row[8]
        if max(o, a, b) < -slack or (k == 0 and min(o, a, b) > slack):
            return True
    return False


@njit(cache=True, error_model="numpy")
def _throw(mesh, p, a, b, sector, heads, links, lines, count):
    """Add the shadow of the segment from a to b to the lines of each triangle that it crosses.

    ``p`` is the point from which the shadow is cast and ``sector`` the result of `_sector`.
    ``heads``, ``links`` and ``lines`` are the linked lists of `outline`, ``count`` the number of
    lines. Returns ``links``, ``lines`` and the new count, since the arrays may be replaced by
    longer ones.
    """
    rows, boxes, reach, _, _, _ = mesh
    first_leaf = boxes.shape[0] // 2
    slack = ROUNDING * reach
    node = 0
    while node >= 0:
        if _box_outside(boxes[node], sector, slack):
            node = after(node)
            continue
        if node < first_leaf:
            node = 2 * node + 1
            continue
        start = 4 * (node - first_leaf)
        for t in range(start, min(start + 4, rows.shape[0])):
            if _aside(rows[t], sector, slack):
                continue
            if count == links.size:
                links, lines = _longer(links, lines)
            if _cast(a, b, rows[t], p, slack, lines[count]) and _enters(lines[count]):
                links[count], heads[t] = heads[t], count
                count += 1
        node = after(node)
    return links, lines, count


@njit(cache=True, error_model="numpy")
def copy_row(source, i, target, j):
    """Copy row i to row j; assignments of whole rows take seconds to compile."""
    for k in range(source.shape[1]):
        target[j, k] = source[i, k]


@njit(cache=True, error_model="numpy")
def _longer(links, lines):
    """Return copies of both arrays with twice the length."""
    more, longer = np.empty(2 * links.size, dtype=np.int64), np.empty((2 * links.size, 4))
    for i in range(links.size):
        more[i] = links[i]
        copy_row(lines, i, longer, i)
    return more, longer


@njit(cache=True, error_model="numpy")
def _cast(a, b, row, p, slack, line):
    """Project the segment from a to b, as seen from p, onto the plane of the triangle ``row``.

    ``line`` gets the ends (u, v, u, v) of this shadow. Only the part of the segment between the
    plane and p casts one; without such a part the result is False.
    """
    n, to_u, to_v = frame(row)
    f = 1.0 / math.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
    height = f * (n[0] * (p[0] - row[0]) + n[1] * (p[1] - row[1]) + n[2] * (p[2] - row[2]))
    if height < 0.0:
        f, height = -f, -height
    first = f * (n[0] * (a[0] - row[0]) + n[1] * (a[1] - row[1]) + n[2] * (a[2] - row[2]))
    last = f * (n[0] * (b[0] - row[0]) + n[1] * (b[1] - row[1]) + n[2] * (b[2] - row[2]))
    top = height * (1.0 - 1e-9)  # at the height of the point the shadow would be at infinity
    if max(first, last) <= slack or min(first, last) >= top:
        return False
    for end in range(2):
        here = first if end == 0 else last
        level = min(max(here, 0.0), top)
        share = float(end)
        if level != here:
            share = (first - level) / (first - last)
        t = height / (height - level)
        x = p[0] + t * (a[0] + share * (b[0] - a[0]) - p[0]) - row[0]
        y = p[1] + t * (a[1] + share * (b[1] - a[1]) - p[1]) - row[1]
        z = p[2] + t * (a[2] + share * (b[2] - a[2]) - p[2]) - row[2]
        line[2 * end] = to_u[0] * x + to_u[1] * y + to_u[2] * z
        line[2 * end + 1] = to_v[0] * x + to_v[1] * y + to_v[2] * z
    return True


@njit(cache=True, error_model="numpy")
def _enters(line):
    """Return whether the part of a segment inside the triangle is longer than rounding errors.

    ``line`` is (u, v, u, v) in the triangle's coordinates.
    """
    u, v, du, dv = line[0], line[1], line[2] - line[0], line[3] - line[1]
    low, high = 0.0, 1.0
    for k in range(3):
        first = (u, v, 1.0 - u - v)[k] - ROUNDING
        rise = (du, dv, -du - dv)[k]
        if first <= 0.0 and first + rise <= 0.0:
            return False
        if first < 0.0:
            low = max(low, -first / rise)
        elif first + rise < 0.0:
            high = min(high, -first / rise)
    return (high - low) * math.hypot(du, dv) > ROUNDING


@njit(cache=True, error_model="numpy")
def _left_of(ax, ay, bx, by, x, y):
    """Return the signed distance of (x, y) from the line a to b, positive on its left."""
    ex, ey = bx - ax, by - ay
    return (ex * (y - ay) - ey * (x - ax)) / math.sqrt(ex * ex + ey * ey)


@njit(cache=True, error_model="numpy")
def _crosses(polygon, size, line):
    """Whether the part of a segment inside a counter-clockwise convex polygon exceeds rounding."""
    low, high = 0.0, 1.0
    length = math.hypot(line[2] - line[0], line[3] - line[1])
    for i in range(size):
        j = (i + 1) % size
        ax, ay, bx, by = polygon[2 * i], polygon[2 * i + 1], polygon[2 * j], polygon[2 * j + 1]
        first = _left_of(ax, ay, bx, by, line[0], line[1]) - ROUNDING
        last = _left_of(ax, ay, bx, by, line[2], line[3]) - ROUNDING
        if first <= 0.0 and last <= 0.0:
            return False
        if first < 0.0:
            low = max(low, first / (first - last))
        elif last < 0.0:
            high = min(high, first / (first - last))
    return (high - low) * length > ROUNDING


@njit(cache=True, error_model="numpy")
def _put(cells, sizes, at, count, corners, size):
    """Store a convex polygon, split in two if it has too many corners.

    Returns the new number of polygons or OVERFLOW.
    """
    kept = min(size, CORNERS)
    if max(count, at + 1) + size - kept > sizes.size:
        return OVERFLOW
    for i in range(kept):
        cells[at, 2 * i], cells[at, 2 * i + 1] = corners[i, 0], corners[i, 1]
    sizes[at] = kept
    count = max(count, at + 1)
    if size > kept:  # one corner too many: split off the triangle of the first and last two
        for i, k in enumerate((0, size - 2, size - 1)):
            cells[count, 2 * i], cells[count, 2 * i + 1] = corners[k, 0], corners[k, 1]
        sizes[count] = 3
        count += 1
    return count


@njit(cache=True, error_model="numpy")
def _distinct(corners, count):
    """Remove corners equal to the one before, cyclically; return the number that remains."""
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
def _area(corners, size):
    """Return twice the area of a counter-clockwise convex polygon."""
    twice = 0.0
    for i in range(1, size - 1):
        ux, uy = corners[i, 0] - corners[0, 0], corners[i, 1] - corners[0, 1]
        vx, vy = corners[i + 1, 0] - corners[0, 0], corners[i + 1, 1] - corners[0, 1]
        twice += ux * vy - uy * vx
    return twice


@njit(cache=True, error_model="numpy")
def _part(cells, sizes, at, count, line, sides):
    """Split a polygon in two along a line, if both parts have an area.

    Returns the new number of polygons or OVERFLOW.
    """
    left, right = sides
    cell, size = cells[at], sizes[at]
    n_left = n_right = 0
    for i in range(size):
        j = (i + 1) % size
        ax, ay, bx, by = cell[2 * i], cell[2 * i + 1], cell[2 * j], cell[2 * j + 1]
        here = _left_of(line[0], line[1], line[2], line[3], ax, ay)
        there = _left_of(line[0], line[1], line[2], line[3], bx, by)
        if here >= 0.0:
            left[n_left, 0], left[n_left, 1] = ax, ay
            n_left += 1
        if here <= 0.0:
            right[n_right, 0], right[n_right, 1] = ax, ay
            n_right += 1
        if (here > 0.0 and there < 0.0) or (here < 0.0 and there > 0.0):
            share = here / (here - there)
            x, y = ax + share * (bx - ax), ay + share * (by - ay)
            left[n_left, 0], left[n_left, 1] = x, y
            right[n_right, 0], right[n_right, 1] = x, y
            n_left += 1
            n_right += 1
    n_left, n_right = _distinct(left, n_left), _distinct(right, n_right)
    if n_left < 3 or n_right < 3 or min(_area(left, n_left), _area(right, n_right)) < ROUNDING:
        return count
    count = _put(cells, sizes, at, count, left, n_left)
    return count if count == OVERFLOW else _put(cells, sizes, count, count, right, n_right)


@njit(cache=True, error_model="numpy")
def _cut(cells, sizes, count, line, sides):
    """Split all polygons that a segment crosses; return the new number of polygons or OVERFLOW."""
    for k in range(count):  # does nothing if count is OVERFLOW
        if _crosses(cells[k], sizes[k], line):
            count = _part(cells, sizes, k, count, line, sides)
            if count == OVERFLOW:
                break
    return count


@njit(cache=True, error_model="numpy")
def _hidden(mesh, t, p, cell, size):
    """Return whether a triangle lies between the point p and the mean of a polygon's corners.

    ``cell`` holds the ``size`` corners on triangle ``t``.
    """
    row = mesh[0][t]
    u = v = 0.0
    for i in range(size):
        u += cell[2 * i] / size
        v += cell[2 * i + 1] / size
    d = (
        row[0] + u * row[3] + v * row[6] - p[0],
        row[1] + u * row[4] + v * row[7] - p[1],
        row[2] + u * row[5] + v * row[8] - p[2],
    )
    return blocked(mesh[0], mesh[1], p, d)


@njit(cache=True, error_model="numpy")
def see(mesh, t, p, outlined, polygons, sizes, count, room):
    """Reduce the polygons of a triangle to the parts that a point sees.

    Returns the new number of polygons, or OVERFLOW.
    """
    cells, cell_sizes, more, more_sizes, sides = room
    _, _, _, _, crossed, cuts = mesh
    heads, links, lines, _ = outlined
    new = 0
    for m in range(count):
        copy_row(polygons, m, cells, 0)
        cell_sizes[0], n_cells = sizes[m], 1
        for i in range(crossed[t], crossed[t + 1]):
            n_cells = _cut(cells, cell_sizes, n_cells, cuts[i], sides)
        i = heads[t]
        while i >= 0:
            n_cells = _cut(cells, cell_sizes, n_cells, lines[i], sides)
            i = links[i]
        if n_cells == OVERFLOW:
            return OVERFLOW
        seen = 0
        for k in range(n_cells):
            if not _hidden(mesh, t, p, cells[k], cell_sizes[k]):
                copy_row(cells, k, cells, seen)
                cell_sizes[seen] = cell_sizes[k]
                seen += 1
        if seen == n_cells:  # entirely visible: keep the uncut polygon
            copy_row(polygons, m, cells, 0)
            cell_sizes[0], seen = sizes[m], 1
        if new + seen > more_sizes.size:
            return OVERFLOW
        for k in range(seen):
            copy_row(cells, k, more, new)
            more_sizes[new] = cell_sizes[k]
            new += 1
    for m in range(new):
        copy_row(more, m, polygons, m)
        sizes[m] = more_sizes[m]
    return new


@njit(cache=True, error_model="numpy")
def shadow_room():
    """Return the working arrays of `see`."""
    return (
        np.empty((PIECES, 2 * CORNERS)),
        np.empty(PIECES, dtype=np.int64),
        np.empty((PIECES, 2 * CORNERS)),
        np.empty(PIECES, dtype=np.int64),
        (np.empty((2 * CORNERS, 2)), np.empty((2 * CORNERS, 2))),
    )


@njit(cache=True, error_model="numpy")
def outline_room(mesh):
    """Return the arrays that `outline` fills."""
    n = mesh[0].shape[0]
    work = np.empty(n, dtype=np.bool_), np.empty((4, 4))
    return (
        np.empty(n, dtype=np.int64),
        np.empty(n + 16, dtype=np.int64),
        np.empty((n + 16, 4)),
        work,
    )


@njit(cache=True, error_model="numpy")
def crossings(rows, boxes, reach, ends, cuts):
    """Fill ``cuts`` with the lines (u, v, u, v) in which other triangles meet each triangle.

    With an empty ``cuts``, ``ends`` (n + 1,) gets at t + 1 the number of lines of triangle t. In a
    second call, with ``ends`` summed cumulatively by the caller, lines are stored from ``ends[t]``.
    """
    first_leaf = boxes.shape[0] // 2
    line, heights = np.empty(4), np.empty(3)
    for t in range(rows.shape[0]):
        row = rows[t]
        n, to_u, to_v = frame(row)
        slack = ROUNDING * reach * math.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
        count = 0
        node = 0
        while node >= 0:
            if _apart(row, boxes[node], ROUNDING * reach):
                node = after(node)
                continue
            if node < first_leaf:
                node = 2 * node + 1
                continue
            start = 4 * (node - first_leaf)
            for m in range(start, min(start + 4, rows.shape[0])):
                if m == t or not _through(rows[m], row, n, slack, to_u, to_v, heights, line):
                    continue
                if _enters(line):
                    if cuts.size:
                        cuts[ends[t] + count] = line
                    count += 1
            node = after(node)
        if not cuts.size:
            ends[t + 1] = count


@njit(cache=True, error_model="numpy")
def _apart(row, box, slack):
    """Whether a triangle's bounding box is disjoint from another box."""
    for k in range(3):
        o, a, b = row[k], row[k] + row[3 + k], row[k] + row[6 + k]
        if min(o, a, b) > box[3 + k] + slack or max(o, a, b) < box[k] - slack:
            return True
    return False


@njit(cache=True, error_model="numpy")
def _through(other, row, n, slack, to_u, to_v, heights, line):
    """Fill ``line`` with the intersection of ``other`` and a triangle's plane, if it is a line."""
    level = 0
    for i in range(3):
        x = _corner(other, i)
        heights[i] = n[0] * (x[0] - row[0]) + n[1] * (x[1] - row[1]) + n[2] * (x[2] - row[2])
        if abs(heights[i]) <= slack:
            heights[i] = 0.0
            level += 1
    if level == 3:
        return False
    found = 0
    for i in range(3):
        j = (i + 1) % 3
        here, there = heights[i], heights[j]
        if here != 0.0 and here * there >= 0.0:
            continue
        share = here / (here - there) if here != 0.0 else 0.0
        a, b = _corner(other, i), _corner(other, j)
        x = a[0] + share * (b[0] - a[0]) - row[0]
        y = a[1] + share * (b[1] - a[1]) - row[1]
        z = a[2] + share * (b[2] - a[2]) - row[2]
        line[2 * found] = to_u[0] * x + to_u[1] * y + to_u[2] * z
        line[2 * found + 1] = to_v[0] * x + to_v[1] * y + to_v[2] * z
        found += 1
    return found == 2


@njit(cache=True, error_model="numpy")
def clear_sides(rows, reach):
    """Return whether the space above (column 0) and below (1) each triangle's plane is empty."""
    n = rows.shape[0]
    clear = np.ones((n, 2), dtype=np.bool_)
    for t in range(n):
        row = rows[t]
        normal = frame(row)[0]
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
