"""Light from the cells of a plane to wall points, past the exact shadows of triangle meshes.

Coordinates (u, v) on the plane are in units of cells: u along a row, v from row to row. The shadow
of a mesh, seen from a point, is the union of its projected triangles. Edges between triangles of
the same orientation cancel; a line that sweeps over the others leaves the outline of the union.
Line integrals along the outline give the covered area of each cell, and its rate of change.
"""

from __future__ import annotations

import math

import numpy as np

from ..kernels import brdf
from ..kernels.compiling import njit

NEAR = 1e-9  # nearest and farthest part of a path, as a fraction, that an occluder can block
# Direction of the sweep, rad: edges along rows and columns of cells are not parallel to its line
SWEEP = 0.3


@njit(cache=True)
def _project(places, speeds, i, point, frame, at, height, out, out_rate):
    """Project place ``i`` (n, 3) and its velocities (n, m, 3) from a point onto the plane.

    ``out`` (n, 3) gets depth, 1 on the plane, and u, v; ``out_rate`` (n, m, 2) their velocities.
    """
    depth, across, down = 0.0, 0.0, 0.0
    for k in range(3):
        step = places[i, k] - point[k]
        depth += frame[3, k] * step
        across += frame[1, k] * step
        down += frame[2, k] * step
    depth /= height
    out[i, 0] = depth
    if depth < 0.5 * NEAR:
        return
    across, down = across / depth, down / depth
    out[i, 1], out[i, 2] = at[0] + across, at[1] + down
    for m in range(speeds.shape[1]):
        deeper, right, lower = 0.0, 0.0, 0.0
        for k in range(3):
            deeper += frame[3, k] * speeds[i, m, k] / height
            right += frame[1, k] * speeds[i, m, k]
            lower += frame[2, k] * speeds[i, m, k]
        out_rate[i, m, 0] = (right - deeper * across) / depth
        out_rate[i, m, 1] = (lower - deeper * down) / depth


@njit(cache=True)
def _append(flat, flat_rate, a, b, weight, mesh, edges, weights, rates, count):
    """Append the edge between two projected places of a mesh; return the new count."""
    weights[count], edges[count, 4] = weight, mesh
    for k in range(2):
        edges[count, k], edges[count, 2 + k] = flat[a, 1 + k], flat[b, 1 + k]
        for m in range(rates.shape[1]):
            rates[count, m, k], rates[count, m, 2 + k] = flat_rate[a, m, k], flat_rate[b, m, k]
    return count + 1


@njit(cache=True)
def _between(corners, rates, depth, i, j, t, out, out_rate, out_depth, at):
    """Set corner ``at`` to the point at the part ``t`` of the way from corner i to corner j."""
    for k in range(3):
        out[at, k] = corners[i, k] + t * (corners[j, k] - corners[i, k])
        for m in range(rates.shape[1]):
            out_rate[at, m, k] = rates[i, m, k] + t * (rates[j, m, k] - rates[i, m, k])
    for m in range(depth.shape[1]):
        out_depth[at, m] = depth[i, m] + t * (depth[j, m] - depth[i, m])


@njit(cache=True)
def _clipped(corners, rates, depth, count, level, above, out, out_rate, out_depth):
    """Clip a convex polygon to depths above or below a level; return the number of its corners.

    ``depth`` (count, 1 + m), linear in space, is followed by its m rates. A new corner moves with
    the edge that it cuts, in the plane of this depth.
    """
    size = 0
    for i in range(count):
        j = (i + 1) % count
        first, second = depth[i, 0] - level, depth[j, 0] - level
        if not above:
            first, second = -first, -second
        if first >= 0.0:
            _between(corners, rates, depth, i, i, 0.0, out, out_rate, out_depth, size)
            size += 1
        if (first >= 0.0) != (second >= 0.0):
            t = first / (first - second)
            _between(corners, rates, depth, i, j, t, out, out_rate, out_depth, size)
            for m in range(rates.shape[1]):
                slide = -out_depth[size, 1 + m] / (depth[j, 0] - depth[i, 0])
                out_depth[size, 1 + m] = 0.0
                for k in range(3):
                    out_rate[size, m, k] += slide * (corners[j, k] - corners[i, k])
            out_depth[size, 0] = level
            size += 1
    return size


