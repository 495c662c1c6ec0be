"""The noise estimate on images whose noise is known."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from nlosoptics.errors import SamplingError, SceneError
from nlosoptics.imaging import ForwardModel, camera_image
from nlosoptics.inverse import Measurement, estimate_noise, tv_deconvolve, wiener
from nlosoptics.inverse.data.noisy_image import noisy_image


@pytest.mark.parametrize("sigma", [1e-3, 7.0])
def test_white_noise_is_found(sigma):
    noise = np.random.default_rng(0).normal(size=(128, 120))
    # stated bias of 2 % and three standard errors of 2/sqrt(pixels)
    assert estimate_noise(5.0 + sigma * noise) == pytest.approx(1.02 * sigma, rel=0.048)


@pytest.mark.parametrize("wall", ["smooth", "speckle"])
def test_the_picture_is_not_taken_for_noise(case, wall):
    data, _ = case("hanzi_zhong", wall)
    # as on white noise
    assert estimate_noise(data.image) == pytest.approx(1.02 * data.noise_sigma, rel=0.048)


def test_noise_that_follows_the_light_is_averaged(case):
    data, model = case("R", "smooth")
    mean = np.maximum(model.forward(data.truth), 0.0) * 1000 + 1
    counts = np.random.default_rng(0).poisson(mean)
    # the light varies within a block: measured 1 to 7 % high
    assert estimate_noise(counts) == pytest.approx(np.sqrt(mean.mean()), rel=0.15)


def test_uniform_and_sparse_images():
    assert estimate_noise(np.full((20, 20), 3.0)) == 0.0
    few = (np.random.default_rng(0).random((128, 128)) < 0.05).astype(float)
    # variance of a rare event is its rate
    assert estimate_noise(few) == pytest.approx(np.sqrt(0.05 * 0.95), rel=0.1)


def test_image_must_hold_a_second_difference():
    with pytest.raises(SamplingError, match="at least 3 x 3"):
        estimate_noise(np.ones((2, 9)))


def test_values_that_are_not_finite_are_refused():
    image = np.zeros((9, 8))
    image[3, 4] = np.nan
    with pytest.raises(SceneError, match="1 of 72 values that are not finite; replace"):
        estimate_noise(image)


def test_a_picture_without_noise_is_not_taken_for_no_light():
    """Rows all alike have second differences of nothing."""
    stripes = np.zeros((24, 24))
    stripes[:, 6:10] = 1.0
    model = ForwardModel(np.ones((1, 1)), shape=stripes.shape)
    with pytest.raises(SceneError, match="estimated noise of the image is 0 .*; give noise_sigma"):
        wiener(stripes, model)
    assert wiener(np.ones((24, 24)), model).status == "too_few_photons"


@pytest.mark.parametrize("image", ["F.png", [[1.0], [2.0, 3.0]], np.ones((9, 9)) + 1j])
def test_what_is_no_image_is_named(image):
    with pytest.raises(SceneError, match="is not an array of real numbers"):
        estimate_noise(image)


def test_a_tensor_that_records_gradients_is_an_image():
    image = np.random.default_rng(0).normal(size=(24, 24))
    assert estimate_noise(torch.tensor(image, requires_grad=True)) == estimate_noise(image)


@pytest.mark.parametrize("factor", [0.8, 1.25, 5.0])
def test_the_image_sets_the_scale_of_a_stated_noise(factor):
    """The statement gives the shape; about 3400 frequencies beyond the optics give the scale."""
    y, x = np.mgrid[-20:21, -20:21]
    kernel = np.exp(-(x * x + y * y) / (2 * 2.5**2))
    model = ForwardModel(kernel / kernel.sum(), shape=(64, 64))
    shape = np.linspace(0.5, 2.0, 64) * np.ones((64, 64))
    image = shape * np.random.default_rng(0).normal(size=(64, 64))
    data, other = (
        noisy_image(Measurement(image, noise_sigma=f * shape), model) for f in (factor, 1.0)
    )
    assert data.sigma == pytest.approx(other.sigma, rel=1e-12)
    np.testing.assert_allclose(data.sigma / np.sqrt(data.weights), shape, rtol=0.04)
    uniform = noisy_image(image, model)
    number = noisy_image(Measurement(image, noise_sigma=factor), model)
    assert number.sigma == pytest.approx(uniform.sigma, rel=1e-12)


def test_detail_of_a_sharp_image_does_not_add_to_a_stated_noise():
    """Without frequencies beyond the optics, second differences are an upper bound."""
    rng = np.random.default_rng(0)
    image = rng.random((32, 32)) + 0.01 * rng.normal(size=(32, 32))
    model = ForwardModel(np.ones((1, 1)), shape=(32, 32))
    assert noisy_image(Measurement(image, noise_sigma=0.01), model).sigma == 0.01
    most = noisy_image(Measurement(image, noise_sigma=10.0), model).sigma
    assert most == pytest.approx(noisy_image(image, model).sigma, rel=1e-12)


@pytest.mark.parametrize("size", [1e308, 1e-305])
def test_values_whose_squares_are_no_floats_are_refused(size, tmp_path):
    image = size * np.random.default_rng(1).random((32, 32))
    model = ForwardModel(np.full((3, 3), 1.0 / 9.0), shape=image.shape)
    limits = "has values up to .*, must be 1e-60 to 1e.60; multiply all of them by a constant"
    np.save(tmp_path / "image.npy", image)
    calls = [
        lambda: estimate_noise(image),
        lambda: tv_deconvolve(image, model),
        lambda: wiener(image, model),
        lambda: camera_image(tmp_path / "image.npy"),
    ]
    for call in calls:  # warnings are errors
        with pytest.raises(SceneError, match=limits):
            call()
