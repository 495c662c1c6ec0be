"""Compiled light paths of a single point: emission, arrival at the lens, and detector position.

A source of 1 W is a row of 7 numbers: position (m), normal, and 1 for isotropic or 0 for Lambertian
emission.
"""

from __future__ import annotations

import math

from ...kernels.brdf import is_mirror, material, material_pdf
from ...kernels.codes import GROUPS, UNIT
from ...kernels.compiling import njit
from ...kernels.random import disc
from ..fans import paths
from ._connection_kernels import between, next_density, reflected
from ._light_kernels import (
    BEFORE,
    DENSITY,
    LOBE,
    MET,
    MIRROR,
    PDF,
    POWER,
    SCALE,
    SURFACE,
    aimed_share,
    lobes_of,
)
from ._lobe_kernels import tangents
from ._surround_kernels import (
    DRAW_BEAM,
    DRAW_LENS,
    DRAW_PIXEL,
    LENS,
    NOTHING,
    OBJECT,
    WALL,
    dot,
    object_point,
    pair,
    three,
    unit,
)


@njit(cache=True, nogil=True)
def glow(world, sampler, first, power, new):
    """Fill vertices on the hidden object's front, as if lit at normal incidence."""
    for i in range(new.shape[0]):
        u, v = pair(sampler, first + i, DRAW_PIXEL)
        point, normal = object_point(world, world.splits, u, v)
        for k in range(3):
            new[i, k], new[i, 3 + k], new[i, 6 + k] = point[k], normal[k], normal[k]
        new[i, POWER], new[i, DENSITY], new[i, SURFACE], new[i, SCALE] = power, -1.0, OBJECT, 1.0
        new[i, MET], new[i, BEFORE] = 1.0, NOTHING


@njit(cache=True)
def spots(sampler, first, corner, size, xy):
    """Fill ``xy`` (n, 2) with points spread uniformly over a rectangle, m."""
    for i in range(xy.shape[0]):
        u, v = pair(sampler, first + i, DRAW_LENS)
        xy[i, 0], xy[i, 1] = corner[0] + u * size[0], corner[1] + v * size[1]


@njit(cache=True, nogil=True)
def to_wall(world, light, targets, value, starts, ends):
    """Fill the power, W, that light vertices send directly to chosen wall points.

    The balance heuristic weights it against light that reaches the wall by scattering.
    """
    for i in range(light.shape[0]):
        value[i] = 0.0
        a, b = light[i], targets[i]
        if a[SURFACE] < 0.0 or b[SURFACE] < 0.0:
            continue
        d, square, cos_a, cos_b = between(a, b)
        if cos_a <= 0.0 or cos_b <= 0.0:
            continue
        lobes = lobes_of(world, int(a[SURFACE]))
        f = reflected(lobes, a, d, cos_a) * a[POWER] * cos_a * cos_b / square
        if f <= 0.0:
            continue
        share, came = aimed_share(world, a, False), three(a, 6)
        walked = next_density(lobes, share, world.norm, a, came, d, cos_a, b, cos_b, square, False)
        value[i] = f / (b[DENSITY] + walked)
        for k in range(3):
            starts[i, k], ends[i, k] = a[k], b[k]


