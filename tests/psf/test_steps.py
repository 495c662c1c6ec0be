"""All that leads to a point spread, on record: what every function returns on the way."""

import numpy as np
import pytest

from nlosoptics import psf
from nlosoptics.psf.batch import point_spreads
from nlosoptics.psf.walls.scene_costs import point_cost
from nlosoptics.psf.walls.scene_psf import point_window
from nlosoptics.raytrace import pupil_rays
from nlosoptics.scene import FacetWall

from ..records import attempt
from ..runs.random_scenes import random_case
from ..steps import NEAR, steps

WAVES = [(kind, index) for kind in ("polar", "grid", "scattered", "map") for index in (2, 4, 7)]
WAVES.append(("cells", 7))
SYSTEM = {"wavelength": 6e-7, "pupil_radius": 4e-3, "image_distance": 0.06}


def attempts(*calls):
    for call, *given in calls:
        *given, options = given if isinstance(given[-1], dict) else (*given, {})
        attempt(call, *given, **options)


@pytest.mark.parametrize(("kind", "index"), WAVES)
def test_a_wave(kind, index, draw, on_record):
    case = draw(41, index, 0.4, kind)
    asked = case.options | {"shape": (19, 14), "max_seconds": 0.03}
    methods = ("quadrature", "mdft", "geometric")
    ways = [(psf.point_spread, case.front, asked | {"method": one, "tol": 0.03}) for one in methods]
    wide = {"model": "high-aperture", "polarisation": 0.3, "tol": 0.03}
    calls = [
        (psf.point_spread, case.front, asked),
        *ways,
        (psf.point_spread, case.front, asked | wide),
    ]
    on_record(steps(lambda: attempts(*calls), "psf"), NEAR)


@pytest.mark.parametrize("kind", ["polar", "grid", "scattered"])
def test_figures(kind, draw, on_record):
    wave = draw(41, 2, 0.4, kind).front
    cutoff = 1 / (wave.wavelength * wave.f_number)
    lines, shifts = (
        cutoff * np.array([0.1, 0.7]),
        9 / cutoff * wave.f_number * np.array([-0.7, 1.0]),
    )
    calls = [
        (psf.mtf, wave, lines, {"azimuth": 0.4}),
        (psf.encircled_energy, wave, [0.7 / cutoff, 3 / cutoff]),
        (psf.fit_zernike, wave, 7),
        (psf.spot_diagram, wave, {"rings": 3}),
        (psf.best_focus, wave),
        (psf.through_focus, wave, shifts, {"criterion": "mtf", "frequency": 0.3 * cutoff}),
    ]
    on_record(steps(lambda: attempts(*calls), "psf/metrics", "psf/wave", "psf/aperture"), NEAR)


A = psf.Aperture
SQUARE = [(-0.8, -0.7), (0.9, -0.8), (0.7, 0.8), (-0.9, 0.6)]
APERTURES = {
    "ellipse": lambda: A.ellipse(1.0, 0.6, 0.3, obscuration=0.2, centre=(0.05, -0.02)),
    "vanes": lambda: A.round(1.0, 0.3, vanes=3, vane_width=0.08, angle=0.2),
    "bent": lambda: A.polygon([(0, 0), (1, -0.5), (0.4, 0.2), (0.9, 0.9), (-0.8, 0.5)]),
    "hexagons": lambda: A.hexagons(1, 0.6, 0.05, angle=0.1, central=False),
    "discs": lambda: A.discs([((0.1, 0.2), 0.9), ((0.7, 0.1), 0.3)], within=SQUARE),
    "many discs": lambda: A.discs([((0.4 * k - 0.6, 0.3 * k % 0.7), 0.31) for k in range(4)]),
    "obscured": lambda: A.polygon(SQUARE, obscuration=0.25),
}


@pytest.mark.parametrize("name", APERTURES)
def test_an_aperture(name, on_record):
    u, v = np.random.default_rng(1).uniform(-1.1, 1.1, (2, 50))

    def measured():
        aperture = APERTURES[name]()
        aperture.nodes(4, 5), aperture.grid_nodes(24), aperture.grid_shares(20, 0.11)
        aperture.contains(u, v), aperture.area, aperture.perimeter
        wave = psf.Wavefront.from_zernike(
            {4: 9e-7, 7: 2e-7}, **SYSTEM | {"pupil_radius": 1.2}, aperture=aperture
        )
        attempts((psf.mtf, wave, [1e6, 9e6], {"azimuth": 0.7}))

    on_record(steps(measured, "psf/aperture", "psf/transform", "psf/metrics"), NEAR)


