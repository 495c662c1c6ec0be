"""Dead and hot pixels are found and ignored; sharp objects and noise are not taken for them."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from nlosoptics import inverse
from nlosoptics.imaging import ForwardModel
from nlosoptics.inverse import Measurement, estimate_noise, registered_correlation, tv_deconvolve
from nlosoptics.inverse.data.models import passed_power
from nlosoptics.inverse.data.outliers import lone_pixels, noise_of_neighbours, predicted

SIDE, NOISE = 64, 0.01


def blurred(width, *, seed=0, side=SIDE, truth=None):
    """Object, model of a Gaussian blur, and noisy image of a letter."""
    if truth is None:
        truth = np.zeros((side, side))
        truth[side // 4 : 3 * side // 4, side // 4 : side // 3] = 1.0
        truth[side // 4 : side // 3, side // 4 : 3 * side // 4] = 1.0
    axis = np.arange(31.0) - 15.0
    kernel = np.exp(-(axis**2 + axis[:, None] ** 2) / (2 * width**2))
    model = ForwardModel(kernel / kernel.sum(), shape=(side, side))
    image = model.forward(truth) + np.random.default_rng(seed).normal(0.0, NOISE, (side, side))
    return truth, model, image


def spoilt(image, share, value, seed=1):
    """Return the image with dead pixels, and their mask."""
    dead = np.random.default_rng(seed).random(image.shape) < share
    return np.where(dead, value, image), dead


@pytest.mark.parametrize("noise", [None, NOISE, np.full((SIDE, SIDE), NOISE)], ids=["", "1", "map"])
@pytest.mark.parametrize("as_tensor", [False, True])
def test_dead_pixels_are_ignored(noise, as_tensor):
    truth, model, image = blurred(1.5)
    image, dead = spoilt(image, 0.01, 1.5)
    given = torch.from_numpy(image) if as_tensor else image
    found = tv_deconvolve(Measurement(given, noise_sigma=noise), model)
    told = found.physical_parameters
    assert told["bad_pixels"] == told["bad_pixel_map"].sum()
    assert np.array_equal(told["bad_pixel_map"], dead)
    assert found.status == "converged"
    assert registered_correlation(found, truth) > 0.98


@pytest.mark.parametrize("name", ["wiener", "richardson_lucy", "inverse_filter"])
def test_other_solvers_ignore_them_too(name):
    truth, model, image = blurred(1.5)
    solver = getattr(inverse, name)
    image, dead = spoilt(image, 0.01, 1.5)
    found = solver(image, model)
    assert found.physical_parameters["bad_pixels"] == dead.sum()
    assert registered_correlation(found, truth) > 0.9


@pytest.mark.parametrize("value", [0.0, 1.5])
def test_noise_is_that_of_the_others(value):
    _, model, image = blurred(1.5)
    image, _ = spoilt(image, 0.03, value)
    assert estimate_noise(image, model) == pytest.approx(NOISE, rel=0.05)


@pytest.mark.parametrize("pair", [[(30, 17), (30, 18)], [(0, 20), (0, 21)], [(63, 0), (62, 1)]])
def test_neighbours_and_edges(pair):
    """Of two bad neighbours each hides the other; at edges the frame's jumps do."""
    _, model, image = blurred(1.5)
    rows, columns = zip(*pair, strict=True)
    image[rows, columns] = 1.5
    bad, filled = lone_pixels(image, passed_power(model), NOISE)
    assert sorted(zip(*np.nonzero(bad), strict=True)) == sorted(pair)
    assert np.abs(filled[rows, columns] - blurred(1.5)[2][rows, columns]).max() < 0.1


@pytest.mark.parametrize("height", [0.5, 5.0])
def test_hot_pixels_are_found_with_the_sharpest_optics(height):
    """As for an unknown wall: the image is blurred more than the given optics would."""
    image, sharpest = blurred(2.5)[2], blurred(0.8)[1]
    hot = np.random.default_rng(3).choice(image.size, 10, replace=False)
    passed = passed_power(sharpest)
    assert not lone_pixels(image, passed, noise_of_neighbours(image))[0].any()
    image.flat[hot] += height
    bad, _ = lone_pixels(image, passed, noise_of_neighbours(image))
    assert sorted(np.flatnonzero(bad)) == sorted(hot)


@pytest.mark.parametrize("width", [0.3, 0.6, 0.8, 1.5, 4.0])
@pytest.mark.parametrize("seed", range(3))
def test_points_of_an_object_are_not_bad(width, seed):
    """Stars behind a narrow blur are lone pixels too."""
    rng = np.random.default_rng(seed)
    truth = np.where(rng.random((SIDE, SIDE)) < 0.01, rng.uniform(0.3, 1.0, (SIDE, SIDE)), 0.0)
    truth *= 2 * np.pi * max(width, 0.4) ** 2  # as bright in the image for each blur
    _, model, image = blurred(width, seed=seed, truth=truth)
    assert not lone_pixels(image, passed_power(model), NOISE)[0].any()
    assert "bad_pixels" not in tv_deconvolve(image, model).physical_parameters


@pytest.mark.parametrize("side", [3, 7, 8, 200])
def test_good_images_have_none(side):
    _, model, image = blurred(1.0, side=side)
    assert not lone_pixels(image, passed_power(model), NOISE)[0].any()


def test_the_stated_noise_of_a_pixel_counts():
    """A pixel whose noise is stated to be large is not bad, and stays in the fit."""
    _, model, image = blurred(1.5)
    image[30, 17] += 0.5
    noise = np.full(image.shape, NOISE)
    assert (
        tv_deconvolve(Measurement(image, noise_sigma=noise), model).physical_parameters[
            "bad_pixels"
        ]
        == 1
    )
    noise[30, 17] = 0.2
    assert (
        "bad_pixels"
        not in tv_deconvolve(Measurement(image, noise_sigma=noise), model).physical_parameters
    )


def test_an_image_whose_squares_underflow_is_left_as_it_is():
    faint = 1e-170 * np.random.default_rng(0).random((8, 8))
    bad = np.eye(8, dtype=bool)
    assert np.array_equal(predicted(faint, bad, np.fft.rfft2(faint), np.ones((8, 5))), faint)