@njit(cache=True)
def outline(point, frame, shape, mesh, speeds, edges, weights, rates, count):
    """Append the projected edges of a mesh that do not cancel; return the new count.

    ``mesh`` is `penumbra.Edges.arrays`; ``speeds`` (n_vertices, m, 3) are velocities of its
    vertices. Edges (u, v, u, v, number of the mesh) have the covered side on their left ``weights``
    times.
    """
    vertices, faces, ends, starts, sides, turned, groups = mesh
    n_rates = speeds.shape[1]
    height = 0.0
    at = np.zeros(2)
    for k in range(3):
        height += frame[3, k] * (frame[0, k] - point[k])
        at[0] += frame[1, k] * (point[k] - frame[0, k])
        at[1] += frame[2, k] * (point[k] - frame[0, k])
    if height == 0.0:
        return count
    flat, flat_rate = np.empty((len(vertices), 3)), np.empty((len(vertices), n_rates, 2))
    turn = np.zeros(len(faces), dtype=np.int64)
    corners, other = np.empty((5, 3)), np.empty((5, 3))
    moves, other_moves = np.empty((5, n_rates, 3)), np.empty((5, n_rates, 3))
    depth, other_depth = np.empty((5, 1 + n_rates)), np.empty((5, 1 + n_rates))
    seen, seen_rate = np.empty((5, 3)), np.empty((5, n_rates, 2))
    for g in range(len(groups)):
        v0, v1, f0, f1, e0, e1 = groups[g]  # first and last vertices, faces and edges
        nearest, farthest = np.inf, -np.inf
        left, right, top, bottom = np.inf, -np.inf, np.inf, -np.inf
        for v in range(v0, v1):
            _project(vertices, speeds, v, point, frame, at, height, flat, flat_rate)
            nearest, farthest = min(nearest, flat[v, 0]), max(farthest, flat[v, 0])
            left, right = min(left, flat[v, 1]), max(right, flat[v, 1])
            top, bottom = min(top, flat[v, 2]), max(bottom, flat[v, 2])
        if farthest <= NEAR or nearest >= 1.0 - NEAR:
            continue
        between = nearest >= NEAR and farthest <= 1.0 - NEAR
        if between and (right <= 0.0 or bottom <= 0.0 or left >= shape[1] or top >= shape[0]):
            continue
        for f in range(f0, f1):
            a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
            turn[f] = 0
            near = min(flat[a, 0], flat[b, 0], flat[c, 0])
            far = max(flat[a, 0], flat[b, 0], flat[c, 0])
            if near >= NEAR and far <= 1.0 - NEAR:
                area = (flat[b, 1] - flat[a, 1]) * (flat[c, 2] - flat[a, 2])
                area -= (flat[c, 1] - flat[a, 1]) * (flat[b, 2] - flat[a, 2])
                turn[f] = 1 if area > 0.0 else -1
                continue
            if far <= NEAR or near >= 1.0 - NEAR:
                continue
            for i in range(3):
                v = faces[f, i]
                depth[i, 0] = flat[v, 0]
                depth[i, 1:] = 0.0
                for k in range(3):
                    corners[i, k] = vertices[v, k]
                    for m in range(n_rates):
                        moves[i, m, k] = speeds[v, m, k]
                        depth[i, 1 + m] += frame[3, k] * speeds[v, m, k] / height
            n = _clipped(corners, moves, depth, 3, NEAR, True, other, other_moves, other_depth)
            n = _clipped(
                other, other_moves, other_depth, n, 1.0 - NEAR, False, corners, moves, depth
            )
            area = 0.0
            for i in range(n):
                _project(corners, moves, i, point, frame, at, height, seen, seen_rate)
            for i in range(2, n):
                area += (seen[i - 1, 1] - seen[0, 1]) * (seen[i, 2] - seen[0, 2])
                area -= (seen[i, 1] - seen[0, 1]) * (seen[i - 1, 2] - seen[0, 2])
            for i in range(n):
                count = _append(
                    seen,
                    seen_rate,
                    i,
                    (i + 1) % n,
                    1 if area > 0.0 else -1,
                    g,
                    edges,
                    weights,
                    rates,
                    count,
                )
        for e in range(e0, e1):
            weight = 0
            for k in range(starts[e], starts[e + 1]):
                weight += turned[k] * turn[sides[k]]
            if weight != 0:
                a, b = ends[e, 0], ends[e, 1]
                count = _append(flat, flat_rate, a, b, weight, g, edges, weights, rates, count)
    return count


