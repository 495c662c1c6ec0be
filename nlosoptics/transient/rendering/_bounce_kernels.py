"""Compiled steps of random paths between hidden surfaces: sample, extend, connect and bin.

A vertex is a row of VERTEX numbers: point, unit normal, unit vector back along the path, weight,
length of the path so far, and index of the triangle, -1 for none.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...kernels.brdf import material, material_pdf, sample_material
from ...kernels.codes import LAMBERT
from ...kernels.compiling import njit
from ...kernels.random import draw
from ...raytrace.light._lobe_kernels import tangents
from ...raytrace.light._surround_kernels import dot, three
from ._sight_kernels import blocked

VERTEX = 12
P, N, I = slice(0, 3), slice(3, 6), slice(6, 9)  # noqa: E741  (I as in incidence)
WEIGHT, LENGTH, TRIANGLE = range(9, 12)
LEAVE = 4
DENSITY, SENT, REACH, COSINE = range(4)
# numbers of random draws of a path: those for the first vertex, then those for each leg
DRAWS_SEEN, DRAWS_A_LEG = 4, 4
DRAW_VIEW = 1000  # draw number of `view`, larger than that of any leg
VIEWS = 8  # number of sensors whose lobes guide the leg from a first vertex


class Surfaces(NamedTuple):
    """Data of the hidden triangles and, after them, of the relay wall's triangles, if any.

    ``lobes`` are the rows of the materials and ``spans`` (n, 2) the range of rows for each
    triangle. ``triangles`` (n, 9) hold a corner and two sides, m. ``normals`` (n, 3) are unit
    vectors; ``sides`` (n,) is the side on which all sensors lie, 1 or -1, or 0 for both.
    ``shares`` is the cumulative fraction of the hidden area before each hidden triangle, ending
    with 1; ``area`` is the hidden area, m^2. ``rows`` and ``boxes`` are the hidden triangles and
    their tree for shadows.
    """

    lobes: NDArray[np.float64]
    spans: NDArray[np.int64]
    triangles: NDArray[np.float64]
    normals: NDArray[np.float64]
    sides: NDArray[np.int64]
    shares: NDArray[np.float64]
    area: float
    rows: NDArray[np.float64]
    boxes: NDArray[np.float64]


@njit(cache=True)
def _lobes(surfaces, triangle):
    return surfaces.lobes[surfaces.spans[triangle, 0] : surfaces.spans[triangle, 1]]


@njit(cache=True)
def _about(n, x, y, z):
    """Return the vector with components (x, y, z) in an orthonormal frame whose third axis is n."""
    a, b = tangents(n)
    return (
        x * a[0] + y * b[0] + z * n[0],
        x * a[1] + y * b[1] + z * n[1],
        x * a[2] + y * b[2] + z * n[2],
    )


@njit(cache=True)
def _cosine_weighted(n, u, v):
    """Sample a direction with density cos/pi about n."""
    radius, turn = math.sqrt(u), 2.0 * math.pi * v
    return _about(n, radius * math.cos(turn), radius * math.sin(turn), math.sqrt(1.0 - u))


@njit(cache=True)
def _hidden_point(surfaces, u, v):
    """Sample a point uniformly over the hidden area; return it and its triangle."""
    shares = surfaces.shares
    k = min(np.searchsorted(shares, u, side="right") - 1, shares.size - 2)
    u = min((u - shares[k]) / (shares[k + 1] - shares[k]), 1.0)
    row, root = surfaces.triangles[k], math.sqrt(u)
    b, c = root * (1.0 - v), root * v
    return (
        row[0] + b * row[3] + c * row[6],
        row[1] + b * row[4] + c * row[7],
        row[2] + b * row[5] + c * row[8],
    ), k


@njit(cache=True, nogil=True)
def look(surfaces, sampler, aimed, sensors, first, origins, directions, triangles):
    """Sample first vertices, as rays from sensors or as points over the hidden area.

    A point fills ``origins`` with itself, ``directions`` with its normal on the side of the sensors
    and ``triangles`` with its triangle. A ray fills the first two, and ``triangles`` with -1.
    """
    for i in range(origins.shape[0]):
        ray = first + i
        u, v = draw(sampler, 0, ray, ray, 0), draw(sampler, 0, ray, ray, 1)
        if draw(sampler, 0, ray, ray, 2) < aimed:
            p, t = _hidden_point(surfaces, u, v)
            triangles[i], side = t, surfaces.sides[t]
            if side == 0:
                side = 1 if draw(sampler, 0, ray, ray, 3) < 0.5 else -1
            n = three(surfaces.normals[t], 0)
            d = (side * n[0], side * n[1], side * n[2])
        else:
            triangles[i] = -1
            c = int(draw(sampler, 0, ray, ray, 3) * sensors.shape[0])
            p = three(sensors[min(c, sensors.shape[0] - 1)], 0)
            d = _cosine_weighted((0.0, 0.0, 1.0), u, v)
        for k in range(3):
            origins[i, k], directions[i, k] = p[k], d[k]


@njit(cache=True, nogil=True)
def seen_from(surfaces, sensors, vertices, factor, distance):
    """Fill ``factor`` and ``distance`` (sensors, vertices): cos cos/r^2, 1/m^2, and r, m."""
    for c in range(sensors.shape[0]):
        s = three(sensors[c], 0)
        for j in range(vertices.shape[0]):
            p, n = three(vertices[j], 0), three(vertices[j], 3)
            d = (p[0] - s[0], p[1] - s[1], p[2] - s[2])
            square = dot(d, d)
            product = -d[2] * dot(d, n)
            factor[c, j] = 0.0
            distance[c, j] = math.sqrt(square)
            if vertices[j, TRIANGLE] < 0.0 or d[2] <= 0.0 or product <= 0.0:
                continue
            if blocked(surfaces.rows, surfaces.boxes, s, d):
                continue
            factor[c, j] = product / (square * square)


@njit(cache=True, nogil=True)
def view(sampler, sensors, factor, vertices, views):
    """Fill ``views`` (vertices, VIEWS, 3) with unit vectors to a sample of each vertex's sensors.

    Sensors are chosen by systematic sampling: equal steps of the cumulative ``factor``
    (sensors, vertices), with a random offset.
    """
    for j in range(vertices.shape[0]):
        total = 0.0
        for c in range(sensors.shape[0]):
            total += factor[c, j]
        if total <= 0.0:
            continue
        shift = draw(sampler, 0, j, j, DRAW_VIEW)
        k, below = 0, 0.0
        for c in range(sensors.shape[0]):
            below += factor[c, j]
            last = c == sensors.shape[0] - 1
            while k < VIEWS and ((k + shift) * total < below * VIEWS or last):
                d = (
                    sensors[c, 0] - vertices[j, 0],
                    sensors[c, 1] - vertices[j, 1],
                    sensors[c, 2] - vertices[j, 2],
                )
                r = math.sqrt(dot(d, d))
                for m in range(3):
                    views[j, k, m] = d[m] / r
                k += 1


@njit(cache=True)
def _lobe_direction(lobes, incident, n, u, v, w):
    """Sample a direction from the lobes of a material."""
    a, b = tangents(n)
    x, y, z, _ = sample_material(
        lobes, dot(incident, a), dot(incident, b), dot(incident, n), u, v, w
    )
    return _about(n, x, y, z)


@njit(cache=True)
def _viewed_density(lobes, views, n, d, cosine):
    """Return the density per solid angle with which `leave` samples d at a first vertex."""
    density = 0.0
    for k in range(VIEWS):
        w = three(views[k], 0)
        density += material_pdf(lobes, dot(w, n), cosine, dot(w, d))
    return 0.5 * cosine / math.pi + 0.5 * density / VIEWS


@njit(cache=True)
def _plain(lobes):
    """Return whether a material is purely Lambertian."""
    return lobes.shape[0] == 1 and lobes[0, 0] == LAMBERT


@njit(cache=True, nogil=True)
def leave(surfaces, draws, aimed, views, vertices, leaving, rays):
    """Sample the directions of the next leg, from a lobe or towards a point of the hidden area.

    ``views`` (vertices, VIEWS, 3) is given for first vertices and empty otherwise. The lobe of a
    first vertex is evaluated only in `gather`, where the sensor is known. Half of its directions
    have the density of the cosine, half that of the lobes for the views; on Lambertian surfaces all
    have that of the cosine. ``leaving`` is filled with the density per solid angle; lobe times
    cosine (for first vertices the cosine only); the distance of the point aimed at, or -1; and the
    cosine.
    """
    (sampler, first, number), (origins, directions) = draws, rays
    seen = views.shape[0] > 0
    for i in range(vertices.shape[0]):
        vertex, out = vertices[i], leaving[i]
        out[DENSITY], out[SENT], out[REACH], out[COSINE] = 0.0, 0.0, -1.0, 0.0
        if vertex[TRIANGLE] < 0.0:
            continue
        ray = first + i
        u, v = draw(sampler, 0, ray, ray, number), draw(sampler, 0, ray, ray, number + 1)
        p, n, incident = three(vertex, 0), three(vertex, 3), three(vertex, 6)
        lobes = _lobes(surfaces, int(vertex[TRIANGLE]))
        if aimed > 0.0 and draw(sampler, 0, ray, ray, number + 2) < aimed:
            to, _ = _hidden_point(surfaces, u, v)
            d = (to[0] - p[0], to[1] - p[1], to[2] - p[2])
            reach = math.sqrt(dot(d, d))
            if reach == 0.0:
                continue
            d = (d[0] / reach, d[1] / reach, d[2] / reach)
            out[REACH] = reach
        else:
            choice = draw(sampler, 0, ray, ray, number + 3)
            if not seen:
                d = _lobe_direction(lobes, incident, n, u, v, choice)
            elif choice < 0.5 or _plain(lobes):
                d = _cosine_weighted(n, u, v)
            else:
                choice = (2.0 * choice - 1.0) * VIEWS
                k = min(int(choice), VIEWS - 1)
                d = _lobe_direction(lobes, three(views[i, k], 0), n, u, v, choice - k)
        cosine = dot(d, n)
        if cosine <= 0.0:
            continue
        out[COSINE] = cosine
        if seen:
            out[DENSITY], out[SENT] = cosine / math.pi, cosine
            if not _plain(lobes):
                out[DENSITY] = _viewed_density(lobes, views[i], n, d, cosine)
        else:
            mu, between = dot(incident, n), dot(incident, d)
            out[DENSITY] = material_pdf(lobes, mu, cosine, between)
            out[SENT] = material(lobes, mu, cosine, between) * cosine
        for k in range(3):
            origins[i, k], directions[i, k] = p[k], d[k]


@njit(cache=True, nogil=True)
def arrive(surfaces, aimed, old, leaving, hits, new):
    """Fill ``new`` with the vertices at which paths arrive.

    Lobes and aiming at the area are combined by the balance heuristic.
    """
    directions, distance, triangle = hits
    hidden = surfaces.shares.size - 1
    for i in range(old.shape[0]):
        new[i, TRIANGLE] = -1.0
        k, out, r = triangle[i], leaving[i], distance[i]
        if k < 0 or out[SENT] <= 0.0:
            continue
        d, n = three(directions[i], 0), three(surfaces.normals[k], 0)
        cosine = -dot(d, n)
        if cosine == 0.0 or r <= 0.0:
            continue
        side = 1.0 if cosine > 0.0 else -1.0
        cosine *= side
        if out[REACH] >= 0.0 and abs(r - out[REACH]) > 1e-6 * out[REACH]:
            continue  # the point aimed at is occluded
        density = (1.0 - aimed) * out[DENSITY]
        if aimed > 0.0 and k < hidden:
            density += aimed / surfaces.area * r * r / cosine
        if density <= 0.0:
            continue
        for j in range(3):
            new[i, j] = old[i, j] + r * d[j]
            new[i, 3 + j], new[i, 6 + j] = side * n[j], -d[j]
        new[i, WEIGHT] = old[i, WEIGHT] * out[SENT] / density
        new[i, LENGTH] = old[i, LENGTH] + r
        new[i, TRIANGLE] = k


@njit(cache=True, nogil=True)
def connect(surfaces, laser, vertices, value, length):
    """Connect vertices to a laser's spot; fill weight ``value``, 1/m^2, and path ``length``, m."""
    for i in range(vertices.shape[0]):
        value[i], vertex = 0.0, vertices[i]
        if vertex[TRIANGLE] < 0.0 or vertex[WEIGHT] <= 0.0:
            continue
        d = (laser[0] - vertex[0], laser[1] - vertex[1], laser[2] - vertex[2])
        square = dot(d, d)
        r = math.sqrt(square)
        cosine = dot(d, three(vertex, 3)) / r
        if cosine <= 0.0 or d[2] >= 0.0:
            continue
        if blocked(surfaces.rows, surfaces.boxes, three(vertex, 0), d):
            continue
        incident = three(vertex, 6)
        mu, between = dot(incident, three(vertex, 3)), dot(incident, d) / r
        f = material(_lobes(surfaces, int(vertex[TRIANGLE])), mu, cosine, between)
        value[i] = vertex[WEIGHT] * f * cosine * -d[2] / (r * square)
        length[i] = vertex[LENGTH] + r


