"""Compiled starts and hits of rays in a scene: laser, lens, wall, planar object and meshes."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...kernels.codes import GROUPS
from ...kernels.compiling import njit
from ...kernels.heights import tangent
from ...kernels.random import disc, draw
from ..intersection._wall_kernels import HIT, UNRESOLVED, wall_hit

# kinds of hit: OCCLUDER is a black occluder, BACK the back of the hidden object, LOST a hit that
# could not be resolved, and ROOM + k an occluder of material k
NOTHING, WALL, OBJECT, OCCLUDER, LENS, BACK, LOST, ROOM = range(-1, 7)
# Numbers of a ray's random draws. Low Sobol dimensions are the most uniform, so that the draws with
# the largest influence on the detected power come first.
DRAW_PIXEL, DRAW_FIRST, DRAW_LENS, DRAW_BEAM, DRAW_EYE, DRAW_NEXT = 0, 2, 6, 8, 10, 14
DRAWS_A_BOUNCE = 5
DRAW_THIN = 1000  # above the draws of all bounces


class World(NamedTuple):
    """Data of a scene for the kernels; lengths in m, world frame.

    Attributes
    ----------
    wall, thing : ndarray, (n, 7)
        Lobes of the wall and of the hidden object.
    room : ndarray, (m, k, 7)
        Lobes of the m materials of occluders that reflect light; rows without a lobe are 0.
    kinds : ndarray of int16, (f,)
        Kinds of hit of the triangles of occluders and wall.
    plate : ndarray, (14,)
        Planar object: centre, right, up, normal, half width, half height; empty for a mesh.
    picture : ndarray, (ny, nx)
        Brightness of the planar object, row 0 on top.
    rows, columns : ndarray, (ny + 1,) and (ny, nx + 1)
        Cumulative brightness of the rows, and of the pixels within each row, 0 to 1.
    triangles, areas, firsts, splits, patches : ndarray
        Mesh object: `prepared_meshes.Chart` of its triangles, whose ``shares`` are ``areas``.
    lit_splits, lit : ndarray, (p,)
        Mesh object: splits of the chart, and densities on the patches, 1/m^2, with which rays from
        the laser spot are aimed; see `surroundings.lit_patches`.
    norm : float
        1 over the integral of brightness over the object's area, 1/m^2; 0 for a black object.
    aimed : ndarray, (2,)
        Shares of rays from the wall that are aimed at the object; see `surroundings.AIMED`.
    glossy : bool
        Whether a lobe requires three sampling strategies.
    chains : int
        Surfaces of which `_chain_kernels` traces chains of narrow lobes: 1 for the wall, plus 2 for
        the hidden object.
    ball : ndarray, (4,)
        Centre and radius of a sphere around the object.
    camera : ndarray, (21,)
        0-11: lens centre, e1, e2, axis. 12-14: stop radius, focus distance, image distance.
        15-16: half widths of the detector. 17: cosine of half the field stop, or -1.
        18: transmission. 19: sampled area of the detector plane. 20: radius, at the focus distance,
        of the cone through the field stop, or 0 to sample the detector.
    laser : ndarray, (14,)
        Start, direction, two transverse axes, beam radius, power (W).
    """

    wall: NDArray[np.float64]
    thing: NDArray[np.float64]
    room: NDArray[np.float64]
    kinds: NDArray[np.int16]
    plate: NDArray[np.float64]
    picture: NDArray[np.float64]
    rows: NDArray[np.float64]
    columns: NDArray[np.float64]
    triangles: NDArray[np.float64]
    areas: NDArray[np.float64]
    firsts: NDArray[np.int64]
    splits: NDArray[np.float64]
    patches: NDArray[np.int32]
    lit_splits: NDArray[np.float64]
    lit: NDArray[np.float64]
    norm: float
    aimed: NDArray[np.float64]
    glossy: bool
    chains: int
    ball: NDArray[np.float64]
    camera: NDArray[np.float64]
    laser: NDArray[np.float64]


@njit(cache=True)
def dot(a, b):
    """Return the scalar product of two vectors."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(cache=True)
def reflects(kind):
    """Return whether surfaces of this kind reflect light, so that a path may go on from them."""
    return kind in (WALL, OBJECT) or kind >= ROOM


