"""Kernels of a point's light with random arguments, on record."""

import numpy as np
import pytest
import trimesh

from nlosoptics.kernels.codes import GROUPS, UNIT
from nlosoptics.raytrace.fans import paths
from nlosoptics.raytrace.light import _light_kernels as kernels
from nlosoptics.raytrace.light import _point_kernels as points
from nlosoptics.raytrace.light import _surround_kernels as surround

from .draws import GLOSSY, SAMPLER, Draw, rays_to_lens, scene, world

COUNT, FIRST, MOST = 400, 2 * UNIT, 3
BALL = trimesh.creation.icosphere(subdivisions=1, radius=0.25)
SOURCES = {
    kind: np.array([0.1, -0.2, 0.6, *(np.array([0.6, 0.3, -0.2]) / 0.7), float(kind)])
    for kind in (0, 1)
}
WHOLE, NARROW, NOWHERE = (-0.9, -0.7, 1.8, 1.5), (-0.3, 0.1, 0.5, 0.25), (0.0, 0.0, 0.0, 0.0)
MATT = GLOSSY.lobe_table()[:1].copy()


@pytest.fixture(params=["generic", "coarse"])
def draw(request):
    return Draw(6, request.param == "coarse")


@pytest.mark.parametrize("mesh", [None, BALL])
def test_light_to_the_wall(mesh, draw, on_record):
    given, new = world(scene(mesh=mesh)), np.zeros((COUNT, kernels.VERTEX))
    points.glow(given, SAMPLER, FIRST, 0.3, new)
    xy, power = np.zeros((COUNT, 2)), np.zeros(COUNT)
    points.spots(SAMPLER, FIRST, np.array([-0.4, 0.1]), np.array([0.9, 0.35]), xy)
    light, targets = draw.vertices(COUNT), draw.vertices(COUNT)
    targets[:, kernels.DENSITY] = np.abs(targets[:, kernels.DENSITY]) + 0.1
    value, (starts, ends) = np.zeros(COUNT), np.zeros((2, COUNT, 3))
    points.to_wall(given, light, targets, value, starts, ends)
    light[:, 5] = np.abs(light[:, 5]) + 0.125  # walls have no upright parts
    points.arrivals(light, 0.7, power)
    corner, step = np.array([-0.5, -0.25]), np.array([0.25, 0.125])
    cells, powers = np.zeros(COUNT, dtype=np.int64), np.zeros(COUNT)
    on_map = points.cells_of(
        *(light[:, kernels.P].copy(), power, FIRST, corner, step, (3, 4), cells, powers)
    )
    on_record([new, xy, value, starts, ends, power, on_map, cells, powers], 1e-8)


@pytest.mark.parametrize("isotropic", [0, 1])
@pytest.mark.parametrize(
    ("whole", "share"), [(WHOLE, 0.0), (WHOLE, 0.4), (NOWHERE, 0.0), (NOWHERE, 0.3)]
)
def test_first_vertices(whole, share, isotropic, draw, on_record):
    source, where = SOURCES[isotropic], (np.array(whole), np.array(NARROW), share)
    directions, aims = np.zeros((2, COUNT, 3))
    aimed, live = np.zeros(COUNT, dtype=bool), np.ones(COUNT, dtype=bool)
    points.shine(SAMPLER, FIRST, source, *where, directions, aims, aimed)
    shone = [directions.copy(), aims.copy(), aimed]
    aims[:, 2] = draw.choice((0.0, 0.01, np.nan), COUNT)
    reach, new = np.zeros(COUNT), np.zeros((COUNT, kernels.VERTEX))
    points.toward(source, aims, aimed, directions, reach, live)
    hits = draw.hits(COUNT)
    hits[1][::2] = surround.WALL
    away = draw.choice((1.0, 1.0, 1 + 0.8e-6, 1 - 1.5e-6, 1 + 4e-6), COUNT)
    hits[0][:] = np.where(reach > 0.0, reach * away, hits[0] + 0.1)
    hits[2][:] = draw.units(COUNT, (0.0, 0.0, 2.0))
    points.arrive(source, *where, directions, reach, live, hits, new)
    on_record([shone, directions, reach, live, new], 1e-8)


