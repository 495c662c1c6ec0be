"""Kernels of light paths with random arguments, on record."""

import numpy as np
import pytest
import trimesh

from nlosoptics.kernels.codes import GROUPS, UNIT
from nlosoptics.raytrace.light import _chain_kernels as chains
from nlosoptics.raytrace.light import _connection_kernels as connections
from nlosoptics.raytrace.light import _light_kernels as kernels
from nlosoptics.raytrace.light import _surround_kernels as surround
from nlosoptics.raytrace.light.surroundings import Surroundings
from nlosoptics.scene import Lambert

from .draws import FLAT, GLOSSY, PLAIN, SAMPLER, WAVY, Draw, rays_to_lens, scene, world

COUNT, FIRST, MOST = 400, 2 * UNIT, 3
BALL = trimesh.creation.icosphere(subdivisions=1, radius=0.25)


@pytest.fixture(params=["generic", "coarse"])
def draw(request):
    return Draw(5, request.param == "coarse")


def sums():
    return np.zeros((GROUPS, MOST + 1 + kernels.SUMS))


@pytest.mark.parametrize("eye", [False, True])
@pytest.mark.parametrize("mesh", [None, BALL])
def test_scattering(mesh, eye, draw, on_record):
    found = []
    for glossy, bits, paint in ((True, 3, GLOSSY), (False, 1, PLAIN), (False, 2, Lambert(0.6))):
        given = world(scene(mesh=mesh, paint=paint), glossy=glossy, chains=bits)
        vertices, leave = draw.vertices(COUNT), np.zeros((COUNT, kernels.LEAVE))
        origins, directions = np.zeros((2, COUNT, 3))
        live = np.zeros(COUNT, dtype=bool)
        kernels.scatter(
            *(given, SAMPLER, FIRST, 6, eye, vertices, leave, origins, directions, live)
        )
        found.append([leave, origins, directions, live])
    on_record(found, 1e-8)


@pytest.mark.parametrize("chains", [0, 1, 3])
@pytest.mark.parametrize(
    "settings", [(1, MOST, False, -1), (MOST, MOST, True, -1), (2, MOST, False, 9)]
)
def test_landing(settings, chains, draw, on_record):
    given, old, hits = world(), draw.vertices(COUNT), draw.hits(COUNT)
    leave = draw.leaving(old, hits)
    lens = hits[1] == surround.LENS  # from where they meet it, or miss the detector
    ends, away = rays_to_lens(draw, given.camera, COUNT)
    old[lens, kernels.P] = (ends + hits[0][:, None] * away)[lens]
    leave[lens, :3], old[lens, kernels.N] = -away[lens], -away[lens]
    origins, directions = old[:, kernels.P].copy(), leave[:, :3].copy()
    new, total, fates = np.zeros_like(old), sums(), np.zeros(COUNT, dtype=np.int8)
    around = (given.camera, given.norm, chains)
    kernels.land(
        *(around, SAMPLER, FIRST, settings, old, leave, origins, directions),
        *(hits, new, total, fates),
    )
    on_record([new, total, fates], 1e-8)


def test_first_vertices_and_thinning(draw, on_record):
    given, hits, total = world(), draw.hits(COUNT), sums()
    origins, directions = draw.numbers(-1.0, 1.0, COUNT, 3), draw.units(COUNT)
    lit, seen, further = np.zeros((3, COUNT, kernels.VERTEX))
    fates = np.zeros(COUNT, dtype=np.int8)
    powers, densities = draw.choice((0.0, 0.3, 1.0), COUNT), draw.numbers(0.2, 1.8, COUNT)
    kernels.start(0.7, FIRST, MOST, origins, directions, hits, lit, total, fates)
    kernels.look(origins, directions, powers, densities, draw.hits(COUNT), seen)
    old, hits = draw.vertices(COUNT), draw.hits(COUNT)
    leave = draw.leaving(old, hits)
    kernels.look_on(given.norm, old, leave, origins, directions, hits, further)
    kernels.thin(SAMPLER, FIRST, 0.25, old)
    on_record([lit, total, fates, seen, further, old], 1e-8)


