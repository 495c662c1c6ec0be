"""Pictures from shadows: closed forms, a disc over a matt wall, empty scenes, refusals."""

from __future__ import annotations

import functools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from pytest import approx

from nlosoptics import Scene, inverse
from nlosoptics.errors import NlosError
from nlosoptics.imaging import WallTransport
from nlosoptics.inverse.shadows.linear_model import wall_image
from nlosoptics.inverse.shadows.total_variation import least_variation
from nlosoptics.scene import Lambert

PIXELS, CELLS = 24, 14
DISC = np.array([0.05, -0.02, 0.45, 0.09])  # x, y, height and radius, m


@functools.cache
def operator(shift=(0.0, 0.0, 0.0), cells=CELLS, parts=2):
    """Light on a wall of 0.8 m, past a disc, from the cells of a plane of 0.6 m, 1 m away."""
    x, y, z, radius = DISC + np.append(shift, 0.0)
    wall = 0.8 * ((np.arange(PIXELS * 2) + 0.5) / (PIXELS * 2) - 0.5)
    plane = 0.6 * ((np.arange(cells * parts) + 0.5) / (cells * parts) - 0.5)
    across = np.subtract.outer(wall, plane)  # from plane to wall
    at_disc = np.add.outer((1.0 - z) * wall, z * plane)
    inside = np.add.outer(
        (at_disc - y) ** 2, (at_disc - x) ** 2
    )  # wall y, plane y, wall x, plane x
    free = np.clip(0.5 + (np.sqrt(inside) - radius) / 0.012, 0.0, 1.0)
    light = free / (1.0 + np.add.outer(across**2, across**2)) ** 2
    shape = (PIXELS, 2, cells, parts, PIXELS, 2, cells, parts)
    light = light.reshape(shape).mean((1, 5)).mean((2, 5)).transpose(0, 2, 1, 3)
    return light.reshape(PIXELS**2, cells**2) * (CELLS / cells) ** 2


