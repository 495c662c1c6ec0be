"""Compiled intersection of rays with triangles.

Every ray is o + t d with unit d and t in m. Rows of ``facets`` (n, 9) are a corner and the two
sides that start at it, in the order of the leaves of the tree ``boxes``. ``edges`` (n,) are the
lengths of the longest sides, m, and ``names`` (n,) the indices in the mesh.

Rows of ``desk`` (n, 8) hold the working data of one ray in one cache line, first origin and
direction, later the hit: point, normal, distance and, as an integer, the triangle's index or -1.
"""

from __future__ import annotations

import math

import numpy as np

from ...kernels.compiling import njit
from ._wall_kernels import HIT, MISS, _unit

BLOCK = 64  # rays processed at once
OX, OY, OZ, DX, DY, DZ, T, DEPTH, NX, NY, NZ, PX, PY, PZ, FACET = range(0, 15 * BLOCK, BLOCK)
ROWS = 24
SIDE = 144  # cells along a side of the octahedral map by which rays are sorted
INDEX = 6  # column of ``rays`` with the number of the ray, as an integer
NAME = 7  # column of ``desk`` with the index of the triangle, as an integer, or -1


@njit(cache=True, inline="always")
def _across(d):
    """Return a unit vector perpendicular to the unit vector d, without branches.

    Duff et al., J. Comput. Graph. Tech. 6(1), 2017.
    """
    sign = math.copysign(1.0, d[2])
    a = -sign / (1.0 + abs(d[2]))
    return 1.0 + sign * a * d[0] * d[0], sign * a * d[0] * d[1], -sign * d[0]


@njit(cache=True, error_model="numpy")
def _entry(boxes, node, o, inverse, low, high):
    """Return the distance at which a ray enters an axis-parallel box, m; inf if it misses the box.

    Row ``node`` of ``boxes`` (n, 6) holds the low and the high corner. Only distances from ``low``
    to ``high`` count. ``inverse`` (3,) is 1 / d, infinite for a component of d that is zero.
    """
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


@njit(cache=True, inline="always", error_model="numpy")
def _bin(x, y, z, dx, dy, dz):
    """Return the number of the cell, 0 to SIDE^2 - 1, by which a ray is sorted.

    Rays of one cell pass through much the same part of the mesh. The point (x, y, z), scaled to the
    mesh's size, is moved along the unit vector (dx, dy, dz) to a sphere around the mesh. The sphere
    is mapped to a square by unfolding an octahedron (Meyer et al. 2010).
    """
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


@njit(cache=True, inline="always", error_model="numpy")
def _landing(row, o, d, t):
    """Return hit point (m) and unit normal of a ray at the distance t, m, on the triangle ``row``.

    ``row`` (9,) holds a corner and two sides. The normal points to the side the ray comes from.
    """
    nx = row[4] * row[8] - row[5] * row[7]
    ny = row[5] * row[6] - row[3] * row[8]
    nz = row[3] * row[7] - row[4] * row[6]
    along = nx * d[0] + ny * d[1] + nz * d[2]
    size = math.copysign(1.0 / math.sqrt(nx * nx + ny * ny + nz * nz), -along)
    p = (o[0] + t * d[0], o[1] + t * d[1], o[2] + t * d[2])
    return p, (nx * size, ny * size, nz * size)


@njit(cache=True, inline="always", error_model="numpy")
def _head(w, centre, half):
    """Normalise the directions of a block of rays, and count the rays that start outside a box.

    The box has the centre ``centre`` and the half sides ``half``, both (3,), m. The count is NaN if
    a ray is invalid. ``w`` holds rows of BLOCK numbers at the offsets OX, OY, and so on. Fixed
    distances between the rows and loops without branches let the compiler vectorise over rays.
    """
    outside = bad = 0.0
    for i in range(BLOCK):
        x, y, z = _unit((w[DX + i], w[DY + i], w[DZ + i]))
        w[DX + i], w[DY + i], w[DZ + i], w[T + i], w[DEPTH + i] = x, y, z, 0.0, 0.0
        px, py, pz = w[OX + i] - centre[0], w[OY + i] - centre[1], w[OZ + i] - centre[2]
        within = (abs(px) < half[0]) & (abs(py) < half[1]) & (abs(pz) < half[2])
        outside += 0.0 if within else 1.0
        bad += 0.0 * (px + py + pz + x + y + z)
    return outside + bad