@njit(cache=True)
def three(row, start):
    """Return three consecutive numbers of a row as a tuple."""
    return row[start], row[start + 1], row[start + 2]


@njit(cache=True)
def interval(shares, u):
    """Return the number of the interval of cumulative ``shares``, from 0 to 1, in which u lies."""
    low, high = 0, shares.size
    while low < high:
        middle = (low + high) >> 1
        if shares[middle] <= u:
            low = middle + 1
        else:
            high = middle
    return min(low - 1, shares.size - 2)


@njit(cache=True)
def pair(sampler, ray, number):
    """Return the random numbers ``number`` and ``number + 1`` of a ray."""
    group, index = ray % GROUPS, ray // GROUPS
    return draw(sampler, group, index, ray, number), draw(sampler, group, index, ray, number + 1)


@njit(cache=True)
def unit(start, end):
    """Return the unit vector from one point to another, and their distance."""
    d = (end[0] - start[0], end[1] - start[1], end[2] - start[2])
    r = math.sqrt(dot(d, d))
    return (d[0] / r, d[1] / r, d[2] / r), r


@njit(cache=True, nogil=True)
def beam(laser, sampler, first, origins, directions):
    """Fill the rays of the laser, distributed uniformly over the beam."""
    for i in range(origins.shape[0]):
        x, y = disc(*pair(sampler, first + i, DRAW_BEAM))
        for k in range(3):
            origins[i, k] = laser[k] + laser[12] * (x * laser[6 + k] + y * laser[9 + k])
            directions[i, k] = laser[3 + k]


@njit(cache=True, nogil=True)
def sight(camera, sampler, first, origins, directions, powers, densities):
    """Fill rays from the lens into the scene, uniform over lens and detector (or field stop)."""
    lens_area, zoom, baffle = math.pi * camera[12] ** 2, camera[13] / camera[14], camera[20]
    for i in range(origins.shape[0]):
        x, y = pair(sampler, first + i, DRAW_PIXEL)
        u, v = disc(*pair(sampler, first + i, DRAW_LENS))
        u, v = u * camera[12], v * camera[12]
        # toward the image of the detector point in the plane in focus
        c = camera[13]
        if baffle > 0.0:
            a, b = disc(x, y)
            a, b = a * baffle, b * baffle
        else:
            a = (1.0 - 2.0 * x) * camera[15] * zoom - u
            b = (1.0 - 2.0 * y) * camera[16] * zoom - v
        norm = math.sqrt(a * a + b * b + c * c)
        cosine = c / norm
        for k in range(3):
            origins[i, k] = camera[k] + u * camera[3 + k] + v * camera[6 + k]
            directions[i, k] = (a * camera[3 + k] + b * camera[6 + k] + c * camera[9 + k]) / norm
        densities[i] = camera[14] ** 2 / (camera[19] * cosine**3)
        seen = abs(a + u) <= camera[15] * zoom and abs(b + v) <= camera[16] * zoom
        seen &= baffle > 0.0 or cosine >= camera[17]
        powers[i] = lens_area * cosine * camera[18] / densities[i] if seen else 0.0


@njit(cache=True)
def on_detector(camera, point, direction):
    """Return the density of `sight` for a direction from a point of the lens, 1/sr."""
    cosine = dot(direction, three(camera, 9))
    if cosine <= 0.0 or cosine < camera[17]:
        return 0.0
    apart = (point[0] - camera[0], point[1] - camera[1], point[2] - camera[2])
    far, zoom = camera[13] / cosine, camera[14] / camera[13]
    e1, e2 = three(camera, 3), three(camera, 6)
    x = (dot(apart, e1) + far * dot(direction, e1)) * zoom
    y = (dot(apart, e2) + far * dot(direction, e2)) * zoom
    if abs(x) > camera[15] or abs(y) > camera[16]:
        return 0.0
    return camera[14] ** 2 / (camera[19] * cosine**3)


