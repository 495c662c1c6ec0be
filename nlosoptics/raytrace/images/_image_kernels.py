"""Compiled pixels, bins and polarisation of detected light."""

from __future__ import annotations

import math

from ...kernels.brdf import is_mirror, lobe
from ...kernels.codes import GROUPS
from ...kernels.compiling import njit
from ...kernels.polarisation import cross, fresnel, perpendicular, turned
from ..light._light_kernels import DENSITY, SURFACE, lobes_of
from ..light._point_kernels import landing
from ..light._surround_kernels import dot, three


@njit(cache=True, nogil=True)
def sort_light(
    camera, first, layers, power, length, legs, last, ends, shape, bins, cells, slots, powers, rays
):
    """Find the pixel and the bin of the light in each path that reaches the lens; return a count.

    ``camera`` is that of `World`. The other inputs have one row per ray, of which ``first`` is the
    number of the first: ``layers`` (layer of the image, and number of layers), ``power`` (W, 0
    without a path), ``length`` of the path (m), ``legs`` (its first leg, m), the ``last`` vertices
    and the points ``ends`` on the lens (m). ``shape`` is (ny, nx) and ``bins`` (start and width of
    a bin, m, number of bins, whether to count the outer legs).

    For each path the outputs get ``cells`` = (group, layer, row, column) and ``slots`` = (group,
    layer, bin + 1), as one number each, with one slot before the first bin and one after the last.
    ``powers`` and ``rays`` get the power and the ray's position in the block.
    """
    ny, nx = shape
    start, width, n_bins, outer = bins
    layer, n_layers = layers
    pitch = 2.0 * camera[15] / nx
    count = 0
    for i in range(power.size):
        if power[i] <= 0.0:
            continue
        p, a = three(ends[i], 0), three(last[i], 0)
        d = (a[0] - p[0], a[1] - p[1], a[2] - p[2])
        r = math.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
        x, y = landing(camera, p, (d[0] / r, d[1] / r, d[2] / r))
        # the point is on the detector, but rounding may move it across the edge
        column = min(max(int(math.floor(x / pitch + 0.5 * nx)), 0), nx - 1)
        row = min(max(int(math.floor(y / pitch + 0.5 * ny)), 0), ny - 1)
        path = length[i] if outer else length[i] - legs[i] - r
        slot = int(math.floor(min(max((path - start) / width, -1.0), float(n_bins)))) + 1
        group = (first + i) % GROUPS
        deep = group * n_layers + layer[i]
        cells[count] = (deep * ny + row) * nx + column
        slots[count] = deep * (n_bins + 2) + slot
        powers[count], rays[count] = power[i], i
        count += 1
    return count


@njit(cache=True)
def _reflected(lobes, mirror, stokes, mu_i, mu_o, between):
    """Return the Stokes parameters of reflected light relative to the power that lobes reflect.

    Those of the incident light are ``stokes``; both refer to the normal of the plane of incidence
    on a facet. Lobes with a refractive index reflect by Fresnel, all others depolarise. If
    ``mirror``, the smooth mirrors among them reflect the light, otherwise all other lobes.
    """
    i, q, u, v = stokes
    total = new_i = new_q = new_u = new_v = 0.0
    cosine = math.sqrt(max(0.0, 0.5 * (1.0 + between)))
    for j in range(lobes.shape[0]):
        if mirror:
            share = lobes[j, 1] * lobes[j, 3] if is_mirror(lobes, j) else 0.0
        else:
            share = lobe(lobes, j, mu_i, mu_o, between)
        if share <= 0.0:
            continue
        total += share
        if lobes[j, 5] > 0.0:
            a, b, c, d = fresnel(lobes[j, 5], lobes[j, 6], cosine)
            new_i += share * (i + b / a * q)
            new_q += share * (q + b / a * i)
            new_u += share * (c * u - d * v) / a
            new_v += share * (d * u + c * v) / a
        else:
            new_i += share * i
    if total <= 0.0:
        return 0.0, 0.0, 0.0, 0.0
    return new_i / total, new_q / total, new_u / total, new_v / total


@njit(cache=True, nogil=True)
def path_stokes(world, power, vertices, n_light, mirrored, ends, laser, axis, out):
    """Fill ``out`` (n, 4) with the Stokes parameters of paths relative to their power.

    ``vertices`` (m, n, VERTEX) are the vertices of each path in the order of the light, of which
    the first ``n_light`` belong to the light path; ``mirrored`` (n,) tells whether a smooth mirror
    sent the light to the lens at ``ends`` (n, 3), m. ``laser`` are the Stokes parameters of the
    laser for the reference vector ``axis``. Those of the result refer to the axis e1 of the camera,
    and U is positive for light polarised along e1 + e2.
    """
    m, camera = vertices.shape[0], world.camera
    for i in range(power.size):
        stokes = (0.0, 0.0, 0.0, 0.0)
        if power[i] > 0.0:
            stokes = laser
            first = vertices[0, i]
            d = (-first[6], -first[7], -first[8])
            e = perpendicular(axis, d, axis)
            for j in range(m):
                vertex = vertices[j, i]
                p, n = three(vertex, 0), three(vertex, 3)
                to = three(vertices[j + 1, i], 0) if j + 1 < m else three(ends[i], 0)
                out_d = (to[0] - p[0], to[1] - p[1], to[2] - p[2])
                r = math.sqrt(dot(out_d, out_d))
                out_d = (out_d[0] / r, out_d[1] / r, out_d[2] / r)
                # a density below 0 tells that a mirror led to a vertex; eye paths go backward
                mirror = False
                if j + 1 < n_light:
                    mirror = vertices[j + 1, i, DENSITY] < 0.0
                elif j > n_light:
                    mirror = vertices[j - 1, i, DENSITY] < 0.0
                elif m == n_light:
                    mirror = mirrored[i]
                normal = perpendicular(cross(d, out_d), d, e)
                stokes = turned(stokes, d, e, normal)
                mu_i, between = -dot(d, n), -dot(d, out_d)
                lobes = lobes_of(world, int(vertex[SURFACE]))
                stokes = _reflected(lobes, mirror, stokes, mu_i, dot(out_d, n), between)
                e, d = normal, out_d
            first_axis = perpendicular(three(camera, 3), d, e)
            stokes = turned(stokes, d, e, first_axis)
            if dot(cross(first_axis, d), three(camera, 6)) < 0.0:
                stokes = (stokes[0], stokes[1], -stokes[2], -stokes[3])
        for k in range(4):
            out[i, k] = stokes[k]