@njit(cache=True, inline="always", error_model="numpy")
def _prepare(w, centre, shrink, aside, cells):
    """Compute the displaced starts of a block of rays for Embree, and their sorting cells.

    The starts go to the rows PX, PY and PZ of ``w``, in units of 1 / ``shrink`` about ``centre``
    (3,). They are displaced by ``aside``, m, sideways and by 8 times as much backward. ``cells``
    (BLOCK,) receives the numbers of `_bin`.
    """
    for i in range(BLOCK):
        d, back = (w[DX + i], w[DY + i], w[DZ + i]), w[T + i] - 8.0 * aside
        e = _across(d)
        x = (w[OX + i] + back * d[0] - centre[0] + aside * e[0]) * shrink
        y = (w[OY + i] + back * d[1] - centre[1] + aside * e[1]) * shrink
        z = (w[OZ + i] + back * d[2] - centre[2] + aside * e[2]) * shrink
        w[PX + i], w[PY + i], w[PZ + i] = x, y, z
        cells[i] = _bin(x, y, z, d[0], d[1], d[2])


@njit(cache=True, nogil=True, error_model="numpy")
def enter(origins, directions, limits, centre, scale, aside, desk, loose, bins, rays):
    """Prepare rays in float64, and in float32 for Embree those that meet the box ``limits`` (1, 6).

    Rows of ``desk`` are filled with origin, unit direction, an unused column and -1. Rows of
    ``rays`` (n, 8), float32, are filled with start, direction and, as an integer, the number of the
    ray. They are sorted so that similar rays follow each other, for the processor's caches;
    ``loose`` and ``bins`` are buffers for sorting.

    Starts are in units of ``scale`` about ``centre``, at the entry into the box. They are displaced
    sideways by ``aside``, so that a ray aimed at a vertex passes next to it. They are also moved
    back by 8 ``aside``, so that triangles in front of the origin remain in front.

    Returns the number of rays for Embree, or -1 if a ray has NaN, infinity or a zero direction.
    """
    kept = 0
    numbers, names = loose.view(np.int32), desk.view(np.int64)
    counts = np.zeros(SIDE * SIDE + 1, dtype=np.int32)
    half = 0.5 * (limits[0, 3:] - limits[0, :3])
    w, cells = np.ones(ROWS * BLOCK), np.empty(BLOCK, dtype=np.int32)
    for start in range(0, origins.shape[0], BLOCK):
        n = min(BLOCK, origins.shape[0] - start)
        for i in range(n):
            for k in range(3):
                w[k * BLOCK + i] = origins[start + i, k]
                w[DX + k * BLOCK + i] = directions[start + i, k]
        outside = _head(w, centre, half)
        if not math.isfinite(outside):
            return -1
        for i in range(n):
            for k in range(6):
                desk[start + i, k] = w[k * BLOCK + i]
            names[start + i, NAME] = -1
        if outside > 0.0:
            for i in range(n):
                o = (w[OX + i], w[OY + i], w[OZ + i])
                inverse = (1.0 / w[DX + i], 1.0 / w[DY + i], 1.0 / w[DZ + i])
                w[DEPTH + i] = _entry(limits, 0, o, inverse, 0.0, math.inf)
                w[T + i] = w[DEPTH + i] if w[DEPTH + i] < math.inf else 0.0
        _prepare(w, centre, 1.0 / scale, aside, cells)
        for i in range(n):
            if w[DEPTH + i] == math.inf:
                continue
            for k in range(3):
                loose[kept, k] = w[PX + k * BLOCK + i]
                loose[kept, k + 3] = w[DX + k * BLOCK + i]
            numbers[kept, INDEX] = start + i
            bins[kept] = cells[i]
            counts[cells[i] + 1] += 1
            kept += 1
    for k in range(1, counts.size):
        counts[k] += counts[k - 1]
    sorted_rays, rows = rays.view(np.int64), loose.view(np.int64)
    for j in range(kept):
        to = counts[bins[j]]
        counts[bins[j]] += 1
        for k in range(4):
            sorted_rays[to, k] = rows[j, k]
    return kept


@njit(cache=True)
def _facet(row, o, d):
    """Return three signed volumes that locate a ray on a triangle, their sum, and the distance.

    The volumes divided by their sum are barycentric coordinates: the ray hits the triangle ``row``
    = (a, b - a, c - a) if none is negative. The distance is in m.
    """
    sx, sy, sz = o[0] - row[0], o[1] - row[1], o[2] - row[2]
    ax, ay, az, bx, by, bz = row[3], row[4], row[5], row[6], row[7], row[8]
    px, py, pz = d[1] * bz - d[2] * by, d[2] * bx - d[0] * bz, d[0] * by - d[1] * bx
    qx, qy, qz = sy * az - sz * ay, sz * ax - sx * az, sx * ay - sy * ax
    det = ax * px + ay * py + az * pz
    u = sx * px + sy * py + sz * pz
    v = d[0] * qx + d[1] * qy + d[2] * qz
    t = (bx * qx + by * qy + bz * qz) / det
    side, det = math.copysign(1.0, det), abs(det)
    u, v = side * u, side * v
    return u, v, det - u - v, det, t