@njit(cache=True)
def _plate(plate, o, d, low, high):
    """Return the distance, m, from low to high at which a ray hits the planar object, else inf."""
    along = dot(d, three(plate, 9))
    if along == 0.0:
        return math.inf
    away = (plate[0] - o[0], plate[1] - o[1], plate[2] - o[2])
    t = dot(away, three(plate, 9)) / along
    if not low < t < high:
        return math.inf
    across = (o[0] + t * d[0] - plate[0], o[1] + t * d[1] - plate[1], o[2] + t * d[2] - plate[2])
    if abs(dot(across, three(plate, 3))) > plate[12]:
        return math.inf
    return t if abs(dot(across, three(plate, 6))) <= plate[13] else math.inf


@njit(cache=True)
def texel(plate, picture, point):
    """Return the pixel value of the planar object's picture at a point on the object."""
    across = (point[0] - plate[0], point[1] - plate[1], point[2] - plate[2])
    ny, nx = picture.shape
    column = int((0.5 + 0.5 * dot(across, three(plate, 3)) / plate[12]) * nx)
    row = int((0.5 - 0.5 * dot(across, three(plate, 6)) / plate[13]) * ny)
    return picture[min(max(row, 0), ny - 1), min(max(column, 0), nx - 1)]


@njit(cache=True)
def _lens(camera, o, d, low, high):
    """Return the distance, m, from low to high at which a ray hits the lens, else inf."""
    axis = three(camera, 9)
    along = dot(d, axis)
    if along == 0.0:
        return math.inf
    away = (camera[0] - o[0], camera[1] - o[1], camera[2] - o[2])
    t = dot(away, axis) / along
    if not low < t < high:
        return math.inf
    x, y, z = t * d[0] - away[0], t * d[1] - away[1], t * d[2] - away[2]
    return t if x * x + y * y + z * z <= camera[12] ** 2 else math.inf


@njit(cache=True, nogil=True, error_model="numpy")
def wall_hits(
    terms, tables, grid_bounds, box, slab, rim, origins, directions, live, distance, kind, normal
):
    """Fill distance, kind and normal of those ``live`` rays that hit a compiled wall."""
    for i in range(distance.size):
        if not live[i]:
            continue
        o, d = three(origins[i], 0), three(directions[i], 0)
        hx = hy = 0.0
        if terms is None:
            t = -o[2] / d[2] if d[2] < 0.0 else math.nan
            on = abs(o[0] + t * d[0]) <= box[0] and abs(o[1] + t * d[1]) <= box[1]
            condition = HIT if on and t >= 0.0 else -1
        else:
            t, condition, hx, hy = wall_hit(terms, tables, grid_bounds, box, slab, rim, o, d)
        if condition == HIT:
            norm = 1.0 / math.sqrt(1.0 + hx * hx + hy * hy)
            distance[i], kind[i] = t, WALL
            normal[i, 0], normal[i, 1], normal[i, 2] = -hx * norm, -hy * norm, norm
            if dot(d, three(normal[i], 0)) >= 0.0:
                kind[i] = LOST
        elif condition == UNRESOLVED:
            distance[i], kind[i] = 0.0, LOST


@njit(cache=True, nogil=True)
def settle(terms, tables, points, on_wall):
    """Replace z of the points (n, 3) marked ``on_wall`` by the compiled wall's exact height, m."""
    for i in range(on_wall.size):
        if on_wall[i]:
            height = tangent(terms, tables, points[i, 0], points[i, 1])[0]
            if math.isfinite(height):
                points[i, 2] = height


@njit(cache=True, nogil=True)
def plate_and_lens(
    plate, picture, camera, norm, origins, directions, live, distance, kind, normal, scale, lit
):
    """Replace the hits of ``live`` rays by nearer ones on the planar object and on the lens."""
    has_plate = plate.size > 0
    for i in range(distance.size):
        if not live[i]:
            continue
        o, d = three(origins[i], 0), three(directions[i], 0)
        if has_plate:
            t = _plate(plate, o, d, 1e-9, distance[i])
            if t < distance[i]:
                distance[i] = t
                for k in range(3):
                    normal[i, k] = plate[9 + k]
                kind[i] = OBJECT if dot(d, three(plate, 9)) < 0.0 else BACK
                point = (o[0] + t * d[0], o[1] + t * d[1], o[2] + t * d[2])
                scale[i] = texel(plate, picture, point)
                lit[i] = norm * scale[i]
        t = _lens(camera, o, d, 1e-9, distance[i])
        if t < distance[i]:
            distance[i], kind[i] = t, LENS


