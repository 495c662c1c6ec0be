"""Plans, chains and surroundings of many scenes, on record."""

from collections import Counter
from dataclasses import astuple, replace

import numpy as np
import pytest
import trimesh

from nlosoptics import raytrace
from nlosoptics.raytrace.light import _light_kernels as kernels
from nlosoptics.raytrace.light import blocks, chains, surroundings
from nlosoptics.raytrace.light._surround_kernels import LOST, WALL
from nlosoptics.raytrace.light.surroundings import Surroundings
from nlosoptics.scene import (
    CallableWall,
    ConcaveWall,
    ConvexWall,
    FacetWall,
    FlatWall,
    Lambert,
    Laser,
    MeshWall,
    Occluder,
    SpecularMicrofacet,
    SumWall,
    WavyWall,
)

from .draws import FLAT, GLOSSY, SHINY, WAVY, Draw, scene

BALL = trimesh.creation.icosphere(subdivisions=1, radius=0.25)
FINE = trimesh.creation.icosphere(subdivisions=3, radius=0.25)
WALLS = {
    "flat": FLAT,
    "endless": FlatWall(),
    "wavy": WAVY,
    "gentle": WavyWall(1e-4, 0.5, size=(1.0, 0.8)),
    "fine": WavyWall(1e-4, 0.02, size=(1.0, 0.8)),
    "sum": SumWall(WavyWall(1e-3, 0.3, direction=0.4), ConcaveWall(2.0), size=(1.5, 1.2)),
    "bowl": ConcaveWall(0.9, size=1.2),
    "hollow": ConcaveWall(1.5, size=1.9),
    "trough": ConcaveWall(1.1, shape="cylinder", axis="x", size=(1.9, 2.0)),
    "channel": ConcaveWall(1.1, shape="cylinder", axis="y", size=(2.0, 1.9)),
    "ball": ConvexWall(1.5, size=1.3),
    "facets": FacetWall(0.05, 0.01, seed=2, size=(1.2, 0.9)),
    "functions": CallableWall(
        lambda x, y: 0.1 * (x**2 - y**2),
        lambda x, y: (0.2 * x, -0.2 * y),
        hessian=lambda x, y: (0.2 + 0 * x, 0 * x, -0.2 + 0 * x),
        size=(1.5, 1.2),
        max_height=0.2,
        max_curvature=0.2,
    ),
    "mesh": MeshWall(ConcaveWall(2.0, size=(1.3, 1.1)).to_mesh(max_sag_error=1e-4)),
}


@pytest.mark.parametrize("name", WALLS)
def test_a_plan(name, on_record):
    found, told, texts = [], [], set()
    for mesh in (None, BALL, FINE):
        for paint in (GLOSSY, Lambert(0.3), SpecularMicrofacet(0.3, 0.2)):
            for material in (SHINY, Lambert(0.5)):
                one = scene(WALLS[name], mesh=mesh, paint=paint, material=material)
                alone = replace(one, occluders=())
                for each in (one, alone):
                    plan = raytrace.ray_plan(each)
                    found.append([int(value) for value in astuple(plan)[1:-1]])
                    texts |= {plan.wall_hits, str(plan)}
                    told += [chains.mirror_chains(each, wall_to_wall=w) for w in (False, True)]
    shapes = [chains._lens_elevation(one)]
    if WALLS[name].has_height and not WALLS[name].is_flat:
        shapes += chains._slopes(one)
    if isinstance(WALLS[name], ConcaveWall):
        for away in (0.4, 0.6, 0.9, 1.4):
            camera = replace(one.camera, position=(-away, 0.1 * away, 0.8))
            shapes.append(surroundings._within_hollow(WALLS[name], replace(one, camera=camera)))
    joint = chains.joint_chains(told[1:9:3])
    numbers = [[int(one.both), int(one.several), one.surfaces, one.steepest] for one in told]
    texts |= {str(path) for one in told for path in one.unreached}
    counts = [np.array(found), np.array(numbers)]
    on_record([*counts, sorted(texts), shapes, joint, chains.left_to_chance(joint)])


