"""Spectra of images, and signs that a fit is wrong, on record."""

import numpy as np
import pytest

from nlosoptics.imaging import ForwardModel
from nlosoptics.inverse.data import scores, signs, spectra

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
            "transfer": spectra.frame_transfer(model),
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