@njit(cache=True)
def _row(numbers, start, step):
    """Return nine numbers of a flat array, ``step`` apart from index ``start`` on, as a tuple.

    Array views would be reference-counted by atomic operations, which slow down parallel threads.
    """
    return (
        numbers[start],
        numbers[start + step],
        numbers[start + 2 * step],
        numbers[start + 3 * step],
        numbers[start + 4 * step],
        numbers[start + 5 * step],
        numbers[start + 6 * step],
        numbers[start + 7 * step],
        numbers[start + 8 * step],
    )


@njit(cache=True, inline="always", error_model="numpy")
def _land(w):
    """Compute where the rays of a block meet the planes of their triangles.

    In ``w``, rows of BLOCK numbers, the rows OX to DZ hold the rays and nine rows from FACET on the
    triangles. The results are distance (T, m), smallest signed volume of `_facet` (DEPTH), unit
    normal (NX to NZ) and point (PX to PZ, m). Fixed distances between the rows and a loop without
    branches let the compiler vectorise over rays.
    """
    for i in range(BLOCK):
        o, d = (w[OX + i], w[OY + i], w[OZ + i]), (w[DX + i], w[DY + i], w[DZ + i])
        row = _row(w, FACET + i, BLOCK)
        a, b, c, _, t = _facet(row, o, d)
        a = b if b < a else a
        w[T + i], w[DEPTH + i] = t, c if c < a else a
        p, n = _landing(row, o, d, t)
        w[PX + i], w[PY + i], w[PZ + i] = p
        w[NX + i], w[NY + i], w[NZ + i] = n


@njit(cache=True, nogil=True, error_model="numpy")
def place(facets, edges, names, desk, rays, ids, margin, nearest, farthest):
    """Accept the triangles that Embree found if float64 arithmetic confirms them beyond doubt.

    Rows of ``desk`` receive the hits. ``ids`` (n,) are the positions in ``facets`` of the triangles
    found, or -1. ``margin`` is the largest lateral error of Embree, m. ``nearest``, m, and
    ``farthest`` (n,), m, limit the distance; an empty ``farthest`` is no limit. Doubtful rays and
    rays without a triangle are moved to the front of ``rays`` and ``ids``; their number is
    returned.
    """
    doubtful = 0
    numbers, rows, named = rays.view(np.int32), rays.view(np.int64), desk.view(np.int64)
    w = np.zeros(ROWS * BLOCK)
    for start in range(0, ids.size, BLOCK):
        count = min(BLOCK, ids.size - start)
        for n in range(count):
            i, k = numbers[start + n, INDEX], max(ids[start + n], 0)
            for m in range(6):
                w[m * BLOCK + n] = desk[i, m]
            for m in range(9):
                w[FACET + m * BLOCK + n] = facets[k, m]
        _land(w)
        for n in range(count):
            j = start + n
            i, k = numbers[j, INDEX], ids[j]
            # a hit must be inside the triangle by more than ``margin``; a strip of this width along
            # a side has at most the volume margin * edge
            if k >= 0 and w[DEPTH + n] > margin * edges[k] and w[T + n] >= nearest:
                if farthest.size == 0 or w[T + n] <= farthest[i]:
                    for m in range(3):
                        desk[i, m] = w[PX + m * BLOCK + n]
                        desk[i, m + 3] = w[NX + m * BLOCK + n]
                    desk[i, 6] = w[T + n]
                    named[i, NAME] = names[k]
                continue
            ids[doubtful] = k
            for m in range(4):
                rows[doubtful, m] = rows[j, m]
            doubtful += 1
    return doubtful


@njit(cache=True, nogil=True)
def finish(desk, distance, points, normals, triangle, status):
    """Copy the rows of ``desk`` to the result arrays, with NaN for rays without a hit."""
    names = desk.view(np.int64)
    for i in range(distance.size):
        hit = names[i, NAME] >= 0
        triangle[i], status[i] = names[i, NAME], HIT if hit else MISS
        distance[i] = desk[i, 6] if hit else math.nan
        for k in range(3):
            points[i, k] = desk[i, k] if hit else math.nan
            normals[i, k] = desk[i, k + 3] if hit else math.nan


