"""Compiled intersection of rays with triangles.

Every ray is o + t d with unit d and t in m. Rows of ``facets`` (n, 9) are a corner and the two
sides that start at it, in the order of the leaves of the tree ``boxes``. ``edges`` (n,) are the
lengths of the longest sides, m, and ``names`` (n,) the indices in the mesh.

``hits`` receives the first hits: distance (n,), m, point and unit normal, both (n, 3), and the
index of the triangle (n,), -1 without a hit, when the others are NaN. Points and normals that have
no rows are left out.
"""

from __future__ import annotations

import math

import numpy as np

from ...kernels.compiling import njit
from ._wall_kernels import _unit

BLOCK = 64  # rays processed at once
OX, OY, OZ, DX, DY, DZ, T, DEPTH, PX, PY, PZ = range(0, 11 * BLOCK, BLOCK)
SIDE = 144  # cells along a side of the octahedral map by which rays are sorted
INDEX = 6  # column of ``rays`` with the number of the ray, as an integer
MISSED = (math.nan, math.nan, math.nan)


@njit(cache=True, forceinline=True, error_model="numpy")
def _across(d):
    """Return a unit vector perpendicular to the unit vector d, without branches."""
    sign = math.copysign(1.0, d[2])
    a = -sign / (1.0 + abs(d[2]))
    return 1.0 + sign * a * d[0] * d[0], sign * a * d[0] * d[1], -sign * d[0]


@njit(cache=True, error_model="numpy")
def _entry(boxes, node, o, inverse, low, high):
    """Return the distance at which a ray enters an axis-parallel box, m; inf if it misses."""
    for k in range(3):
        near, far = boxes[node, k] - o[k], boxes[node, k + 3] - o[k]
        if abs(inverse[k]) == math.inf:
            if near > 0.0 or far < 0.0:
                return math.inf
        else:
            p, q = near * inverse[k], far * inverse[k]
            low, high = max(low, min(p, q)), min(high, max(p, q))
    # the slack allows for three roundings of each limit
    return low if low <= high + 1e-15 * (abs(low) + abs(high)) else math.inf


@njit(cache=True, forceinline=True, error_model="numpy")
def _bin(x, y, z, dx, dy, dz):
    """Return the number of the cell, 0 to SIDE^2 - 1, by which a ray is sorted."""
    b, c = x * dx + y * dy + z * dz, x * x + y * y + z * z
    t = math.sqrt(max(b * b - c + 1.5, 0.0)) - b
    x, y, z = x + t * dx, y + t * dy, z + t * dz
    shrink = 1.0 / (abs(x) + abs(y) + abs(z) + 1e-30)
    x, y = x * shrink, y * shrink
    below = 0.5 - math.copysign(0.5, z)  # a factor 0 or 1, since a branch would be mispredicted
    u = x + below * (math.copysign(1.0 - abs(y), x) - x)
    v = y + below * (math.copysign(1.0 - abs(x), y) - y)
    # 0.4999 instead of 0.5 keeps the cell below SIDE even at u = 1 plus rounding
    return int((u + 1.0) * (0.4999 * SIDE)) * SIDE + int((v + 1.0) * (0.4999 * SIDE))


@njit(cache=True, error_model="numpy")
def _head(w, centre, half):
    """Normalise the directions of a block of rays, and count the rays that start outside a box."""
    outside = bad = 0  # whole numbers, since the order of their sum may change
    for i in range(BLOCK):
        x, y, z = _unit((w[DX + i], w[DY + i], w[DZ + i]))
        w[DX + i], w[DY + i], w[DZ + i], w[T + i], w[DEPTH + i] = x, y, z, 0.0, 0.0
        px, py, pz = w[OX + i] - centre[0], w[OY + i] - centre[1], w[OZ + i] - centre[2]
        within = (abs(px) < half[0]) & (abs(py) < half[1]) & (abs(pz) < half[2])
        outside += 0 if within else 1
        total = px + py + pz + x + y + z
        bad += 0 if total - total == 0.0 else 1  # NaN if a component is NaN or infinite
    return -1 if bad else outside