@njit(cache=True, nogil=True)
def arrivals(vertices, evenly, power):
    """Fill the power, W, of light that reaches the wall by scattering; see `to_wall`.

    ``evenly`` is the density of the points of `to_wall` per area of the mean plane, 1/m^2.
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
    """Find the map cells of light that arrives at wall points; return how many lie on the map."""
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


@njit(cache=True)
def _intensity(source, d):
    """Return the radiant intensity, W/sr, of a source of 1 W along the unit vector d."""
    if source[6] > 0.0:
        return 0.25 / math.pi
    return max(0.0, dot(d, three(source, 3))) / math.pi


@njit(cache=True)
def _along(a, b, n, x, y, z):
    """Return the vector with components (x, y, z) along a, b and n."""
    return (
        x * a[0] + y * b[0] + z * n[0],
        x * a[1] + y * b[1] + z * n[1],
        x * a[2] + y * b[2] + z * n[2],
    )


@njit(cache=True, nogil=True)
def shine(sampler, first, source, whole, box, share, directions, aims, aimed):
    """Draw directions of light that leaves a source, or the wall points at which it is aimed.

    A fraction ``share`` of the rays is aimed at the part ``box`` = (low x, low y, width, height),
    m, of the wall. The others are aimed uniformly at the whole wall, ``whole``, or follow the
    emission of the source if ``whole`` has no width.
    """
    n = three(source, 3)
    a, b = tangents(n)
    for i in range(directions.shape[0]):
        u, v = pair(sampler, first + i, DRAW_BEAM)
        aimed[i] = u < share
        if aimed[i]:
            aims[i, 0], aims[i, 1] = box[0] + u / share * box[2], box[1] + v * box[3]
            continue
        u = (u - share) / (1.0 - share)
        if whole[2] > 0.0:
            aimed[i] = True
            aims[i, 0], aims[i, 1] = whole[0] + u * whole[2], whole[1] + v * whole[3]
            continue
        if source[6] > 0.0:
            z, turn = 1.0 - 2.0 * u, 2.0 * math.pi * v
            r = math.sqrt(max(0.0, 1.0 - z * z))
            x, y = r * math.cos(turn), r * math.sin(turn)
        else:
            x, y = disc(u, v)
            z = math.sqrt(max(0.0, 1.0 - x * x - y * y))
        d = _along(a, b, n, x, y, z)
        for k in range(3):
            directions[i, k] = d[k]


@njit(cache=True, nogil=True)
def toward(source, aims, aimed, directions, reach, live):
    """Fill directions and distances, m, from a source to the wall points at which it is aimed."""
    for i in range(live.size):
        live[i], reach[i] = True, -1.0
        if not aimed[i]:
            continue
        d = (aims[i, 0] - source[0], aims[i, 1] - source[1], aims[i, 2] - source[2])
        reach[i] = math.sqrt(dot(d, d))
        live[i] = math.isfinite(reach[i])  # NaN if the wall has no height at this point
        for k in range(3):
            directions[i, k] = d[k] / reach[i] if live[i] else 0.0


@njit(cache=True, nogil=True)
def arrive(source, whole, box, share, directions, reach, live, hits, new):
    """Fill the first vertices of a source's light on the wall."""
    distance, kind, normal, _, _ = hits
    for i in range(new.shape[0]):
        new[i, SURFACE] = NOTHING
        if not live[i] or kind[i] != WALL:
            continue
        if reach[i] >= 0.0 and abs(distance[i] - reach[i]) > 1e-6 * reach[i]:
            continue  # another surface hides the point aimed at
        d, n, t = three(directions[i], 0), three(normal[i], 0), distance[i]
        cosine, intensity = -dot(d, n), _intensity(source, d)
        if cosine <= 0.0 or intensity <= 0.0:
            continue
        p = (source[0] + t * d[0], source[1] + t * d[1], source[2] + t * d[2])
        upright = n[2] * t * t / cosine  # mean-plane area per solid angle
        density = intensity
        if whole[2] > 0.0:
            density = upright / (whole[2] * whole[3])
        density *= 1.0 - share
        x, y = p[0] - box[0], p[1] - box[1]
        if share > 0.0 and 0.0 <= x <= box[2] and 0.0 <= y <= box[3]:
            density += share / (box[2] * box[3]) * upright
        if density <= 0.0:
            continue  # rounding has moved an aimed point outside its box
        for k in range(3):
            new[i, k], new[i, 3 + k], new[i, 6 + k] = p[k], n[k], -d[k]
        new[i, POWER], new[i, DENSITY] = intensity / density, density * cosine / (t * t)
        new[i, SURFACE], new[i, BEFORE] = WALL, NOTHING


@njit(cache=True)
def _lens_point(camera, sampler, ray):
    """Draw a point from the uniform distribution over the lens."""
    u, v = disc(*pair(sampler, ray, DRAW_LENS))
    u, v = u * camera[12], v * camera[12]
    return (
        camera[0] + u * camera[3] + v * camera[6],
        camera[1] + u * camera[4] + v * camera[7],
        camera[2] + u * camera[5] + v * camera[8],
    )


@njit(cache=True)
def landing(camera, point, d):
    """Return the detector point (x, y), m, of light that goes back along ``d`` from the lens."""
    cosine = dot(d, three(camera, 9))
    apart = (point[0] - camera[0], point[1] - camera[1], point[2] - camera[2])
    far, zoom = camera[13] / cosine, camera[14] / camera[13]
    e1, e2 = three(camera, 3), three(camera, 6)
    return (
        -(dot(apart, e1) + far * dot(d, e1)) * zoom,
        -(dot(apart, e2) + far * dot(d, e2)) * zoom,
    )


