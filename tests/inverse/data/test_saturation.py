"""Saturated pixels are found and censored; bright, even objects and equal values are not."""

from __future__ import annotations

import re

import numpy as np
import pytest
import torch

from nlosoptics import inverse
from nlosoptics.errors import SceneError
from nlosoptics.imaging import ForwardModel
from nlosoptics.inverse import Measurement, estimate_noise, registered_correlation, tv_deconvolve
from nlosoptics.inverse.data.noisy_image import noisy_image

SIDE, NOISE, LEVEL = 48, 0.01, 0.5


def taken(*, flat=False, seed=0):
    """Object, model and image without noise, its largest value 1: a pyramid, or an even square."""
    y, x = np.abs(np.mgrid[:SIDE, :SIDE] - SIDE // 2 + 0.5)
    truth = np.where(np.maximum(y, x) < 10, 1.0 if flat else 1.2 - np.maximum(y, x) / 10, 0.0)
    axis = np.arange(15.0) - 7.0
    kernel = np.exp(-(axis**2 + axis[:, None] ** 2) / (2 * 1.5**2))
    model = ForwardModel(kernel / kernel.sum(), shape=truth.shape)
    clean = np.maximum(model.forward(truth), 0.0)  # without rounding errors
    noise = np.random.default_rng(seed).normal(0.0, NOISE, truth.shape)
    return truth, model, clean / clean.max(), noise


@pytest.mark.parametrize("kind", ["float", "counts", "tensor", "background"])
def test_clipped_pixels_are_at_least_as_bright(kind):
    truth, model, clean, noise = taken()
    image = np.minimum(clean + noise, LEVEL)
    given = Measurement(image, background=0.1 if kind == "background" else 0.0)
    if kind == "counts":
        given = Measurement(np.round(200.0 * image))
    if kind == "tensor":
        given = Measurement(torch.from_numpy(image.astype(np.float32)))
    found = tv_deconvolve(given, model)
    told = found.physical_parameters
    full = clean + noise >= LEVEL - (0.0026 if kind == "counts" else 0.0)
    assert told["saturated_pixels"] == full.sum() == told["bad_pixels"]
    assert np.array_equal(told["bad_pixel_map"], full)
    assert registered_correlation(found, truth) > 0.95
    masked = tv_deconvolve(Measurement(clean + noise, masked=full), model)
    assert registered_correlation(found, truth) > registered_correlation(masked, truth) - 0.002


@pytest.mark.parametrize("name", ["wiener", "richardson_lucy", "inverse_filter"])
def test_other_solvers_ignore_clipped_pixels(name):
    _, model, clean, noise = taken()
    image = np.minimum(clean + noise, LEVEL)
    told = getattr(inverse, name)(image, model).physical_parameters
    assert told["saturated_pixels"] == (image == LEVEL).sum()


def test_noise_is_that_of_the_other_pixels():
    _, model, clean, noise = taken()
    image = np.minimum(clean + noise, 0.2)
    assert (image == 0.2).mean() > 0.15
    assert estimate_noise(image, model) == pytest.approx(NOISE, rel=0.07)


def test_ignored_pixels_are_no_plateau():
    _, model, clean, noise = taken()
    image = np.minimum(clean + noise, LEVEL)
    full = image == LEVEL
    ignored = Measurement(image, noise_sigma=np.where(full, np.inf, NOISE))
    for given in (Measurement(image, masked=full), ignored):
        assert "saturated_pixels" not in tv_deconvolve(given, model).physical_parameters


def test_equal_values_without_clipping():
    """Images of few counts, with few levels, or with repeated pixels."""
    _, model, clean, noise = taken(flat=True)
    rng = np.random.default_rng(1)
    images = [np.round(20 * (clean + noise))]
    images += [rng.poisson(mean * clean).astype(float) for mean in (0.3, 3.0, 30.0, 300.0)]
    images += [(rng.random(clean.shape) < 0.4).astype(float), rng.integers(0, 3, clean.shape) + 0.0]
    images += [np.kron((clean + noise)[::2, ::2], np.ones((2, 2)))]
    for image in images:
        assert (
            noisy_image(Measurement(image, noise_sigma=0.01 * np.ptp(image)), model).least is None
        )
    clipped = np.minimum(clean + noise, LEVEL)
    assert noisy_image(clipped, model).least is not None
    assert noisy_image(np.round(200.0 * clipped), model).least is not None


def test_hot_pixels_of_one_value_are_not_saturated_by_light():
    truth, model, clean, noise = taken()
    hot = np.random.default_rng(2).random(clean.shape) < 0.01
    image = np.where(hot, 1.5, clean + noise)
    found = tv_deconvolve(image, model)
    assert "saturated_pixels" not in found.physical_parameters
    assert np.array_equal(found.physical_parameters["bad_pixel_map"], hot)
    assert registered_correlation(found, truth) > 0.98


def full_well(clean, noise, seed=0):
    """Image and mask of a full well at half the range, read out with a third of the noise."""
    full = clean + noise >= LEVEL
    readout = np.random.default_rng(seed + 90).normal(0.0, noise.std() / 3.0, clean.shape)
    return np.minimum(clean + noise, LEVEL) + readout, full


@pytest.mark.thorough
@pytest.mark.parametrize("sigma", [0.03, 0.06])
def test_stated_full_pixels_are_better_than_search_and_mask(sigma):
    gains = []
    for seed in (2, 3):
        truth, model, clean, noise = taken(seed=seed)
        image, full = full_well(clean, noise * (sigma / NOISE), seed)
        kinds = [{}, {"masked": full}, {"saturated": full}]
        found = [tv_deconvolve(Measurement(image, **kind), model) for kind in kinds]
        told = [one.physical_parameters.get("saturated_pixels") for one in found]
        assert told == [None, None, full.sum()]
        *others, stated = (registered_correlation(one, truth) for one in found)
        gains.append([stated - other for other in others])
    # measured gains are 0.003 to 0.013
    assert np.min(np.mean(gains, axis=0)) > 0.002, gains


@pytest.mark.parametrize("name", ["wiener", "richardson_lucy", "inverse_filter"])
def test_other_solvers_ignore_stated_full_pixels(name):
    _, model, clean, noise = taken()
    image, full = full_well(clean, noise)
    solver = getattr(inverse, name)
    stated = solver(Measurement(image, noise_sigma=NOISE, saturated=full), model)
    masked = solver(Measurement(image, noise_sigma=NOISE, masked=full), model)
    assert np.array_equal(stated.object, masked.object)


def test_stated_masks_end_the_search():
    _, model, clean, noise = taken()
    clipped = np.minimum(clean + noise, LEVEL)
    none = np.zeros(clipped.shape, dtype=bool)
    assert noisy_image(clipped, model).saturated is not None
    assert noisy_image(Measurement(clipped, saturated=none), model).saturated is None


def test_stated_full_pixels_that_are_hot_are_no_lower_limits():
    _, model, clean, noise = taken()
    image, full = clean + noise, np.zeros(clean.shape, dtype=bool)
    full[3, 5] = full[40, 40] = full[24, 24] = True
    image[3, 5] = image[40, 40] = 1.5  # hot
    data = noisy_image(Measurement(image, masked=full, saturated=full), model)
    assert np.argwhere(data.saturated).tolist() == [[24, 24]]
    assert np.array_equal(data.weights == 0.0, full)
    noise = np.where(full, 1.0, np.inf)
    for more in ({"masked": ~full}, {"noise_sigma": noise}):
        with pytest.raises(SceneError, match="every pixel is masked, saturated or of infinite"):
            noisy_image(Measurement(clean, saturated=full, **more), model)


def test_an_object_in_saturated_pixels_alone_is_a_doubt():
    _, model, clean, noise = taken()
    image, full = np.where(clean > 0.2, 1.0, 0.0) + 10.0 * noise, clean > 0.2
    found = tv_deconvolve(Measurement(image, noise_sigma=10.0 * NOISE, saturated=full), model)
    assert found.object.any()
    assert found.status == "does_not_fit"
    assert re.search(r"only the \d+ saturated pixels show an object; expose shorter", str(found))
