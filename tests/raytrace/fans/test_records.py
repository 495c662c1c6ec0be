"""Fans of rays to the lens of random scenes, on record."""

import pytest

from nlosoptics import raytrace

from ...records import attempt
from ...runs.random_scenes import random_case


@pytest.mark.parametrize("number", range(14))
def test_a_fan(number, on_record):
    scene = random_case(number, wild=number % 3 == 2).scene
    point = [c + 0.01 for c in scene.hidden.position]
    on_record(
        [
            attempt(raytrace.pupil_rays, scene, n_rays=100),
            attempt(raytrace.pupil_rays, scene, n_rays=70, seed=3, object_point=point),
        ]
    )
