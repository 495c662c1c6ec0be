"""Pixels of infinite noise: their values have no effect, and residuals exclude them."""

from __future__ import annotations

import numpy as np
import pytest

from nlosoptics.imaging import ForwardModel
from nlosoptics.inverse import (
    Measurement,
    PupilPSF,
    evidence_fit,
    inverse_filter,
    phase_retrieval,
    registered_correlation,
    wiener,
    wu2024_fit,
)

SHAPE = (33, 48)
NOISE = 0.01


@pytest.fixture(scope="module")
def pictures():
    """Object, model, image, and noise that is infinite for a part of the pixels."""
    truth = np.zeros(SHAPE)
    truth[8:16, 12:16], truth[16:20, 12:36] = 1.0, 0.7
    axis = np.arange(9.0) - 4.0
    kernel = np.exp(-(axis**2 + axis[:, None] ** 2) / 4.0)
    model = ForwardModel(kernel / kernel.sum(), shape=SHAPE)
    rng = np.random.default_rng(0)
    image = model.forward(truth) + NOISE * rng.standard_normal(SHAPE)

    def masked(part):
        out = np.random.default_rng(7).random(SHAPE) < part
        return np.where(out, 1e6, image), np.where(out, np.inf, NOISE)

    return truth, model, masked


def test_inverse_filter_keeps_its_frequencies(pictures):
    truth, model, masked = pictures
    image, noise = masked(0.01)
    found = inverse_filter(Measurement(image, noise_sigma=noise), model)
    # a constant, of correlation 0, where infinite noise allowed to leave all of them out
    assert registered_correlation(found, truth) > 0.8


@pytest.fixture(scope="module")
def pupil():
    wavelength, radius, distance = 5e-7, 5e-3, 0.1
    return PupilPSF.from_zernike(
        [4, 5],
        wavelength=wavelength,
        pupil_radius=radius,
        image_distance=distance,
        pitch=wavelength * distance / (4 * radius),
        shape=SHAPE,
    )


@pytest.mark.thorough
def test_residual_of_the_published_fit_is_over_the_counting_pixels(pictures, pupil):
    _, _, masked = pictures
    image, noise = masked(0.5)
    found = wu2024_fit(
        Measurement(image, noise_sigma=noise), pupil, max_iterations=300, learning_rate=1e-9
    )
    # steps of nothing leave the last residual that of the answer
    assert found.history["residual"][-1] == pytest.approx(found.score, rel=1e-3)


@pytest.mark.thorough
def test_score_of_the_blind_fit_is_over_the_counting_pixels(pictures, pupil):
    truth, _, masked = pictures
    image, noise = masked(0.1)
    found = evidence_fit(
        Measurement(image, noise_sigma=noise), pupil, known_object=truth, max_iterations=1
    )
    seen = np.isfinite(noise)
    strength = found.physical_parameters["gain"] * found.object
    kernel = pupil(pupil.coefficients.new_tensor(found.physical_parameters["coefficients"]))
    model = ForwardModel(kernel.detach().double().numpy(), shape=SHAPE)
    misfit = (image - model.forward(strength) - found.physical_parameters["background"])[seen]
    # the fit's point spread has a longer period than the model's, and the noise is measured
    assert found.score == pytest.approx(np.sqrt(np.mean(misfit**2)) / NOISE, rel=0.04)


def test_lags_of_masked_pixels_are_not_taken_for_an_object(pictures):
    _, model, masked = pictures
    sizes = []
    for part in (0.3, 0.0):
        image, noise = masked(part)
        found = phase_retrieval(
            Measurement(image, noise_sigma=noise), model, method="raar", max_iterations=20
        )
        sizes.append(np.array(found.physical_parameters["object_size"]))
    # 2 x 2 pixels, one pixel's own lag, where the masked ones were taken for light
    assert sizes[0].min() >= sizes[1].min() // 2


@pytest.mark.parametrize("share", [0.1, 0.3, 0.5])
def test_masked_pixels_leave_the_measured_noise_as_it_is(share):
    """Each filled pixel takes the noise of one frequency, as a parameter of a fit does."""
    side, measured = 128, []
    axis = np.arange(31) - 15.0
    spread = np.exp(-(axis**2 + axis[:, None] ** 2) / 18.0)
    model = ForwardModel(spread / spread.sum(), shape=(side, side))
    truth = np.zeros((side, side))
    truth[30:60, 40:56] = 1.0
    for seed in range(5):
        draw = np.random.default_rng(seed)
        image = model.forward(truth) + 0.01 * draw.normal(size=truth.shape)
        masked = draw.random(truth.shape) < share
        data = Measurement(np.where(masked, np.nan, image), masked=masked)
        found = wiener(data, model, max_iterations=1)
        # of 1/sigma^2 over all pixels, masked ones with 0
        sigma = found.physical_parameters["noise_sigma"] * np.sqrt(1.0 - masked.mean())
        measured.append(sigma / 0.01)
    # five images of 7000 frequencies and more: a standard error of 0.4 %
    assert np.mean(measured) == pytest.approx(1.0, abs=0.01)
