"""Compiled chains of narrow lobes: light from a vertex over mirrors to a point of the lens.

A chain of m reflections alternates between wall and hidden object, and begins with either of them
if it comes from an occluder. At each reflection a narrow lobe
is chosen and the slope of a facet is drawn; a smooth mirror has slope 0. Newton steps then find the
points at which facets of these slopes reflect the light from the vertex to the lens. The Jacobian
of the equations gives the power (Hanika et al., Manifold next event estimation, 2015).

A surface is a frame (origin, two axes, normal) with a height above its plane: the wall has the
world's frame, and the object's plane or triangle has its own with height 0. A point has coordinates
u, v in its frame.
"""

from __future__ import annotations

import math

import numpy as np

from ...kernels.brdf import lobe
from ...kernels.codes import GGX, WARD_1992
from ...kernels.compiling import njit
from ...kernels.heights import surface
from ...kernels.random import uniform
from ._connection_kernels import narrow_at, reflected
from ._light_kernels import LENGTH, MET, NARROW, POWER, SURFACE, chained_at, lobes_of
from ._lobe_kernels import STEEPEST, facet_slope_sq, is_narrow
from ._surround_kernels import OBJECT, ROOM, WALL, dot, interval, on_detector, texel, three, unit


@njit(cache=True)
def _number(seed, ray, bounce, m, k):
    """Return random number ``k`` of a ray's chain of m reflections after ``bounce`` reflections."""
    address = ((np.uint64(bounce) << np.uint64(8)) | np.uint64(m)) << np.uint64(32)
    return uniform(seed, np.uint64(303), np.uint64(ray), address | np.uint64(k))


@njit(cache=True)
def _set_frame(world, kind, u, frame, bounds):
    """Fill the frame (12,) of a surface and its bounds (8,); return 1 / its chance.

    A triangle of a mesh is drawn by area with the random number ``u``. Its bounds give barycentric
    coordinates; those of the planar object are its half width and height.
    """
    if kind == WALL:
        frame[:] = 0.0
        frame[3] = frame[7] = frame[11] = 1.0
        return 1.0
    if world.plate.size > 0:
        for i in range(12):
            frame[i] = world.plate[i]
        bounds[0], bounds[1] = world.plate[12], world.plate[13]
        return 1.0
    areas = world.areas
    k = interval(areas, u)
    row = world.triangles[k]
    a, b = three(row, 3), three(row, 6)
    n = (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])
    side, double = math.sqrt(dot(a, a)), math.sqrt(dot(n, n))
    for i in range(3):
        frame[i], frame[3 + i], frame[9 + i] = row[i], a[i] / side, n[i] / double
    frame[6] = frame[10] * frame[5] - frame[11] * frame[4]
    frame[7] = frame[11] * frame[3] - frame[9] * frame[5]
    frame[8] = frame[9] * frame[4] - frame[10] * frame[3]
    bx, by = dot(b, three(frame, 3)), dot(b, three(frame, 6))
    bounds[0], bounds[1], bounds[2] = 1.0 / side, -bx / (side * by), 1.0 / by
    return 1.0 / (areas[k + 1] - areas[k])


@njit(cache=True)
def _set_facet(lobes, seed, ray, address, wider, slope):
    """Draw a narrow lobe and the slope (2,) of a facet; return the lobe or -1, and 1/density."""
    bounce, m, first = address
    some = 0
    for j in range(lobes.shape[0]):
        some += 1 if is_narrow(lobes, j) else 0
    if some == 0:
        return -1, 0.0
    narrow = min(int(some * _number(seed, ray, bounce, m, first)), some - 1)
    chosen = -1
    for j in range(lobes.shape[0]):
        if is_narrow(lobes, j):
            if narrow == 0:
                chosen = j
                break
            narrow -= 1
    alpha = lobes[chosen, 2] * wider
    slope[0] = slope[1] = 0.0
    if alpha == 0.0:
        return chosen, float(some)
    if lobes[chosen, 0] < WARD_1992:
        alpha *= math.sqrt(2.0)
    u, square = _number(seed, ray, bounce, m, first + 1), alpha * alpha
    if lobes[chosen, 0] == GGX:
        far = square * u / (1.0 - u)
        inverse = math.pi * (square + far) ** 2 / square
    else:
        far = -square * math.log(1.0 - u)
        inverse = math.pi * square / (1.0 - u)
    turn = 2.0 * math.pi * _number(seed, ray, bounce, m, first + 2)
    slope[0], slope[1] = math.sqrt(far) * math.cos(turn), math.sqrt(far) * math.sin(turn)
    return chosen, some * inverse