@pytest.mark.parametrize("rough", [False, True], ids=["smooth", "rough"])
@pytest.mark.parametrize("number", [21, 22, 24, 26, 28])
def test_a_scene(number, rough, on_record):
    case = random_case(number, rough=rough)
    scene, tol = case.scene, max(case.tol, 1e-2)
    pitch = 2 * scene.camera.image_pitch

    def computed():
        optics = psf.SceneOptics(scene)
        seen = optics.at()
        calls = [(point_window, seen, pitch, tol), (point_cost, seen, pitch / 3, (50, 60), 1e-5)]
        calls += [(psf.wavefront, scene, {"samples": (8, 16)}), (psf.wall_view, scene)]
        attempts(*calls)
        cost = attempt(point_cost, seen, pitch, (16, 12), tol)
        if not isinstance(cost, Exception) and cost.seconds < 0.1:
            attempts((psf.scene_point_spread, optics, tol, {"pitch": pitch, "shape": (16, 12)}))
        paths, pupil = attempt(pupil_rays, scene, n_rays=200), attempt(lambda: optics.exit_pupil)
        if not isinstance(paths, Exception) and not isinstance(pupil, Exception):
            attempts((psf.wavefront_from_rays, paths, pupil, scene.laser.wavelength))

    on_record(steps(computed, "psf"), NEAR)


WALLS = {
    "gaussian": psf.Roughness(2e-8, 7e-4),
    "exponential": psf.Roughness(7e-8, 4e-4, "exponential"),
    "facets": FacetWall(4e-4, 2e-3, seed=4),
}


@pytest.mark.parametrize("obscuration", [0.0, 0.3])
@pytest.mark.parametrize("wall", WALLS)
def test_a_rough_wall(wall, obscuration, on_record):
    samples = 384 if wall == "facets" else 96
    grid = {"nodes": "grid", "samples": samples, "obscuration": obscuration}
    wave = psf.Wavefront.from_zernike({5: 5e-8}, **SYSTEM, **grid)
    polar = psf.Wavefront.from_zernike({5: 5e-8}, **SYSTEM, obscuration=obscuration)
    view = {"footprint": np.diag([0.5, 0.6]), "cos_sum": 1.8, "pitch": 2e-6}
    sampled = view | {"shape": 18, "seed": 3, "effective_distance": 0.4}
    calls = [
        (psf.sample_point_spread, wave, WALLS[wall], sampled | {"propagation": how})
        for how in ("geometric", "fresnel")
    ]
    calls += [
        (psf.sample_point_spread, polar, WALLS[wall], sampled | {"independent_patterns": 2}),
        (psf.mean_point_spread, polar, WALLS[wall], view | {"tol": 1e-3}),
    ]
    if wall != "facets":
        calls.append((psf.two_scale_point_spread, polar, WALLS[wall], sampled | {"tol": 0.05}))
    on_record(steps(lambda: attempts(*calls), "psf/rough", "psf/walls"), NEAR)


@pytest.mark.parametrize("obscuration", [0.0, 0.4])
def test_a_batch(obscuration, monkeypatch, on_record):
    monkeypatch.setattr(point_spreads, "threads", lambda: 2)  # whatever machine this is
    wave = psf.Wavefront.from_zernike({6: 2e-7}, obscuration=obscuration, **SYSTEM)
    modes = np.stack([psf.zernike(j, wave.u / 4e-3, wave.v / 4e-3) for j in (4, 5, 7)])
    bend = np.tensordot(np.random.default_rng(5).normal(size=(3, 3)) * 3e-7, modes, 1)
    asked = {"pitch": 3e-6, "shape": (12, 17), "tol": 1e-3}
    calls = [
        (psf.point_spreads, wave, one * bend, asked | {"pixel_integrated": whole})
        for one in (0.3, 9.0)
        for whole in (False, True)
    ]
    on_record(steps(lambda: attempts(*calls), "psf/batch", "psf/window"), NEAR)


def test_slopes(on_record):
    rng = np.random.default_rng(2)
    y, x = np.mgrid[:14, :17] - 6.5
    inside = (x**2 + y**2 < 50) & (x**2 + y**2 > 5)
    slopes = 1e-6 * np.stack([x + 0.1 * y**2, 0.3 * y - x]) + 1e-7 * rng.normal(size=(2, 14, 17))
    calls = [(psf.integrated_slopes, slopes, 1e-4, where) for where in (inside, None)]
    options = {"wavelength": 6e-7, "image_distance": 0.1}
    calls += [(psf.wavefront_from_slopes, slopes, 1e-4, inside, options)]
    on_record(steps(lambda: attempts(*calls), "psf/pupil"), NEAR)
