"""Solvers: progress callbacks, interruption and resumption, and excluded pixels."""

from __future__ import annotations

import math

import numpy as np
import pytest
from pytest import approx
from scipy import ndimage

from nlosoptics import inverse
from nlosoptics.errors import SamplingError, SceneError
from nlosoptics.imaging import ForwardModel
from nlosoptics.inverse import Measurement
from nlosoptics.inverse.data.driver import goes_on, started_from, state_of

SIGMA = 0.02
SOLVERS = [inverse.tv_deconvolve, inverse.wiener]


def case(seed: int = 0):
    """Blurred bars in noise, with the model that blurred them."""
    truth = np.zeros((48, 48))
    truth[10:38, 12:18] = 1.0
    truth[10:16, 18:34] = 0.7
    kernel = np.zeros((31, 31))
    kernel[15, 15] = 1.0
    model = ForwardModel(ndimage.gaussian_filter(kernel, 1.8), shape=truth.shape)
    noise = np.random.default_rng(seed).normal(size=truth.shape)
    return truth, model, model.forward(truth) + SIGMA * noise


class Watch:
    """Keeps what it is told; ends the fit at a report."""

    def __init__(self, last: int | None = None) -> None:
        self.last, self.told, self.states = last, [], []

    def __call__(self, text: str, fraction: float) -> None:
        self.told.append((fraction, text))

    def look(self, snapshot) -> None:
        self.states.append(snapshot())
        if self.last is not None and len(self.states) >= self.last:
            raise inverse.Stop


def test_a_start_near_the_end_saves_iterations() -> None:
    _, model, image = case()
    image = inverse.Measurement(image, noise_sigma=SIGMA)
    options = {"tolerance": 1e-4, "max_iterations": 2000}
    cold = inverse.wiener(image, model, **options)
    level = cold.object * cold.physical_parameters["gain"]
    warm = inverse.wiener(image, model, **options, start=level)
    assert warm.status == "converged"
    assert len(warm.history["residual"]) < len(cold.history["residual"])
    assert warm.object == approx(cold.object, abs=2e-2)


def test_an_object_alone_is_a_start_too() -> None:
    """Of another weight's fit: what comes out is the fit of this weight."""
    _, model, image = case()
    image = inverse.Measurement(image, noise_sigma=SIGMA)
    options = {"tv_weight": 0.3, "tolerance": 1e-5, "max_iterations": 4000}
    cold = inverse.tv_deconvolve(image, model, **options)
    other = inverse.tv_deconvolve(image, model, **{**options, "tv_weight": 3.0})
    level = other.object * other.physical_parameters["gain"]
    warm = inverse.tv_deconvolve(image, model, **options, start=level)
    assert warm.status == cold.status == "converged"
    # both end within the tolerance per iteration of the same minimum
    assert warm.object == approx(cold.object, abs=1e-2)
    assert abs(other.object - cold.object).max() > 0.05


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_stopped_fit_starts_again_from_its_object(solver) -> None:
    _, model, image = case()
    watch = Watch(last=2)
    part = solver(Measurement(image, noise_sigma=SIGMA), model, progress=watch)
    assert part.status == "unconverged"
    state = watch.states[-1]
    # the last state is what is returned, over its gain
    assert part.object * part.physical_parameters["gain"] == approx(state["object"], abs=1e-6)
    again = solver(Measurement(image, noise_sigma=SIGMA), model, start=state)
    whole = solver(Measurement(image, noise_sigma=SIGMA), model)
    assert again.status == whole.status == "converged"
    assert inverse.registered_correlation(again, whole) > 0.998


def test_text_tells_the_residual() -> None:
    _, model, image = case()
    watch = Watch()
    found = inverse.tv_deconvolve(
        inverse.Measurement(image, noise_sigma=SIGMA), model, progress=watch
    )
    fractions = [fraction for fraction, _ in watch.told]
    assert fractions[-1] == 1.0
    assert fractions == sorted(fractions)
    assert f"residual {found.history['residual'][-1]:.3f}" in watch.told[-1][1]


def test_stop_may_come_from_the_call_itself() -> None:
    def ended(text: str, fraction: float) -> None:
        raise inverse.Stop

    _, model, image = case()
    found = inverse.tv_deconvolve(
        inverse.Measurement(image, noise_sigma=SIGMA), model, progress=ended
    )
    assert (found.status, len(found.history["residual"])) == ("unconverged", 10)
    assert goes_on(None, "", 0.0, lambda: {})
    with pytest.raises(KeyboardInterrupt):
        goes_on(_interrupted, "", 0.0, lambda: {})


def _interrupted(text: str, fraction: float) -> None:
    raise KeyboardInterrupt


@pytest.mark.parametrize("count", [3, 12])
@pytest.mark.parametrize("solver", [*SOLVERS, inverse.richardson_lucy, inverse.inverse_filter])
def test_the_last_report_tells_the_whole(solver, count: int) -> None:
    """Also of a fit that ends before the next report would have come, or at its last iteration."""
    _, model, image = case()
    watch = Watch()
    options = {} if solver is inverse.inverse_filter else {"max_iterations": count}
    found = solver(Measurement(image, noise_sigma=SIGMA), model, progress=watch, **options)
    assert watch.told[-1][0] == 1.0
    assert isinstance(watch.told[-1][1], str)
    if options:
        assert found.status == "unconverged"


def test_states_are_copies_with_an_object() -> None:
    level = np.ones((3, 4))
    state = state_of(level, coefficients=[0.1, 0.2])
    level += 1
    assert np.array_equal(state["object"], np.ones((3, 4)))
    assert np.array_equal(state["coefficients"], [0.1, 0.2])


@pytest.mark.parametrize(
    ("start", "named"),
    [
        ({"angles": np.ones(3)}, "angles"),
        (np.full((3, 4), np.nan), "not finite"),
        (np.ones((4, 4)), "(4, 4)"),
    ],
)
def test_bad_starts_are_named(start, named: str) -> None:
    with pytest.raises((SceneError, SamplingError)) as refused:
        started_from(start, (3, 4))
    assert named in str(refused.value)


@pytest.mark.parametrize("solver", SOLVERS)
def test_pixels_of_infinite_noise_do_not_count(solver) -> None:
    """Whatever they read, the object is the same; the score is of the others."""
    truth, model, image = case()
    sigma = np.full(image.shape, SIGMA)
    sigma[20:23, 13:16] = np.inf
    sigma[40, 40] = np.inf
    results = []
    for wrong in (0.0, 3.0):
        spoilt = np.where(np.isinf(sigma), wrong, image)
        results.append(solver(Measurement(spoilt, noise_sigma=sigma, fit_background=False), model))
    assert np.array_equal(results[0].object, results[1].object)
    assert inverse.registered_correlation(results[1], truth) > 0.9
    whole = solver(Measurement(image, noise_sigma=SIGMA, fit_background=False), model)
    # ten pixels of 2304 less: the score moves by their noise, 10/2304/2 and what they had been
    assert results[0].score == approx(whole.score, abs=0.01)


def test_no_pixel_left_is_refused() -> None:
    _, model, image = case()
    with pytest.raises(SceneError, match="infinite in every pixel"):
        inverse.wiener(
            inverse.Measurement(image, noise_sigma=np.full(image.shape, math.inf)), model
        )
    with pytest.raises(SceneError, match="not finite"):
        inverse.wiener(
            inverse.Measurement(image, noise_sigma=np.full(image.shape, math.nan)), model
        )