@njit(cache=True, nogil=True)
def look_around(world, sampler, first, origins, directions, powers):
    """Fill rays from random lens points, cosine-weighted over the front hemisphere."""
    camera = world.camera
    axis, e1, e2 = three(camera, 9), three(camera, 3), three(camera, 6)
    for i in range(powers.size):
        point = _lens_point(camera, sampler, first + i)
        x, y = disc(*pair(sampler, first + i, DRAW_PIXEL))
        cosine = math.sqrt(max(0.0, 1.0 - x * x - y * y))
        d = _along(e1, e2, axis, x, y, cosine)
        for k in range(3):
            origins[i, k], directions[i, k] = point[k], d[k]
        seen = cosine > 0.0 and cosine >= camera[17]
        powers[i] = (math.pi * camera[12]) ** 2 * camera[18] if seen else 0.0


@njit(cache=True, nogil=True)
def look_at_pixels(world, sampler, first, each, window, origins, directions, powers):
    """Fill rays from the lens into the fields of view of pixels, ``each`` rays per pixel."""
    camera = world.camera
    zoom, c = camera[13] / camera[14], camera[13]
    low_x, low_y, pitch, columns = window
    area = math.pi * (camera[12] * pitch / camera[14]) ** 2 * camera[18]
    for i in range(powers.size):
        ray = first + i
        row, column = ray // each // columns, ray // each % columns
        sign = 1.0
        if ray % 2 == 1:
            sign, ray = -1.0, ray - 1
        u, v = disc(*pair(sampler, ray, DRAW_LENS))
        u, v = sign * camera[12] * u, sign * camera[12] * v
        x, y = pair(sampler, ray, DRAW_PIXEL)
        x = low_x + pitch * (column + 0.5 + sign * (x - 0.5))
        y = low_y + pitch * (row + 0.5 + sign * (y - 0.5))
        # toward the image of the detector point in the plane in focus
        a, b = -x * zoom - u, -y * zoom - v
        norm = math.sqrt(a * a + b * b + c * c)
        cosine = c / norm
        d = _along(three(camera, 3), three(camera, 6), three(camera, 9), a, b, c)
        for k in range(3):
            origins[i, k] = camera[k] + u * camera[3 + k] + v * camera[6 + k]
            directions[i, k] = d[k] / norm
        powers[i] = area * cosine**4 if cosine >= camera[17] else 0.0


@njit(cache=True, nogil=True)
def mirrored(world, eye, origins, directions, powers, live):
    """Fill the rays that continue eye paths by reflection at the wall's smooth mirror lobes."""
    strength = 0.0
    for j in range(world.wall.shape[0]):
        if is_mirror(world.wall, j):
            strength += world.wall[j, 1] * world.wall[j, 3]
    for i in range(live.size):
        live[i] = eye[i, SURFACE] == WALL and eye[i, POWER] > 0.0
        powers[i] = eye[i, POWER] * strength if live[i] else 0.0
        cosine = dot(three(eye[i], 6), three(eye[i], 3))
        for k in range(3):
            origins[i, k] = eye[i, k]
            directions[i, k] = 2.0 * cosine * eye[i, 3 + k] - eye[i, 6 + k]


@njit(cache=True, nogil=True)
def from_source(source, lobes, eye, value, starts, ends):
    """Fill the detected power, W, of connections between a source and eye vertices on the wall."""
    for i in range(value.size):
        value[i] = 0.0
        b = eye[i]
        if b[SURFACE] != WALL:
            continue
        d, r = unit(source, b)
        cosine, incident = -dot(d, three(b, 3)), three(b, 6)
        if cosine <= 0.0:
            continue
        f = material(lobes, cosine, dot(incident, three(b, 3)), -dot(incident, d))
        value[i] = f * b[POWER] * _intensity(source, d) * cosine / (r * r)
        for k in range(3):
            starts[i, k], ends[i, k] = source[k], b[k]


@njit(cache=True)
def _imaged(lobes, matt, mu, cosine, turn, f):
    """Return the part of ``f``, the sum of all lobes (1/sr), that is due to mirror-like lobes."""
    if matt.shape[0] == lobes.shape[0] or f <= 0.0:
        return 0.0
    return 1.0 - material(matt, mu, cosine, turn) / f


