"""The noise estimate on images whose noise is known."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from nlosoptics.errors import SamplingError, SceneError
from nlosoptics.imaging import ForwardModel
from nlosoptics.inverse import estimate_noise, wiener


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
