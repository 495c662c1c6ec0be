"""All that leads to captures and their pictures, on record: what every function returns."""

import warnings

import numpy as np
import pytest
import trimesh

from nlosoptics.errors import ValidityWarning
from nlosoptics.scene import Lambert, SpecularMicrofacet, SumMaterial
from nlosoptics.transient import (
    Detector,
    TransientCapture,
    Volume,
    backprojection,
    depth_error,
    depth_map,
    distance_weighted,
    downsampled,
    fk_migration,
    gated,
    lct,
    phasor_image,
    render,
    render_scene,
    smoothed,
    wall_grid,
    without_outer_legs,
)

from ..records import attempt
from ..runs.random_scenes import random_case
from ..steps import NEAR, steps

VOLUME = Volume.before(0.9, 6, np.linspace(0.4, 0.9, 5))
GLOSS = SumMaterial(Lambert(0.4), SpecularMicrofacet(0.2, 0.15))


@pytest.fixture(autouse=True)
def quiet():
    """The sampling is meant to be coarse."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ValidityWarning)
        yield


def capture(pairing, count, **changes):
    wall = wall_grid(1.0, count)
    lasers = wall if pairing == "confocal" else np.array([[0.1, -0.05, 0.0], [-0.2, 0.1, 0.0]])
    shape = (count, count) if pairing == "confocal" else (2, count, count)
    light = np.random.default_rng(1).random((70, *shape))
    given = {"laser_points": lasers, "sensor_points": wall, "delta_t": 0.03, "t_start": 0.3}
    return TransientCapture(H=light, pairing=pairing, **given | changes)


@pytest.mark.parametrize("count", [7, 8])
@pytest.mark.parametrize("pairing", ["confocal", "all"])
def test_pictures(pairing, count, on_record):
    light = capture(pairing, count)
    cameras = ("confocal_time_gated", "transient", "photo", "steady_state")
    options = [{"camera": one, "wl_mean": 0.25} for one in cameras]
    options += [{"wl_mean": 0.21, "method": one} for one in ("paths", "planes", "fft", "direct")]
    options += [{"wl_mean": 0.21, "laser": 0}, {"wl_mean": 0.4, "wl_sigma": 0.3, "tol": 1e-4}]

    def made():
        for one in options:
            attempt(phasor_image, light, VOLUME, **one)
        for one in (fk_migration, lct, backprojection):
            attempt(one, light)
            attempt(one, light, VOLUME)
        attempt(lct, light, penalty="curvature", snr=3.0)
        image = backprojection(light, VOLUME)
        found = depth_map(image), depth_map(image, threshold=0.3, interpolate=False)
        attempt(depth_error, *found, min_coverage=0.1)

    on_record(steps(made, "transient/imaging", "transient/capture"), NEAR)


@pytest.mark.parametrize("pairing", ["confocal", "all"])
def test_steps_of_a_capture(pairing, tmp_path, on_record):
    origins = {"laser_origin": (0.0, 0.5, 1.0), "sensor_origin": (0.2, 0.5, 1.0)}
    light = capture(pairing, 6, **origins, outer_legs=True)
    detectors = [
        Detector(photons=1e4, efficiency=0.3, jitter=0.04, dark_counts=3.0),
        Detector(photons=2e3, jitter=0.02, gate=(0.5, 1.5), tail=0.2, tail_share=0.3),
    ]

    def made():
        calls = [
            (gated, {"start": 0.7, "stop": 1.9}),
            (downsampled, {"bins": 3, "grid": 2}),
            (smoothed, {"path": 0.2, "grid": 0.3}),
            (distance_weighted, {"power": 2.0}),
            (without_outer_legs, {}),
        ]
        for call, given in calls:
            attempt(call, light, **given)
        for one in detectors:
            attempt(one.expected, light)
            attempt(one.measure, light, seed=2)
        light.save(tmp_path / "light.hdf5")
        attempt(TransientCapture.load, tmp_path / "light.hdf5")

    on_record(steps(made, "transient/capture"), NEAR)


@pytest.mark.parametrize("number", range(2))
def test_renderings(number, on_record):
    box = trimesh.creation.box((0.4, 0.3, 0.2))
    box.apply_transform(trimesh.transformations.rotation_matrix(0.5, (1, 2, 0.5)))
    box.apply_translation((0.1, 0.0, 0.9))
    ball = trimesh.creation.icosphere(0, 0.2)
    ball.apply_translation((0.1, 0.0, 0.6))
    points = np.array([[-0.5, 0.4, 0.0], [0.3, -0.2, 0.0], [0.0, 0.1, 0.0]])
    bins = {"t_start": 1.0, "delta_t": 0.05, "n_bins": 60, "tol": 0.3}
    surfaces = [(box, GLOSS if number else Lambert(0.8)), (ball, Lambert(0.6))]

    def made():
        whole = {"laser_points": points[2], "sensor_points": points}
        attempt(render, surfaces, **whole, **bins, max_bounces=3)
        if number == 0:
            attempt(render, surfaces[:1], **whole, **bins, min_bounces=1, max_bounces=4, seed=2)
        paired = {"laser_points": points, "sensor_points": points, "pairing": "confocal"}
        attempt(render, surfaces[:1], **paired, **bins, max_bounces=3, wall_albedo=0.5)
        scene = random_case(3 * number + 1).scene
        attempt(render_scene, scene, **whole, **bins, max_bounces=3)

    on_record(steps(made, "transient/rendering"), NEAR)