@njit(cache=True)
def _widening(walls, at, steepest):
    """Return how much wider the slopes of facets are drawn where the wall itself has a slope."""
    if steepest == 0.0:
        return 1.0
    values = surface(walls[0], walls[1], at[0], at[1])
    # the margin bounds the slope at the solution
    slope = math.hypot(values[1], values[2]) + 0.3
    return 1.0 + (slope if slope < steepest else steepest) ** 2


@njit(cache=True)
def _unfold(frames, a, p, u):
    """Fill the coordinates (m, 2) at which plane mirrors in the frames reflect from a to p."""
    m = u.shape[0]
    images = np.empty((m, 3))
    image = p
    for i in range(m - 1, -1, -1):
        f = frames[i]
        n = three(f, 9)
        off = 2.0 * dot((image[0] - f[0], image[1] - f[1], image[2] - f[2]), n)
        image = (image[0] - off * n[0], image[1] - off * n[1], image[2] - off * n[2])
        for k in range(3):
            images[i, k] = image[k]
    o = a
    for i in range(m):
        f, to = frames[i], three(images[i], 0)
        n = three(f, 9)
        d = (to[0] - o[0], to[1] - o[1], to[2] - o[2])
        along, above = dot(d, n), dot((f[0] - o[0], f[1] - o[1], f[2] - o[2]), n)
        t = above / along if along != 0.0 else 0.5
        if not 0.0 < t < 1.0:
            t = 0.5
        x = (o[0] + t * d[0] - f[0], o[1] + t * d[1] - f[1], o[2] + t * d[2] - f[2])
        u[i, 0], u[i, 1] = dot(x, three(f, 3)), dot(x, three(f, 6))
        o = tuple_at(f, u[i, 0], u[i, 1])


@njit(cache=True)
def tuple_at(frame, u, v):
    """Return the point of a frame's plane with the coordinates u, v."""
    return (
        frame[0] + u * frame[3] + v * frame[6],
        frame[1] + u * frame[4] + v * frame[7],
        frame[2] + u * frame[5] + v * frame[8],
    )


@njit(cache=True)
def _tangent(frame, k, slope):
    """Return the tangent along axis ``k`` of a frame, of a surface with this slope there."""
    return (
        frame[3 + 3 * k] + slope * frame[9],
        frame[4 + 3 * k] + slope * frame[10],
        frame[5 + 3 * k] + slope * frame[11],
    )


@njit(cache=True)
def _equations(walls, kinds, frames, slopes, a, p, u, x, g, own, back, ahead):
    """Fill points, heights and the equations of a chain; return their sum of squares, or infinity.

    ``x`` (m, 3) receives the points, ``g`` (m, 4) the two slopes of the surface and the values of
    the equations, and ``own``, ``back`` and ``ahead`` (m, 2, 2) the blocks of the Jacobian for the
    coordinates of the point itself and of its neighbours. An equation is the scalar product of a
    tangent of the facet with the sum of the unit vectors from both neighbours.
    """
    m = u.shape[0]
    bends = np.zeros((m, 3))
    for i in range(m):
        f, h = frames[i], 0.0
        g[i, 0] = g[i, 1] = 0.0
        if kinds[i] == WALL:
            h, g[i, 0], g[i, 1], hxx, hxy, hyy = surface(walls[0], walls[1], u[i, 0], u[i, 1])
            if not math.isfinite(h):
                return math.inf
            bends[i, 0], bends[i, 1], bends[i, 2] = hxx, hxy, hyy
        at = tuple_at(f, u[i, 0], u[i, 1])
        for k in range(3):
            x[i, k] = at[k] + h * f[9 + k]
    total = 0.0
    for i in range(m):
        before = a if i == 0 else three(x[i - 1], 0)
        after = p if i == m - 1 else three(x[i + 1], 0)
        d = (x[i, 0] - before[0], x[i, 1] - before[1], x[i, 2] - before[2])
        e = (x[i, 0] - after[0], x[i, 1] - after[1], x[i, 2] - after[2])
        r, s = math.sqrt(dot(d, d)), math.sqrt(dot(e, e))
        if r == 0.0 or s == 0.0:
            return math.inf
        d, e = (d[0] / r, d[1] / r, d[2] / r), (e[0] / s, e[1] / s, e[2] / s)
        f, both = frames[i], (d[0] + e[0], d[1] + e[1], d[2] + e[2])
        up = dot(both, three(f, 9))
        for k in range(2):
            facet = _tangent(f, k, g[i, k] + slopes[i, k])
            g[i, 2 + k] = dot(facet, both)
            total += g[i, 2 + k] ** 2
            on_d, on_e = dot(facet, d), dot(facet, e)
            for q in range(2):
                t = _tangent(f, q, g[i, q])
                flat = dot(facet, t)
                own[i, k, q] = (flat - on_d * dot(t, d)) / r + (flat - on_e * dot(t, e)) / s
                own[i, k, q] += bends[i, k + q] * up
                if i > 0:
                    t = _tangent(frames[i - 1], q, g[i - 1, q])
                    back[i, k, q] = (on_d * dot(t, d) - dot(facet, t)) / r
                if i < m - 1:
                    t = _tangent(frames[i + 1], q, g[i + 1, q])
                    ahead[i, k, q] = (on_e * dot(t, e) - dot(facet, t)) / s
    return total