def picture(cells):
    """Bright angle on a black plane."""
    fine = np.zeros((42, 42))
    fine[8:34, 9:15] = fine[8:14, 9:30] = 1.0
    return fine.reshape(cells, 42 // cells, cells, 42 // cells).mean((1, 3))


def wall(electrons=4e4, ambient=0.0, seed=0, shift=(0.0, 0.0, 0.0)):
    """Image of the wall, rendered on finer cells, with photon noise."""
    seen = operator(shift, 21) @ picture(21).ravel()
    scale = electrons / seen.mean()
    slope = 1.0 + 0.2 * np.linspace(-1, 1, PIXELS)[:, None] * np.linspace(-1, 1, PIXELS) ** 2
    expected = scale * seen.reshape(PIXELS, PIXELS) + ambient * electrons * slope
    return np.random.default_rng(seed).poisson(expected).astype(float), scale


def correlation(fit):
    return np.corrcoef(fit.object.ravel(), picture(CELLS).ravel())[0, 1]


def test_steps_shrink_by_the_closed_form():
    """Two plateaus of n cells approach each other by weight/n each; weight TV is the modes."""
    step = np.repeat([0.0, 10.0], 10)[:, None]
    options = {"start": step, "brightest": np.array([np.inf]), "tolerance": 1e-9, "most": 2000}
    fit, changes = least_variation(np.eye(20), step, (1, 20), 9.8, **options)
    assert fit[:, 0] == approx(np.repeat([0.1, 9.9], 10), abs=1e-6)
    assert changes[-1] < 1e-9
    options["brightest"] = np.array([5.0])
    assert least_variation(np.eye(20), step, (1, 20), 5.0, **options)[0].max() == 5.0


@pytest.mark.parametrize(("ambient", "order"), [(0.0, -1), (10.0, 0)])
def test_picture_past_a_disc(ambient, order):
    image, scale = wall(1e5, ambient)
    fit = inverse.shadow_fit(image, scale * operator(), cells=(CELLS, CELLS))
    assert fit.status == "converged", fit.reasons
    assert correlation(fit) > 0.93
    estimates = fit.physical_parameters
    assert estimates["ambient_order"] >= order
    assert estimates["noise_sigma"] == approx(np.sqrt(image.mean()), rel=0.1)
    error = (estimates["resolved_object"] - picture(CELLS)) / estimates["object_error"]
    assert 0.4 < error.std() < 2.0


def test_two_exposures_and_larger_pixels_give_the_same_picture():
    """Colours, summed pixels and a second exposure without the object."""
    image, scale = wall(4e4)
    dark, _ = wall(0.0)
    fine = np.repeat(np.repeat(image, 2, 0), 2, 1) / 4
    options = {"cells": (CELLS, CELLS), "ambient": 0}
    first = inverse.shadow_fit(image, scale * operator(), noise=200.0, **options)
    again = inverse.shadow_fit(
        fine + 7.0,
        scale * operator(),
        noise=100.0,
        reference=dark.repeat(2, 0).repeat(2, 1) + 7.0,
        **options,
    )
    assert again.object == approx(first.object, abs=1e-6)
    colours = inverse.shadow_fit(
        np.stack([image, 0.5 * image], 2), scale * operator(), noise=200.0, **options
    )
    assert colours.object.shape == (CELLS, CELLS, 2)
    assert correlation(inverse.shadow_fit(image, scale * operator(), **options)) > 0.9


@pytest.mark.parametrize("seed", range(3))
def test_nothing_there(seed):
    light = 5e4 * (1.0 + 0.2 * np.linspace(-1, 1, PIXELS))
    image = np.random.default_rng(seed).poisson(np.tile(light, (PIXELS, 1))).astype(float)
    fit = inverse.shadow_fit(image, operator(), cells=(CELLS, CELLS))
    assert fit.status == "too_few_photons"
    assert "no object is detected" in fit.reasons[0]
    assert not fit.object.any()


def test_a_wrong_height_does_not_fit():
    image, scale = wall()
    fit = inverse.shadow_fit(image, scale * operator((0.0, 0.0, 0.1)), cells=(CELLS, CELLS))
    assert fit.status == "does_not_fit"
    assert "check the occluder's place" in fit.reasons[0]


@pytest.mark.parametrize("shift", [(0.2, 0.0, 0.0), (0.15, -0.1, -0.2)])
def test_more_light_is_no_remedy_for_a_wrong_place(shift):
    """The residual lowers the expected correlation; a hundred times the light does not raise it."""
    for electrons in (4e3, 4e5):
        image, scale = wall(electrons, 3.0)
        fit = inverse.shadow_fit(image, scale * operator(shift), cells=(CELLS, CELLS))
        assert fit.physical_parameters["expected_correlation"] < 0.8
        assert fit.status == "does_not_fit"


def test_more_light_is_the_remedy_for_few_photons():
    """The object is smoother than its linear estimate then, which is no contradiction."""
    for seed in (0, 1, 7):
        image, scale = wall(60.0, 3.0, seed=seed)
        fit = inverse.shadow_fit(image, scale * operator(), cells=(CELLS, CELLS))
        assert fit.physical_parameters["disagreement"] > 0.3
        assert fit.status == "too_few_photons", fit.reasons


def test_other_structure_than_shadows_does_not_fit():
    """A pattern of 2 %, such as wallpaper, ten times the noise: no object is detected."""
    wave = np.linspace(-6.0, 6.0, PIXELS)
    expected = 1e6 * (1.0 + 0.02 * np.outer(np.cos(wave), np.sin(wave)))
    image = np.random.default_rng(0).poisson(expected).astype(float)
    fit = inverse.shadow_fit(image, operator(), cells=(CELLS, CELLS))
    assert not fit.object.any()
    assert fit.status == "does_not_fit"
    assert fit.physical_parameters["misfit"] == approx(1.0)
    # white noise that is a third stronger than stated is no contradiction
    noise = np.random.default_rng(1).normal(1e6, 1e3, image.shape)
    fit = inverse.shadow_fit(noise, operator(), cells=(CELLS, CELLS), noise=750.0)
    assert fit.status == "too_few_photons"


def test_a_uniform_object_is_right():
    """Its estimate varies by noise alone, which is no contradiction, however little that is."""
    light = operator(cells=42, parts=1).sum(1)
    for seed in range(4, 8):
        image = np.random.default_rng(seed).poisson(4e3 * light / light.mean())
        bright = 4e3 / light.mean() * operator()
        fit = inverse.shadow_fit(image.reshape(PIXELS, PIXELS), bright, cells=(CELLS, CELLS))
        assert abs(fit.object - 1.0).max() < 0.1
        assert fit.status == "converged", fit.reasons


def test_light_that_only_a_negative_object_explains():
    """The object that is nowhere negative is 0, and the search for it ends."""
    light = (operator() @ np.ones(CELLS**2)).reshape(PIXELS, PIXELS)
    image = np.random.default_rng(0).poisson(1e5 * (1.0 - 0.1 * light / light.max()))
    fit = inverse.shadow_fit(image, operator(), cells=(CELLS, CELLS), ambient=0)
    assert not fit.object.any()
    assert len(fit.history["change"]) < 1000
    assert fit.status == "does_not_fit"


@pytest.mark.thorough
def test_height_of_a_disc():
    """A shift along the wall moves the object as well; the height stands out.

    The coarse operator errs by 1 cm, and the finer one decides.
    """
    image, scale = wall(2e4)
    shares = []
    fit = inverse.occluder_fit(
        image,
        lambda height: scale * operator((0.0, 0.0, 0.01 + float(height[0]))),
        finer=lambda height: scale * operator((0.0, 0.0, float(height[0]))),
        start=[0.04],
        reach=0.04,
        cells=(CELLS, CELLS),
        progress=lambda text, share: shares.append(share),
    )
    estimates = fit.physical_parameters
    assert len(shares) == estimates["evaluations"]
    assert shares == sorted(shares)
    assert 0.0 < shares[-1] <= 1.0
    assert abs(estimates["place"][0]) < 0.004
    assert abs(estimates["place"][0]) < 5.0 * estimates["place_covariance"][0, 0] ** 0.5 + 0.002
    assert correlation(fit) > 0.9


def test_profile_past_an_edge():
    """A half-plane shows the profile along the angle about its edge, as in a corner camera."""
    base = Scene.load(Path(__file__).parents[2] / "examples" / "scenes" / "letter_flat.toml")
    edge = trimesh.creation.box((1.0, 3.0, 1e-3)).apply_translation((0.77, 0.0, 0.5))
    scene = replace(base.resized(32), wall_material=Lambert(0.8), occluders=(edge,))
    walls = [WallTransport(scene, cells=(1, n), source="luminous", exposure=1.0) for n in (36, 12)]
    profile = np.zeros((1, 36))
    profile[0, 9:18], profile[0, 24:30] = 1.0, 0.5
    light = walls[0].forward(profile)
    light *= 1e5 / light.max()
    dark = light == 0.0  # behind the field stop
    image = np.where(dark, np.nan, np.random.default_rng(0).poisson(light + 1e4))
    fit = inverse.shadow_fit(image, walls[1])
    assert fit.status == "converged", fit.reasons
    assert np.corrcoef(fit.object[0], profile.reshape(12, 3).mean(1))[0, 1] > 0.97


IMAGE = np.ones((24, 24))
TABLE = {
    "cells": ({"cells": (3, 3)}, "for (3, 3) cells, must be (pixels, rows * columns)"),
    "operator": ({"operator": np.full((576, 196), np.nan)}, "operator has values that are not"),
    "rows": ({"operator": np.ones((575, 196))}, "operator has 575 rows and image the shape"),
    "noise": ({"noise": 0.0}, "noise is not above 0 in all pixels; state"),
    "negative": ({"noise": -1.0}, "noise is not above 0 in all pixels; state"),
    "nothing": ({"image": np.full((24, 24), np.nan)}, "image has 0 pixels among finite ones"),
    "size": ({"cells": 3}, "cells = 3 is not (rows, columns); give two integers"),
    "reference": ({"reference": np.ones((3, 4))}, "reference has shape (3, 4); give numbers"),
    "ambient": ({"noise": 1.0, "ambient": 13}, "ambient = 13 is out of range"),
    "brightest": ({"noise": 1.0, "brightest": -1.0}, "brightest = -1 is out of range"),
    "pixels": ({"image": np.full((24, 24), np.nan), "noise": 1.0}, "image has 0 pixels"),
}


@pytest.mark.parametrize(("options", "message"), TABLE.values(), ids=TABLE.keys())
def test_refusals(options, message):
    options = {"image": IMAGE, "operator": operator(), "cells": (CELLS, CELLS)} | options
    with pytest.raises(NlosError) as refused:
        inverse.shadow_fit(**options)
    assert message in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("call", "start", "message"),
    [(3, 0.0, "operator_at = 3 cannot be called"), (operator, "x", "start of type str is not an")],
)
def test_a_search_needs_a_function_and_numbers(call, start, message):
    with pytest.raises(NlosError, match=message):
        inverse.occluder_fit(IMAGE, call, start=start, cells=(CELLS, CELLS))


def test_an_operator_that_ambient_light_explains_shows_no_object():
    """All cells light the wall evenly, as the room does."""
    fit = inverse.shadow_fit(IMAGE, np.ones((576, 9)), cells=(3, 3), noise=1.0)
    assert fit.status == "too_few_photons"
    assert not fit.object.any()


def test_estimated_noise_has_no_bias():
    """The mean over 60 images has a standard error of 0.8 %."""
    images = np.random.default_rng(0).poisson(1e4, (60, 64, 64)).astype(float)
    variances = [float(wall_image(image, (64, 64)).sigma[0] ** 2) for image in images]
    assert np.mean(variances) == approx(1e4, rel=0.03)
