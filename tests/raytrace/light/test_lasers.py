"""Several lasers in one run: each as alone, and all of them together."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from pytest import approx

from nlosoptics.errors import MemoryLimitError, SceneError
from nlosoptics.raytrace import trace, trace_lasers
from nlosoptics.scene import (
    Camera,
    FlatWall,
    Lambert,
    Laser,
    MeshObject,
    Occluder,
    PlanarObject,
    Scene,
    SpecularMicrofacet,
    SumMaterial,
)

GLOSS = SumMaterial(Lambert(0.4), SpecularMicrofacet(0.4, 0.08))
BALL = MeshObject(
    trimesh.creation.icosphere(2, 0.2), position=(0.3, 0.0, 0.6), material=Lambert(0.9)
)
SIDE = trimesh.Trimesh(
    [(0.8, -0.5, 0), (0.8, 0.5, 0), (0.8, 0.5, 1), (0.8, -0.5, 1)], [(0, 1, 2), (0, 2, 3)]
)


def room(**changes):
    scene = Scene(
        Laser(wavelength=633e-9, power=2.0, beam_diameter=0.02, position=(-0.1, 0.5, 0.9)),
        FlatWall(size=(1.6, 1.2)),
        PlanarObject(np.eye(3), 0.5, position=(0.35, 0.0, 0.6), yaw=0.3),
        Camera(
            position=(-0.3, 0.1, 1.0),
            aim=(0.0, -0.1, 0.0),
            focal_length=0.1,
            stop_diameter=0.1,
            pixel_pitch=1e-3,
            pixels=(160, 160),
            binning=1,
            focus_distance=1.5,
        ),
        wall_material=Lambert(0.7),
    )
    return replace(scene, **changes)


def lasers_of(scene):
    """Return lasers of several places, aims, powers and beams."""
    return [
        scene.laser,
        replace(scene.laser, aim=(0.3, 0.1, 0.0), power=0.5),
        replace(scene.laser, position=(0.4, 0.4, 0.7), aim=(-0.2, -0.3, 0.0), beam_diameter=0.05),
    ]


@pytest.mark.parametrize(
    "scene",
    [
        room(),
        room(wall_material=SumMaterial(Lambert(0.4), SpecularMicrofacet(0.4, 0.15))),
        room(occluders=(Occluder(SIDE, material=Lambert(0.5)),), wall_material=GLOSS),
    ],
    ids=["matt", "gloss", "room"],
)
@pytest.mark.parametrize("sampler", ["sobol", "philox"])
def test_each_laser_has_the_bits_of_its_own_trace(scene, sampler):
    """Also in the last block, which is not full, and in the later ones."""
    lasers = lasers_of(scene)
    found = trace_lasers(scene, lasers, n_rays=9000, seed=3, sampler=sampler)
    assert len(found.each) == 3
    for laser, one in zip(lasers, found.each, strict=True):
        alone = trace(replace(scene, laser=laser), n_rays=9000, seed=3, sampler=sampler)
        assert one.by_bounce.tobytes() == alone.by_bounce.tobytes()
        assert one.by_bounce_error.tobytes() == alone.by_bounce_error.tobytes()
        assert dict(one.ledger) == dict(alone.ledger)
        assert (one.stray, one.n_rays) == (alone.stray, 9000)


def test_lasers_add_and_their_errors_are_joint():
    scene = room(wall_material=GLOSS)
    twice = trace_lasers(scene, [scene.laser, scene.laser], n_rays=4096, seed=1)
    one = twice.each[0]
    assert twice.together.flux == approx(2 * one.flux, rel=1e-12)
    # the same rays: the errors add, and not their squares
    assert twice.together.standard_error == approx(2 * one.standard_error, rel=1e-9)
    assert sum(twice.together.ledger.values()) == approx(2 * sum(one.ledger.values()), rel=1e-12)
    three = trace_lasers(scene, lasers_of(scene), n_rays=4096, seed=1)
    assert three.together.by_bounce == approx(sum(r.by_bounce for r in three.each), rel=1e-12)
    assert three.together.queries["wall"] == sum(r.queries["wall"] for r in three.each)


@pytest.mark.parametrize(
    "scene", [room(hidden=BALL), room(wall_material=GLOSS)], ids=["mesh", "glint"]
)
def test_other_scenes_agree_with_their_own_traces(scene):
    """Meshes: rays are drawn by all lasers' light. Glints: only some lasers send one to the object.

    In both, only the noise differs.
    """
    lasers = lasers_of(scene)
    found = trace_lasers(scene, lasers, n_rays=1 << 16, seed=4)
    for k, (laser, one) in enumerate(zip(lasers, found.each, strict=True)):
        alone = trace(replace(scene, laser=laser), n_rays=1 << 16, seed=50 + k)
        error = math.hypot(one.standard_error, alone.standard_error)
        assert one.flux == approx(alone.flux, abs=4 * error)
        assert error < 0.02 * one.flux


@pytest.mark.parametrize(
    ("lasers", "options", "error", "message"),
    [
        ([], {}, SceneError, "give a list of at least one Laser"),
        (room().laser, {}, SceneError, "give a list of at least one Laser"),
        ([room().laser, 3], {}, SceneError, r"lasers\[1\] is a int; give a Laser"),
        ([room().laser], {"n_rays": 0}, SceneError, "n_rays = 0"),
        ([room().laser] * 10**6, {}, MemoryLimitError, "1000000 lasers.*give fewer lasers"),
    ],
)
def test_bad_input_is_one_line(lasers, options, error, message):
    with pytest.raises(error, match=message):
        trace_lasers(room(), lasers, **options)