@njit(cache=True, nogil=True)
def to_lens(world, sampler, first, counted, glossy, light, value, starts, ends, x, y, imaged):
    """Fill power, detector position and imaged share of connections from the wall to the lens.

    The imaged share is what mirror-like lobes reflect. ``counted`` is (all lobes to count, those of
    them that are not mirror-like).
    """
    lobes, matt = counted
    camera = world.camera
    area, axis = math.pi * camera[12] ** 2, three(camera, 9)
    for i in range(value.size):
        value[i] = 0.0
        a = light[i]
        if a[SURFACE] != WALL:
            continue
        p = _lens_point(camera, sampler, first + i)
        d, r = unit(a, p)
        cosine, at_lens = dot(d, three(a, 3)), -dot(d, axis)
        if cosine <= 0.0 or at_lens <= 0.0 or at_lens < camera[17]:
            continue
        mu, turn = dot(three(a, 6), three(a, 3)), dot(three(a, 6), d)
        f = material(lobes, mu, cosine, turn)
        imaged[i] = _imaged(lobes, matt, mu, cosine, turn, f)
        f *= cosine * a[POWER] * at_lens * area / (r * r)
        if glossy:
            here = r * r / (at_lens * area)
            f /= 1.0 + material_pdf(world.wall, mu, cosine, turn) / here
        value[i] = f * camera[18]
        x[i], y[i] = landing(camera, p, (-d[0], -d[1], -d[2]))
        for k in range(3):
            starts[i, k], ends[i, k] = a[k], p[k]


@njit(cache=True, nogil=True)
def image_hits(world, directions, origins, powers, hits, value, x, y, imaged):
    """Fill power (W) and detector position (m) of mirror-reflected rays that enter the lens."""
    camera, axis = world.camera, three(world.camera, 9)
    distance, kind = hits[0], hits[1]
    for i in range(value.size):
        value[i] = 0.0
        d = three(directions[i], 0)
        at_lens = -dot(d, axis)
        if kind[i] != LENS or powers[i] <= 0.0 or at_lens <= 0.0 or at_lens < camera[17]:
            continue
        t = distance[i]
        p = (origins[i, 0] + t * d[0], origins[i, 1] + t * d[1], origins[i, 2] + t * d[2])
        value[i], imaged[i] = powers[i] * camera[18], 1.0
        x[i], y[i] = landing(camera, p, (-d[0], -d[1], -d[2]))


@njit(cache=True, nogil=True)
def lens_hits(
    world, counted, glossy, first_one, old, leave, new, fates, by_mirrors, value, x, y, imaged
):
    """Fill power, detector position and imaged fraction of scattered rays that hit the lens."""
    lobes, matt = counted
    camera = world.camera
    area, axis = math.pi * camera[12] ** 2, three(camera, 9)
    for i in range(value.size):
        value[i] = 0.0
        mirror = leave[i, MIRROR] >= 0.0
        by_mirrors[i] = by_mirrors[i] and mirror
        if fates[i] not in (paths.DETECTED, paths.BLOCKED) or old[i, SURFACE] != WALL:
            continue
        d = three(leave[i], 0)
        at_lens = -dot(d, axis)
        if at_lens <= 0.0 or at_lens < camera[17]:
            continue
        sent = new[i, POWER] * (1.0 if fates[i] == paths.DETECTED else camera[18])
        if mirror:
            value[i] = sent if by_mirrors[i] and not first_one else 0.0
            imaged[i] = 1.0
        elif glossy and leave[i, LOBE] > 0.0:
            incident, n, p = three(old[i], 6), three(old[i], 3), three(old[i], 0)
            cosine = dot(d, n)
            away = (new[i, 0] - p[0], new[i, 1] - p[1], new[i, 2] - p[2])
            here = dot(away, away) / (at_lens * area)
            mu, turn = dot(incident, n), dot(incident, d)
            f = material(lobes, mu, cosine, turn)
            imaged[i] = _imaged(lobes, matt, mu, cosine, turn, f)
            value[i] = sent * f * cosine / leave[i, LOBE]
            value[i] *= leave[i, PDF] / (leave[i, PDF] + here)
        x[i], y[i] = landing(camera, three(new[i], 0), (-d[0], -d[1], -d[2]))


@njit(cache=True, nogil=True)
def landings(world, points, directions, x, y):
    """Fill the detector positions, m, of light that arrives along rays traced from the lens."""
    for i in range(x.size):
        x[i], y[i] = landing(world.camera, three(points[i], 0), three(directions[i], 0))


@njit(cache=True, nogil=True)
def book(value, x, y, window, rows, bounce, most, first, path_sums, cells):
    """Add power to the sum of its number of reflections, and find its pixels."""
    low_x, low_y, pitch, columns = window
    for i in range(value.size):
        cells[i] = -1
        if value[i] <= 0.0:
            continue
        sums = path_sums[i // UNIT * GROUPS + (first + i) % GROUPS]
        sums[bounce] += value[i]
        column = math.floor((x[i] - low_x) / pitch)
        row = math.floor((y[i] - low_y) / pitch)
        if 0 <= column < columns and 0 <= row < rows:
            cells[i] = row * columns + column
        else:
            sums[most + 1] += value[i]