@njit(cache=True, error_model="numpy")
def _prepare(w, centre, shrink, aside):
    """Compute the displaced starts of a block of rays for Embree."""
    for i in range(BLOCK):
        d, back = (w[DX + i], w[DY + i], w[DZ + i]), w[T + i] - 8.0 * aside
        e = _across(d)
        x = (w[OX + i] + back * d[0] - centre[0] + aside * e[0]) * shrink
        y = (w[OY + i] + back * d[1] - centre[1] + aside * e[1]) * shrink
        z = (w[OZ + i] + back * d[2] - centre[2] + aside * e[2]) * shrink
        w[PX + i], w[PY + i], w[PZ + i] = x, y, z


@njit(cache=True, error_model="numpy")
def _cells(w, cells):
    """Fill ``cells`` (BLOCK,) with the numbers of `_bin` of a block of rays."""
    for i in range(BLOCK):
        start, d = (w[PX + i], w[PY + i], w[PZ + i]), (w[DX + i], w[DY + i], w[DZ + i])
        cells[i] = _bin(start[0], start[1], start[2], d[0], d[1], d[2])


@njit(cache=True)
def _flat(hits):
    """Return the result arrays with one axis, whose columns have constant distances."""
    return hits[0], hits[1].reshape(-1), hits[2].reshape(-1), hits[3]


@njit(cache=True, forceinline=True, error_model="numpy")
def _record(found, i, t, point, normal, name):
    """Write the hit of ray ``i`` to the result arrays of `_flat`."""
    distance, points, normals, triangle = found
    distance[i], triangle[i] = t, name
    if points.size > 0:
        for k in range(3):
            points[3 * i + k], normals[3 * i + k] = point[k], normal[k]


@njit(cache=True, nogil=True, error_model="numpy")
def enter(origins, directions, limits, centre, scale, aside, loose, bins, rays, hits, fresh):
    """Prepare rays in float32 for Embree, those that meet the box ``limits`` (1, 6), m.

    Rows of ``rays`` (n, 8) are filled with start, direction and, as an integer, the number of the
    ray. They are sorted so that similar rays follow each other, for the processor's caches;
    ``loose`` and ``bins`` are buffers for sorting. Without ``bins`` (0,) the order stays. If
    ``fresh``, the other rays get no hit.

    Starts are in units of ``scale`` about ``centre``, at the entry into the box. They are displaced
    sideways by ``aside``, so that a ray aimed at a vertex passes next to it. They are also moved
    back by 8 ``aside``, so that triangles in front of the origin remain in front.

    Returns the number of rays for Embree, or -1 if a ray has NaN, infinity or a zero direction.
    """
    kept, sorting, found = 0, bins.size > 0, _flat(hits)
    # flat arrays have constant distances between columns, unlike arrays with two axes
    target = loose.reshape(-1) if sorting else rays.reshape(-1)
    numbers, starts, ways = target.view(np.int32), origins.reshape(-1), directions.reshape(-1)
    counts = np.zeros(SIDE * SIDE + 1 if sorting else 1, dtype=np.int32)
    half = 0.5 * (limits[0, 3:] - limits[0, :3])
    w, cells = np.ones(11 * BLOCK), np.empty(BLOCK, dtype=np.int32)
    for start in range(0, origins.shape[0], BLOCK):
        n = min(BLOCK, origins.shape[0] - start)
        for i in range(n):
            for k in range(3):
                w[k * BLOCK + i] = starts[3 * (start + i) + k]
                w[DX + k * BLOCK + i] = ways[3 * (start + i) + k]
        outside = _head(w, centre, half)
        if outside < 0:
            return -1
        if outside > 0:
            for i in range(n):
                o = (w[OX + i], w[OY + i], w[OZ + i])
                inverse = (1.0 / w[DX + i], 1.0 / w[DY + i], 1.0 / w[DZ + i])
                w[DEPTH + i] = _entry(limits, 0, o, inverse, 0.0, math.inf)
                w[T + i] = w[DEPTH + i] if w[DEPTH + i] < math.inf else 0.0
        _prepare(w, centre, 1.0 / scale, aside)
        if sorting:
            _cells(w, cells)
        for i in range(n):
            if w[DEPTH + i] == math.inf:
                if fresh:
                    _record(found, start + i, math.nan, MISSED, MISSED, -1)
                continue
            for k in range(3):
                target[8 * kept + k] = w[PX + k * BLOCK + i]
                target[8 * kept + k + 3] = w[DX + k * BLOCK + i]
            numbers[8 * kept + INDEX] = start + i
            if sorting:
                bins[kept] = cells[i]
                counts[cells[i] + 1] += 1
            kept += 1
    if not sorting:
        return kept
    for k in range(1, counts.size):
        counts[k] += counts[k - 1]
    sorted_rays, rows = rays.view(np.int64), loose.view(np.int64)
    for j in range(kept):
        to = counts[bins[j]]
        counts[bins[j]] += 1
        for k in range(4):
            sorted_rays[to, k] = rows[j, k]
    return kept