@njit(cache=True, nogil=True)
def aside(rays, shift, turn, out):
    """Fill ``out`` (n, 6) with copies of rays that are displaced sideways by ``shift``.

    ``turn`` is the azimuth of the displacement, rad. ``shift`` has the unit of the rays' starts.
    """
    cosine, sine = math.cos(turn), math.sin(turn)
    for j in range(rays.shape[0]):
        d = (rays[j, 3], rays[j, 4], rays[j, 5])
        e = _across(d)
        f = (d[1] * e[2] - d[2] * e[1], d[2] * e[0] - d[0] * e[2], d[0] * e[1] - d[1] * e[0])
        norm = shift / math.sqrt(e[0] * e[0] + e[1] * e[1] + e[2] * e[2])
        for k in range(3):
            out[j, k] = rays[j, k] + norm * (cosine * e[k] + sine * f[k])
            out[j, k + 3] = d[k]


@njit(cache=True, inline="always")
def after(node):
    """Return the node that follows the subtree of ``node`` in depth-first order; -1 at the end.

    The nodes of the complete binary tree are numbered level by level from the root, 0.
    """
    while node > 0 and node & 1 == 0:  # a second child ends the subtree of its parent too
        node = (node >> 1) - 1
    return node + 1 if node > 0 else -1


@njit(cache=True, error_model="numpy")
def _strike(row, edge, o, d):
    """Return the distance to a triangle, m, including its edges and corners; NaN if it is missed.

    ``edge`` is the length of the triangle's longest side, m, which scales the rounding error.
    """
    u, v, w, det, t = _facet(row, o, d)
    away = abs(o[0] - row[0]) + abs(o[1] - row[1]) + abs(o[2] - row[2])
    # the rounding error of the volumes, so that no ray passes between adjacent triangles
    slack = 4e-16 * (away + edge) * edge
    return t if det > 0.0 and min(u, v, w) >= -slack else math.nan


@njit(cache=True, nogil=True, error_model="numpy")
def search(facets, edges, names, boxes, desk, index, nearest, farthest):
    """Find the first triangle of each ray of ``index`` within its distance limits, in float64 only.

    Rows of ``desk`` receive the hits. ``boxes`` (m, 6) is a complete binary tree of low and high
    corners, with four triangles per leaf. ``nearest``, m, and ``farthest`` (n,), m, limit the
    distance; an empty ``farthest`` is no limit. Among triangles at the same distance, the first one
    in ``facets`` is taken.
    """
    first_leaf, corners = boxes.shape[0] // 2, facets.reshape(-1)
    stack, entries, named = np.empty(128, dtype=np.int64), np.empty(128), desk.view(np.int64)
    for j in range(index.size):
        i = index[j]
        o = (desk[i, 0], desk[i, 1], desk[i, 2])
        d = (desk[i, 3], desk[i, 4], desk[i, 5])
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
                t = _strike(_row(corners, 9 * m, 1), edges[m], o, d)
                if nearest <= t <= best and (t < best or chosen < 0 or m < chosen):
                    best, chosen = t, m
        if chosen >= 0:
            point, normal = _landing(_row(corners, 9 * chosen, 1), o, d, best)
            desk[i, 0], desk[i, 1], desk[i, 2] = point
            desk[i, 3], desk[i, 4], desk[i, 5] = normal
            desk[i, 6], named[i, NAME] = best, names[chosen]


@njit(cache=True, error_model="numpy")
def _blur(row, edge, o, d):
    """Return the rounding error of a hit's distance, m, with the sign of the triangle's side.

    ``edge`` is the length of the triangle's longest side, m.
    """
    nx = row[4] * row[8] - row[5] * row[7]
    ny = row[5] * row[6] - row[3] * row[8]
    nz = row[3] * row[7] - row[4] * row[6]
    det = nx * d[0] + ny * d[1] + nz * d[2]
    away = abs(o[0] - row[0]) + abs(o[1] - row[1]) + abs(o[2] - row[2])
    return 4e-15 * (away + edge) * edge * edge / det


@njit(cache=True, nogil=True)
def _once(hits, begin, end):
    """Remove repeated hits of one ray from the rows ``begin`` to ``end``; return the new end.

    Rows of ``hits`` are (distance, signed rounding error, triangle), sorted by distance. A hit is
    repeated if an earlier one is on the same side at the same distance within rounding, as on the
    common edge of two triangles.
    """
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
                t = _strike(_row(corners, 9 * m, 1), edges[m], o, d)
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
                    _blur(_row(corners, 9 * m, 1), edges[m], o, d),
                    m,
                )
                end += 1
            node = after(node)
        end = _once(hits, begin, end)
        counts[i] = end - begin
    return hits[:end]
