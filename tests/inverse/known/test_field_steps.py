"""Solvers under a field of point spreads."""

from __future__ import annotations

import numpy as np
import pytest

from nlosoptics.imaging import ForwardModel
from nlosoptics.inverse import Measurement, registered_correlation, tv_deconvolve, wiener
from nlosoptics.inverse.data.models import mean_transfer
from nlosoptics.inverse.known.field_step import FieldStep
from nlosoptics.psf import PointSpreadField

SIDE = 48


def letter():
    picture = np.zeros((SIDE, SIDE))
    for rows, columns in (((8, 38), (10, 17)), ((8, 14), (10, 38)), ((21, 26), (10, 30))):
        picture[slice(*rows), slice(*columns)] = 1.0
    return picture


@pytest.fixture
def scene(point_spread_field):
    """``scene(boundary)``: noisy image, its model, and the model of the mean point spread."""

    def make(boundary):
        model = ForwardModel(point_spread_field, shape=(SIDE, SIDE), boundary=boundary)
        mean = np.tensordot(model.weights.mean(axis=(1, 2)), model.kernel, 1)
        noise = 0.01 * np.random.default_rng(0).normal(size=(SIDE, SIDE))
        image = model.forward(letter()) + noise
        return image, model, ForwardModel(mean, shape=(SIDE, SIDE), boundary=boundary)

    return make


@pytest.mark.parametrize("boundary", ["padded", "circular"])
@pytest.mark.parametrize("solver", [tv_deconvolve, wiener])
def test_the_field_explains_more_than_its_mean(scene, boundary, solver):
    image, model, mean = scene(boundary)
    missed = [
        1.0
        - registered_correlation(solver(Measurement(image, noise_sigma=0.01), m).object, letter())
        for m in (model, mean)
    ]
    # measured: 1.2e-3 and 1.1e-2 by total variation, 3.2e-2 and 3.8e-2 by Wiener, 64 pixels a side
    assert missed[0] < 0.9 * missed[1]
    assert missed[0] < (5e-3 if solver is tv_deconvolve else 0.06)


def test_a_field_of_one_mode_is_its_point_spread(scene, point_spread_field):
    image, _, mean = scene("padded")
    even = PointSpreadField(
        modes=mean.kernel[None].copy(),
        weights=np.ones((1, 4, 4)),
        across=point_spread_field.across,
        up=point_spread_field.up,
        pitch=1e-5,
        truncation_error=0.0,
        error_estimate=0.0,
    )
    field = ForwardModel(even, shape=(SIDE, SIDE))
    found = tv_deconvolve(Measurement(image, noise_sigma=0.01), field)
    expected = tv_deconvolve(Measurement(image, noise_sigma=0.01), mean)
    assert found.reasons == expected.reasons
    # one conjugate gradient with an exact preconditioner; single precision over 100 iterations
    np.testing.assert_allclose(found.object, expected.object, rtol=0, atol=2e-4)


def test_steps_repeat_until_the_normal_equations_hold(scene):
    """The gradient of the quadratic function at its minimum, by the image model itself."""
    _, model, _ = scene("circular")
    image, pull = np.random.default_rng(0).normal(size=(2, *model.grid))
    step = FieldStep(model.weights, model.transfer, image)
    rest = np.full((model.grid[0], model.grid[1] // 2 + 1), 0.3)
    power = np.abs(mean_transfer(model)) ** 2
    free = seen = np.zeros_like(image)
    for _ in range(12):
        free, seen = step.solve(image, pull, 2.0, rest, 1.0 / (2.0 * power + rest), (free, seen))
    gradient = 2.0 * model.adjoint(model.forward(free) - image) + 0.3 * free - pull
    # twelve falls by ten in the residual, whose start is some tens
    assert np.linalg.norm(gradient) < 1e-8
    np.testing.assert_allclose(seen, model.forward(free), rtol=0, atol=1e-12)  # roundings