@pytest.mark.parametrize("mesh", [None, BALL])
def test_beams_that_may_meet_the_object(mesh, on_record):
    """Lasers all around, directly and by the wall, at several spreads."""
    draw, found = np.random.default_rng(3), []
    for _ in range(60):
        laser = Laser(
            wavelength=633e-9,
            power=1.0,
            beam_diameter=0.01,
            position=tuple(draw.uniform((-0.8, -0.8, 0.2), (0.8, 0.8, 1.5)).tolist()),
            aim=(*draw.uniform(-0.5, 0.8, 2).tolist(), 0.0),
        )
        one = replace(scene(mesh=mesh), laser=laser)
        found += [
            chains._meets_object(one, spread, mirrored=mirrored)
            for spread in (0.0, 0.1, 0.3, 0.9)
            for mirrored in (False, True)
        ]
    on_record(np.array(found, dtype=float))


@pytest.mark.parametrize("mesh", [None, BALL])
@pytest.mark.parametrize("name", WALLS)
def test_hits_and_lines(name, mesh, on_record):
    """First hits of any rays, of rays that leave the wall, and connections."""
    around, draw, count = Surroundings(scene(WALLS[name], mesh=mesh)), Draw(4), 300
    origins = draw.numbers(-0.6, 0.6, count, 3) + np.array([0.0, 0.0, 0.65])
    directions = draw.units(count, (0.0, 0.0, -0.6))
    live, on_wall = draw.random.random((2, count)) < 0.8
    on_wall[::2] = False
    if around.plan.wall_to_wall:
        around.settle(origins, on_wall)
    counts = Counter()
    hits = around.first_hits(origins, directions, live, on_wall, counts)
    value = draw.choice((0.0, 0.4, 1.3), count)
    ends = origins[::-1].copy()
    around.clear(origins, ends, on_wall, value, counts)
    given = around.world
    on_record(
        {
            "hits": hits,
            "value": value,
            "counts": dict(sorted(counts.items())),
            "world": given,
            "analog": Surroundings(scene(WALLS[name], mesh=mesh), analog=True).world.aimed,
            "met": [
                surroundings._met(scene(WALLS[name]), (0.0, 0.1, 1.0), to)
                for to in ((0.2, 0.1, 0.0), (0.2, 0.1, 2.0))
            ],
        },
        1e-7,
    )


def test_partners_and_lasers(on_record):
    laser = scene().laser
    rows = [surroundings.laser_row(replace(laser, position=p)) for p in ((0, 0.3, 1), (0.4, 0, 2))]
    found = [blocks._partners(n, 4) for n in (1, 33, 1024, 1500)]
    on_record([rows, found, [kernels.VERTEX, blocks.LEDGER]])


def test_a_ray_that_a_wall_of_functions_cannot_resolve(on_record):
    """It ends where it starts, and what it meets is lost."""
    steep = replace(WALLS["functions"], max_curvature=1e12)  # whose steps are too short
    around = Surroundings(
        replace(scene(steep), occluders=(Occluder(BALL, position=(0.0, 0.0, 0.8)),))
    )
    origins = np.array([[-0.3, 0.0, 0.15], [-0.3, 0.01, 0.15], [0.0, 0.3, 0.2]])
    directions = np.array([[0.6, 0.0, -0.8], [0.6, 0.0, 0.8], [0.0, 0.0, -1.0]])
    live = np.ones(3, dtype=bool)
    distance, kind = np.full(3, np.inf), np.full(3, -1, dtype=np.int16)
    normal = np.zeros((3, 3))
    around._python_hits(origins, directions, live, distance, kind, normal)
    on_record([distance, kind, normal])
    assert kind.tolist() == [LOST, LOST, WALL]
    assert distance[0] == 0.0