@njit(cache=True, nogil=True)
def gather(surfaces, paths, place, found, start, rate, bins):
    """Add all paths to the bins of one sensor.

    ``paths`` is (seen, spread, first): paths ``spread[j]`` to ``spread[j + 1] - 1`` leave the first
    vertex ``seen[j]`` in directions ``first`` (paths, 3). ``found`` is their weight and length
    (paths,) from the vertex to the laser. ``place`` is the sensor, with its factor and distance
    (vertices,) from `seen_from`. ``start`` is the start of bin 0, m, and ``rate`` the number of
    bins per m.
    """
    (seen, spread, first), (value, length) = paths, found
    sensor, factor, away = place
    n_bins = bins.size
    for j in range(seen.shape[0]):
        if factor[j] <= 0.0:
            continue
        lobes = _lobes(surfaces, int(seen[j, TRIANGLE]))
        plain = _plain(lobes)
        scale = factor[j] * material(lobes, 1.0, 1.0, 1.0) if plain else factor[j]
        n, p = three(seen[j], 3), three(seen[j], 0)
        to = (
            (sensor[0] - p[0]) / away[j],
            (sensor[1] - p[1]) / away[j],
            (sensor[2] - p[2]) / away[j],
        )
        mu, shift = dot(to, n), away[j] - start
        for k in range(spread[j], spread[j + 1]):
            v, t = value[k], (length[k] + shift) * rate
            if t < 0.0 or t >= n_bins:
                continue
            if not plain:
                d = three(first[k], 0)
                v *= material(lobes, mu, dot(d, n), dot(d, to))
            bins[int(t)] += v * scale


