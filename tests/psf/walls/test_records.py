"""Point spreads of random scenes' walls, with window, predicted cost and tails, on record."""

from dataclasses import replace

import numpy as np
import pytest

from nlosoptics import Scene, psf
from nlosoptics.psf.walls import rough_wall, scene_costs
from nlosoptics.psf.walls.scene_costs import point_cost
from nlosoptics.psf.walls.scene_psf import point_window
from nlosoptics.psf.wave.detilted import split
from nlosoptics.scene import FacetWall, GaussianWall, SpecularMicrofacet, WallRoughness

from ...records import attempt
from ...runs.random_scenes import random_case


@pytest.mark.parametrize("rough", [False, True], ids=["smooth", "rough"])
@pytest.mark.parametrize("number", range(15))
def test_a_scene(number, rough, on_record):
    case = random_case(number, wild=number % 4 == 3, rough=rough)
    tol, pitch = max(case.tol, 3e-3), case.scene.camera.image_pitch
    optics = psf.SceneOptics(case.scene)
    seen = attempt(optics.at)
    if isinstance(seen, Exception):
        return on_record(seen)
    cost = attempt(point_cost, seen, pitch, (32, 24), tol)
    cheap = not isinstance(cost, Exception) and cost.seconds < 0.1
    on_record(
        {
            "pupil": attempt(lambda: optics.exit_pupil),
            "view": attempt(lambda: seen.view),
            "zoom": attempt(lambda: seen.zoom),
            "window": attempt(point_window, seen, pitch, tol),
            "cost": cost,
            "spread": cheap
            and attempt(psf.scene_point_spread, optics, tol, pitch=pitch, shape=(32, 24)),
            "finer cost": attempt(point_cost, seen, pitch / 3, (50, 60), 1e-5),
            "hybrid": cheap
            and not rough
            and attempt(psf.hybrid_point_spread, case.scene, n_rays=512, shape=16, tol=0.05),
        }
    )


@pytest.mark.parametrize("number", [0, 2, 4, 6])
def test_a_field(number, on_record):
    scene = random_case(number).scene
    pitch = 2 * scene.camera.image_pitch
    told = []
    asked = {"pitch": pitch, "checks": 1, "progress": lambda *step: told.append(step)}
    field = attempt(psf.point_spread_field, scene, 2, tol=0.05, **asked)
    if isinstance(field, Exception):
        return on_record(field)
    at = np.array([-0.7, 0.4]), np.array([0.2, 0.9])
    on_record([field, field.at(*at), field.mean, field.deviation, field.compressed(0.02), told])
    return None


def test_isoplanatic_radius(flat_scene, on_record):
    scenes = [random_case(number).scene for number in (1, 5)]
    on_record([attempt(psf.isoplanatic_radius, one, tol=0.2) for one in (flat_scene, *scenes)])


@pytest.mark.parametrize("waves", [0.0, 0.4])
def test_bands_and_tails(waves, on_record):
    system = {"wavelength": 6e-7, "pupil_radius": 4e-3, "image_distance": 0.06}
    wave = psf.Wavefront.from_zernike({5: waves * 6e-7, 7: 1e-7}, **system)
    asked = {"pitch": 2e-6, "shape": 31, "tol": 0.02, "pixel_integrated": True}
    lines, weights = psf.gaussian_band(6e-7, 4e-8, count=3)
    spread = attempt(psf.point_spread, wave, **asked)
    on_record(
        [
            attempt(psf.band_point_spread, wave, lines, weights, **asked),
            attempt(psf.widened, spread, tol=1e-2, shape=(40, 30)),
        ]
    )


HEIGHTS = {
    "long": GaussianWall(2e-7, 8e-3, seed=2),
    "bumps": GaussianWall(3e-7, 2e-3, seed=1),
    "facets": FacetWall(1e-3, 5e-4, seed=1),
    "large facets": FacetWall(5e-3, 1e-7, seed=2),
    "steep": FacetWall(1e-3, 3e-2, seed=1),
}


def letter(examples, heights, realisation):
    scene = Scene.load(examples / "scenes" / "letter_flat.toml").resized(64)
    return replace(
        scene,
        wall_material=SpecularMicrofacet(0.05, 0.0),
        wall_roughness=WallRoughness(heights, realisation),
    )


@pytest.mark.parametrize("realisation", ["pattern", "mean"])
@pytest.mark.parametrize("name", HEIGHTS)
def test_regimes_of_rough_walls(name, realisation, examples, on_record):
    """Regime, sampling, cost and window, for narrow and wide pixels."""
    scene = letter(examples, HEIGHTS[name], realisation)
    seen, pitch = psf.SceneOptics(scene).at(), scene.camera.image_pitch
    cases = [(pitch, (9, 12), 1e-2), (pitch / 16, (25, 30), 1e-3), (pitch / 3, (80, 64), 1e-5)]
    on_record(
        [
            [
                attempt(rough_wall.rough_choice, seen, *case),
                attempt(point_cost, seen, *case),
                attempt(rough_wall.rough_window, seen, case[0], case[2]),
            ]
            for case in cases
        ]
    )


@pytest.mark.parametrize(
    ("name", "parts", "shape"),
    [
        ("long", 64, (20, 25)),
        ("facets", 16, (24, 27)),
        ("facets", 0.5, (5, 8)),
        ("steep", 1, (15, 12)),
    ],
)
def test_images_of_rough_walls(name, parts, shape, examples, on_record):
    scene = letter(examples, HEIGHTS[name], "pattern")
    seen, pitch = psf.SceneOptics(scene).at(), scene.camera.image_pitch
    _, spread, field = rough_wall.rough_image(seen, pitch / parts, shape, 1e-2)
    card = field and [field.amplitude, field.phase, str(field._figures())]
    on_record([spread, field, card])


@pytest.mark.parametrize("name", ["polar", "cells", "grid"])
def test_costs_of_smooth_waves(name, on_record):
    """Time and memory of each layout, on narrow and wide pixels, and of finer grids."""
    options = {"cells": {"aperture": psf.Aperture.regular(6, 3.5e-3, 0.1)}, "grid": {"samples": 90}}
    wave = psf.Wavefront.from_zernike(
        {2: 1e-7, 5: 6e-8, 8: 9e-8},
        wavelength=6e-7,
        pupil_radius=4e-3,
        image_distance=-0.06,
        nodes=name,
        **options.get(name, {}),
    )
    residual = split(wave)
    cases = [(2e-6, (30, 41), 1e-3), (2e-6, (30, 41), 1e-6), (2e-4, (21, 30), 1e-3)]
    cases += [(3e-5, (90, 41), 3e-2), (1e-6, (700, 600), 1e-4)]
    found = [
        attempt(scene_costs.smooth_cost, residual, *case, cells)
        for case in cases
        for cells in (0, 300)
    ]
    if name == "grid":
        found += [
            attempt(scene_costs.grid_samples, residual, pitch, side, tol)
            for pitch, side in ((2e-6, 60), (2e-6, 900), (3e-5, 60), (1e-4, 40))
            for tol in (1e-2, 1e-4, 1e-6)
        ]
    on_record(found)
