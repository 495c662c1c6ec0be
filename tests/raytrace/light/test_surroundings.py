"""Starts of rays at laser and lens, and first hits in a scene, against plain geometry in numpy."""

import math
from collections import Counter

import numpy as np
import pytest
from pytest import approx

from nlosoptics import raytrace
from nlosoptics.raytrace.light import _surround_kernels as kernels
from nlosoptics.raytrace.light.surroundings import Surroundings
from nlosoptics.scene import Camera, FlatWall, Laser, PlanarObject, Scene, WavyWall

PICTURE = np.random.default_rng(1).uniform(0.1, 1.0, (4, 6))
#: Random numbers from Philox alone.
SAMPLER = (np.uint64(3), np.zeros((0, 0, 32), dtype=np.uint64), np.zeros((0, 0), dtype=np.uint64))


def room(wall=None, **camera):
    """A tilted picture and a wide lens, both in front of a wall."""
    options = {
        "position": (-0.5, 0.2, 0.8),
        "aim": (0.1, 0.0, 0.0),
        "focal_length": 0.05,
        "stop_diameter": 0.2,
        "focus_distance": 0.9,
        "transmission": 0.8,
        "pixel_pitch": 1e-4,
        "pixels": (90, 160),
        "binning": 1,
    }
    return Scene(
        Laser(
            wavelength=633e-9,
            power=1.0,
            beam_diameter=0.02,
            position=(0.8, 0.4, 1.2),
            aim=(0.3, 0.1, 0.0),
        ),
        FlatWall(size=(2.0, 1.5)) if wall is None else wall,
        PlanarObject(PICTURE, 0.6, position=(0.4, -0.1, 0.6), yaw=0.4, pitch=0.3),
        Camera(**options | camera),
    )


def rays(count, seed):
    """Rays from above the wall to wall, picture and lens, and from behind both of these."""
    draw = np.random.default_rng(seed)
    origins = draw.uniform((-0.9, -0.7, 0.05), (0.9, 0.7, 1.3), (count, 3))
    aims = np.array([[0.0, 0.0, 0.0], [0.4, -0.1, 0.6], [-0.5, 0.2, 0.8]])[np.arange(count) % 3]
    reach = np.array([0.9, 0.4, 0.15])[np.arange(count) % 3, None]
    directions = aims + reach * draw.uniform(-1, 1, (count, 3)) - origins
    return origins, directions / np.linalg.norm(directions, axis=1)[:, None]


def on_picture(points):
    """Return right and up of points (n, 3) on the picture's plane, m, and the pixels' values."""
    thing = room().hidden
    right, up, _ = thing.axes
    x, y = (points - thing.position) @ right, (points - thing.position) @ up
    width, height = thing.size
    column = np.clip(np.floor((x / width + 0.5) * 6), 0, 5).astype(int)
    row = np.clip(np.floor((0.5 - y / height) * 4), 0, 3).astype(int)
    return x, y, PICTURE[row, column]


@pytest.mark.parametrize("wall", [FlatWall(size=(2.0, 1.5)), WavyWall(0.03, 0.5, size=1.8)])
def test_first_hits_are_the_nearest_surfaces(wall):
    scene = room(wall)
    found = Surroundings(scene)
    (o, d), (_, _, n) = rays(1500, seed=2), scene.hidden.axes
    live = np.arange(1500) % 10 != 0
    distance, kind, normal, scale, lit = found.first_hits(
        o, d, live, np.zeros(1500, dtype=bool), Counter()
    )
    hits = raytrace.intersect(wall, o, d)
    to_wall = np.where(hits.hit, np.nan_to_num(hits.distance), np.inf)
    plane = (scene.hidden.position - o) @ n / (d @ n)
    x, y, grey = on_picture(o + plane[:, None] * d)
    width, height = scene.hidden.size
    met = (plane > 0) & (np.abs(x) <= width / 2) & (np.abs(y) <= height / 2)
    to_picture = np.where(met, plane, np.inf)
    axis, centre = scene.camera.frame[2], np.array(scene.camera.position)
    plane = (centre - o) @ axis / (d @ axis)
    off = np.linalg.norm(o + plane[:, None] * d - centre, axis=1)
    to_lens = np.where((plane > 0) & (off <= 0.1), plane, np.inf)
    nearest = np.minimum(to_wall, np.minimum(to_picture, to_lens))
    nearest[~live] = np.inf
    assert distance == approx(nearest, rel=1e-11)
    wanted = np.full(1500, kernels.NOTHING)
    wanted[live & (nearest == to_wall) & hits.hit] = kernels.WALL
    seen = live & met & (nearest == to_picture)
    assert (nearest != to_lens)[seen].all()
    wanted[seen] = np.where(d @ n < 0, kernels.OBJECT, kernels.BACK)[seen]
    wanted[live & (nearest == to_lens) & np.isfinite(to_lens)] = kernels.LENS
    assert (kind == wanted).all()
    for one in (kernels.NOTHING, kernels.WALL, kernels.OBJECT, kernels.BACK, kernels.LENS):
        assert (wanted == one).sum() > 30
    assert normal[kind == kernels.WALL] == approx(hits.normals[kind == kernels.WALL], abs=1e-12)
    assert normal[seen] == approx(np.tile(n, (seen.sum(), 1)))
    assert scale[seen] == approx(grey[seen])
    # the brightness is a density on the picture
    assert lit[seen] == approx(grey[seen] / (PICTURE.mean() * width * height))


