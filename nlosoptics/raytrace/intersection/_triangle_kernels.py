"""Where rays meet triangles, compiled.

Every ray is o + t d with unit d and t in m. Rows of ``facets`` are a corner and the two sides from
it, (n, 9), in the order of the leaves of the tree of ``boxes``; ``edges`` are the longest side of
each, m.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from ._wall_kernels import HIT, MISS, _unit

BLOCK = 64  # rays at a time
OX, OY, OZ, DX, DY, DZ, T, DEPTH, NX, NY, NZ, PX, PY, PZ, FACET = range(0, 15 * BLOCK, BLOCK)
ROWS = 24
SIDE = 144  # cells along a side of the map of directions by which rays are sorted
INDEX = 6  # column of a ray's number in its row of what Embree gets
NAME = 7  # column of a triangle's number, -1 for none, in a row of the desk


@njit(cache=True, inline="always")
def _across(d):
    """A unit vector across the unit vector d, without a jump (Duff et al. 2017)."""
    sign = math.copysign(1.0, d[2])
    a = -sign / (1.0 + abs(d[2]))
    return 1.0 + sign * a * d[0] * d[0], sign * a * d[0] * d[1], -sign * d[0]


@njit(cache=True, error_model="numpy")
def _entry(boxes, node, o, inverse, low, high):
    """Distance at which a ray enters a box between low and high, inf where it does not.

    ``inverse`` is 1 / d, infinite along an axis along which the ray does not move.
    """
    for k in range(3):
        near, far = boxes[node, k] - o[k], boxes[node, k + 3] - o[k]
        if abs(inverse[k]) == math.inf:
            if near > 0.0 or far < 0.0:
                return math.inf
        else:
            p, q = near * inverse[k], far * inverse[k]
            low, high = max(low, min(p, q)), min(high, max(p, q))
    # three roundings of either
    return low if low <= high + 1e-15 * (abs(low) + abs(high)) else math.inf


@njit(cache=True, inline="always", error_model="numpy")
def _bin(x, y, z, dx, dy, dz):
    """Cell of an octahedral map of where a ray's middle in the unit ball, pushed out along it, is.

    Rays of one cell meet much the same triangles. Meyer et al. 2010 unfold the octahedron.
    """
    b, c = x * dx + y * dy + z * dz, x * x + y * y + z * z
    t = math.sqrt(max(b * b - c + 1.5, 0.0)) - b
    x, y, z = x + t * dx, y + t * dy, z + t * dz
    shrink = 1.0 / (abs(x) + abs(y) + abs(z) + 1e-30)
    x, y = x * shrink, y * shrink
    below = 0.5 - math.copysign(0.5, z)  # a factor, as a jump would be guessed wrong half the time
    u = x + below * (math.copysign(1.0 - abs(y), x) - x)
    v = y + below * (math.copysign(1.0 - abs(x), y) - y)
    # short of SIDE at 1 and rounding beyond
    return int((u + 1.0) * (0.4999 * SIDE)) * SIDE + int((v + 1.0) * (0.4999 * SIDE))


@njit(cache=True, inline="always", error_model="numpy")
def _landing(row, o, d, t):
    """Point and normal, against the ray, where a ray meets a triangle at t."""
    nx = row[4] * row[8] - row[5] * row[7]
    ny = row[5] * row[6] - row[3] * row[8]
    nz = row[3] * row[7] - row[4] * row[6]
    along = nx * d[0] + ny * d[1] + nz * d[2]
    size = math.copysign(1.0 / math.sqrt(nx * nx + ny * ny + nz * nz), -along)
    p = (o[0] + t * d[0], o[1] + t * d[1], o[2] + t * d[2])
    return p, (nx * size, ny * size, nz * size)


@njit(cache=True, inline="always", error_model="numpy")
def _head(w, centre, half):
    """Make directions of a block units; return 0 if all start in the box, NaN if a ray is bad.

    ``w`` holds rows of BLOCK numbers. Rows of one array at fixed distances and loops without jumps
    let the compiler work on several rays at once.
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
    """Starts of a block of rays for Embree, as points of ``w``, and the cells they sort into."""
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
    """Rays in float64, and what Embree gets of those that meet the box ``limits`` (1, 6).

    Rows of ``desk`` (n, 8), one cache line each, become origin, unit direction, an unused column
    and -1. Rows of ``rays`` (n, 8), float32, become start, head and, as an integer, the ray's
    number, sorted so that rays alike follow each other, for the processor's caches; ``loose`` and
    ``bins`` are room for this. Starts are in units of ``scale`` about ``centre``, from where a ray
    enters the box. They stand ``aside`` of the ray, so that one aimed at a vertex passes beside it,
    and as far back eightfold, so that what the ray starts in front of is still in front of it.
    Returns the number kept, or -1 where a ray holds NaN, infinity or no direction.
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
    """Signed volumes (u, v, w), their sum and the distance of a triangle (a, b - a, c - a)."""
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
    """Nine numbers of a flat array as a tuple: views would be counted, which threads wait for."""
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
    """Distance, depth within the triangle, normal and point of a block of rays on triangles.

    ``w`` holds rows of BLOCK numbers, OX to FACET and the rest of a triangle. Rows of one array at
    fixed distances and a loop without jumps let the compiler work on several rays at once.
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
    """Accept Embree's triangles where float64 agrees beyond doubt; return the others' number.

    Rows of the ``desk`` become point, normal, distance and the triangle's name. ``margin`` is how
    far aside Embree may be, m; ``farthest`` is empty where there is no limit. Rays in doubt move to
    the front of ``rays`` and ``ids``, those without a triangle included.
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
            # volumes over det are barycentric; margin * edge is the volume of a strip
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
    """Take apart the rows of the desk, with NaN where a ray meets nothing."""
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
    """Copies of rays ``shift`` away from where they are, in the direction ``turn`` around them."""
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
    """Node that follows all below ``node`` in a complete binary tree; -1 where none does."""
    while node > 0 and node & 1 == 0:  # a second child: its parent is done with it
        node = (node >> 1) - 1
    return node + 1 if node > 0 else -1


@njit(cache=True, error_model="numpy")
def _strike(row, edge, o, d):
    """Distance of a triangle, edges and corners included, or NaN."""
    u, v, w, det, t = _facet(row, o, d)
    away = abs(o[0] - row[0]) + abs(o[1] - row[1]) + abs(o[2] - row[2])
    # rounding of the volumes, so that no ray slips between two triangles
    slack = 4e-16 * (away + edge) * edge
    return t if det > 0.0 and min(u, v, w) >= -slack else math.nan


@njit(cache=True, nogil=True, error_model="numpy")
def search(facets, edges, names, boxes, desk, index, nearest, farthest):
    """First triangle of every ray of ``index`` between its limits, in float64 throughout.

    Rows of the ``desk`` become as in `place`. ``boxes`` (n, 6) is a complete binary tree, low and
    high corners; its leaves hold four triangles each. Of triangles at the same distance the first
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
    """Rounding of a hit's distance, m, with the sign of the side that is hit."""
    nx = row[4] * row[8] - row[5] * row[7]
    ny = row[5] * row[6] - row[3] * row[8]
    nz = row[3] * row[7] - row[4] * row[6]
    det = nx * d[0] + ny * d[1] + nz * d[2]
    away = abs(o[0] - row[0]) + abs(o[1] - row[1]) + abs(o[2] - row[2])
    return 4e-15 * (away + edge) * edge * edge / det


@njit(cache=True, nogil=True)
def _once(hits, begin, end):
    """Drop from sorted rows those that repeat one before them; return where they end."""
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
    """Every hit of every ray beyond ``nearest``, in float64 throughout.

    Fills unit directions and the number of hits of each ray (-1: it is none). Returns rows
    (distance, rounding, triangle), ray by ray and sorted by distance. Hits that differ by rounding
    and are of one side are one, that of the first row.
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
                # triangles come in their order, so that those at one distance stay in it
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
