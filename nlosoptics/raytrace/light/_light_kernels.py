"""Compiled light paths: start, scattering and arrival of vertices.

A vertex is a row of VERTEX numbers: point P and normal N (world, m), direction I to the previous
vertex, and

- POWER: power that arrives, W; for paths from the lens, detected power per unit radiance, m^2 sr;
- DENSITY: sampling density of the vertex, 1/m^2, or -1 if a mirror or the laser determined it;
- SURFACE: kind of surface, negative if the path has ended; SCALE: brightness;
- LENGTH: path length so far, m; MET: 1 if the path has met the hidden object;
- HISTORY: bit 0 is set if DENSITY is -1 here, bit 1 if it was at the previous vertex;
- BEFORE: kind of surface of the previous vertex;
- NARROW: share of the light that narrow lobes reflected at the previous vertex, 1 for the laser;
- BEGUN: share that arrives by a chain of narrow lobes, or may begin one here;
- LIT: density, 1/m^2, with which rays aimed from the laser spot meet the object here;
- LINKED: share that `_chain_kernels` traces if narrow lobes reflect it to the lens from here.
"""

from __future__ import annotations

import math

import numpy as np

from ...kernels.brdf import material
from ...kernels.codes import GROUPS, UNIT
from ...kernels.compiling import njit
from ...kernels.random import draw
from ..fans import paths
from ._lobe_kernels import lobe_density, lobe_direction, narrow_part
from ._surround_kernels import (
    DRAW_THIN,
    LENS,
    LOST,
    NOTHING,
    OBJECT,
    OCCLUDER,
    ROOM,
    WALL,
    dot,
    object_point,
    on_detector,
    reflects,
    three,
)

VERTEX = 21
P, N, I = slice(0, 3), slice(3, 6), slice(6, 9)  # noqa: E741  (the letter of incidence)
POWER, DENSITY, SURFACE, SCALE, LENGTH, MET, HISTORY, BEFORE = range(9, 17)
NARROW, BEGUN, LINKED, LIT = range(17, 21)
LEAVE = 10
LOBE, PDF, MIRROR, AIMED, REACH, APART, SHARE = range(3, 10)

# columns of the sums that follow the fluxes by number of reflections
STRAY, LENGTHS, ABSORBED_WALL, ABSORBED_OBJECT, ABSORBED_OCCLUDERS = range(5)
ESCAPED, BLOCKED, LEFT, UNRESOLVED_LIGHT, WALL_TO_WALL, TRAPPED = range(5, 11)
SUMS = 11