@pytest.mark.parametrize("glossy", [False, True])
@pytest.mark.parametrize("chains", [0, 1, 2, 3])
def test_connections(chains, glossy, draw, on_record):
    given, found = world(chains=chains), []
    for second in (False, True):
        light, eye, seen = (draw.vertices(COUNT) for _ in range(3))
        eye[:3, :3] = light[:3, :3]  # no distance between them
        eye[:, kernels.DENSITY] = np.abs(eye[:, kernels.DENSITY]) + 0.1 * ~second
        seen[:, kernels.DENSITY] = np.abs(seen[:, kernels.DENSITY]) + 0.1
        value, length = np.zeros((2, COUNT))
        starts, ends = np.zeros((2, COUNT, 3))
        connections.connect(given, light, eye, seen, second, glossy, value, length, starts, ends)
        found.append([value, length, starts, ends])
        total = sums()
        connections.book(light, eye, 2, MOST, FIRST, value, length, total)
        lens, _ = rays_to_lens(draw, given.camera, COUNT)
        value, length = np.zeros((2, COUNT))
        starts, ends = np.zeros((2, COUNT, 3))
        connections.to_lens(given, light, seen, lens, glossy, value, length, starts, ends)
        found.append([total, value, length, starts, ends])
    on_record(found, 1e-8)


@pytest.mark.parametrize("stop", [None, 0.2, 0.9, 2.5])
def test_rays_of_laser_and_lens(stop, draw, on_record):
    given = world(scene(field_stop=stop))
    origins, directions = np.zeros((2, COUNT, 3))
    surround.beam(given.laser, SAMPLER, FIRST, origins, directions)
    beam = [origins.copy(), directions.copy()]
    powers, densities = np.zeros((2, COUNT))
    surround.sight(given.camera, SAMPLER, FIRST, origins, directions, powers, densities)
    on_record([beam, origins, directions, powers, densities], 1e-8)


@pytest.mark.parametrize("mesh", [None, BALL])
@pytest.mark.parametrize("wall", [FLAT, WAVY])
def test_hits_and_blocked_lines(wall, mesh, draw, on_record):
    around = Surroundings(scene(wall, mesh=mesh))
    given = around.world._replace(camera=around.world.camera.copy())
    if draw.coarse:  # object and lens at places that coarse rays meet at their edges
        given.camera[:13] = (-0.5, 0.0, 0.75, 1, 0, 0, 0, 1, 0, 0, 0, -1, 0.25)
    plate = given.plate
    if draw.coarse and plate.size:
        plate = np.array([0.25, 0.0, 0.5, 1, 0, 0, 0, 1, 0, 0, 0, -1, 0.25, 0.125])
    origins = draw.numbers(-1.0, 1.0, COUNT, 3) + np.array([0.0, 0.0, 0.5])
    directions, live = draw.units(COUNT, (0.0, 0.0, -0.5)), draw.random.random(COUNT) < 0.9
    distance, scale, lit = np.full(COUNT, np.inf), np.ones(COUNT), np.zeros(COUNT)
    kind, normal = np.full(COUNT, surround.NOTHING, dtype=np.int16), np.zeros((COUNT, 3))
    ends = (distance, kind, normal, scale, lit)
    surround.wall_hits(*around._walls, origins, directions, live, distance, kind, normal)
    steps = [[distance.copy(), kind.copy(), normal.copy()]]
    surround.plate_and_lens(
        *(plate, given.picture, given.camera, given.norm, origins, directions, live), *ends
    )
    steps.append([one.copy() for one in ends])
    triangles = draw.random.integers(-1, len(given.kinds) + given.patches.size, COUNT)
    away, normals = draw.numbers(0.1, 1.2, COUNT), draw.units(given.kinds.size + given.patches.size)
    rows = np.flatnonzero(live)
    surround.mesh_hits(*(given, rows, triangles[rows], away[rows], normals, directions), *ends)
    value = draw.choice((0.0, 0.4, 1.3), COUNT)
    surround.clear(plate, given.camera, origins, origins + 1.5 * directions, value)
    on_record([steps, ends, value], 1e-8)


