"""Light that arrives at points and cells of the wall, compiled."""

from __future__ import annotations

import math

from numba import njit

from .._random_kernels import draw
from ._light_kernels import (
    BEFORE,
    DENSITY,
    MET,
    POWER,
    SCALE,
    SURFACE,
    between,
    next_density,
    reflected,
)
from ._surround_kernels import DRAW_LENS, DRAW_PIXEL, NOTHING, OBJECT, WALL, object_point, three
from .surroundings import GROUPS


@njit(cache=True, nogil=True)
def glow(world, sampler, first, power, new):
    """Vertices on the object's front, in proportion to area times brightness, lit from above."""
    for i in range(new.shape[0]):
        ray = first + i
        group, index = ray % GROUPS, ray // GROUPS
        u = draw(sampler, group, index, ray, DRAW_PIXEL)
        v = draw(sampler, group, index, ray, DRAW_PIXEL + 1)
        point, normal = object_point(world, u, v)
        for k in range(3):
            new[i, k], new[i, 3 + k], new[i, 6 + k] = point[k], normal[k], normal[k]
        new[i, POWER], new[i, DENSITY], new[i, SURFACE], new[i, SCALE] = power, -1.0, OBJECT, 1.0
        new[i, MET], new[i, BEFORE] = 1.0, NOTHING


@njit(cache=True)
def spots(sampler, first, corner, size, xy):
    """Points (n, 2) evenly over the rectangle from ``corner`` on."""
    for i in range(xy.shape[0]):
        ray = first + i
        group, index = ray % GROUPS, ray // GROUPS
        for k in range(2):
            u = draw(sampler, group, index, ray, DRAW_LENS + k)
            xy[i, k] = corner[k] + u * size[k]


@njit(cache=True, nogil=True)
def to_wall(world, light, targets, value, starts, ends):
    """Power that light vertices send to wall points, vertices with their DENSITY and 1/DENSITY.

    Walks that arrive by themselves are the other strategy, by the balance heuristic.
    """
    for i in range(light.shape[0]):
        value[i] = 0.0
        a, b = light[i], targets[i]
        if a[SURFACE] < 0.0 or b[SURFACE] < 0.0:
            continue
        d, square, cos_a, cos_b = between(a, b)
        if cos_a <= 0.0 or cos_b <= 0.0:
            continue
        f = reflected(world, a, d, cos_a) * a[POWER] * cos_a * cos_b / square
        if f <= 0.0:
            continue
        walked = next_density(world, a, three(a, 6), d, cos_a, b, cos_b, square, False)
        value[i] = f / (b[DENSITY] + walked)
        for k in range(3):
            starts[i, k], ends[i, k] = a[k], b[k]


@njit(cache=True, nogil=True)
def arrivals(vertices, evenly, power):
    """Powers of walks that arrive at the wall, shared with `to_wall` of density ``evenly``.

    That density is per mean-plane area, so that the wall's tilt takes part.
    """
    for i in range(vertices.shape[0]):
        power[i] = 0.0
        if vertices[i, SURFACE] == WALL:
            power[i] = vertices[i, POWER]
            if vertices[i, DENSITY] >= 0.0:
                walked = vertices[i, DENSITY]
                power[i] *= walked / (walked + evenly * vertices[i, 5])


@njit(cache=True, nogil=True)
def cells_of(points, power, first, corner, step, shape, cells, powers):
    """Cells (group, row and column as one number) and powers of light at points; their number."""
    count = 0
    ny, nx = shape
    for i in range(power.size):
        if power[i] > 0.0:
            column = int(math.floor((points[i, 0] - corner[0]) / step[0]))
            row = int(math.floor((points[i, 1] - corner[1]) / step[1]))
            if 0 <= column < nx and 0 <= row < ny:
                cells[count] = ((first + i) % GROUPS * ny + row) * nx + column
                powers[count] = power[i]
                count += 1
    return count