@njit(cache=True)
def union(edges, weights, count, pieces):
    """Find the outline of all that is covered at least once; return the number of its pieces.

    Pieces (n, 4) are the index of an edge, the part of it from and to, 0 to 1 along the sweep, and
    the side: 1 if the piece enters the covered area in the sweep's line, -1 if it leaves. Only as
    many as ``pieces`` has room for are stored.
    """
    cosine, sine = math.cos(SWEEP), math.sin(SWEEP)
    low, high, start, slope = (np.empty(count), np.empty(count), np.empty(count), np.empty(count))
    step = np.empty(count, dtype=np.int64)
    for e in range(count):
        s0 = cosine * edges[e, 1] + sine * edges[e, 0]
        s1 = cosine * edges[e, 3] + sine * edges[e, 2]
        t0 = cosine * edges[e, 0] - sine * edges[e, 1]
        t1 = cosine * edges[e, 2] - sine * edges[e, 3]
        step[e] = -weights[e]
        if s0 > s1:
            s0, s1, t0, t1, step[e] = s1, s0, t1, t0, weights[e]
        low[e], high[e], start[e] = s0, s1, t0
        slope[e] = (t1 - t0) / (s1 - s0) if s1 > s0 else 0.0
    order = np.argsort(low)
    active, side, since = np.empty(count, np.int64), np.zeros(count, np.int64), np.zeros(count)
    here = np.empty(count)
    n_active, following, n_pieces, s = 0, 0, 0, -np.inf
    while following < count or n_active > 0:
        if n_active == 0:
            s = low[order[following]]
        while following < count and low[order[following]] <= s:
            e = order[following]
            if high[e] > s:
                active[n_active] = e
                n_active += 1
            following += 1
        stop = low[order[following]] if following < count else np.inf
        for i in range(n_active):
            stop = min(stop, high[active[i]])
        # the order of two edges changes once at most before ``stop``
        for _ in range(n_active * n_active + 1):
            for i in range(n_active):
                e = active[i]
                here[e] = start[e] + (s - low[e]) * slope[e]
                j = i
                while j > 0 and (
                    here[active[j - 1]] > here[e]
                    or (here[active[j - 1]] == here[e] and slope[active[j - 1]] > slope[e])
                ):
                    active[j] = active[j - 1]
                    j -= 1
                active[j] = e
            end = stop
            for i in range(1, n_active):
                a, b = active[i - 1], active[i]
                gap = here[b] - here[a]
                lost = (slope[a] - slope[b]) * (stop - s) - gap
                if lost > 1e-12 * max(1.0, abs(here[a])):
                    end = min(end, s + gap / (gap + lost) * (stop - s))
            if end < stop:
                end = max(end, s + 1e-12 * max(1.0, abs(s)))
            if end > stop:
                end = stop
            layers = 0
            for i in range(n_active):
                e = active[i]
                after = layers + step[e]
                now = 1 if layers == 0 and after != 0 else 0
                if layers != 0 and after == 0:
                    now = -1
                layers = after
                if now != side[e]:
                    if side[e] != 0:
                        n_pieces = _add(pieces, n_pieces, e, since[e], s, low, high, side[e])
                    side[e], since[e] = now, s
            s = end
            if s >= stop:
                break
        left = 0
        for i in range(n_active):
            e = active[i]
            if high[e] > s:
                active[left] = e
                left += 1
            elif side[e] != 0:
                n_pieces = _add(pieces, n_pieces, e, since[e], s, low, high, side[e])
        n_active = left
    return n_pieces


@njit(cache=True)
def _add(pieces, n, edge, since, until, low, high, side):
    if n < len(pieces):
        length = high[edge] - low[edge]
        pieces[n, 0], pieces[n, 3] = edge, side
        pieces[n, 1] = max((since - low[edge]) / length, 0.0)
        pieces[n, 2] = min((until - low[edge]) / length, 1.0)
    return n + 1


@njit(cache=True)
def _upward(edges, e):
    """Return the edge's ends and whether they are exchanged, so that the sweep meets A first."""
    u0, v0, u1, v1 = edges[e, 0], edges[e, 1], edges[e, 2], edges[e, 3]
    cosine, sine = math.cos(SWEEP), math.sin(SWEEP)
    if cosine * v0 + sine * u0 > cosine * v1 + sine * u1:
        return u1, v1, u0, v0, True
    return u0, v0, u1, v1, False


