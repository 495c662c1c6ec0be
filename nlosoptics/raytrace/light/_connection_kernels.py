"""Compiled connections: between vertices of light and eye paths, and from vertices to the lens.

The columns of a vertex are those of `_light_kernels`.
"""

from __future__ import annotations

import math

from ...kernels.brdf import material
from ...kernels.compiling import njit
from ._light_kernels import (
    DENSITY,
    LENGTH,
    LENGTHS,
    LINKED,
    LIT,
    MET,
    NARROW,
    POWER,
    SCALE,
    STRAY,
    SURFACE,
    aimed_share,
    chain_shares,
    chained_at,
    lobes_of,
    narrow_share,
    sums_of,
    target_density,
)
from ._lobe_kernels import lobe_density
from ._surround_kernels import OBJECT, dot, on_detector, three, unit


@njit(cache=True)
def reflected(lobes, vertex, direction, cosine):
    """Return f_r times brightness of a vertex toward a unit vector, 1/sr, without mirrors."""
    incident = three(vertex, 6)
    mu = dot(incident, three(vertex, 3))
    f = material(lobes, mu, cosine, dot(incident, direction))
    return f * vertex[SCALE] if vertex[SURFACE] == OBJECT else f


@njit(cache=True)
def narrow_at(lobes, chained, vertex, direction, cosine):
    """Return the share of the narrow lobes in `reflected`; 0 unless the surface is ``chained``."""
    incident = three(vertex, 6)
    mu = dot(incident, three(vertex, 3))
    return narrow_share(lobes, chained, mu, cosine, dot(incident, direction))


@njit(cache=True)
def next_density(
    lobes, share, norm, vertex, incident, direction, cosine, target, target_cosine, square, eye
):
    """Return the density, 1/m^2, with which `scatter` continues a path to the point of a target.

    ``lobes`` and ``share`` are `lobes_of` and `aimed_share` of the vertex. ``incident`` and
    ``direction`` are unit vectors toward the previous vertex and the target, ``cosine`` and
    ``target_cosine`` the cosines at both ends, ``square`` the squared distance, m^2.
    """
    n = three(vertex, 3)
    mu, between = dot(incident, n), dot(incident, direction)
    density = lobe_density(lobes, mu, cosine, between, eye)
    density *= (1.0 - share) * target_cosine / square
    if target[SURFACE] == OBJECT:
        density += share * target_density(norm, vertex, eye, target[SCALE], target[LIT])
    return density


@njit(cache=True)
def between(a, b):
    """Return the unit vector from vertex a to b, the squared distance (m^2), and both cosines."""
    d = (b[0] - a[0], b[1] - a[1], b[2] - a[2])
    square = dot(d, d)
    if square == 0.0:
        return d, 1.0, 0.0, 0.0
    r = math.sqrt(square)
    d = (d[0] / r, d[1] / r, d[2] / r)
    return d, square, dot(d, three(a, 3)), -dot(d, three(b, 3))


@njit(cache=True)
def _chained(world, a, b, seen, second, d, cos_a, cos_b):
    """Return the share of a connection by `connect` that is traced as a chain of narrow lobes."""
    kind_a, kind_b = int(a[SURFACE]), int(b[SURFACE])
    chained = chained_at(world.chains, kind_a)
    narrow = narrow_at(lobes_of(world, kind_a), chained, a, d, cos_a)
    begun, linked = chain_shares(a, narrow, kind_b)
    chained, back = chained_at(world.chains, kind_b), (-d[0], -d[1], -d[2])
    narrow_b = narrow_at(lobes_of(world, kind_b), chained, b, back, cos_b)
    if not second:
        return linked * narrow_b
    if b[SURFACE] == seen[SURFACE]:
        return 0.0
    return b[NARROW] * (narrow_b * begun + (1.0 - narrow_b) * narrow)


