"""Steps of the deep image prior with a network whose pictures are given, against NumPy."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from pytest import approx

from nlosoptics.imaging import ForwardModel
from nlosoptics.inverse import Measurement
from nlosoptics.inverse.data.driver import Run
from nlosoptics.inverse.data.noisy_image import noisy_image
from nlosoptics.inverse.published.deep_image_prior import _Fit

SHAPE, SIGMA, STEPS = (9, 12), 0.3, 40
DRAW = np.random.default_rng(8)
TRUTH = DRAW.uniform(0.0, 1.0, SHAPE)
PICTURES = np.clip(TRUTH + DRAW.normal(size=(60, *SHAPE)) * 0.3, 0.0, 1.0)
MODEL = ForwardModel(np.array([[0.1, 0.2, 0.0], [0.3, 0.2, 0.1], [0.0, 0.1, 0.0]]), shape=SHAPE)
IMAGE = 7.0 * MODEL.forward(TRUTH) + 2.0 + SIGMA * DRAW.normal(size=SHAPE)


class Played(torch.nn.Module):
    """Network without anything to learn, which gives one picture after the other."""

    def __init__(self, pictures):
        super().__init__()
        self.nothing = torch.nn.Parameter(torch.zeros(()))
        self.pictures = iter(torch.from_numpy(pictures).float())

    def forward(self):
        return next(self.pictures) + 0.0 * self.nothing


def fitted(picture, weight):
    """Objective, rms residual and object, in units of the noise."""
    columns = np.stack([MODEL.forward(picture).ravel(), np.ones(picture.size)], axis=1)
    gain, level = np.linalg.lstsq(columns, IMAGE.ravel() / SIGMA, rcond=None)[0]
    square = np.mean((columns @ (gain, level) - IMAGE.ravel() / SIGMA) ** 2)
    down, along = np.diff(picture, axis=0)[:, :-1], np.diff(picture, axis=1)[:-1]
    edges = np.sum(np.sqrt(down**2 + along**2 + 1e-6) - 1e-3)
    return square / 2 + weight * gain * edges / picture.size, math.sqrt(square), gain * picture


def fit_of(pictures, weight, known=None, tolerance=0.1):
    data = noisy_image(Measurement(IMAGE, noise_sigma=SIGMA), SHAPE).in_torch()
    network = Played(pictures)
    return _Fit(data, MODEL, (STEPS, tolerance), network, weight, 0.02, known)


@pytest.mark.parametrize("weight", [0.0, 0.2])
@pytest.mark.parametrize("better", ["average", "best"])
def test_steps_and_their_result(weight, better):
    """A running average from step 25 on, or the best picture, whichever has less."""
    pictures = PICTURES.copy()
    if better == "best":
        pictures[11] = TRUTH
    else:  # errors that cancel
        pictures[25:] = 1.0 - pictures[25] + 2.0 * (TRUTH - 0.5)
        pictures[25] = PICTURES[25]
    mix = (torch.full(SHAPE, 3.0, dtype=torch.float64), 0.25)
    fit, plain = fit_of(pictures, weight, mix), fit_of(pictures, weight)
    state, least = fit.init(None), math.inf
    before = average = np.zeros(SHAPE)
    for t in range(34):
        state.count = t
        objective, residual, level = fitted(pictures[t], weight)
        found = fit.step(state)
        rate = 0.02 * (0.05 + 0.95 * (0.5 + 0.5 * math.cos(math.pi * t / STEPS)))
        assert state.network.param_groups[0]["lr"] == approx(rate, rel=1e-12)
        change = np.linalg.norm(level - before) / np.linalg.norm(level)
        assert found == approx((objective, residual, change), rel=1e-4)
        assert state.residual == found[1]
        if objective < least:
            least, best = objective, level
        if t >= 25:
            average = level if t == 25 else average + 0.04 * (level - average)
            assert state.average.numpy() == approx(average, rel=1e-4, abs=1e-4)
        before = level
        assert state.least == approx(least, rel=1e-4)
        assert state.best.numpy() == approx(best, rel=1e-4, abs=1e-4)
        if t == 20:
            assert plain.level(state).numpy() == approx(SIGMA * best, rel=1e-4, abs=1e-4)
    averaged = fitted(average, weight)[0]
    assert (averaged < least) == (better == "average")
    chosen = SIGMA * (average if better == "average" else best)
    assert plain.level(state).numpy() == approx(chosen, rel=1e-4, abs=1e-4)
    mixed = 0.75 * chosen + 0.25 * 3.0
    assert fit.level(state).numpy() == approx(mixed, rel=1e-4, abs=1e-4)


def test_where_a_fit_ends():
    """Where the residual is that of the noise without the outlines' share, half of it at least."""
    fit = fit_of(PICTURES, 0.0)
    state = fit.init(None)
    assert not fit.done(state)
    target = math.sqrt(1 - 2 * (9 + 12) / (9 * 12))
    for share, ends in ((1 + 1e-9, False), (1 - 1e-9, True)):
        state.residual = share * target
        assert fit.done(state) is ends
    tiny = noisy_image(Measurement(IMAGE[:4, :5], noise_sigma=SIGMA), (4, 5)).in_torch()
    small = ForwardModel(np.array([[1.0]]), shape=(4, 5))
    few = _Fit(tiny, small, (STEPS, 0.1), Played(PICTURES[:, :4, :5]), 0.0, 0.02, None)
    for share, ends in ((1 + 1e-9, False), (1 - 1e-9, True)):
        state.residual = share * math.sqrt(0.5)
        assert few.done(state) is ends


@pytest.mark.parametrize("stopped", [False, True])
@pytest.mark.parametrize(("factor", "within"), [(1 - 1e-6, False), (1 + 1e-6, True)])
def test_verdict_on_a_fit(factor, within, stopped):
    level = torch.from_numpy(6.0 * PICTURES[0])
    seen = 6.0 * MODEL.forward(PICTURES[0])
    strength = (IMAGE - seen).mean()
    score = float(np.sqrt(np.mean((IMAGE - seen - strength) ** 2))) / SIGMA
    fit = fit_of(PICTURES, 0.6, tolerance=factor * score - 1.0)
    state = fit.init(None)
    state.count = 17
    found = fit.answer(Run(state, {"residual": [2.0], "change": [0.1]}, stopped), level)
    assert found["background"] == approx(strength, rel=1e-9)
    assert found["ending"].converged is (within and not stopped)
    assert found["ending"].history == {"residual": [2.0], "change": [0.1]}
    assert found["ending"].most_residual == approx(max(1.05, factor * score))
    assert (found["tv_weight"], found["iterations"]) == (0.6, 17.0)
    strict = fit_of(PICTURES, 0.6, tolerance=0.01)
    ending = strict.answer(Run(state, {}, stopped), level)["ending"]
    assert (ending.converged, ending.most_residual) == (False, 1.05)