@njit(cache=True)
def cover(edges, pieces, n_pieces, covered):
    """Set ``covered`` (rows, columns + 1) to the covered share of each cell; the last is spare."""
    rows, columns = covered.shape[0], covered.shape[1] - 1
    covered[:] = 0.0
    none = np.empty((0, 0))
    _differences(edges, pieces, n_pieces, (rows, columns), covered, (none, none, none, none))
    for row in range(rows):
        total = 0.0
        for column in range(columns):
            total += covered[row, column]
            covered[row, column] = min(max(total, 0.0), 1.0)


@njit(cache=True)
def _differences(edges, pieces, n_pieces, shape, covered, light):
    """Add the differences of the covered share along each row, see `_put`."""
    rows, columns = shape
    for p in range(n_pieces):
        a_u, a_v, b_u, b_v, _ = _upward(edges, int(pieces[p, 0]))
        u0, v0 = a_u + pieces[p, 1] * (b_u - a_u), a_v + pieces[p, 1] * (b_v - a_v)
        u1, v1 = a_u + pieces[p, 2] * (b_u - a_u), a_v + pieces[p, 2] * (b_v - a_v)
        sign = pieces[p, 3]
        if v0 > v1:
            u0, v0, u1, v1, sign = u1, v1, u0, v0, -sign
        if v1 <= 0.0 or v0 >= rows or v0 == v1 or min(u0, u1) >= columns:
            continue
        slope = (u1 - u0) / (v1 - v0)
        v, stop = max(v0, 0.0), min(v1, float(rows))
        row = int(v)
        while v < stop and row < rows:
            above = min(stop, row + 1.0)
            x0, x1 = u0 + (v - v0) * slope, u0 + (above - v0) * slope
            if x0 > x1:
                x0, x1 = x1, x0
            _cover_row(covered, light, row, x0, x1, sign * (above - v), columns)
            v = above
            row += 1