@njit(cache=True)
def _steps(g, own, back, ahead, step):
    """Fill the Newton step (m, 2) of a chain, and return the determinant of its Jacobian."""
    m = g.shape[0]
    side, whole = np.zeros((m, 2, 2)), 1.0
    for i in range(m):
        right0, right1 = -g[i, 2], -g[i, 3]
        p, q, r, s = own[i, 0, 0], own[i, 0, 1], own[i, 1, 0], own[i, 1, 1]  # the pivot's rows
        if i > 0:
            a, b, c, d = back[i, 0, 0], back[i, 0, 1], back[i, 1, 0], back[i, 1, 1]
            p -= a * side[i - 1, 0, 0] + b * side[i - 1, 1, 0]
            q -= a * side[i - 1, 0, 1] + b * side[i - 1, 1, 1]
            r -= c * side[i - 1, 0, 0] + d * side[i - 1, 1, 0]
            s -= c * side[i - 1, 0, 1] + d * side[i - 1, 1, 1]
            right0 -= a * step[i - 1, 0] + b * step[i - 1, 1]
            right1 -= c * step[i - 1, 0] + d * step[i - 1, 1]
        det = p * s - q * r
        if det == 0.0:
            return 0.0
        whole *= det
        step[i, 0] = (s * right0 - q * right1) / det
        step[i, 1] = (p * right1 - r * right0) / det
        if i < m - 1:
            for k in range(2):
                c0, c1 = ahead[i, 0, k], ahead[i, 1, k]
                side[i, 0, k] = (s * c0 - q * c1) / det
                side[i, 1, k] = (p * c1 - r * c0) / det
    for i in range(m - 2, -1, -1):
        for k in range(2):
            step[i, k] -= side[i, k, 0] * step[i + 1, 0] + side[i, k, 1] * step[i + 1, 1]
    return whole


@njit(cache=True)
def _solve(walls, kinds, frames, slopes, a, p, u, x, g, steps, halvings):
    """Move the coordinates ``u`` (m, 2) to a solution; return the Jacobian's determinant, or 0."""
    m = u.shape[0]
    own, back, ahead = np.zeros((m, 2, 2)), np.zeros((m, 2, 2)), np.zeros((m, 2, 2))
    step, old = np.zeros((m, 2)), np.empty((m, 2))
    worst = _equations(walls, kinds, frames, slopes, a, p, u, x, g, own, back, ahead)
    for _ in range(steps):
        if not worst < math.inf:
            return 0.0
        det = _steps(g, own, back, ahead, step)
        if worst < 1e-20 or det == 0.0:
            return det if worst < 1e-20 else 0.0
        for i in range(m):
            old[i, 0], old[i, 1] = u[i, 0], u[i, 1]
        share, better = 1.0, math.inf
        for _ in range(halvings):
            for i in range(m):
                u[i, 0], u[i, 1] = old[i, 0] + share * step[i, 0], old[i, 1] + share * step[i, 1]
            better = _equations(walls, kinds, frames, slopes, a, p, u, x, g, own, back, ahead)
            if better < worst:
                break
            share *= 0.5
        if not better < worst:
            return 0.0
        worst = better
    return 0.0


@njit(cache=True)
def _normal(frame, slopes):
    """Return the unit normal of a surface with these two slopes above the plane of a frame."""
    tilt = 1.0 / math.sqrt(1.0 + slopes[0] ** 2 + slopes[1] ** 2)
    return (
        (frame[9] - slopes[0] * frame[3] - slopes[1] * frame[6]) * tilt,
        (frame[10] - slopes[0] * frame[4] - slopes[1] * frame[7]) * tilt,
        (frame[11] - slopes[0] * frame[5] - slopes[1] * frame[8]) * tilt,
    )


