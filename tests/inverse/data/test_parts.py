"""Parts of every solver: limits of detection, steps of Adam, what a result tells of itself."""

from __future__ import annotations

import math

import numpy as np
import pytest

from nlosoptics import inverse
from nlosoptics.imaging import ForwardModel
from nlosoptics.inverse import Measurement
from nlosoptics.inverse.data import noisy_image
from nlosoptics.inverse.known.total_variation import sharpest

SHAPE = (20, 24)
KERNEL = np.outer([1.0, 3.0, 2.0], [1.0, 2.0, 4.0, 1.0, 0.5]) / 51.0
MODEL = ForwardModel(KERNEL, shape=SHAPE)
RISE = np.linspace(0.5, 1.5, SHAPE[0])[:, None] * np.ones(SHAPE)
NOISE = np.random.default_rng(5).normal(size=SHAPE)


def measured(image, **changes):
    given = inverse.Measurement(image, **{"noise_sigma": 0.1, **changes})
    return noisy_image.noisy_image(given, MODEL)


@pytest.mark.parametrize(("errors", "dark"), [(3.05, True), (3.13, False)])
def test_even_light_is_an_object_at_one_chance_in_1000(errors, dark):
    """3.09 standard errors of the mean; with an unknown background it is that background."""
    image = 0.1 * (NOISE - NOISE.mean() + errors / math.sqrt(NOISE.size))
    assert measured(image, fit_background=False).is_background() is dark
    assert measured(image).is_background()


def test_without_noise_nothing_is_told_from_it():
    still = measured(np.full(SHAPE, 2.0), noise_sigma=None)
    assert still.sigma == 0.0
    assert still.is_background()


def test_the_sharpest_object_of_noise_is_dark():
    level, veil, weight = sharpest(measured(3.0 + 0.1 * NOISE), MODEL)
    assert not level.any()
    assert level.shape == SHAPE
    assert veil == pytest.approx(3.0 + 0.1 * NOISE.mean(), rel=1e-12)
    assert weight == 0.0


def reconstruction(history, **parameters):
    return inverse.Reconstruction(
        object=np.zeros(SHAPE),
        physical_parameters=parameters,
        status="too_few_photons",
        score=1.23456,
        history={name: np.zeros(n) for name, n in history.items()},
        seconds=0.5,
    )


def test_a_result_tells_its_numbers():
    rows = reconstruction({"residual": 7, "change": 6}, tv_weight=0.123456, n=3, map=np.ones(2))
    assert rows._figures().rows == {
        "status": "too few photons",
        "residual, rms of the noise": "1.23",
        "iterations": "7",
        "seconds": "0.5",
        "tv weight": "0.1235",
        "n": "3",
    }
    retrieved = reconstruction({"fourier_error": 4})._figures()
    assert list(retrieved.rows)[1:3] == ["agreement of halves", "restarts"]
    assert retrieved.rows["restarts"] == "4"
    assert reconstruction({})._figures().rows["iterations"] == "0"


SOLVERS = [inverse.tv_deconvolve, inverse.richardson_lucy, inverse.wiener, inverse.inverse_filter]


@pytest.mark.parametrize("solver", SOLVERS, ids=lambda solver: solver.__name__)
def test_a_result_follows_the_unit_of_the_image(solver):
    """In a unit 2^12 times as large, gain, background and noise are as much smaller."""
    truth = np.zeros(SHAPE)
    truth[6:13, 8:15] = 1.0
    image = MODEL.forward(truth) + 0.5 + 0.02 * NOISE
    asked = {} if solver is inverse.inverse_filter else {"max_iterations": 9}
    plain, small = (
        solver(Measurement(unit * image, noise_sigma=0.02 * unit), MODEL, **asked)
        for unit in (1.0, 2.0**-12)
    )
    np.testing.assert_allclose(small.object, plain.object, rtol=0, atol=1e-9)
    for name in ("gain", "background", "noise_sigma"):
        was, now = (one.physical_parameters[name] for one in (plain, small))
        assert 2.0**12 * now == pytest.approx(was, rel=1e-9, abs=1e-12)
    assert small.score == pytest.approx(plain.score, rel=1e-9)
    assert small.status == plain.status
