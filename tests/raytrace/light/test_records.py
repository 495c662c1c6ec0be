"""Traced light of random scenes, of points and of lasers, on record."""

import pytest

from nlosoptics import raytrace

from ...records import attempt
from ...runs.random_scenes import random_case


@pytest.mark.parametrize("number", range(12))
def test_a_scene(number, on_record):
    scene = random_case(number, rough=number % 5 == 4).scene
    on_record(
        {
            "plan": attempt(raytrace.ray_plan, scene),
            "ledger": attempt(raytrace.trace, scene, n_rays=1024, max_bounces=3),
            "paths": attempt(
                raytrace.trace, scene, n_rays=64, keep_paths=True, sampler="philox", seed=2
            ),
            "analog": attempt(raytrace.trace, scene, n_rays=512, max_bounces=3, analog=True),
        }
    )


@pytest.mark.parametrize("emission", ["lambertian", "isotropic"])
@pytest.mark.parametrize("number", [0, 2, 3, 7, 9, 11])
def test_a_point(number, emission, on_record):
    scene, told = random_case(number).scene, []
    asked = {"emission": emission, "n_rays": 512, "max_bounces": 2, "shape": (8, 6)}
    asked |= {"pitch": 20 * scene.camera.image_pitch, "progress": lambda *step: told.append(step)}
    on_record([attempt(raytrace.trace_point, scene, **asked), told])


@pytest.mark.parametrize("source", ["laser", "object"])
@pytest.mark.parametrize("number", [0, 3, 8])
def test_irradiance(number, source, on_record):
    scene = random_case(number).scene
    asked = {"shape": (6, 5), "source": source, "n_rays": 1024}
    on_record(attempt(raytrace.wall_irradiance, scene, **asked))


def test_lasers(flat_scene, on_record):
    told = []
    asked = {"n_rays": 512, "progress": lambda *step: told.append(step)}
    on_record([attempt(raytrace.trace_lasers, flat_scene, [flat_scene.laser] * 2, **asked), told])


LIMITS = {
    "rays": {"n_rays": 40_000},
    "tol": {"tol": 0.02},
    "few bounces": {"n_rays": 1024, "max_bounces": 1},
    "no bounce": {"n_rays": 1024, "max_bounces": 0},
    "scrambled": {"n_rays": 1024, "seed": 7},
}


@pytest.mark.parametrize("limit", LIMITS)
def test_steps_of_a_trace(limit, flat_scene, on_record):
    told = []
    found = attempt(
        raytrace.trace, flat_scene, **LIMITS[limit], progress=lambda *step: told.append(step)
    )
    on_record([found, told])