@njit(cache=True, nogil=True)
def mesh_hits(world, rows, found, away, normals, directions, distance, kind, normal, scale, lit):
    """Replace the hits of the rays ``rows`` by nearer ones on triangles."""
    thing_faces = world.patches.size
    for j in range(rows.size):
        i, k = rows[j], found[j]
        # a triangle that lies in the wall's surface does not cover the wall
        limit = distance[i] * (1.0 - 1e-9) if kind[i] == WALL else distance[i]
        if k < 0 or not away[j] < limit:
            continue
        distance[i], scale[i] = away[j], 1.0
        for m in range(3):
            normal[i, m] = normals[k, m]
        front = dot(three(directions[i], 0), three(normals[k], 0)) < 0
        if k < thing_faces:
            kind[i] = OBJECT if front else BACK
            lit[i] = world.lit[world.patches[k]]
            continue
        kind[i] = world.kinds[k - thing_faces]
        if not front:
            for m in range(3):
                normal[i, m] = -normal[i, m]


@njit(cache=True)
def _triangle(world, splits, u, v):
    """Return the triangle at a point of the chart's unit square, and the place within it."""
    areas, node = world.areas, 1
    along = True
    while node < splits.size:
        split, t = splits[node], u if along else v
        node *= 2
        if t < split or split == 1.0:  # rounding may have made t one
            t /= split
        else:
            t = (t - split) / (1.0 - split)
            node += 1
        if along:
            u = t
        else:
            v = t
        along = not along
    patch = node - splits.size
    a, b = world.firsts[patch], world.firsts[patch + 1]
    t = areas[a] + u * (areas[b] - areas[a])
    k = a + min(np.searchsorted(areas[a : b + 1], t, side="right") - 1, b - a - 1)
    whole = areas[k + 1] - areas[k]
    return k, min((t - areas[k]) / whole, 1.0) if whole > 0.0 else 0.5, v


@njit(cache=True)
def object_point(world, splits, u, v):
    """Draw a point of the object's front by area times brightness; return it and its normal."""
    if world.plate.size > 0:
        plate = world.plate
        ny, nx = world.picture.shape
        row = interval(world.rows, u)
        line = world.columns[row]
        column = interval(line, v)
        y = row + (u - world.rows[row]) / (world.rows[row + 1] - world.rows[row])
        x = column + (v - line[column]) / (line[column + 1] - line[column])
        across, up = (2.0 * x / nx - 1.0) * plate[12], (1.0 - 2.0 * y / ny) * plate[13]
        return (
            plate[0] + across * plate[3] + up * plate[6],
            plate[1] + across * plate[4] + up * plate[7],
            plate[2] + across * plate[5] + up * plate[8],
        ), three(plate, 9)
    k, u, v = _triangle(world, splits, u, v)
    row, root = world.triangles[k], math.sqrt(u)
    b, c = root * (1.0 - v), root * v
    point = (
        row[0] + b * row[3] + c * row[6],
        row[1] + b * row[4] + c * row[7],
        row[2] + b * row[5] + c * row[8],
    )
    x = row[4] * row[8] - row[5] * row[7]
    y = row[5] * row[6] - row[3] * row[8]
    z = row[3] * row[7] - row[4] * row[6]
    norm = math.sqrt(x * x + y * y + z * z)
    return point, (x / norm, y / norm, z / norm)


@njit(cache=True, nogil=True)
def clear(plate, camera, starts, ends, value):
    """Set to zero the values of connections that the planar object or the lens blocks."""
    has_plate = plate.size > 0
    for i in range(value.size):
        if value[i] <= 0.0:
            continue
        o = three(starts[i], 0)
        d = (ends[i, 0] - o[0], ends[i, 1] - o[1], ends[i, 2] - o[2])
        low, high = 1e-9, 1.0 - 1e-9
        hidden = _lens(camera, o, d, low, high) < high
        if hidden or (has_plate and _plate(plate, o, d, low, high) < high):
            value[i] = 0.0
