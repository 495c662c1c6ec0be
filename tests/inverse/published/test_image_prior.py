"""The deep image prior: quality on a known wall, stop, seeds, statuses, one-line errors."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from nlosoptics import inverse
from nlosoptics.errors import SamplingError, SceneError
from nlosoptics.imaging import ForwardModel
from nlosoptics.inverse import Measurement
from nlosoptics.inverse.data.noisy_image import noisy_image
from nlosoptics.inverse.data.scaled_images import ScaledImage


@pytest.fixture(scope="module")
def small():
    rng = np.random.default_rng(0)
    truth = np.zeros((32, 40))
    truth[8:20, 12:26] = 1.0
    truth[11:16, 16:22] = 0.3
    model = ForwardModel(np.full((5, 5), 0.04), shape=truth.shape)
    return model.forward(truth) + 0.02 * rng.normal(size=truth.shape), model, truth


@pytest.mark.thorough
def test_letter_by_an_unknown_scene_is_recovered(case):
    """5 % noise, a wall of half a wave: better than the answer that it starts from."""
    data, model = case("F", "smooth", 0, 0.05)
    found = inverse.deep_image_prior(
        inverse.Measurement(data.image, noise_sigma=data.noise_sigma), model
    )
    start = inverse.tv_deconvolve(
        inverse.Measurement(data.image, noise_sigma=data.noise_sigma), model
    )
    correlation = inverse.registered_correlation(found, data.truth)
    # the benchmark's walls span 0.98 to 0.99
    assert correlation > 0.98
    assert correlation > inverse.registered_correlation(start, data.truth) - 0.005
    assert found.status == "converged"


@pytest.mark.parametrize("guide", ["tv", "wiener", "noise"])
def test_small_picture_is_recovered_from_any_guide(small, guide):
    image, model, truth = small
    found = inverse.deep_image_prior(
        inverse.Measurement(image, noise_sigma=0.02), model, guide=guide, depth=2, tolerance=0.2
    )
    assert found.status == "converged"
    # 0.897 before; networks come to 0.97 to 0.98 in 200 steps
    assert inverse.registered_correlation(found, truth) > 0.965
    assert found.physical_parameters["gain"] == pytest.approx(1.0, abs=0.2)
    # a sigmoid reaches 0 nowhere, and the background pays for what it leaves; 0.02 to 0.045
    assert abs(found.physical_parameters["background"]) < 0.06


def test_guide_share_mixes_network_and_guide(small):
    """Levels, in image units: all of the guide is total variation's answer, a half the mean."""
    image, model, _ = small
    levels = []
    for share in (0.0, 0.5, 1.0):
        found = inverse.deep_image_prior(
            inverse.Measurement(image, noise_sigma=0.02),
            model,
            guide_share=share,
            depth=2,
            max_iterations=5,
        )
        levels.append(found.object * found.physical_parameters["gain"])
    guide = inverse.tv_deconvolve(inverse.Measurement(image, noise_sigma=0.02), model)
    # arithmetic in double precision
    known = guide.object * guide.physical_parameters["gain"]
    np.testing.assert_allclose(levels[2], known, atol=1e-12)
    np.testing.assert_allclose(levels[1], 0.5 * (levels[0] + known), atol=1e-12)
    assert abs(levels[0] - known).max() > 0.1


def test_array_gives_array_and_tensor_gives_tensor(small):
    image, model, _ = small
    found = inverse.deep_image_prior(
        inverse.Measurement(image, noise_sigma=0.02), model, max_iterations=5
    )
    assert isinstance(found.object, np.ndarray)
    assert found.object.max() == 1.0
    twin = inverse.TorchForwardModel.from_numpy(model)
    tensor = inverse.deep_image_prior(
        inverse.Measurement(torch.from_numpy(image), noise_sigma=0.02), twin, max_iterations=5
    )
    assert tensor.object.dtype == torch.float64
    # five steps of a network in single precision, a transfer function likewise
    np.testing.assert_allclose(tensor.object.numpy(), found.object, atol=1e-2)


def test_seed_decides_every_bit(small):
    image, model, _ = small
    image, options = (
        inverse.Measurement(image, noise_sigma=0.02),
        {"max_iterations": 8, "guide": "noise"},
    )
    first, again, other = (
        inverse.deep_image_prior(image, model, seed=seed, **options).object.tobytes()
        for seed in (1, 1, 2)
    )
    assert first == again
    assert first != other