def test_least_distances(on_record):
    """Rays that start or end about 1e-9 m from object, lens and wall."""
    around = Surroundings(scene(WAVY, mesh=BALL))
    given = around.world._replace(camera=around.world.camera.copy())
    given.camera[:13] = (-0.5, 0.0, 0.75, 1, 0, 0, 0, 1, 0, 0, 0, -1, 0.25)
    plate = np.array([0.25, 0.0, 0.5, 1, 0, 0, 0, 1, 0, 0, 0, -1, 0.25, 0.125])
    steps = np.array([0.5, 0.9, 1.1, 1.5, 1.9, 2.1, 3.0, 6.0]) * 1e-9
    count, found = 2 * len(steps), []
    at = np.repeat([[0.3, 0.05, 0.5], [-0.45, 0.05, 0.75]], len(steps), axis=0)
    near, up = np.tile(steps, 2), np.zeros((count, 3))
    up[:, 2], live = 1.0, np.ones(count, dtype=bool)
    for side in (-1.0, 1.0):
        ends = [np.full(count, np.inf), np.full(count, surround.NOTHING, dtype=np.int16)]
        ends += [np.zeros((count, 3)), np.ones(count), np.zeros(count)]
        starts = at - side * near[:, None] * up
        picture = (plate, np.full((2, 3), 0.7), given.camera, 0.4)
        surround.plate_and_lens(*picture, starts, side * up, live, *ends)
        found.append(ends)
        for line in (side * up, -side * up):
            value = np.ones(count)
            surround.clear(plate, given.camera, starts, starts + line, value)
            found.append(value)
            value = np.ones(count)
            surround.clear(plate, given.camera, starts + line, starts, value)
            found.append(value)
    faces = np.arange(count, dtype=np.int64)
    distance, kind = np.ones(count), np.tile([surround.WALL, surround.OCCLUDER], len(steps))
    ends = (distance, kind.astype(np.int16), np.zeros((count, 3)), np.ones(count), np.zeros(count))
    away = 1.0 - np.repeat(steps, 2)
    surround.mesh_hits(given, faces, faces, away, np.tile(up, (9, 1)), -up, *ends)
    points = np.column_stack([near * 1e8, 0.3 - near * 1e8, near])
    around.settle(points, np.arange(count) % 3 > 0)
    on_record([found, ends, points], 1e-8)


SHEET = trimesh.Trimesh(
    [(-0.9, -0.8, 0.1), (1.1, -0.7, -0.2), (0.8, 0.9, -0.1), (-1.0, 0.8, 0.2)],
    [(0, 2, 1), (0, 3, 2)],  # its front faces the wall
    process=False,
)
CHAINS = [  # reflections, whether the first is at the wall from an occluder, wall, several, rays
    *((m, at_wall, FLAT, False, 64) for m in (1, 2, 3, 5, 6) for at_wall in (False, True)),
    *((m, at_wall, WAVY, False, 40) for m in (1, 2) for at_wall in (False, True)),
    *((m, at_wall, WAVY, True, 12) for m in (1, 2) for at_wall in (False, True)),
]


@pytest.mark.parametrize("mesh", [None, SHEET], ids=["plate", "mesh"])
@pytest.mark.parametrize(("m", "at_wall", "wall", "several", "count"), CHAINS)
def test_chains(m, at_wall, wall, several, count, mesh, on_record):
    """Between a wall, a large plate or mesh, and a wide lens with a wide detector."""
    draw, around = Draw(7), Surroundings(scene(wall, mesh=mesh))
    camera, plate = around.world.camera.copy(), around.world.plate.copy()
    camera[12], camera[15:17] = 0.8, 1.2
    plate[12:] *= 3.0
    given = around.world._replace(chains=3, camera=camera, plate=plate)
    kinds = (surround.ROOM,) if at_wall else (surround.WALL, surround.OBJECT)
    light = draw.vertices(count, surfaces=kinds)
    light[:, kernels.P] = draw.numbers(-0.3, 0.3, count, 3) + np.array([-0.3, 0.1, 0.5])
    light[:, kernels.N] = draw.units(count, (0.0, 0.0, -6.0))
    light[:, kernels.POWER] += 0.3
    on_wall, on_thing = (
        light[:, kernels.SURFACE] == kind for kind in (surround.WALL, surround.OBJECT)
    )
    light[on_wall, 2] = 0.0
    light[on_wall, kernels.N] *= -1.0
    if mesh is None:
        u, v = draw.numbers(-0.2, 0.2, 2, count, 1)
        light[on_thing, :3] = (plate[:3] + u * plate[3:6] + v * plate[6:9])[on_thing]
    light[:, kernels.I] = light[:, kernels.N] + 0.2 * draw.units(count)
    light[:, kernels.I] /= np.linalg.norm(light[:, kernels.I], axis=1)[:, None]
    light[::9, kernels.SURFACE] = surround.NOTHING
    value, length = np.zeros((2, count))
    mirrors = np.zeros((m, count, kernels.VERTEX))
    lens, _ = rays_to_lens(draw, camera, count)
    chains.chain_to_lens(
        *(given, around.chain_wall, SAMPLER, FIRST, light, lens, (2, m, at_wall)),
        *(several, around.chains.steepest, value, length, mirrors),
    )
    on_record([np.log(value[value > 0.0]), value, length, mirrors], 1e-6)
