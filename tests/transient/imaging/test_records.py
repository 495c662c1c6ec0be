"""Volumes reconstructed from random captures by every method and option, on record."""

import itertools
import warnings
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from nlosoptics.errors import ValidityWarning
from nlosoptics.transient import (
    TransientCapture,
    Volume,
    VolumeImage,
    backprojection,
    depth_error,
    depth_map,
    fk_migration,
    lct,
    phasor_image,
    true_depths,
    voxelised,
    wall_grid,
)

from ...records import attempt

WALL = wall_grid(1.0, 8)
VOLUME = Volume.before(0.9, 6, np.linspace(0.4, 0.9, 5))


def capture(pairing, count=90):
    paired = pairing == "confocal"
    lasers = WALL if paired else np.array([[0.1, -0.05, 0.0], [-0.2, 0.1, 0.0]])
    shape = (8, 8) if paired else (2, 8, 8)
    light = np.random.default_rng(1).random((count, *shape))
    given = {"laser_points": lasers, "sensor_points": WALL, "delta_t": 0.03, "t_start": 0.3}
    return TransientCapture(H=light, **given, pairing=pairing)


@pytest.fixture(autouse=True)
def quiet():
    """The sampling is meant to be coarse."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ValidityWarning)
        yield


def seen(found):
    """What no clock has measured."""
    if not isinstance(found, VolumeImage):
        return found
    values = [found.intensity, found.volume, found.method, dict(found.details)]
    return [*values, getattr(found, "field", None), getattr(found, "notes", None)]


FILTERS = ("none", "second_derivative", "laplacian")
FALLOFFS = ("none", "matched", "diffuse", "retroreflective")


@pytest.mark.parametrize("pairing", ["confocal", "all"])
@pytest.mark.parametrize(("filter_", "falloff"), [*itertools.product(FILTERS, FALLOFFS)])
def test_backprojection(filter_, falloff, pairing, on_record):
    told = []
    asked = {"filter": filter_, "falloff": falloff, "progress": lambda *step: told.append(step)}
    if filter_ == "second_derivative":
        asked["width"] = 0.1
    volume = VOLUME if falloff == "none" else None
    on_record([seen(attempt(backprojection, capture(pairing), volume, **asked)), told])


@pytest.mark.parametrize("target", ["diffuse", "retroreflective"])
@pytest.mark.parametrize("volume", [None, VOLUME], ids=["own", "given"])
def test_confocal_transforms(target, volume, on_record):
    light, told = capture("confocal"), []
    double = {"dtype": "float64", "progress": lambda *step: told.append(step)}
    on_record(
        [
            seen(attempt(fk_migration, light, volume, target=target, **double)),
            seen(attempt(fk_migration, light, volume, target=target, amplitude="light", **double)),
            seen(attempt(lct, light, volume, target=target, **double)),
            seen(
                attempt(lct, light, volume, target=target, penalty="curvature", snr=3.0, **double)
            ),
            told,
        ]
    )


CAMERAS = ("confocal_time_gated", "transient", "photo", "steady_state", "confocal_at_time")
METHODS = ("auto", "paths", "planes", "fft", "sum", "direct")


@pytest.mark.parametrize("pairing", ["confocal", "all"])
@pytest.mark.parametrize("camera", CAMERAS)
def test_phasor_images(camera, pairing, on_record):
    told = []
    asked = {"camera": camera, "wl_mean": 0.2, "tol": 1e-2}
    asked["progress"] = lambda *step: told.append(step)
    timed = asked | {"times": [0.0, 0.2]}
    focused = asked | {"projector_focus": (0.0, 0.1, 0.7), "aperture": 0.5}
    calls = [asked, timed, focused, asked | {"laser": (0,), "wl_sigma": 0.3}]
    calls += [asked | {"method": method} for method in METHODS]
    light = capture(pairing)
    on_record([[seen(attempt(phasor_image, light, VOLUME, **one)) for one in calls], told])


def test_a_dark_capture(on_record):
    dark = replace(capture("confocal"), H=np.zeros((90, 8, 8)))
    calls = (fk_migration, lct, backprojection)
    found = [seen(attempt(one, dark, VOLUME)) for one in calls]
    on_record([found, seen(attempt(phasor_image, dark, VOLUME, wl_mean=0.2))])


def test_depths(on_record):
    image = backprojection(capture("confocal"), VOLUME)
    ball = trimesh.creation.icosphere(2, 0.2)
    ball.apply_translation((0.05, 0.0, 0.65))
    truth = true_depths(ball, VOLUME)
    found = [depth_map(image), depth_map(image, threshold=0.3, interpolate=False)]
    errors = [attempt(depth_error, one, truth, min_coverage=0.1) for one in (image, *found)]
    solid = attempt(voxelised, ball, VOLUME)
    on_record([truth, found, errors, solid, image.projection("x"), image.peak_depth()])