@njit(cache=True, nogil=True)
def connect(world, light, eye, seen, second, glossy, value, length, starts, ends):
    """Fill the detected power and length of connections between light vertices and eye vertices."""
    for i in range(light.shape[0]):
        value[i] = 0.0
        a, b = light[i], eye[i]
        if a[SURFACE] < 0.0 or b[SURFACE] < 0.0:
            continue
        d, square, cos_a, cos_b = between(a, b)
        if cos_a <= 0.0 or cos_b <= 0.0:
            continue
        back = (-d[0], -d[1], -d[2])
        lobes_a, lobes_b = lobes_of(world, int(a[SURFACE])), lobes_of(world, int(b[SURFACE]))
        f = reflected(lobes_a, a, d, cos_a) * reflected(lobes_b, b, back, cos_b)
        if f <= 0.0:
            continue
        f *= a[POWER] * b[POWER] * cos_a * cos_b / square
        if glossy:
            share, norm, came = aimed_share(world, a, False), world.norm, three(a, 6)
            onward = next_density(lobes_a, share, norm, a, came, d, cos_a, b, cos_b, square, False)
            x = seen[i]
            if second:
                if b[DENSITY] > 0.0:
                    # density with which the light path would find the first eye vertex
                    to, r2, cos_1, cos_2 = between(b, x)
                    share = aimed_share(world, b, False)
                    last = next_density(
                        lobes_b, share, norm, b, back, to, cos_1, x, cos_2, r2, False
                    )
                    f /= 1.0 + onward / b[DENSITY] * (1.0 + last / x[DENSITY])
            else:
                others = onward / b[DENSITY]
                if a[DENSITY] > 0.0:
                    share, came = aimed_share(world, b, True), three(b, 6)
                    upstream = next_density(
                        lobes_b, share, norm, b, came, back, cos_b, a, cos_a, square, True
                    )
                    others += upstream / a[DENSITY]
                f /= 1.0 + others
        if world.chains != 0:
            f *= 1.0 - _chained(world, a, b, seen[i], second, d, cos_a, cos_b)
        value[i] = f
        length[i] = a[LENGTH] + math.sqrt(square) + b[LENGTH]
        for k in range(3):
            starts[i, k], ends[i, k] = a[k], b[k]


@njit(cache=True, nogil=True)
def to_lens(world, light, before, lens, glossy, value, length, starts, ends):
    """Fill the detected power and length of connections between light vertices and lens points."""
    camera = world.camera
    area, axis = math.pi * camera[12] ** 2 * camera[18], three(camera, 9)
    for i in range(light.shape[0]):
        value[i] = 0.0
        a, p = light[i], three(lens[i], 0)
        if a[SURFACE] < 0.0:
            continue
        d, r = unit(a, p)
        square, cosine = r * r, dot(d, three(a, 3))
        if cosine <= 0.0:
            continue
        seen = on_detector(camera, p, (-d[0], -d[1], -d[2]))
        if seen <= 0.0:
            continue
        lobes = lobes_of(world, int(a[SURFACE]))
        f = reflected(lobes, a, d, cosine) * cosine * a[POWER] * area * -dot(d, axis) / square
        if f <= 0.0:
            continue
        if glossy and a[DENSITY] > 0.0:
            here = seen * cosine / square
            ratio = here / a[DENSITY]
            b = before[i]
            if b[DENSITY] > 0.0:
                to, r2, cos_a, cos_b = between(a, b)
                share, norm = aimed_share(world, a, True), world.norm
                upstream = next_density(lobes, share, norm, a, d, to, cos_a, b, cos_b, r2, True)
                ratio += ratio * upstream / b[DENSITY]
            f /= 1.0 + ratio
        if a[LINKED] > 0.0:
            chained = chained_at(world.chains, int(a[SURFACE]))
            f *= 1.0 - a[LINKED] * narrow_at(lobes, chained, a, d, cosine)
        value[i] = f
        length[i] = a[LENGTH] + r
        for k in range(3):
            starts[i, k], ends[i, k] = a[k], p[k]


@njit(cache=True, nogil=True)
def book(light, eye, bounce, most, first, value, length, path_sums):
    """Add the power of connections to the sum of their number of reflections, or stray light."""
    for i in range(value.size):
        if value[i] > 0.0:
            sums = sums_of(path_sums, first, i)
            if light[i, MET] > 0.0 or eye[i, MET] > 0.0:
                sums[bounce] += value[i]
                sums[most + 1 + LENGTHS] += value[i] * length[i]
            else:
                sums[most + 1 + STRAY] += value[i]