@njit(cache=True, forceinline=True, error_model="numpy")
def _facet(row, o, d):
    """Return where a ray meets the plane of the triangle ``row`` = (a, b - a, c - a).

    These are three signed volumes, their sum, the distance, m, and the triangle's normal times
    twice its area, m^2. The volumes divided by their sum are barycentric coordinates: the ray hits
    the triangle if none is negative.
    """
    sx, sy, sz = o[0] - row[0], o[1] - row[1], o[2] - row[2]
    ax, ay, az, bx, by, bz = row[3], row[4], row[5], row[6], row[7], row[8]
    mx, my, mz = sy * d[2] - sz * d[1], sz * d[0] - sx * d[2], sx * d[1] - sy * d[0]
    nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    along = nx * d[0] + ny * d[1] + nz * d[2]
    t = -(nx * sx + ny * sy + nz * sz) / along
    side, det = math.copysign(1.0, -along), abs(along)
    u = side * (bx * mx + by * my + bz * mz)
    v = -side * (ax * mx + ay * my + az * mz)
    return u, v, det - u - v, det, t, (nx, ny, nz)


@njit(cache=True, forceinline=True, error_model="numpy")
def _landing(normal, o, d, t):
    """Return point (m) and unit normal of a hit at the distance t, m."""
    nx, ny, nz = normal
    along = nx * d[0] + ny * d[1] + nz * d[2]
    size = math.copysign(1.0 / math.sqrt(nx * nx + ny * ny + nz * nz), -along)
    p = (o[0] + t * d[0], o[1] + t * d[1], o[2] + t * d[2])
    return p, (nx * size, ny * size, nz * size)


@njit(cache=True, forceinline=True, error_model="numpy")
def _row(numbers, k):
    """Return nine numbers of a flat array from index ``k`` on as a tuple.

    Array views would be reference-counted by atomic operations, which slow down parallel threads.
    """
    first = (numbers[k], numbers[k + 1], numbers[k + 2], numbers[k + 3], numbers[k + 4])
    return (*first, numbers[k + 5], numbers[k + 6], numbers[k + 7], numbers[k + 8])


@njit(cache=True, nogil=True, error_model="numpy")
def place(facets, edges, names, origins, directions, rays, ids, margin, near, far, hits, fresh):
    """Accept the triangles that Embree found if float64 arithmetic confirms them beyond doubt."""
    doubtful, found = 0, _flat(hits)
    numbers, rows = rays.reshape(-1).view(np.int32), rays.view(np.int64)
    starts, ways, corners = origins.reshape(-1), directions.reshape(-1), facets.reshape(-1)
    for j in range(ids.size):
        i, k = numbers[8 * j + INDEX], ids[j]
        o = (starts[3 * i], starts[3 * i + 1], starts[3 * i + 2])
        d = _unit((ways[3 * i], ways[3 * i + 1], ways[3 * i + 2]))
        u, v, w, _, t, normal = _facet(_row(corners, 9 * max(k, 0)), o, d)
        # a hit must be inside the triangle by more than ``margin``; a strip of this width along a
        # side has at most the volume margin * edge
        if k >= 0 and min(u, v, w) > margin * edges[k] and t >= near:
            if far.size == 0 or t <= far[i]:
                point, normal = _landing(normal, o, d, t)
                _record(found, i, t, point, normal, names[k])
            elif fresh:
                _record(found, i, math.nan, MISSED, MISSED, -1)
            continue
        if fresh:
            _record(found, i, math.nan, MISSED, MISSED, -1)
        ids[doubtful] = k
        for m in range(4):
            rows[doubtful, m] = rows[j, m]
        doubtful += 1
    return doubtful


