"""Spectra of images, and signs that a fit is wrong, on record."""

import numpy as np
import pytest

from nlosoptics.imaging import ForwardModel
from nlosoptics.inverse import Measurement
from nlosoptics.inverse.data import noisy_image, scores, signs, spectra

SHAPE = (21, 26)


@pytest.fixture
def picture():
    rng = np.random.default_rng(1)
    values = 0.05 * rng.random(SHAPE)
    values[5:14, 6:19] += rng.random((9, 13)) + 0.5
    return values


@pytest.mark.parametrize("boundary", ["padded", "circular"])
def test_spectra(boundary, picture, on_record):
    kernel = np.outer([1.0, 3.0, 2.0], [1.0, 2.0, 4.0, 1.0, 0.5])
    model = ForwardModel(kernel / kernel.sum(), shape=SHAPE, boundary=boundary)
    seen, passed = spectra.power(picture), spectra.passed_power(model)
    signal = spectra.expected_signal(spectra.periodic_power(picture), passed, 1e-3, SHAPE)
    mask = spectra.beyond_optics(signal, 1e-2)
    on_record(
        {
            "powers": [seen, spectra.periodic_power(picture), passed],
            "transfer": spectra.frame_transfer(model.transfer, model),
            "weights": [spectra.half_weights(SHAPE), spectra.noise_share(SHAPE)],
            "object": spectra.object_power(SHAPE),
            "signal": [signal, mask, spectra.cosines_within(mask, SHAPE)],
        }
    )


@pytest.mark.parametrize("veil", [0.0, 0.4])
def test_signs(veil, picture, on_record):
    again = picture + 0.05 * np.roll(picture, 1, axis=0)
    found = signs.signs(picture + veil, again, residual=1.1, excess=30.0)
    usual = signs.as_if_steady(found)
    on_record(
        {
            "signs": found,
            "doubt": [signs.doubt(found), signs.risk(found), usual, signs.risk(usual)],
            "told": list(signs.told(found)),
            "blocks": signs.block_means(picture, 4),
            "scores": scores.registered_scores(picture + veil, again),
        }
    )


NOISES = {"even": 0.05, "map": np.linspace(0.03, 0.09, SHAPE[1]) * np.ones(SHAPE)}
NOISES["lost"] = np.where(np.hypot(*np.mgrid[:21, :26]) < 5, np.inf, 0.05)


@pytest.mark.parametrize("fit", [True, False])
@pytest.mark.parametrize("noise", NOISES)
def test_a_measurement(noise, fit, picture, on_record):
    kernel = np.outer([1.0, 3.0, 2.0], [1.0, 2.0, 4.0, 1.0, 0.5])
    model = ForwardModel(kernel / kernel.sum(), shape=SHAPE)
    data = noisy_image.noisy_image(
        Measurement(
            picture,
            noise_sigma=NOISES[noise],
            background=0.02,
            fit_background=fit,
            background_shape=np.linspace(0.5, 1.5, SHAPE[0])[:, None] * np.ones(SHAPE)
            if fit
            else None,
        ),
        model,
    )
    other, guess = 0.9 * data.data, model.forward(picture)
    on_record(
        {
            "powers": [data.counted, data.noise_power(), data.weighted(other)],
            "means": [data.weighted_mean(other), data.background_strength(other)],
            "levels": [data.background(0.3), data.border_strength(), data.span()],
            "score": [data.score(other), data.in_numpy().score(guess)],
            "doubts": [data.is_background(), data.is_background(model)],
            "energies": data.in_numpy().energies(model),
            "near": [data.in_numpy().is_noise_about(one * guess) for one in (1.0, 0.99, 0.5)],
        }
    )


def test_chances(on_record):
    """Of weighted sums of power, below and above what noise has."""
    shares = np.random.default_rng(2).exponential(size=(21, 14))
    low = np.exp(-np.hypot(*np.mgrid[:21, :14]) / 4)
    on_record(
        [
            noisy_image._chance(scale * shares * (1 + more * low), weights, SHAPE, own)
            for scale in (0.8, 1.0, 1.1)
            for more in (0.0, 1.0)
            for weights in (low, 1 - 0.3 * low, np.ones(low.shape))
            for own in (False, True)
        ]
        + [noisy_image._chance(0.0 * shares, low, SHAPE, True)]
    )
