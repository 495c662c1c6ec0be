"""Point spreads of random scenes' walls, with window, predicted cost and tails, on record."""

import numpy as np
import pytest

from nlosoptics import psf
from nlosoptics.psf.walls.scene_costs import point_cost
from nlosoptics.psf.walls.scene_psf import point_window

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
