"""Common loop of the solvers: a fit interrupted anywhere and resumed gives the same bits."""

from __future__ import annotations

import functools
import io

import numpy as np
import pytest
from scipy import ndimage

from nlosoptics import inverse
from nlosoptics.errors import SamplingError, SceneError
from nlosoptics.imaging import ForwardModel

from ..by_name import called

SIGMA = 0.02
SIDE = 32
# less noise than there is, so that Richardson-Lucy uses all its iterations
SHARP = {"noise_sigma": 0.5 * SIGMA, "max_iterations": 45}


def letter() -> np.ndarray:
    picture = np.zeros((SIDE, SIDE))
    picture[6:26, 9:13] = 1.0
    picture[6:10, 9:23] = 0.7
    return picture


def noise() -> np.ndarray:
    return SIGMA * np.random.default_rng(0).normal(size=(SIDE, SIDE))


def known(solver, *, most=np.inf, **options):
    """A solver on a padded frame, with a uniform background to fit.

    Values above ``most`` are clipped.
    """
    kernel = np.zeros((15, 15))
    kernel[7, 7] = 1.0
    model = ForwardModel(ndimage.gaussian_filter(kernel, 1.8), shape=(SIDE, SIDE))
    image = np.minimum(model.forward(letter()) + 0.1 + noise(), most)
    return functools.partial(called, solver, image, model, **{"noise_sigma": SIGMA, **options})


def masked(solver, **options):
    """The same with a map of noise, some pixels excluded, and a sloping background."""
    sigma = np.full((SIDE, SIDE), SIGMA)
    sigma[:, 20:] *= 2.0
    sigma[12:15, 10:12] = np.inf
    veil = np.linspace(0.2, 1.8, SIDE) * np.ones((SIDE, 1))
    return known(solver, noise_sigma=sigma, background_shape=veil, **options)


def field(solver, spread, **options):
    """A point spread that varies over the frame."""
    model = ForwardModel(spread, shape=(SIDE, SIDE))
    image = model.forward(letter()) + noise()
    return functools.partial(called, solver, image, model, **{"noise_sigma": SIGMA, **options})


def wu2024(**options):
    wavelength = 632.8e-9
    pupil = inverse.PupilPSF.from_zernike(
        (4, 5, 7),
        wavelength=wavelength,
        pupil_radius=1e-3,
        image_distance=50e-3,
        pitch=wavelength * 50e-3 / 4e-3,
        shape=SIDE,
    )
    image = ndimage.gaussian_filter(letter(), 1.5) + noise()
    options = {"depth": 2, "alternate": 4, "max_iterations": 43, **options}
    return functools.partial(called, inverse.wu2024_fit, image, pupil, noise_sigma=SIGMA, **options)


FITS = {
    "wiener": known(inverse.wiener),
    "wiener, masked": masked(inverse.wiener),
    "richardson_lucy": known(inverse.richardson_lucy, **SHARP),
    "richardson_lucy, plain": known(inverse.richardson_lucy, accelerated=False, **SHARP),
    "richardson_lucy, masked": masked(inverse.richardson_lucy, accelerated=False),
    "tv_deconvolve": known(inverse.tv_deconvolve),
    "tv_deconvolve, weight": known(inverse.tv_deconvolve, tv_weight=0.5, max_iterations=64),
    "tv_deconvolve, masked": masked(inverse.tv_deconvolve, max_iterations=64),
    "tv_deconvolve, clipped": known(inverse.tv_deconvolve, most=0.5),
    "wu2024": wu2024(),
    "wu2024, fed back": wu2024(network_input="reconstruction"),
    "wu2024, noise": wu2024(network_input="noise"),
}


class Watch:
    """Keeps the states that it is offered; ends the fit at a report."""

    def __init__(self, last: int | None = None) -> None:
        self.last, self.states = last, []

    def __call__(self, text: str, fraction: float) -> None:
        assert text
        assert 0.0 < fraction <= 1.0

    def look(self, snapshot) -> None:
        self.states.append(snapshot())
        if len(self.states) == self.last:
            raise inverse.Stop


def through_a_file(state):
    """The state as `nlosoptics reconstruct` keeps it."""
    file = io.BytesIO()
    np.savez(file, **state)
    file.seek(0)
    with np.load(file, allow_pickle=False) as kept:
        return {name: kept[name] for name in kept.files}


def assert_same(found, expected) -> None:
    assert found.object.tobytes() == expected.object.tobytes()
    assert (found.status, found.score) == (expected.status, expected.score)
    for name, records in expected.history.items():
        assert found.history[name].tobytes() == records.tobytes()
    for name, value in expected.physical_parameters.items():
        np.testing.assert_array_equal(found.physical_parameters[name], value)


def interrupted_and_resumed(fit) -> None:
    """At the first reports, in the middle, and at the last, which leaves nothing to do."""
    seen = Watch()
    whole = fit(progress=seen)
    assert len(seen.states) >= 2
    for last in {1, 2, len(seen.states) // 2 + 1, len(seen.states)}:
        watch = Watch(last)
        fit(progress=watch)
        assert len(watch.states) == last
        assert_same(fit(start=through_a_file(watch.states[-1])), whole)


@pytest.mark.parametrize("name", FITS)
def test_every_solver_resumes_bit_for_bit(name) -> None:
    interrupted_and_resumed(FITS[name])


@pytest.mark.parametrize(
    ("solver", "options"),
    [
        (inverse.wiener, {}),
        (inverse.tv_deconvolve, {"max_iterations": 64}),
        (inverse.richardson_lucy, SHARP),
    ],
)
def test_a_field_resumes_bit_for_bit(solver, options, point_spread_field) -> None:
    """Total variation keeps the solution that its next conjugate gradients start from."""
    interrupted_and_resumed(field(solver, point_spread_field, **options))


def test_clipped_pixels_are_ignored_in_this_fit() -> None:
    told = FITS["tv_deconvolve, clipped"]().physical_parameters
    assert told["saturated_pixels"] > 20


def test_a_longer_fit_resumes_from_a_shorter_one() -> None:
    """The state at the last of few iterations is that of the longer fit at the same iteration."""
    for fit in (FITS["tv_deconvolve, weight"], FITS["richardson_lucy"], wu2024()):
        watch = Watch()
        fit(max_iterations=22, progress=watch)
        resumed = fit(max_iterations=40, start=watch.states[-1])
        assert_same(resumed, fit(max_iterations=40))


def test_a_state_of_another_fit_is_named() -> None:
    watch = Watch(1)
    FITS["richardson_lucy"](progress=watch)
    (state,) = watch.states
    for name, wrong, kind, words in (
        ("numbers", np.ones(2), SceneError, "must be 6 finite values; give a state of richardson"),
        ("history", np.ones((2, 4)), SceneError, r"history has shape \(2, 4\), must be \(3, n\)"),
        ("move", np.ones((3, 3)), SamplingError, r"start's move has shape \(3, 3\)"),
    ):
        with pytest.raises(kind, match=words):
            FITS["richardson_lucy"](start={**state, name: wrong})
    with pytest.raises(SceneError, match="start holds no network; give a state of wu2024_fit"):
        FITS["wu2024"](start=state)