@njit(cache=True, nogil=True)
def aside(rays, shift, turn, out):
    """Fill ``out`` (n, 6) with copies of rays that are displaced sideways by ``shift``."""
    cosine, sine = math.cos(turn), math.sin(turn)
    for j in range(rays.shape[0]):
        d = (rays[j, 3], rays[j, 4], rays[j, 5])
        e = _across(d)
        f = (d[1] * e[2] - d[2] * e[1], d[2] * e[0] - d[0] * e[2], d[0] * e[1] - d[1] * e[0])
        norm = shift / math.sqrt(e[0] * e[0] + e[1] * e[1] + e[2] * e[2])
        for k in range(3):
            out[j, k] = rays[j, k] + norm * (cosine * e[k] + sine * f[k])
            out[j, k + 3] = d[k]


@njit(cache=True)
def after(node):
    """Return the node that follows the subtree of ``node`` in depth-first order; -1 at the end."""
    while node > 0 and node & 1 == 0:  # a second child ends the subtree of its parent too
        node = (node >> 1) - 1
    return node + 1 if node > 0 else -1


@njit(cache=True, error_model="numpy")
def _strike(row, edge, o, d):
    """Return the distance to a triangle, m, including its edges; NaN if it is missed."""
    u, v, w, det, t, _ = _facet(row, o, d)
    away = abs(o[0] - row[0]) + abs(o[1] - row[1]) + abs(o[2] - row[2])
    # the rounding error of the volumes, so that no ray passes between adjacent triangles
    slack = 4e-16 * (away + edge) * edge
    return t if det > 0.0 and min(u, v, w) >= -slack else math.nan


@njit(cache=True, nogil=True, error_model="numpy")
def search(facets, edges, names, boxes, origins, directions, index, nearest, farthest, hits):
    """Find the first triangle of each ray of ``index`` within its distance limits, in float64 only.

    ``boxes`` (m, 6) is a complete binary tree of low and high corners, with four triangles per
    leaf. ``nearest``, m, and ``farthest`` (n,), m, limit the distance; an empty ``farthest`` is no
    limit. Among triangles at the same distance, the first one in ``facets`` is taken. Rays without
    a triangle keep their ``hits``.
    """
    first_leaf, corners = boxes.shape[0] // 2, facets.reshape(-1)
    stack, entries, found = np.empty(128, dtype=np.int64), np.empty(128), _flat(hits)
    for j in range(index.size):
        i = index[j]
        o = (origins[i, 0], origins[i, 1], origins[i, 2])
        d = _unit((directions[i, 0], directions[i, 1], directions[i, 2]))
        inverse = (1.0 / d[0], 1.0 / d[1], 1.0 / d[2])
        best, chosen = math.inf if farthest.size == 0 else farthest[i], -1
        stack[0], entries[0], top = 0, nearest, 1
        while top > 0:
            top -= 1
            node = stack[top]
            if entries[top] > best + 1e-15 * abs(best):
                continue
            if node < first_leaf:
                near, far = 2 * node + 1, 2 * node + 2
                low = _entry(boxes, near, o, inverse, nearest, best)
                other = _entry(boxes, far, o, inverse, nearest, best)
                if other < low:
                    near, far, low, other = far, near, other, low
                if other < math.inf:
                    stack[top], entries[top] = far, other
                    top += 1
                if low < math.inf:
                    stack[top], entries[top] = near, low
                    top += 1
                continue
            start = 4 * (node - first_leaf)
            for m in range(start, min(start + 4, facets.shape[0])):
                t = _strike(_row(corners, 9 * m), edges[m], o, d)
                if nearest <= t <= best and (t < best or chosen < 0 or m < chosen):
                    best, chosen = t, m
        if chosen >= 0:
            normal = _facet(_row(corners, 9 * chosen), o, d)[5]
            point, normal = _landing(normal, o, d, best)
            _record(found, i, best, point, normal, names[chosen])