@njit(cache=True)
def _inside(walls, kind, is_plate, bounds, u, v):
    """Return whether a surface extends to the point with the coordinates u, v of its frame."""
    if kind == WALL:
        box, rim = walls[2], walls[3]
        return abs(u) <= box[0] and abs(v) <= box[1] and u * u + v * v <= rim * rim
    if is_plate:
        return abs(u) <= bounds[0] and abs(v) <= bounds[1]
    second = bounds[2] * v
    first = bounds[0] * u + bounds[1] * v
    return first >= 0.0 and second >= 0.0 and first + second <= 1.0


@njit(cache=True)
def _carried(world, walls, kinds, frames, bounds, lobes_at, a, p, u, x, g, inverse):
    """Return the power per solid angle at ``a`` and area at ``p`` of a solved chain, 1/m^2.

    It lacks the cosines at both ends, and is still to be divided by the Jacobian's determinant.
    """
    m, value = u.shape[0], 1.0
    for i in range(m):
        kind = kinds[i]
        if not _inside(walls, kind, world.plate.size > 0, bounds[i], u[i, 0], u[i, 1]):
            return 0.0
        before = a if i == 0 else three(x[i - 1], 0)
        after = p if i == m - 1 else three(x[i + 1], 0)
        (d, r), (e, s) = unit(x[i], before), unit(x[i], after)
        f, tilt = frames[i], 1.0 / math.sqrt(1.0 + g[i, 0] ** 2 + g[i, 1] ** 2)
        n = _normal(f, g[i])
        mu_i, mu_o, between = dot(d, n), dot(e, n), dot(d, e)
        if mu_i <= 0.0 or mu_o <= 0.0:
            return 0.0
        lobes, j = world.wall if kind == WALL else world.thing, lobes_at[i]
        if lobes[j, 2] == 0.0:
            scattered = lobes[j, 1] * lobes[j, 3] / (4.0 * mu_i * mu_o * tilt**3)
        elif facet_slope_sq(mu_i, mu_o, between) > STEEPEST * STEEPEST:
            return 0.0
        else:
            scattered = lobe(lobes, j, mu_i, mu_o, between)
        up = dot(d, three(f, 9)) + dot(e, three(f, 9))
        value *= scattered * inverse[i] * up * up / tilt * mu_i * mu_o / (r * r)
        if kind == OBJECT and world.plate.size > 0:
            value *= texel(world.plate, world.picture, three(x[i], 0))
        if i == m - 1:
            value /= s * s
    return value


@njit(cache=True)
def _shift(walls, seed, ray, address, kinds, reach, start, u):
    """Fill ``u`` (m, 2) with a random start: the coordinates ``start`` with shifted wall points."""
    bounce, m, first = address
    box = walls[2]
    for i in range(u.shape[0]):
        u[i, 0], u[i, 1] = start[i, 0], start[i, 1]
        if kinds[i] != WALL:
            continue
        choice = 2.0 * _number(seed, ray, bounce, m, first + 3 * i)
        v = _number(seed, ray, bounce, m, first + 3 * i + 1)
        w = _number(seed, ray, bounce, m, first + 3 * i + 2)
        if choice < 1.0 and box[0] < math.inf and box[1] < math.inf:
            u[i, 0], u[i, 1] = box[0] * (2.0 * v - 1.0), box[1] * (2.0 * w - 1.0)
        else:
            far, turn = reach * 10.0 ** (-4.0 * v), 2.0 * math.pi * w
            u[i, 0] += far * math.cos(turn)
            u[i, 1] += far * math.sin(turn)


