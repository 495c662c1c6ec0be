"""Walls of triangles: plane and folded ones against the same surfaces of other kinds."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from pytest import approx

from nlosoptics.raytrace import (
    trace,
)
from nlosoptics.scene import (
    Camera,
    FlatWall,
    Lambert,
    Laser,
    MeshObject,
    MeshWall,
    Occluder,
    PlanarObject,
    Scene,
    SpecularMicrofacet,
    SumMaterial,
    WavyWall,
)

POWER = 2.0
PAINT = Lambert(0.7)
GLOSS = SumMaterial(Lambert(0.4), SpecularMicrofacet(0.4, 0.08))
BALL = MeshObject(
    trimesh.creation.icosphere(2, 0.2), position=(0.3, 0.0, 0.6), material=Lambert(0.9)
)


def joined(*meshes):
    return trimesh.util.concatenate(list(meshes))


def rectangle(*corners):
    return trimesh.Trimesh(corners, [(0, 1, 2), (0, 2, 3)], process=False)


FLAT = rectangle((-0.7, -0.6, 0), (0.7, -0.6, 0), (0.7, 0.6, 0), (-0.7, 0.6, 0))
#: A shelf in front of the wall, whose parts are three above one another.
SHELF = rectangle((-0.7, -0.2, 0.0), (0.7, -0.2, 0.0), (0.7, -0.3, 0.3), (-0.7, -0.3, 0.3))
LIP = rectangle((-0.7, -0.3, 0.3), (0.7, -0.3, 0.3), (0.7, -0.15, 0.25), (-0.7, -0.15, 0.25))


def room(wall, **changes):
    scene = Scene(
        Laser(
            wavelength=633e-9,
            power=POWER,
            beam_diameter=0.02,
            position=(-0.1, 0.5, 0.9),
            aim=(0.1, 0.1, 0.0),
        ),
        wall,
        PlanarObject(np.ones((2, 2)), 0.5, position=(0.35, 0.05, 0.6), yaw=0.3),
        Camera(
            position=(-0.3, 0.1, 1.0),
            aim=(0.0, -0.1, 0.0),
            focal_length=0.1,
            stop_diameter=0.3,
            pixel_pitch=1e-3,
            pixels=(160, 160),
            binning=1,
            focus_distance=1.5,
        ),
        wall_material=PAINT,
    )
    return replace(scene, **changes)


def agree(one, other, few=0.0):
    """Check flux by reflections, stray light and ledger, within the errors of both traces."""
    for k in range(len(one.by_bounce)):
        error = math.hypot(one.by_bounce_error[k], other.by_bounce_error[k])
        assert one.by_bounce[k] == approx(other.by_bounce[k], abs=4.5 * error + few)
    assert one.stray == approx(
        other.stray, abs=4.5 * math.hypot(one.stray_error, other.stray_error) + few
    )


FOLDED = MeshWall(joined(FLAT, SHELF, LIP), smooth=False)


@pytest.mark.thorough
@pytest.mark.parametrize("material", [PAINT, GLOSS], ids=["matt", "gloss"])
def test_two_triangles_are_a_flat_wall(material):
    one, other = (
        trace(room(wall, wall_material=material), n_rays=1 << 16, max_bounces=5, seed=seed)
        for wall, seed in ((MeshWall(FLAT, smooth=False), 1), (FlatWall(size=(1.4, 1.2)), 2))
    )
    agree(one, other)
    for name in ("absorbed by wall", "absorbed by object", "escaped"):
        error = math.hypot(one.ledger_error[name], other.ledger_error[name])
        assert one.ledger[name] == approx(other.ledger[name], abs=4.5 * error)


@pytest.mark.thorough
@pytest.mark.parametrize("material", [PAINT, GLOSS], ids=["matt", "gloss"])
def test_folded_wall_is_a_wall_with_shelves_of_its_material(material):
    """Undercuts: the same surfaces as a flat wall and two occluders that reflect light."""
    shelves = tuple(Occluder(mesh, material=material) for mesh in (SHELF, LIP))
    flat = room(FlatWall(size=(1.4, 1.2)), occluders=shelves, wall_material=material)
    one = trace(room(FOLDED, wall_material=material), n_rays=1 << 16, max_bounces=5, seed=3)
    other = trace(flat, n_rays=1 << 16, max_bounces=5, seed=4)
    agree(one, other)
    absorbed = other.ledger["absorbed by wall"] + other.ledger["absorbed by occluders"]
    error = math.hypot(
        one.ledger_error["absorbed by wall"],
        other.ledger_error["absorbed by wall"],
        other.ledger_error["absorbed by occluders"],
    )
    assert one.ledger["absorbed by wall"] == approx(absorbed, abs=4.5 * error)
    assert one.wall_to_wall > 0.01 * POWER


@pytest.mark.thorough
def test_fine_triangles_approach_the_smooth_wall():
    wavy = WavyWall(0.03, 0.5, size=(1.4, 1.2))
    mesh = wavy.to_mesh(max_sag_error=2e-5)
    assert len(mesh.faces) > 256  # so that Embree searches them
    one = trace(room(MeshWall(mesh, smooth=False)), n_rays=1 << 15, max_bounces=4, seed=5)
    agree(one, trace(room(wavy), n_rays=1 << 15, max_bounces=4, seed=6))


@pytest.mark.thorough
@pytest.mark.parametrize(
    "changes",
    [{}, {"hidden": BALL}, {"occluders": (Occluder(SHELF, position=(0, 0, 0.4)),)}],
    ids=["picture", "ball", "black shelf"],
)
def test_connections_agree_with_rays_that_nothing_aims(changes):
    scene = room(FOLDED, wall_material=GLOSS, **changes)
    plain = trace(scene, n_rays=1 << 19, max_bounces=5, analog=True, sampler="philox", seed=11)
    assert math.fsum(plain.ledger.values()) == approx(POWER, rel=1e-12)
    found = trace(scene, n_rays=1 << 16, max_bounces=5, seed=12)
    agree(found, plain, few=3 * POWER / plain.n_rays)
