"""Traced images with and without time, colours and polarisation, on record."""

from dataclasses import replace

import pytest

from nlosoptics import raytrace

from ...records import attempt
from ...runs.random_scenes import random_case

BINS = {"t_start": 0.0, "delta_t": 0.2, "n_bins": 40}


def few_pixels(number):
    scene = random_case(number).scene
    return replace(scene, camera=replace(scene.camera, pixels=(10, 8)))


@pytest.mark.parametrize("number", range(8))
def test_an_image(number, on_record):
    scene = few_pixels(number)
    on_record(
        [
            attempt(raytrace.trace_image, scene, n_rays=512, max_bounces=3),
            attempt(raytrace.trace_image, scene, n_rays=512, **BINS, outer_legs=False, seed=4),
        ]
    )


@pytest.mark.parametrize("number", [0, 1, 2, 7])
def test_colours_and_polarisation(number, on_record):
    scene = few_pixels(number)
    lines = [scene.laser.wavelength, 1.1 * scene.laser.wavelength]
    told = []
    asked = {"n_rays": 256, "progress": lambda *step: told.append(step)}
    on_record(
        [
            attempt(raytrace.trace_colours, scene, lines, **asked),
            attempt(raytrace.trace_polarised, scene, n_rays=256),
            told,
        ]
    )