@njit(cache=True)
def _lit(spread, first, value, length):
    """Return the paths of positive weight: their spread, first directions, weights and lengths."""
    kept = np.flatnonzero(value > 0.0)
    return np.searchsorted(kept, spread), first[kept], value[kept], length[kept]


@njit(cache=True, nogil=True)
def gather_pairs(surfaces, paths, pairs, table, found, total, squares):
    """Add the bins of one batch and their squares, for each pair of laser and sensor.

    ``paths`` is that of `gather`. ``pairs`` is (rows, starts, rate): indices (laser, sensor) of the
    pairs in ``total`` and ``squares`` (orders, pairs, n_bins), sorted by laser; start of bin 0, m,
    of each pair; and bins per m. ``table`` is (factor, away, sensors) and ``found`` (value, length)
    for all sensors, lasers and orders.
    """
    (rows, starts, rate), (factor, away, sensors) = pairs, table
    (value, length), (seen, spread, first) = found, paths
    bins = np.empty(total.shape[2])
    for n in range(total.shape[0]):
        lit = _lit(spread, first, value[0, n], length[0, n])
        last = 0
        for a in range(rows.shape[0]):
            at, c = rows[a]
            if at != last:
                lit, last = _lit(spread, first, value[at, n], length[at, n]), at
            bins[:] = 0.0
            place = sensors[c], factor[c], away[c]
            gather(surfaces, (seen, lit[0], lit[1]), place, lit[2:], starts[a], rate, bins)
            for b in range(bins.size):
                total[n, a, b] += bins[b]
                squares[n, a, b] += bins[b] * bins[b]
