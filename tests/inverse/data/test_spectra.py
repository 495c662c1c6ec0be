"""Power spectra on the frame, and the noise beyond the optics' cut-off."""

from __future__ import annotations

import numpy as np
import pytest

from nlosoptics.errors import SamplingError
from nlosoptics.imaging import ForwardModel
from nlosoptics.inverse import estimate_noise
from nlosoptics.inverse.data.models import (
    frame_transfer,
    half_weights,
    noise_share,
    passed_power,
    periodic_power,
    power,
)


@pytest.mark.parametrize("shape", [(12, 15), (9, 8)])
@pytest.mark.parametrize("boundary", ["padded", "circular"])
@pytest.mark.parametrize("kernel_shape", [(5, 4), (7, 7)])
def test_transfer_on_the_frame_is_the_kernels_sum(shape, boundary, kernel_shape):
    kernel = np.random.default_rng(0).random(kernel_shape)
    model = ForwardModel(kernel, shape=shape, boundary=boundary)
    y, x = (np.arange(n) - n // 2 for n in kernel_shape)
    rows, columns = np.fft.fftfreq(shape[0]), np.fft.rfftfreq(shape[1])
    expected = np.exp(-2j * np.pi * np.outer(rows, y)) @ kernel
    expected = expected @ np.exp(-2j * np.pi * np.outer(x, columns))
    # rounding of two transforms
    np.testing.assert_allclose(frame_transfer(model.transfer, model), expected, atol=1e-12)


def test_power_passed_by_a_field_is_the_mean_over_the_object(point_spread_field):
    """Brute force: the squared transfer function at every pixel, averaged."""
    model = ForwardModel(point_spread_field, shape=(20, 24))
    each = [
        passed_power(ForwardModel(np.tensordot(w, point_spread_field.modes, 1), shape=model.shape))
        for w in model.weights.reshape(len(model.weights), -1).T
    ]
    # rounding of an eigendecomposition
    np.testing.assert_allclose(passed_power(model), np.mean(each, axis=0), atol=1e-12)


@pytest.mark.parametrize("shape", [(12, 15), (9, 8)])
def test_power_counts_every_frequency_once(shape):
    image = np.random.default_rng(0).normal(size=shape)
    image = image - image.mean()
    total = float((half_weights(shape) * power(image)).sum())
    assert total == pytest.approx(float((image**2).sum()), rel=1e-12)  # Parseval


def test_a_ramp_has_no_jump_at_the_edge():
    """Its spectrum falls as slowly as 1/f; what remains is a step of one pixel in place of 32."""
    ramp = np.tile(np.linspace(0.0, 1.0, 32), (32, 1))
    for image, part in ((ramp, np.s_[0, 4:]), (ramp.T, np.s_[4:16, 0])):
        # (1/32)^2 of the power, and twice the step allowed
        assert (periodic_power(image)[part] < power(image)[part] * (2 / 32) ** 2).all()


def test_periodic_image_is_left_alone():
    axis = 2 * np.pi * np.arange(24) / 24
    wave = np.cos(3 * axis)[:, None] * np.cos(2 * axis)
    half = power(wave)
    # an image with equal neighbours across the edge has steps there, a part of its variation
    assert float(periodic_power(wave)[3, 2]) == pytest.approx(float(half[3, 2]), rel=0.2)


@pytest.mark.thorough
@pytest.mark.parametrize("noise", [0.005, 0.1])
def test_noise_is_taken_from_beyond_the_cut_off(mismatches, noise):
    """Fine detail raises the estimate from second differences, not the one with the model."""
    plain, own = [], []
    for seed in range(12):
        data = mismatches.case(seed, "none", noise=noise, wall="smooth")
        model = ForwardModel(data.kernel, shape=data.image.shape)
        plain.append(estimate_noise(data.image) / data.noise_sigma - 1.0)
        own.append(estimate_noise(data.image, model) / data.noise_sigma - 1.0)
    # at least 500 frequencies give 3 % standard error; the largest of 12 is below two and a half
    assert np.abs(own).max() < 0.08
    assert np.abs(own).mean() < np.abs(plain).mean()


@pytest.mark.thorough
@pytest.mark.parametrize("shape", [(8, 8), (9, 14)])
def test_share_of_white_noise_is_the_mean_of_many(shape):
    """Brute force; only at the lowest frequencies do the corners add more than a part of 1/N^2."""
    rng, count = np.random.default_rng(2), 20_000
    drawn = [periodic_power(rng.normal(size=shape)) for _ in range(count)]
    share = noise_share(shape)
    # exponential variables, and real ones at zero and half the sampling frequency
    error = 5.0 * np.sqrt(2.0 / count) * share + 4.0 / (shape[0] * shape[1])
    assert (np.abs(np.mean(drawn, axis=0) - share) < error)[2:-1, 2:].all()
    assert 1.0 - share[shape[0] // 2, -1] > 2 * error[shape[0] // 2, -1]


@pytest.mark.thorough
def test_noise_at_the_edges_counts(mismatches):
    """The mean over 40 images: without the edges' share it is 1.2 % too low."""
    ratios = []
    for seed in range(40):
        data = mismatches.case(700 + seed, "none", noise=0.05, wall="smooth")
        model = ForwardModel(data.kernel, shape=data.image.shape)
        ratios.append(estimate_noise(data.image, model) / data.noise_sigma)
    # single ratios scatter by 1 %, and the image's own power is known to a few parts in a thousand
    assert np.mean(ratios) == pytest.approx(1.0, abs=3.0 * 0.01 / np.sqrt(40) + 0.003)


def test_too_few_frequencies_leave_the_second_differences():
    image = np.random.default_rng(0).normal(size=(24, 24))
    image[6:18, 6:18] += 20.0
    sharp = ForwardModel(np.ones((1, 1)), shape=image.shape)
    assert estimate_noise(image, sharp) == estimate_noise(image)


def test_model_of_another_shape_is_refused():
    model = ForwardModel(np.ones((1, 1)), shape=(24, 25))
    with pytest.raises(SamplingError, match=r"image has shape \(24, 24\), must be \(24, 25\)"):
        estimate_noise(np.random.default_rng(0).normal(size=(24, 24)), model)
