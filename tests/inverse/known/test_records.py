"""Reconstructions by known point spreads, with their histories, on record."""

import numpy as np
import pytest
import torch

from nlosoptics import inverse
from nlosoptics.imaging import ForwardModel

from ...records import attempt
from ..by_name import called

SOLVERS = [inverse.inverse_filter, inverse.richardson_lucy, inverse.tv_deconvolve, inverse.wiener]
SHAPE = (24, 30)


def seen(found):
    if isinstance(found, Exception):
        return found
    return [found.object, dict(found.physical_parameters), found.score, dict(found.history)]


@pytest.fixture(scope="module")
def measured():
    rng = np.random.default_rng(0)
    truth = np.zeros(SHAPE)
    truth[7:16, 9:20] = rng.random((9, 11)) + 0.3
    kernel = np.outer(np.arange(1.0, 6.0), [1, 2, 4, 1])
    model = ForwardModel(kernel / kernel.sum(), shape=SHAPE)
    return model.forward(truth) + 0.1 + 0.02 * rng.normal(size=SHAPE), model


def noise_map():
    sigma = np.full(SHAPE, 0.02)
    sigma[3, 4:7] = np.inf
    sigma[:, 20:] = 0.05
    return sigma


OPTIONS = {
    "default": {},
    "known noise": {"noise_sigma": 0.02},
    "map": {"noise_sigma": noise_map(), "background": 0.05},
    "shape": {"background_shape": np.linspace(0.5, 1.5, SHAPE[1]) * np.ones(SHAPE)},
    "gain": {"fit_background": False, "background": 0.1, "gain": 1.3},
}


@pytest.mark.parametrize("options", OPTIONS)
@pytest.mark.parametrize("solver", SOLVERS, ids=lambda solver: solver.__name__)
def test_a_reconstruction(solver, options, measured, on_record):
    image, model = measured
    asked, told = dict(OPTIONS[options]), []
    asked["progress"] = lambda *step: told.append(step)
    if solver is not inverse.inverse_filter:
        asked["max_iterations"] = 12
    on_record([seen(attempt(called, solver, image, model, **asked)), len(told), told[-1:]])


@pytest.mark.parametrize("solver", SOLVERS, ids=lambda solver: solver.__name__)
def test_other_borders(solver, measured, point_spread_field, on_record):
    image, model = measured
    at = np.meshgrid(np.linspace(-0.9, 0.9, SHAPE[1]), np.linspace(-0.9, 0.9, SHAPE[0]))
    periodic = ForwardModel(model.kernel, shape=SHAPE, boundary="circular")
    varying = ForwardModel(point_spread_field, shape=SHAPE, at=tuple(at))
    asked = {"noise_sigma": 0.03}
    if solver is not inverse.inverse_filter:
        asked["max_iterations"] = 8
    on_record([seen(attempt(called, solver, image, one, **asked)) for one in (periodic, varying)])


def test_tensors(measured, on_record):
    image, model = measured
    given = inverse.Measurement(torch.from_numpy(image), noise_sigma=torch.tensor(noise_map()))
    found = inverse.tv_deconvolve(given, model, max_iterations=8)
    on_record(seen(found))


def test_scores_and_noise(measured, on_record):
    image, model = measured
    other = np.roll(image[::-1], 2, axis=1)
    on_record(
        [
            inverse.registered_correlation(image, other),
            inverse.registered_correlation(image, other, upsampling=7, flip=True),
            inverse.registered_scores(image, other, data_range=2.0),
            inverse.registered_scores(image, other, flip=True),
            [inverse.estimate_noise(image), inverse.estimate_noise(image, model)],
        ]
    )