@njit(cache=True)
def _put(covered, light, row, column, share):
    """Add a difference to ``covered`` or, if that is empty, its light to the last of ``light``.

    ``light`` holds the radiance due to blocks of cells (n, m); of each cell, the sum of the picture
    over the cells to the right of it in its block, itself included (rows, columns); the light of
    all blocks to the right of each block, in each row of cells (rows, m); and the sum (1, 1).
    """
    if covered.size:
        covered[row, column] += share
        return
    radiance, right, beyond, total = light
    rows, columns = right.shape
    if column < columns:
        block = column // (columns // radiance.shape[1])
        value = radiance[row // (rows // radiance.shape[0]), block] * right[row, column]
        total[0, 0] += share * (value + beyond[row, block])


@njit(cache=True)
def _cover_row(covered, light, row, x0, x1, height, columns):
    """Add the differences along a row of what lies right of a segment of some height."""
    if x0 >= columns:
        return
    if x1 <= 0.0:
        _put(covered, light, row, 0, height)
        return
    column = int(max(x0, 0.0))
    if x0 >= 0.0 and x1 <= column + 1.0:
        part = height * (0.5 * (x0 + x1) - column)
        _put(covered, light, row, column, height - part)
        _put(covered, light, row, column + 1, part)
        return
    per = height / (x1 - x0)
    if x0 < 0.0:
        _put(covered, light, row, 0, -per * x0)
        x0 = 0.0
    while x0 < x1 and column < columns:
        right = min(x1, column + 1.0)
        share = per * (right - x0)
        part = share * (0.5 * (x0 + right) - column)
        _put(covered, light, row, column, share - part)
        _put(covered, light, row, column + 1, part)
        x0 = right
        column += 1


@njit(cache=True)
def cover_rates(edges, rates, pieces, n_pieces, values, out):
    """Subtract from ``out`` (meshes, m) rates of the sum of ``values`` (rows, columns) times cover.

    Each mesh alone moves with its m velocities.
    """
    rows, columns = values.shape
    for p in range(n_pieces):
        e = int(pieces[p, 0])
        u, v, b_u, b_v, turned = _upward(edges, e)
        du, dv = b_u - u, b_v - v
        at, stop = pieces[p, 1], pieces[p, 2]
        # part of the piece inside the plane's cells
        for base, change, size in ((u, du, float(columns)), (v, dv, float(rows))):
            if change == 0.0:
                if base < 0.0 or base > size:
                    stop = at
                continue
            first, second = -base / change, (size - base) / change
            at, stop = max(at, min(first, second)), min(stop, max(first, second))
        while at < stop:
            # next line of the grid, a little beyond ``at`` so that steps do not stall
            ahead = at + 1e-12
            until = stop
            for base, change in ((u, du), (v, dv)):
                place = base + ahead * change
                if change > 0.0:
                    until = min(until, (math.floor(place) + 1.0 - base) / change)
                elif change < 0.0:
                    until = min(until, (math.ceil(place) - 1.0 - base) / change)
            until = min(max(until, ahead), stop)
            middle = 0.5 * (at + until)
            column = min(max(int(u + middle * du), 0), columns - 1)
            row = min(max(int(v + middle * dv), 0), rows - 1)
            weight = pieces[p, 3] * values[row, column] * (until - at)
            far = 1.0 - middle if turned else middle
            for m in range(rates.shape[1]):
                u_rate = rates[e, m, 0] + far * (rates[e, m, 2] - rates[e, m, 0])
                v_rate = rates[e, m, 1] + far * (rates[e, m, 3] - rates[e, m, 1])
                out[int(edges[e, 4]), m] += weight * (u_rate * dv - v_rate * du)
            at = until


@njit(cache=True)
def _light(point, normal, lens, plane, wall, source, out):
    """Set ``out`` (rows, columns) to the radiance toward the lens due to each cell, all in sight.

    ``plane`` is the centre of the first cell, the steps from cell to cell along rows and columns,
    the plane's normal and unit axes, (6, 3), and the area of a cell. ``source`` holds the radiance
    of each cell, unit vectors to the laser's spot, the table of lobes or of cosine powers, and the
    kind: 0 for the same radiance in all directions, 1 for lobes, 2 for cosine powers.
    """
    axes, area = plane
    radiance, to_spot, table, kind = source
    matt = len(wall) == 1 and wall[0, 0] == 0
    view, view_range, facing = np.empty(3), 0.0, 0.0
    for k in range(3):
        view[k] = lens[k] - point[k]
        view_range += view[k] ** 2
        facing += view[k] * normal[k]
    facing /= math.sqrt(view_range)
    toward, x = np.empty(3), np.empty(3)
    height = 0.0
    for k in range(3):
        toward[k] = axes[0, k] - point[k]
        height -= toward[k] * axes[3, k]
    if height <= 0.0 or facing <= 0.0:
        out[:] = 0.0
        return
    rows, columns = out.shape
    if matt and kind == 0:
        factor = area * height * wall[0, 1] * wall[0, 3] / math.pi
        for row in range(rows):
            for k in range(3):
                x[k] = toward[k] + row * axes[2, k]
            x0, y0, z0 = x[0], x[1], x[2]
            for column in range(columns):
                dx, dy = x0 + column * axes[1, 0], y0 + column * axes[1, 1]
                dz = z0 + column * axes[1, 2]
                square = dx * dx + dy * dy + dz * dz
                mu = max(dx * normal[0] + dy * normal[1] + dz * normal[2], 0.0)
                out[row, column] = factor * radiance[row, column] * mu / (square * square)
        return
    for row in range(rows):
        for column in range(columns):
            square, mu, cosine = 0.0, 0.0, height
            for k in range(3):
                x[k] = toward[k] + column * axes[1, k] + row * axes[2, k]
                square += x[k] * x[k]
                mu += x[k] * normal[k]
            if mu <= 0.0:
                out[row, column] = 0.0
                continue
            value = radiance[row, column] * area * mu * cosine / (square * square)
            distance = math.sqrt(square)
            mu, cosine, between = mu / distance, cosine / distance, 0.0
            for k in range(3):
                between += x[k] * view[k]
            between /= distance * math.sqrt(view_range)
            value *= brdf.material(wall, mu, facing, between)
            if kind == 1:
                incidence, between = 0.0, 0.0
                for k in range(3):
                    incidence += to_spot[row, column, k] * axes[3, k]
                    between -= to_spot[row, column, k] * x[k] / distance
                value *= brdf.material(table, incidence, cosine, between)
            elif kind == 2:
                for i in range(2):
                    tilt = 0.0
                    for k in range(3):
                        tilt += x[k] / distance * axes[4 + i, k]
                    value *= (cosine * cosine / (cosine * cosine + tilt * tilt)) ** (
                        0.5 * table[0, i]
                    )
            out[row, column] = value


@njit(cache=True)
def _buffers(mesh, spot):
    """Return space for all edges, their weights and rates, the first of them those of the spot."""
    first = len(spot[0])
    most = first + len(mesh[2]) + 5 * len(mesh[1])
    edges, weights = np.empty((most, 5)), np.empty(most, np.int64)
    rates = np.empty((most, spot[2].shape[1], 4))
    for e in range(first):
        weights[e] = spot[1][e]
        edges[e] = spot[0][e]
        for k in range(4):
            for m in range(rates.shape[1]):
                rates[e, m, k] = spot[2][e, m, k]
    return edges, weights, rates


@njit(cache=True)
def _shadow(points, p, k, frame, shape, mesh, speeds, spot, buffers, pieces):
    """Fill the buffers with the outline seen from a point; return pieces.

    The buffers start with the outline seen from the laser's spot.
    """
    edges, weights, rates = buffers
    count = outline(points[p, k], frame, shape, mesh, speeds, edges, weights, rates, len(spot[0]))
    n = union(edges, weights, count, pieces)
    while n > len(pieces):
        pieces = np.empty((n, 4))
        n = union(edges, weights, count, pieces)
    return pieces, n


@njit(cache=True, nogil=True)
def fill_rows(nodes, frame, plane, mesh, speeds, spot, wall, source, parts, out):
    """Fill ``out`` (n, n_cells) with the mean radiance of wall points due to each cell.

    ``nodes`` holds points and normals (n, k, 3), weights (n, k) and points of the lens (k, 3);
    ``parts`` the rows and columns of samples in a cell.
    """
    points, normals, weights, lens = nodes
    shape = source[0].shape
    columns = shape[1] // parts[1]
    buffers, pieces = _buffers(mesh, spot), np.empty((256, 4))
    covered, light = np.zeros((shape[0], shape[1] + 1)), np.empty(shape)
    for p in range(len(points)):
        out[p] = 0.0
        for k in range(points.shape[1]):
            weight = weights[p, k]
            if weight == 0.0:
                continue
            if len(buffers[0]) > 0:
                pieces, n = _shadow(points, p, k, frame, shape, mesh, speeds, spot, buffers, pieces)
                cover(buffers[0], pieces, n, covered)
            _light(points[p, k], normals[p, k], lens[k], plane, wall, source, light)
            row, first = 0, 0
            while row < shape[0]:
                for _ in range(parts[0]):
                    column = 0
                    for cell in range(first, first + columns):
                        total = 0.0
                        for _ in range(parts[1]):
                            total += (1.0 - covered[row, column]) * light[row, column]
                            column += 1
                        out[p, cell] += weight * total
                    row += 1
                first += columns


@njit(cache=True, nogil=True)
def fill_rates(nodes, frame, plane, mesh, speeds, spot, wall, source, parts, values, out):
    """Fill ``out`` (n, meshes, m) with rates of the radiance of wall points as occluders move.

    ``nodes`` also holds, before the points of the lens, which of the ``values`` (k, n_cells) are
    the factors of each point's light from the cells; see `fill_rows` for ``parts``.
    """
    points, normals, weights, which, lens = nodes
    shape = source[0].shape
    columns = shape[1] // parts[1]
    buffers, pieces, light = _buffers(mesh, spot), np.empty((256, 4)), np.empty(shape)
    for p in range(len(points)):
        out[p] = 0.0
        factors = values[which[p]]
        for k in range(points.shape[1]):
            if weights[p, k] == 0.0:
                continue
            pieces, n = _shadow(points, p, k, frame, shape, mesh, speeds, spot, buffers, pieces)
            _light(points[p, k], normals[p, k], lens[k], plane, wall, source, light)
            for row in range(shape[0]):
                first = row // parts[0] * columns
                for column in range(shape[1]):
                    light[row, column] *= factors[first + column // parts[1]] * weights[p, k]
            cover_rates(buffers[0], buffers[2], pieces, n, light, out[p])
