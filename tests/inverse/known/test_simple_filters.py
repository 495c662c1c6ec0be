"""Inverse filter: exact without noise, and its guard against amplified noise."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from nlosoptics import inverse
from nlosoptics.errors import SceneError
from nlosoptics.imaging import ForwardModel
from nlosoptics.inverse.known.inverse_filter import _noise_guard


@pytest.fixture
def sharp():
    """A kernel whose transfer is nowhere under 0.2, and an object."""
    rng = np.random.default_rng(0)
    kernel = 0.4 * rng.random((5, 6)) / 15.0
    kernel[2, 3] += 0.7
    truth = np.zeros((32, 27))
    truth[8:20, 9:15] = 1.0
    return ForwardModel(kernel, shape=truth.shape, boundary="circular"), truth


def test_image_without_noise_gives_the_object_back(sharp):
    model, truth = sharp
    found = inverse.inverse_filter(
        inverse.Measurement(model.forward(truth), noise_sigma=1e-9, fit_background=False, gain=1.0),
        model,
        guard=1e-3,
    )
    # rounding of the transforms over the least transfer
    np.testing.assert_allclose(found.object, truth, rtol=0, atol=1e-13)
    assert found.score == pytest.approx(0.0, abs=1e-4)  # that rounding over the noise


def test_frequencies_under_the_guard_are_left_out_and_no_others(sharp):
    model, truth = sharp
    image = model.forward(truth)
    found = inverse.inverse_filter(
        inverse.Measurement(image, noise_sigma=1e-9, fit_background=False, gain=1.0),
        model,
        guard=0.6,
    )
    size = np.abs(model.transfer) / np.abs(model.transfer).max()
    kept = np.where(size >= 0.6, np.fft.rfft2(truth), 0.0)
    assert 0 < np.count_nonzero(size < 0.6) < size.size
    np.testing.assert_allclose(found.object, np.fft.irfft2(kept, s=truth.shape), atol=1e-13)


def test_zeros_of_the_transfer_do_no_harm():
    """Beyond the pupil's autocorrelation the transfer is zero, and the division is not done."""
    model = ForwardModel(np.full((4, 4), 1 / 16), shape=(32, 32), boundary="circular")
    assert np.abs(model.transfer).min() < 1e-15
    truth = np.zeros((32, 32))
    truth[10:20, 12:18] = 1.0
    image = model.forward(truth) + 1e-3 * np.random.default_rng(0).normal(size=truth.shape)
    found = inverse.inverse_filter(inverse.Measurement(image, noise_sigma=1e-3), model, guard=1e-13)
    # 0.001 of noise over the least transfer that is not zero, 0.005
    assert inverse.registered_correlation(found, truth) > 0.95


@pytest.mark.parametrize("noise", [0.01, 0.05])
def test_chosen_guard_leaves_the_noise(case, noise):
    data, model = case("F", "smooth", noise=noise)
    found = inverse.inverse_filter(
        inverse.Measurement(data.image, noise_sigma=data.noise_sigma), model
    )
    # what the frame cuts off is the difference between the grid's residual and the frame's
    assert found.score == pytest.approx(1.0, abs=0.02)
    # measured 0.970 and 0.925; the bare division 0.001
    assert inverse.registered_correlation(found, data.truth) > 0.9
    bare = inverse.inverse_filter(
        inverse.Measurement(data.image, noise_sigma=data.noise_sigma), model, guard=1e-8
    )
    assert inverse.registered_correlation(bare, data.truth) < 0.1


def test_guard_out_of_range_is_refused(sharp):
    model, truth = sharp
    for guard in (0.0, 2.0):
        with pytest.raises(SceneError, match=f"guard = {guard:g} is out of range"):
            inverse.inverse_filter(model.forward(truth), model, guard=guard)


def test_objective_is_of_the_pixels_that_count():
    truth = np.zeros((16, 16))
    truth[4:8, 4:8] = 50.0
    sigma = np.ones((16, 16))
    sigma[12:, :] = np.inf
    model = ForwardModel(np.full((3, 3), 1 / 9), shape=(16, 16))
    image = model.forward(truth) + np.random.default_rng(0).normal(size=(16, 16))
    found = inverse.inverse_filter(inverse.Measurement(image, noise_sigma=sigma, gain=1.0), model)
    left = image - model.forward(found.object) - found.physical_parameters["background"]
    # rounding
    expected = 0.5 * (left[:12] ** 2).sum()
    assert found.history["objective"][-1] == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("shape", [(24, 40), (40, 24), (9, 15)])
@pytest.mark.parametrize("share", [1e-3, 0.1, 0.9])
def test_frequencies_below_the_guard_carry_the_power_of_the_noise(shape, share):
    """By Parseval over the whole plane of frequencies; one frequency more is too much."""
    rng = np.random.default_rng(1)
    image, kernel = rng.normal(size=shape), rng.random(shape)
    half = shape[1] // 2 + 1
    power = np.abs(np.fft.fft2(image)) ** 2 / image.size
    size = np.abs(np.fft.fft2(kernel))
    size /= size.max()
    allowed = share * power.sum()
    spectrum = np.fft.rfft2(image)
    limit = SimpleNamespace(noise_power=lambda: allowed)
    guard = _noise_guard(limit, spectrum, size[:, :half], shape)
    # pairs of conjugate frequencies agree to rounding
    assert power[size < guard * (1 - 1e-9)].sum() <= allowed * (1 + 1e-9)
    assert power[size < guard * (1 + 1e-9)].sum() > allowed * (1 - 1e-9)