@njit(cache=True)
def sums_of(path_sums, first, i):
    """Return the row of ``path_sums`` to which the power of ray ``first + i`` is added."""
    return path_sums[i // UNIT * GROUPS + (first + i) % GROUPS]


@njit(cache=True)
def lobes_of(world, kind):
    """Return the table of lobes (n, 7) of a surface that reflects light; see `reflects`."""
    if kind == WALL:
        return world.wall
    return world.thing if kind == OBJECT else world.room[kind - ROOM]


@njit(cache=True)
def aimed_share(world, vertex, eye):
    """Return the fraction, 0 to 1, of the rays leaving ``vertex`` that are aimed at the object."""
    if vertex[SURFACE] == OBJECT:
        return 0.0
    return world.aimed[0] if eye or vertex[BEFORE] == NOTHING else world.aimed[1]


@njit(cache=True)
def chained_at(chains, kind):
    """Return whether narrow lobes of a surface take part in `World.chains`."""
    return kind < OCCLUDER and chains & (1 if kind == WALL else 2) != 0


@njit(cache=True)
def _is_spot(vertex, eye):
    """Return whether a vertex is the laser spot."""
    return not eye and vertex[BEFORE] == NOTHING


@njit(cache=True)
def target_density(norm, vertex, eye, scale, lit):
    """Return the density, 1/m^2, with which rays aimed from a vertex meet a point of the object."""
    return lit if _is_spot(vertex, eye) else norm * scale


@njit(cache=True)
def narrow_share(lobes, chained, mu_i, mu_o, cos_between):
    """Return the share of the narrow lobes in f_r of a surface; 0 unless it is ``chained``."""
    if not chained:
        return 0.0
    narrow = narrow_part(lobes, mu_i, mu_o, cos_between)
    return narrow / material(lobes, mu_i, mu_o, cos_between) if narrow > 0.0 else 0.0


@njit(cache=True)
def chain_shares(vertex, narrow, kind):
    """Return BEGUN and LINKED of the vertex on a surface ``kind`` that follows ``vertex``.

    ``narrow`` is the share of the narrow lobes in the reflection at ``vertex``. A chain begins with
    a reflection by other lobes. It goes on from one surface to another kind of surface. A chain of
    one reflection counts if narrow lobes or the laser brought the light to its beginning.
    """
    if vertex[SURFACE] == kind:
        return 0.0, 0.0
    chain, wide = narrow * vertex[BEGUN], 1.0 - narrow
    return wide + chain, wide * vertex[NARROW] + chain


@njit(cache=True)
def _far(world, p):
    """Return whether only rays aimed at the hidden object may reach it from the point ``p``."""
    ball = world.ball
    away = (p[0] - ball[0], p[1] - ball[1], p[2] - ball[2])
    return not world.glossy and dot(away, away) > 2.25 * ball[3] * ball[3]


@njit(cache=True, nogil=True)
def scatter(world, sampler, first, number, eye, vertices, leave, origins, directions, live):
    """Draw the directions of rays leaving vertices: from a lobe, or from the wall to the object.

    ``eye`` is True for vertices of eye paths. Columns of ``leave``: direction; f_r times cosine
    (LOBE); density of the lobes (PDF); weight of a mirror or -1 (MIRROR); share aimed at the object
    (AIMED); distance of the point aimed at or -1 (REACH); 1 if only aimed rays may reach the object
    (APART); share of the narrow lobes in f_r (SHARE).
    """
    for i in range(vertices.shape[0]):
        vertex = vertices[i]
        kind = int(vertex[SURFACE])
        live[i] = kind >= 0 and vertex[POWER] > 0.0
        if not live[i]:
            continue
        ray = first + i
        group, index = ray % GROUPS, ray // GROUPS
        u = draw(sampler, group, index, ray, number)
        v = draw(sampler, group, index, ray, number + 1)
        lobes = lobes_of(world, kind)
        p, n, incident = three(vertex, 0), three(vertex, 3), three(vertex, 6)
        mirror, reach = -1.0, -1.0
        share = aimed_share(world, vertex, eye)
        if share > 0.0 and draw(sampler, group, index, ray, number + 2) < share:
            splits = world.lit_splits if _is_spot(vertex, eye) else world.splits
            to, _ = object_point(world, splits, u, v)
            d = (to[0] - p[0], to[1] - p[1], to[2] - p[2])
            reach = math.sqrt(dot(d, d))
            d = (d[0] / reach, d[1] / reach, d[2] / reach)
        else:
            # a single lobe needs no random choice
            w = draw(sampler, group, index, ray, number + 3) if lobes.shape[0] > 1 else 0.0
            d, mirror = lobe_direction(lobes, incident, n, u, v, w, eye)
        cosine = dot(d, n)
        f = density = 0.0
        chained = chained_at(world.chains, kind)
        narrow = 1.0 if chained else 0.0
        if mirror < 0.0 and cosine > 0.0:
            mu, between = dot(incident, n), dot(incident, d)
            f = material(lobes, mu, cosine, between) * cosine
            density = lobe_density(lobes, mu, cosine, between, eye)
            narrow = narrow_share(lobes, chained, mu, cosine, between)
        for k in range(3):
            leave[i, k] = directions[i, k] = d[k]
            origins[i, k] = p[k]
        leave[i, LOBE], leave[i, PDF], leave[i, MIRROR] = f, density, mirror
        leave[i, AIMED], leave[i, REACH] = share, reach
        leave[i, SHARE] = narrow
        leave[i, APART] = 1.0 if share > 0.0 and _far(world, p) else 0.0
        live[i] = cosine > 0.0


@njit(cache=True)
def _passed_on(leave, distance, kind, normal, target):
    """Return the weight of a ray drawn by `scatter`, and the density at its end, 1/m^2.

    ``leave`` is the ray's row from `scatter`; the others describe what it hits, and ``target`` is
    the `target_density` there. Sampling by lobes
    and by aiming at the object are combined with the one-sample balance heuristic. If only aimed
    rays may reach the object, the weight is a smooth function of the random numbers.
    """
    d, aimed = three(leave, 0), leave[AIMED]
    if leave[MIRROR] >= 0.0:
        return leave[MIRROR] / (1.0 - aimed), -1.0
    cosine = abs(dot(d, normal))
    at_object = 0.0
    if kind == OBJECT and aimed > 0.0:
        at_object = aimed * target * distance * distance / cosine
    astray = kind != OBJECT or abs(distance - leave[REACH]) > 1e-6 * leave[REACH]
    if leave[REACH] >= 0.0 and astray:
        return 0.0, 0.0  # another surface hides the point aimed at
    if leave[APART] > 0.0 and at_object > 0.0:
        if leave[REACH] < 0.0:
            return 0.0, 0.0
        return leave[LOBE] / at_object, at_object * cosine / (distance * distance)
    density = (1.0 - aimed) * leave[PDF] + at_object
    if density <= 0.0:
        return 0.0, 0.0
    # an unresolved hit has distance 0
    square = distance * distance
    return leave[LOBE] / density, density * cosine / square if square > 0.0 else math.inf


@njit(cache=True)
def _arrive(old, new, origin, direction, distance, kind, normal, scale, power, density):
    """Fill the vertex ``new`` at which a ray from the vertex ``old`` arrives."""
    for k in range(3):
        new[k] = origin[k] + distance * direction[k]
        new[3 + k], new[6 + k] = normal[k], -direction[k]
    new[POWER], new[DENSITY], new[SURFACE], new[SCALE] = power, density, kind, scale
    new[LENGTH] = old[LENGTH] + distance
    new[MET] = 1.0 if kind == OBJECT else old[MET]
    new[HISTORY] = float((int(old[HISTORY]) * 2 + (1 if density < 0.0 else 0)) & 3)
    new[BEFORE] = old[SURFACE]


@njit(cache=True)
def _end(old, new, origin, direction, distance, power):
    """Fill point, power and length of a vertex at which a path ends unless it is continued."""
    t = distance if distance < math.inf else 1.0
    for k in range(3):
        new[k] = origin[k] + t * direction[k]
    new[POWER], new[LENGTH], new[MET] = power, old[LENGTH] + t, old[MET]


@njit(cache=True, nogil=True)
def thin(sampler, first, share, vertices):
    """Keep a random part of the vertices and divide their power by its fraction ``share``."""
    for i in range(vertices.shape[0]):
        if vertices[i, SURFACE] >= 0.0:
            ray = first + i
            group, index = ray % GROUPS, ray // GROUPS
            if draw(sampler, group, index, ray, DRAW_THIN) < share:
                vertices[i, POWER] /= share
            else:
                vertices[i, SURFACE] = NOTHING


@njit(cache=True, nogil=True)
def land(
    around, sampler, first, settings, old, leave, origins, directions, hits, new, path_sums, fates
):
    """Fill the next vertices of light paths, and add lost power to the power balance.

    ``around`` is (camera, norm, chains) of `World`. ``settings`` is (bounce, max_bounces, analog,
    number of the draw for Russian roulette or -1). ``hits`` are those of
    `Surroundings.first_hits`. ``fates`` receives the status of paths that end, else -1.
    """
    camera, norm, chains = around
    bounce, most, analog, roulette = settings
    distance, kind, normal, scale, lit = hits
    tail = most + 1
    for i in range(old.shape[0]):
        new[i, SURFACE], fates[i] = NOTHING, -1
        power, at = old[i, POWER], int(old[i, SURFACE])
        if at < 0 or power <= 0.0:
            continue
        ray = first + i
        sums = sums_of(path_sums, first, i)
        where = int(kind[i])
        n = three(normal[i], 0)
        passed, density = 0.0, 0.0
        if dot(three(leave[i], 0), three(old[i], 3)) > 0.0:
            target = target_density(norm, old[i], False, scale[i], lit[i])
            passed, density = _passed_on(leave[i], distance[i], where, n, target)
            if at == OBJECT:
                passed *= old[i, SCALE]
        sent = power * passed
        absorber = ABSORBED_WALL if at == WALL else ABSORBED_OBJECT
        sums[tail + (absorber if at < ROOM else ABSORBED_OCCLUDERS)] += power - sent
        if at == WALL and old[i, BEFORE] == WALL:
            sums[tail + TRAPPED] += power - sent
        if sent > 0.0 and roulette >= 0:
            group, index = ray % GROUPS, ray // GROUPS
            stay = min(1.0, max(0.1, passed))
            sent = sent / stay if draw(sampler, group, index, ray, roulette) < stay else 0.0
        d, o = three(directions[i], 0), three(origins[i], 0)
        _end(old[i], new[i], o, d, distance[i] if sent > 0.0 else 0.0, sent)
        if sent <= 0.0:
            fates[i] = paths.ABSORBED
        elif where == NOTHING:
            sums[tail + ESCAPED] += sent
            fates[i] = paths.ESCAPED
        elif where == LENS:
            kept = _enter_lens(
                camera, sums, tail, old[i], leave[i], bounce, distance[i], sent, analog
            )
            fates[i] = paths.DETECTED if kept > 0.0 else paths.BLOCKED
            if kept > 0.0:
                new[i, POWER] = kept
        elif reflects(where):
            if where == WALL and at == WALL:
                sums[tail + WALL_TO_WALL] += sent
            _arrive(old[i], new[i], o, d, distance[i], where, n, scale[i], sent, density)
            new[i, LIT] = lit[i]
            if chains != 0:
                new[i, NARROW] = leave[i, SHARE]
                if chained_at(chains, where):
                    shares = chain_shares(old[i], leave[i, SHARE], where)
                    new[i, BEGUN], new[i, LINKED] = shares
            if bounce == most:
                sums[tail + LEFT] += sent
                new[i, SURFACE] = NOTHING
                fates[i] = paths.LEFT
        else:
            fate = ABSORBED_OCCLUDERS if where == OCCLUDER else ABSORBED_OBJECT
            sums[tail + (UNRESOLVED_LIGHT if where == LOST else fate)] += sent
            fates[i] = paths.ABSORBED


@njit(cache=True)
def _enter_lens(camera, sums, tail, old, leave, bounce, distance, sent, analog):
    """Add light that hits the lens after scattering to the sums; return its detected power, W.

    Unless the trace is analog, connections already account for this light. The exception is light
    from a mirror if its vertex or the one before was determined by a mirror or the laser, since
    connections cannot find such paths; chains are traced separately. ``sent`` is the power that
    left the vertex, W.
    """
    d = three(leave, 0)
    point = (old[0] + distance * d[0], old[1] + distance * d[1], old[2] + distance * d[2])
    seen = on_detector(camera, point, (-d[0], -d[1], -d[2])) > 0.0
    kept = sent * camera[18] if seen else 0.0
    by_mirrors = leave[MIRROR] >= 0.0 and old[HISTORY] > 0.0
    if analog or by_mirrors:
        counted = kept if analog else kept * (1.0 - old[LINKED])
        if old[MET] > 0.0:
            sums[bounce] += counted
            sums[tail + LENGTHS] += counted * (old[LENGTH] + distance)
        else:
            sums[tail + STRAY] += counted
    sums[tail + BLOCKED] += sent - kept
    return kept


@njit(cache=True, nogil=True)
def start(power, first, most, origins, directions, hits, new, path_sums, fates):
    """Fill the first vertices of the laser's light, and add lost power to the power balance."""
    distance, kind, normal, scale, _ = hits
    source = np.zeros(VERTEX)
    source[HISTORY], source[BEFORE], source[SURFACE] = 1.0, NOTHING, NOTHING
    tail = most + 1
    for i in range(new.shape[0]):
        sums = sums_of(path_sums, first, i)
        new[i, SURFACE], fates[i] = NOTHING, -1
        where = int(kind[i])
        _end(source, new[i], three(origins[i], 0), three(directions[i], 0), distance[i], power)
        if where == NOTHING:
            sums[tail + ESCAPED] += power
            fates[i] = paths.ESCAPED
        elif reflects(where):
            _arrive(
                source,
                new[i],
                three(origins[i], 0),
                three(directions[i], 0),
                distance[i],
                where,
                three(normal[i], 0),
                scale[i],
                power,
                -1.0,
            )
            new[i, NARROW] = 1.0
        elif where == LENS:
            sums[tail + BLOCKED] += power
            fates[i] = paths.BLOCKED
        else:
            fate = ABSORBED_OCCLUDERS if where == OCCLUDER else ABSORBED_OBJECT
            sums[tail + (UNRESOLVED_LIGHT if where == LOST else fate)] += power
            fates[i] = paths.ABSORBED


@njit(cache=True, nogil=True)
def look(origins, directions, powers, densities, hits, new):
    """Fill the first vertices of eye paths, which are paths traced backward from the lens."""
    distance, kind, normal, scale, lit = hits
    source = np.zeros(VERTEX)
    source[BEFORE], source[SURFACE] = NOTHING, NOTHING
    for i in range(new.shape[0]):
        new[i, SURFACE] = NOTHING
        where = int(kind[i])
        if powers[i] > 0.0 and reflects(where):
            d, n = three(directions[i], 0), three(normal[i], 0)
            density = densities[i] * abs(dot(d, n)) / distance[i] ** 2
            o = three(origins[i], 0)
            _arrive(source, new[i], o, d, distance[i], where, n, scale[i], powers[i], density)
            new[i, LIT] = lit[i]


@njit(cache=True, nogil=True)
def look_on(norm, old, leave, origins, directions, hits, new):
    """Fill the second vertices of eye paths, after scattering at the first ones ``old``."""
    distance, kind, normal, scale, lit = hits
    for i in range(new.shape[0]):
        new[i, SURFACE] = NOTHING
        where = int(kind[i])
        if old[i, SURFACE] < 0.0 or not reflects(where):
            continue
        if dot(three(leave[i], 0), three(old[i], 3)) <= 0.0:
            continue
        d, n = three(directions[i], 0), three(normal[i], 0)
        target = target_density(norm, old[i], True, scale[i], lit[i])
        passed, density = _passed_on(leave[i], distance[i], where, n, target)
        if old[i, SURFACE] == OBJECT:
            passed *= old[i, SCALE]
        if passed > 0.0:
            o = three(origins[i], 0)
            power = old[i, POWER] * passed
            _arrive(old[i], new[i], o, d, distance[i], where, n, scale[i], power, density)
            new[i, LIT] = lit[i]
            new[i, NARROW] = leave[i, SHARE]