@njit(cache=True, error_model="numpy")
def _blur(row, edge, o, d):
    """Return the rounding error of a hit's distance, m, with the sign of the triangle's side."""
    nx = row[4] * row[8] - row[5] * row[7]
    ny = row[5] * row[6] - row[3] * row[8]
    nz = row[3] * row[7] - row[4] * row[6]
    det = nx * d[0] + ny * d[1] + nz * d[2]
    away = abs(o[0] - row[0]) + abs(o[1] - row[1]) + abs(o[2] - row[2])
    return 4e-15 * (away + edge) * edge * edge / det


@njit(cache=True, nogil=True)
def _once(hits, begin, end):
    """Remove repeated hits of one ray from the rows ``begin`` to ``end``; return the new end."""
    kept = begin
    for j in range(begin, end):
        t, blur = hits[j, 0], hits[j, 1]
        again = False
        for k in range(begin, kept):
            same = (hits[k, 1] > 0.0) == (blur > 0.0)
            again |= same and t - hits[k, 0] <= abs(blur) + abs(hits[k, 1])
        if not again:
            for column in range(3):
                hits[kept, column] = hits[j, column]
            kept += 1
    return kept


@njit(cache=True, nogil=True, error_model="numpy")
def search_all(facets, edges, boxes, origins, directions, nearest, units, counts):
    """Find all hits of all rays beyond the distance ``nearest``, entirely in float64.

    Fills ``units`` (n, 3) with unit directions and ``counts`` (n,) with the numbers of hits, -1 for
    an invalid ray. Returns rows (distance, rounding error, triangle), ray by ray and sorted by
    distance. Hits on the same side whose distances differ only by rounding are merged into the
    first.
    """
    first_leaf, corners = boxes.shape[0] // 2, facets.reshape(-1)
    hits = np.empty((2 * origins.shape[0] + 16, 3))
    end = 0
    for i in range(origins.shape[0]):
        o = (origins[i, 0], origins[i, 1], origins[i, 2])
        d = _unit((directions[i, 0], directions[i, 1], directions[i, 2]))
        units[i, 0], units[i, 1], units[i, 2] = d
        if not math.isfinite(o[0] + o[1] + o[2] + d[0] + d[1] + d[2]):
            counts[i] = -1
            continue
        begin = end
        inverse = (1.0 / d[0], 1.0 / d[1], 1.0 / d[2])
        node = 0
        while node >= 0:
            if _entry(boxes, node, o, inverse, nearest, math.inf) == math.inf:
                node = after(node)
                continue
            if node < first_leaf:
                node = 2 * node + 1
                continue
            start = 4 * (node - first_leaf)
            for m in range(start, min(start + 4, facets.shape[0])):
                t = _strike(_row(corners, 9 * m), edges[m], o, d)
                if not t >= nearest:
                    continue
                if end == hits.shape[0]:
                    longer = np.empty((2 * end, 3))
                    longer[:end] = hits
                    hits = longer
                # triangles arrive in their order, which insertion keeps at equal distances
                j = end
                while j > begin and hits[j - 1, 0] > t:
                    for column in range(3):
                        hits[j, column] = hits[j - 1, column]
                    j -= 1
                hits[j, 0], hits[j, 1], hits[j, 2] = (
                    t,
                    _blur(_row(corners, 9 * m), edges[m], o, d),
                    m,
                )
                end += 1
            node = after(node)
        end = _once(hits, begin, end)
        counts[i] = end - begin
    return hits[:end]