@pytest.mark.parametrize("stop", [None, 0.9])
def test_rays_from_the_lens(stop, draw, on_record):
    given = world(scene(field_stop=stop))
    origins, directions, found = *np.zeros((2, COUNT, 3)), []
    powers, (x, y) = np.zeros(COUNT), np.zeros((2, COUNT))
    points.look_around(given, SAMPLER, FIRST, origins, directions, powers)
    points.landings(given, origins, directions, x, y)
    found += [origins.copy(), directions.copy(), powers.copy(), x, y]
    window = (-0.045, -0.02, 0.011, 7)
    points.look_at_pixels(*(given, SAMPLER, 6 * 7 * 3, 6, window, origins, directions, powers))
    found += [origins.copy(), directions.copy(), powers.copy()]
    eye, live = draw.vertices(COUNT), np.zeros(COUNT, dtype=bool)
    points.mirrored(given, eye, origins, directions, powers, live)
    on_record([*found, origins, directions, powers, live], 1e-8)


@pytest.mark.parametrize("glossy", [False, True])
def test_light_to_the_lens(glossy, draw, on_record):
    given = world(scene(field_stop=1.4))
    camera, lobes, found = given.camera, given.wall, []
    light, eye = draw.vertices(COUNT), draw.vertices(COUNT)
    toward = camera[:3] - light[:, kernels.P]  # so that many face the lens
    light[:, kernels.N] = draw.units(COUNT, 0.0) + toward
    light[:, kernels.N] /= np.linalg.norm(light[:, kernels.N], axis=1)[:, None]
    value, x, y, imaged = np.zeros((4, COUNT))
    starts, ends = np.zeros((2, COUNT, 3))
    for source in SOURCES.values():
        points.from_source(source, lobes, eye, value, starts, ends)
        found += [value.copy(), starts.copy(), ends.copy()]
    for counted in ((lobes, MATT), (MATT, MATT), (lobes, lobes)):
        points.to_lens(
            *(given, SAMPLER, FIRST, counted, glossy, light, value, starts, ends, x, y, imaged)
        )
        found += [value.copy(), starts.copy(), ends.copy(), x.copy(), y.copy(), imaged.copy()]
    hits, powers = draw.hits(COUNT), draw.choice((0.0, 0.3, 1.0), COUNT)
    hits[1][::2] = surround.LENS
    lens, away = rays_to_lens(draw, camera, COUNT)
    origins = lens + hits[0][:, None] * away
    points.image_hits(given, -away, origins, powers, hits, value, x, y, imaged)
    found += [value.copy(), x.copy(), y.copy(), imaged.copy()]
    leave, fates = draw.leaving(light, hits), draw.choice(range(8), COUNT).astype(np.int8)
    fates[::2] = paths.DETECTED
    fates[1::4] = paths.BLOCKED
    leave[:, :3], new = -away, draw.vertices(COUNT)
    new[:, kernels.P] = lens
    for first_one in (False, True):
        by_mirrors = draw.choice((False, True), COUNT)
        points.lens_hits(
            *(given, (lobes, MATT), glossy, first_one, light, leave, new, fates, by_mirrors),
            *(value, x, y, imaged),
        )
        found += [by_mirrors, value.copy(), x.copy(), y.copy(), imaged.copy()]
    points.connect(given, light, eye, value, starts, ends)
    total, cells = np.zeros((GROUPS, MOST + 2)), np.zeros(COUNT, dtype=np.int64)
    x, y = draw.numbers(-0.25, 0.5, 2, COUNT)
    points.book(value, x, y, (-0.125, 0.0, 0.125, 3), 2, 2, MOST, FIRST, total, cells)
    on_record([*found, value, starts, ends, total, cells], 1e-8)