def test_fit_stops_where_the_noise_is(small):
    """Noise said to be larger is reached sooner, and no part of it is fitted."""
    image, model, _ = small
    calls = []
    found = inverse.deep_image_prior(
        inverse.Measurement(image, noise_sigma=0.04),
        model,
        tv_weight=0.0,
        progress=lambda *call: calls.append(call),
    )
    residuals = found.history["residual"]
    # 1280 pixels, outlines take up 144
    target = np.sqrt(1 - 144 / 1280)
    assert residuals.size < 200
    assert residuals[-1] <= target
    assert (residuals[:-1] > target).all()
    assert calls[-1][1] == 1.0
    assert found.physical_parameters["iterations"] == residuals.size


def test_too_few_steps_are_unconverged(small):
    image, model, _ = small
    assert inverse.deep_image_prior(image, model, max_iterations=2).status == "unconverged"


def test_veil_of_known_shape_is_taken_out(small):
    image, model, truth = small
    veil = np.linspace(0.2, 1.8, image.shape[1]) * np.ones(image.shape)
    found = inverse.deep_image_prior(
        inverse.Measurement(image + 3.0 * veil, noise_sigma=0.02, background_shape=veil), model
    )
    # the object's faint edges share some of it
    assert found.physical_parameters["background"] == pytest.approx(3.0, abs=0.03)
    assert inverse.registered_correlation(found, truth) > 0.965


def test_pixels_of_more_noise_count_less(small):
    """A part that is drowned in noise does not spoil the rest if its noise is told."""
    image, model, truth = small
    sigma = np.full(image.shape, 0.02)
    sigma[:, 30:] = 2.0
    noisy = image + np.where(sigma > 1.0, 1.0, 0.0) * np.random.default_rng(1).normal(
        size=image.shape
    )
    told = inverse.deep_image_prior(inverse.Measurement(noisy, noise_sigma=sigma), model)
    assert inverse.registered_correlation(told, truth) > 0.95


def test_gain_and_background_are_least_squares():
    """Against a weighted fit by numpy, with a veil of known shape."""
    rng = np.random.default_rng(2)
    shape, seen, sigma = 0.5 + rng.random((3, 6, 7))
    image = 4.0 * seen + 3.0 * shape + 0.1 * rng.normal(size=seen.shape)
    data = noisy_image(
        Measurement(image, noise_sigma=sigma, background_shape=shape),
        image.shape,
    ).in_torch()
    gain, residual = ScaledImage(data, 2.0).misfit(torch.from_numpy(seen).float())
    columns = np.stack([seen / sigma, shape / sigma], axis=-1).reshape(-1, 2)
    expected = np.linalg.lstsq(columns, (image / sigma).ravel(), rcond=None)[0]
    # single precision
    assert 2.0 * gain.item() == pytest.approx(expected[0], rel=1e-5)
    left = image - expected[0] * seen - expected[1] * shape
    np.testing.assert_allclose(2.0 * residual.numpy(), left, atol=2e-5)


@pytest.mark.parametrize("level", [0.0, 5.0])
def test_uniform_image_is_too_few_photons(small, level):
    _, model, _ = small
    found = inverse.deep_image_prior(np.full(model.shape, level), model)
    assert found.status == "too_few_photons"
    assert not found.object.any()


@pytest.mark.parametrize(
    ("change", "kind", "words"),
    [
        ({"image": np.full((32, 40), np.nan)}, SceneError, "image has 1280 of 1280 values"),
        ({"image": np.zeros((40, 32))}, SamplingError, r"image has shape \(40, 32\), must be"),
        ({"model": np.ones((5, 5))}, SceneError, "model of type ndarray is not an image model"),
        ({"guide": "blur"}, SceneError, "guide = 'blur' is unknown"),
        ({"guide_share": 1.5}, SceneError, "guide_share = 1.5 is out of range"),
        (
            {"guide": "noise", "guide_share": 0.5},
            SceneError,
            'guide_share = 0.5, but guide="noise" is not an object',
        ),
        ({"base": 9}, SceneError, "base = '9' is unknown"),
        ({"tv_weight": -1.0}, SceneError, "tv_weight = -1 is out of range"),
        ({"learning_rate": 0.0}, SceneError, "learning_rate = 0 is out of range"),
        ({"max_iterations": 0}, SceneError, "max_iterations = 0 is out of range"),
        ({"tolerance": 1.0}, SceneError, "tolerance = 1 is out of range"),
        ({"seed": 0.5}, SceneError, "seed = 0.5 is not a whole number"),
    ],
)
def test_bad_input_is_refused_in_one_line(small, change, kind, words):
    image, model, _ = small
    options = {"image": image, "model": model, **change}
    with pytest.raises(kind, match=words) as caught:
        inverse.deep_image_prior(options.pop("image"), options.pop("model"), **options)
    assert "\n" not in str(caught.value)