def test_connections_are_blocked_by_picture_and_lens():
    found = Surroundings(room())
    o, d = rays(1500, seed=3)
    length = np.random.default_rng(4).uniform(0.05, 1.5, 1500)
    length = np.minimum(length, np.where(d[:, 2] < 0, 0.99 * o[:, 2] / -d[:, 2], np.inf))
    hits = found.first_hits(o, d, np.ones(1500, dtype=bool), np.zeros(1500, dtype=bool), Counter())
    value = np.linspace(1.0, 2.0, 1500)
    value[::10] = 0.0
    kept = value.copy()
    found.clear(o, o + length[:, None] * d, np.zeros(1500, dtype=bool), value, Counter())
    free = hits[0] > length
    assert (value == np.where(free, kept, 0.0)).all()
    assert 300 < free.sum() < 1400


def test_points_of_a_picture_are_as_dense_as_it_is_bright():
    world = Surroundings(room()).world
    n = 48
    middles = (np.arange(n) + 0.5) / n
    drawn = [kernels.object_point(world, world.splits, u, v) for u in middles for v in middles]
    points = np.array([one[0] for one in drawn])
    scene = room()
    assert np.array([one[1] for one in drawn]) == approx(
        np.tile(scene.hidden.axes[2], (n * n, 1)), abs=1e-15
    )
    assert (points - scene.hidden.position) @ scene.hidden.axes[2] == approx(np.zeros(n * n))
    x, y, grey = on_picture(points)
    width, height = scene.hidden.size
    assert np.abs(x).max() < width / 2
    assert np.abs(y).max() < height / 2
    for value in PICTURE.ravel():
        # a strip of points along each edge of a pixel may fall on either side
        assert (grey == value).sum() / n**2 == approx(value / PICTURE.sum(), abs=2 / n / 4)
    # within a pixel, evenly: the middle of all points is that of the light
    columns, rows = np.meshgrid((np.arange(6) - 2.5) / 6, (1.5 - np.arange(4)) / 4)
    middle = (PICTURE * columns).sum() / PICTURE.sum(), (PICTURE * rows).sum() / PICTURE.sum()
    assert x.mean() / width == approx(middle[0], abs=1e-3)
    assert y.mean() / height == approx(middle[1], abs=1e-3)


def etendue(scene, stop=math.pi):
    """Integral of the cosine over lens and seen directions, m^2 sr, by dense sums."""
    camera, far = scene.camera, scene.focus_distance
    ny, nx = camera.shape
    half = 0.5 * camera.image_pitch * np.array([nx, ny]) * far / scene.image_distance
    radius = camera.stop_diameter / 2
    r, turn = radius * np.sqrt((np.arange(20) + 0.5) / 20), 2 * np.pi * np.arange(16) / 16
    u, v = (r[:, None] * f(turn) for f in (np.cos, np.sin))
    x, y = ((np.arange(200) + 0.5) / 100 - 1 for _ in range(2))
    a, b = half[0] * x[:, None] - u.ravel()[:, None, None], half[1] * y - v.ravel()[:, None, None]
    square = a * a + b * b + far * far
    inside = far / np.sqrt(square) >= math.cos(stop / 2)
    cell = 4 * half[0] * half[1] / 200**2
    return math.pi * radius**2 * float((inside * far * far / square**2).sum()) * cell / u.size


@pytest.mark.parametrize("stop", [None, 0.15, 0.25])
def test_rays_from_the_lens_carry_the_etendue_of_the_detector(stop):
    """Without a field stop, with one within the detector, and with one that cuts its corners."""
    scene = room(field_stop=stop)
    found, n = Surroundings(scene), 40_000
    o, d, power, density = np.empty((n, 3)), np.empty((n, 3)), np.empty(n), np.empty(n)
    kernels.sight(found.world.camera, SAMPLER, 0, o, d, power, density)
    frame, centre = scene.camera.frame, np.array(scene.camera.position)
    across = (o - centre) @ frame.T
    assert across[:, 2] == approx(np.zeros(n), abs=1e-15)
    off = np.linalg.norm(across, axis=1)
    assert off.max() <= 0.1
    assert (off < 0.05).mean() == approx(0.25, abs=0.01)
    assert np.linalg.norm(d, axis=1) == approx(np.ones(n))
    assert power.mean() == approx(0.8 * etendue(scene, stop or math.pi), rel=0.02)
    for i in range(0, n, 97):
        seen = kernels.on_detector(found.world.camera, tuple(o[i]), tuple(d[i]))
        assert seen == approx(density[i] if power[i] > 0 else 0.0, rel=1e-10)


def test_density_is_zero_beside_the_detector_and_behind_the_lens():
    found, scene = Surroundings(room()), room()
    frame, centre = scene.camera.frame, tuple(scene.camera.position)
    ny, nx = scene.camera.shape
    half = 0.5 * scene.camera.image_pitch * np.array([nx, ny]) / scene.image_distance
    for x, y in ((0.99, 0.99), (-0.99, 0.99), (1.01, 0.0), (0.0, -1.01), (-1.01, 0.5)):
        d = x * half[0] * frame[0] + y * half[1] * frame[1] + frame[2]
        cosine = 1 / np.linalg.norm(d)
        seen = kernels.on_detector(found.world.camera, centre, tuple(d * cosine))
        inside = abs(x) < 1 and abs(y) < 1
        area = 4 * half.prod() * scene.image_distance**2
        exact = scene.image_distance**2 / (area * cosine**3) if inside else 0.0
        assert seen == approx(exact)
    assert kernels.on_detector(found.world.camera, centre, tuple(-frame[2])) == 0.0
