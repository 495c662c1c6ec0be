"""Searches for footprints and fans of rays, with random arguments, on record."""

import math
from dataclasses import replace

import numpy as np
import pytest

from nlosoptics.raytrace.fans import footprints, pupil_fans
from nlosoptics.raytrace.fans.material_slopes import material_slope
from nlosoptics.scene import (
    Camera,
    ConcaveWall,
    ConvexWall,
    FlatWall,
    Lambert,
    OrenNayar,
    SpecularMicrofacet,
    SumMaterial,
    SumWall,
    Ward,
    WavyWall,
)

from ...records import attempt

CAMERA = Camera(
    position=(-0.5, 0.1, 0.8), aim=(0.0, 0.05, 0.0), focal_length=0.05, stop_diameter=0.04
)
WALLS = {
    "flat": FlatWall(size=(0.9, 0.7)),
    "bowl": ConcaveWall(2.0, size=1.1),
    "ball": ConvexWall(1.2, size=1.3),
    "wave": WavyWall(2e-4, 0.1, 0.3, direction=0.4, size=(0.8, 0.5)),
    "endless wave": WavyWall(1e-4, 0.2, direction=1.0),
    "sum": SumWall(WavyWall(2e-4, 0.2, direction=0.4), ConcaveWall(3.0), size=(1.0, 0.9)),
    "narrow": FlatWall(size=(0.03, 0.02)),
}


@pytest.mark.parametrize("name", WALLS)
def test_footprints(name, on_record):
    wall, point = WALLS[name], np.array([0.4, -0.05, 0.7])
    draw = np.random.default_rng(3)
    low, high = np.array([-0.12, -0.1]), np.array([0.13, 0.17])
    places = draw.uniform(-0.7, 0.7, (60, 2))
    on_record(
        {
            "box": footprints._mirror_box(wall, point, CAMERA),
            "counts": footprints._counts(wall, low, high),
            "landings": footprints._landings(wall, point, CAMERA, places),
            "points": footprints._lit_points(wall, point, CAMERA, low, high),
            "footprint": [
                attempt(footprints.lens_footprint, wall, np.array(at), camera)
                for camera in (CAMERA, replace(CAMERA, stop_diameter=0.2))
                for at in ((0.4, -0.05, 0.7), (0.05, 0.3, 0.4), (0.4, 0.0, -1e-9))
            ],
        },
        1e-8,
    )


def test_rays_to_the_plane_of_the_lens(on_record):
    """Also rays that are parallel to it, start on it or come from behind."""
    draw = np.random.default_rng(4)
    camera = replace(CAMERA, position=(0.0, 0.0, 0.5), aim=(0.0, 0.0, 0.0), stop_diameter=0.99)
    points = draw.integers(-4, 5, (90, 3)) / 4.0
    directions = np.eye(3)[draw.integers(0, 3, 90)] * draw.choice((-1.0, 1.0), (90, 1))
    far = replace(camera, stop_diameter=1.01, position=(0.2, 0.0, 0.5))
    on_record(
        [
            footprints.lens_plane(points, directions, camera),
            footprints.reflected(points + 0.1, directions),
            attempt(footprints._mirror_box, WALLS["flat"], np.array([0.4, 0.0, 0.7]), far),
            attempt(footprints._mirror_box, WALLS["flat"], np.array([0.4, 0.0, 0.7]), camera),
        ]
    )


@pytest.mark.parametrize("count", [2, 16, 17, 100, 257, 1024])
def test_lattices(count, on_record):
    on_record(pupil_fans._lattice(count, 3), 1e-8)


def test_balances_of_fans(on_record):
    draw = np.random.default_rng(5)
    points, length = draw.random((40, 3, 3)), draw.random(40)
    bounces = draw.integers(0, 2, 40).astype(np.int32)
    status = draw.integers(0, 5, 40).astype(np.int8)
    on_record(
        [
            pupil_fans._with_ledger(points, length, bounces, one, 0.7)
            for one in (status, np.zeros(40, dtype=np.int8))
        ]
    )


def test_slopes_of_the_strongest_lobe(flat_scene, on_record):
    matt = Lambert(0.3)
    materials = [
        SumMaterial(matt, SpecularMicrofacet(0.2, 0.1), SpecularMicrofacet(0.3, 0.2)),
        SumMaterial(SpecularMicrofacet(0.4, 0.0), SpecularMicrofacet(0.1, 0.2), matt),
        SumMaterial(OrenNayar(0.3, 0.25), SpecularMicrofacet(0.2, 0.1)),
        *(Ward(0.3, 0.2, variant=name) for name in ("1992", "duer", "bounded")),
        SpecularMicrofacet(0.4, 0.15, distribution="ggx"),
        matt,
    ]
    on_record(
        [attempt(material_slope, replace(flat_scene, wall_material=one)) for one in materials]
    )
    assert math.isclose(
        material_slope(replace(flat_scene, wall_material=materials[3])), 0.2 / math.sqrt(2.0)
    )