@njit(cache=True, nogil=True)
def chain_to_lens(
    world, walls, sampler, first, light, lens, order, several, steepest, value, length, mirrors
):
    """Fill the detected power and length of chains of narrow reflections to points of the lens.

    ``walls`` are terms and tables (`kernels.heights`), box and rim of the wall. ``light`` are the
    vertices at which wide lobes begin the chains, ``lens`` (n, 3) points of the lens, m. ``order``
    is the number of reflections up to the light vertices; m, that of a chain; and whether the first
    reflection is at the wall, from occluders alone. Otherwise it is at the hidden object, or at the
    wall from the object. ``value`` (W), ``length`` (m) and, where the value is above 0, the
    vertices ``mirrors`` (m, n, VERTEX) are filled.

    If ``several``, solutions are found from random starts. A solution is weighted by the number of
    further starts until it is found again, whose mean is the reciprocal of its chance (Zeltner et
    al., Specular manifold sampling, 2020).
    """
    seed, camera, (bounce, m, at_wall) = sampler[0], world.camera, order
    area, axis = math.pi * camera[12] ** 2 * camera[18], three(camera, 9)
    kinds, lobes_at = np.empty(m, dtype=np.int64), np.empty(m, dtype=np.int64)
    frames, bounds, inverse = np.empty((m, 12)), np.zeros((m, 8)), np.empty(m)
    slopes, start, u, again = np.zeros((m, 2)), np.empty((m, 2)), np.empty((m, 2)), np.empty((m, 2))
    x, g, y, other = np.empty((m, 3)), np.empty((m, 4)), np.empty((m, 3)), np.empty((m, 4))
    for i in range(light.shape[0]):
        value[i] = 0.0
        vertex, ray = light[i], first + i
        share = vertex[NARROW] if m == 1 else 1.0
        if vertex[SURFACE] < 0.0 or vertex[POWER] * share <= 0.0:
            continue
        if at_wall and vertex[SURFACE] < ROOM:
            continue
        a, p, ready, on_wall = three(vertex, 0), three(lens[i], 0), True, 0
        begin = WALL if at_wall or vertex[SURFACE] == OBJECT else OBJECT
        for k in range(m):
            kinds[k] = begin if k % 2 == 0 else WALL + OBJECT - begin
            on_wall += 1 if kinds[k] == WALL else 0
        search = several and on_wall > 0
        # keep one of eight searches for each reflection at the wall after the first, and one of two
        # chains for each reflection after the fourth
        keep = 8.0 ** (1 - on_wall) if search else 1.0
        keep *= 0.5 ** max(0, m - 4)
        if keep < 1.0 and _number(seed, ray, bounce, m, 4 * m) >= keep:
            continue
        share /= keep
        for k in range(m):
            chance = _number(seed, ray, bounce, m, 4 * k)
            share *= _set_frame(world, kinds[k], chance, frames[k], bounds[k])
            ready = ready and chained_at(world.chains, kinds[k])
        if not ready:
            continue
        _unfold(frames, a, p, start)
        for k in range(m):
            lobes = world.wall if kinds[k] == WALL else world.thing
            wider = _widening(walls, start[k], steepest) if kinds[k] == WALL else 1.0
            address = (bounce, m, 4 * k + 1)
            lobes_at[k], inverse[k] = _set_facet(lobes, seed, ray, address, wider, slopes[k])
            ready = ready and lobes_at[k] >= 0
        if not ready:
            continue
        reach = unit(a, p)[1] + abs(a[2]) + abs(p[2])
        for k in range(m):
            u[k, 0], u[k, 1] = start[k, 0], start[k, 1]
        # a search tries many starts, of which some have no solution; elsewhere it would be lost
        steps, halvings = (20, 6) if search else (60, 12)
        if search:
            _shift(walls, seed, ray, (bounce, m, 4 * m + 1), kinds, reach, start, u)
        det = _solve(walls, kinds, frames, slopes, a, p, u, x, g, steps, halvings)
        if det == 0.0:
            continue
        carried = _carried(world, walls, kinds, frames, bounds, lobes_at, a, p, u, x, g, inverse)
        if carried <= 0.0:
            continue
        (d, r), (e, s) = unit(a, x[0]), unit(p, x[m - 1])
        cosine = dot(d, three(vertex, 3))
        if cosine <= 0.0 or on_detector(camera, p, e) <= 0.0:
            continue
        kind = int(vertex[SURFACE])
        lobes = lobes_of(world, kind)
        f = reflected(lobes, vertex, d, cosine)
        f *= 1.0 - narrow_at(lobes, chained_at(world.chains, kind), vertex, d, cosine)
        f *= vertex[POWER] * share * cosine * area * dot(e, axis) * carried / abs(det)
        if f <= 0.0:
            continue
        if search:
            trials = 1 << 16  # at most
            for trial in range(1, trials + 1):
                address = (bounce, m, (4 + 3 * trial) * m + 1)
                _shift(walls, seed, ray, address, kinds, reach, start, again)
                found = _solve(walls, kinds, frames, slopes, a, p, again, y, other, steps, halvings)
                if found != 0.0:
                    off = 0.0
                    for k in range(m):
                        for c in range(3):
                            off += abs(x[k, c] - y[k, c])
                    if off < 1e-6 * m * reach:
                        trials = trial
                        break
            f *= trials
        value[i], length[i] = f, vertex[LENGTH] + r + s
        for k in range(m):
            mirror, n = mirrors[k, i], _normal(frames[k], g[k])
            for c in range(3):
                mirror[c], mirror[3 + c] = x[k, c], n[c]
            mirror[SURFACE] = kinds[k]
            mirror[MET] = 1.0 if kinds[k] == OBJECT or k > 0 else vertex[MET]
            if k > 0:
                length[i] += unit(x[k - 1], x[k])[1]
