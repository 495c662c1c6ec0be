"""Wavefronts of random scenes, from rays and from slopes, on record."""

import numpy as np
import pytest

from nlosoptics import psf
from nlosoptics.psf.pupil.paraxial import change_over_object
from nlosoptics.raytrace import pupil_rays

from ...records import attempt
from ...runs.random_scenes import random_case


@pytest.mark.parametrize("number", range(18))
def test_a_scene(number, on_record):
    scene = random_case(number, wild=number % 3 == 2).scene
    pupil = attempt(psf.exit_pupil, scene)
    paths = attempt(pupil_rays, scene, n_rays=256)
    known = not isinstance(paths, Exception)
    hidden = scene.hidden
    point = (*(c + 0.02 for c in hidden.position[:2]), hidden.position[2])
    on_record(
        [pupil]
        if isinstance(pupil, Exception)
        else {
            "pupil": pupil,
            "view": attempt(psf.wall_view, scene, point),
            "wave": attempt(psf.wavefront, scene, point, samples=(12, 24)),
            "grid": attempt(psf.wavefront, scene, nodes="grid", samples=24),
            "automatic": attempt(psf.wavefront, scene),
            "change": attempt(change_over_object, scene, pupil),
            "beyond": attempt(
                psf.path_difference,
                scene.wall,
                hidden.position,
                np.array(scene.camera.position) * (-1.0, 1.0, -0.7),
                0.1,
            ),
            "paths": paths,
            "rays": known
            and attempt(psf.wavefront_from_rays, paths, pupil, scene.laser.wavelength),
        }
    )


@pytest.mark.parametrize("number", [0, 2, 4, 6])
def test_slopes_of_a_wall(number, on_record):
    scene = random_case(number).scene
    steps = np.linspace(-0.05, 0.05, 5)
    x, y = np.meshgrid(steps, steps)
    view = attempt(psf.wall_view, scene)
    places = np.stack([x, y, 0 * x], axis=-1) + getattr(view, "point", np.zeros(3))
    slopes = 1e-3 * np.stack([x + 20 * y**2, 0.4 * y - x], axis=-1) / 0.05
    nodes = 1e-4 * np.array([[0.0, 0.0], [3.0, -2.0], [-5.0, 1.0]])
    on_record(attempt(psf.pupil_slopes, scene, slopes, places, nodes))


@pytest.mark.parametrize("mask", ["whole", "annulus"])
def test_slopes(mask, on_record):
    rng = np.random.default_rng(2)
    y, x = np.mgrid[:20, :20] - 9.5
    inside = (x**2 + y**2 < 90) & ((mask == "whole") | (x**2 + y**2 > 9))
    slopes = 1e-6 * np.stack([x + 0.1 * y**2, 0.3 * y - x]) + 1e-7 * rng.normal(size=(2, 20, 20))
    options = {"wavelength": 6e-7, "image_distance": 0.1}
    on_record(
        [
            attempt(psf.integrated_slopes, slopes, 1e-4, inside),
            attempt(psf.wavefront_from_slopes, slopes, 1e-4, inside, **options),
        ]
    )
