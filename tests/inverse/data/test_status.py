"""Each test of a fit's status passes a right model and fails on the mismatch that it is for."""

from __future__ import annotations

import functools

import numpy as np
import pytest
import torch

from nlosoptics import inverse
from nlosoptics.imaging import ForwardModel
from nlosoptics.inverse import Measurement
from nlosoptics.inverse.data.models import widened
from nlosoptics.inverse.data.noisy_image import noisy_image
from nlosoptics.inverse.data.status import Ending, repetition

SOLVERS = [inverse.inverse_filter, inverse.richardson_lucy, inverse.tv_deconvolve, inverse.wiener]
SIDE = 64
NO_HISTORY = {"residual": [], "change": []}


@pytest.fixture(scope="module")
def drawn(mismatches):
    """``drawn(kind, ...)``: a case of the benchmark's generator and its model."""

    @functools.cache
    def make(kind, seed=0, **fixed):
        case = mismatches.case(seed, kind, **fixed)
        return case, ForwardModel(case.kernel, shape=case.image.shape)

    return make


def lobe(width, side=SIDE):
    """Model of a Gaussian point spread."""
    axis = np.arange(31.0) - 15.0
    kernel = np.exp(-(axis**2 + axis[:, None] ** 2) / (2 * width**2))
    return ForwardModel(kernel / kernel.sum(), shape=(side, side))


@pytest.mark.parametrize("solver", SOLVERS, ids=lambda solver: solver.__name__)
@pytest.mark.parametrize("width", [0.3, 2.0])
@pytest.mark.parametrize("kind", ["normal", "exponential", "poisson"])
def test_noise_shows_no_object(solver, width, kind):
    rng = np.random.default_rng(77)
    image = {
        "normal": rng.normal(200.0, 14.0, (SIDE, SIDE)),
        "exponential": rng.exponential(200.0, (SIDE, SIDE)),
        "poisson": rng.poisson(3.0, (SIDE, SIDE)),
    }[kind]
    found = solver(image, lobe(width))
    assert found.status == "too_few_photons"
    assert not found.object.any()
    assert "no object was detected" in found.reasons[0]


def test_a_faint_object_is_shown_with_low_confidence():
    """The whole frame's mean square is within its error of the noise's."""
    model = lobe(2.0)
    truth = np.zeros((SIDE, SIDE))
    truth[20:44, 22:30] = 1.0
    truth[20:28, 22:42] = 1.0
    detected = 0
    for seed in range(6):
        noise = np.random.default_rng(seed).normal(size=truth.shape)
        image = model.forward(truth) + noise
        data = noisy_image(Measurement(image, noise_sigma=1.0), model)
        detected += not data.is_background(model)
    # about 17 standard errors of the strongest component; none is missed by chance
    assert detected == 6
    found = inverse.tv_deconvolve(inverse.Measurement(image, noise_sigma=1.0), model)
    # the blurred and noisy image itself has 0.3
    assert inverse.registered_correlation(found, truth) > 0.5
    assert found.physical_parameters["expected_correlation"] < 0.9


# by the discrepancy principle of the other two, all but the mean may be noise
@pytest.mark.parametrize("solver", [inverse.richardson_lucy, inverse.wiener])
def test_an_object_below_the_error_of_the_mean_square_is_solved(solver):
    """The stated noise is a little too large, so that the image has less than its power."""
    model = lobe(2.0)
    truth = np.zeros((SIDE, SIDE))
    truth[20:44, 22:30] = 1.0
    image = model.forward(truth) + np.random.default_rng(0).normal(size=truth.shape)
    found = solver(Measurement(image, noise_sigma=1.06), model)
    assert found.status == "too_few_photons"
    assert np.isfinite(found.object).all()
    # the image itself has about 0.3
    assert inverse.registered_correlation(found, truth) > 0.3


def test_even_light_is_an_object_without_a_background():
    image = 0.2 + np.random.default_rng(0).normal(size=(SIDE, SIDE))
    model = lobe(2.0)
    for unknown in (False, True):
        data = noisy_image(Measurement(image, noise_sigma=1.0, fit_background=unknown), model)
        # 0.2 of 64 x 64 pixels is 13 standard errors
        assert data.is_background(model) is unknown


@pytest.mark.parametrize("wall", ["smooth", "speckle", "weak", "lobe"])
@pytest.mark.parametrize("subject", ["glyph", "grey"])
def test_a_right_model_converges_without_reasons(drawn, wall, subject):
    case, model = drawn("none", seed=4, wall=wall, subject=subject, noise=0.01)
    found = inverse.tv_deconvolve(case.image, model)
    assert (found.status, found.reasons) == ("converged", ())
    assert inverse.registered_correlation(found, case.truth) > 0.93


@pytest.mark.parametrize(
    ("kind", "wall", "seed", "noise", "words"),
    [
        ("unblurred_picture", "speckle", 3, 0.03, "times the noise"),
        ("other_wall", "speckle", 3, 0.03, "times the noise"),
        ("gradient", "smooth", 3, 0.03, "frame's edge"),
    ],
)
def test_a_wrong_model_is_named(drawn, kind, wall, seed, noise, words):
    case, model = drawn(kind, seed=seed, wall=wall, subject="glyph", noise=noise)
    found = inverse.tv_deconvolve(case.image, model)
    assert found.status == "does_not_fit"
    assert any(words in reason for reason in found.reasons), found.reasons


def test_detail_that_a_linear_filter_would_miss_is_no_reason(drawn):
    """Dots are recovered although their 1/f^2 neighbours would not be."""
    case, model = drawn("none", seed=700132)
    found = inverse.tv_deconvolve(case.image, model)
    assert inverse.registered_correlation(found, case.truth) > 0.95
    assert (found.status, found.reasons) == ("converged", ())


def test_a_repetition_has_the_noise_of_the_image():
    """Each pixel has its own noise, and excluded pixels have none."""
    rng = np.random.default_rng(0)
    model, truth = lobe(2.0), np.zeros((SIDE, SIDE))
    truth[20:44, 22:30] = 100.0
    noise = rng.uniform(0.5, 5.0, truth.shape)
    noise[::9, ::9] = np.inf
    data = noisy_image(
        Measurement(
            model.forward(truth) + rng.normal(size=truth.shape) * np.minimum(noise, 9.0),
            noise_sigma=noise,
        ),
        model,
    )
    again = repetition(data, truth, 3.0, model)
    excluded = np.isinf(noise)
    change = again.data - model.forward(truth) - 3.0
    assert np.abs(change[excluded]).max() < 1e-12
    # standard error of the rms of 4032 values
    relative = (change / noise)[~excluded]
    # and of about 3000 frequencies, from which the scale is known
    assert np.sqrt(np.mean(relative**2)) == pytest.approx(1.0, abs=6.0 / np.sqrt(2 * 3000))
    # the ratio of large and small noise, by halves of the pixels
    loud = noise[~excluded] > 2.75
    assert np.std(relative[loud]) == pytest.approx(np.std(relative[~loud]), rel=0.1)


@pytest.mark.parametrize("factor", [0.8, 1.25])
def test_a_wrong_scale_of_the_noise_changes_nothing(drawn, factor):
    case, model = drawn("none", seed=4, wall="smooth", subject="glyph", noise=0.03)
    stated = Measurement(case.image, noise_sigma=factor * case.noise_sigma)
    found, plain = (inverse.tv_deconvolve(image, model) for image in (stated, case.image))
    assert found.status == plain.status == "converged"
    assert found.object == pytest.approx(plain.object, abs=1e-6)


def test_light_beyond_the_optics_is_named(drawn):
    """A sharp picture has detail that no blur passes."""
    case, model = drawn("unblurred_picture", seed=0, wall="lobe", subject="glyph", noise=0.01)
    found = inverse.tv_deconvolve(case.image, model)
    assert found.status == "does_not_fit"
    assert any("beyond the optics' cut-off" in reason for reason in found.reasons), found.reasons


def test_an_image_that_the_frame_cuts_off_has_no_light_beyond_the_optics():
    """Blurred light ends at the frame, which spreads its power over all frequencies."""
    model, truth = lobe(3.0), np.zeros((SIDE, SIDE))
    truth[4:30, 3:8] = truth[4:9, 8:24] = truth[40:60, 50:60] = 1.0
    image = model.forward(truth) + 1e-3 * np.random.default_rng(0).normal(size=truth.shape)
    found = inverse.tv_deconvolve(image, model)
    assert (found.status, found.reasons) == ("converged", ())


def test_any_image_fits_a_blur_below_a_pixel():
    y, x = np.mgrid[:SIDE, :SIDE] / SIDE
    image = np.where(np.hypot(x - 0.5, y - 0.5) < 0.3, 0.1, 1.0) + 0.3 * np.sin(9.0 * x)
    image += 0.01 * np.random.default_rng(0).normal(size=image.shape)
    found = inverse.tv_deconvolve(image, lobe(0.3))
    assert (found.status, found.reasons) == ("converged", ())
    assert inverse.registered_correlation(found, image) > 0.98
    told = found.physical_parameters
    low, high = told["expected_correlation_range"]
    assert 0.0 <= low < told["expected_correlation"] < high < 1.0


def test_negative_light_of_a_linear_filter(drawn):
    case, model = drawn("other_wall", seed=0, wall="speckle", subject="glyph", noise=0.01)
    found = inverse.wiener(case.image, model)
    assert found.status == "does_not_fit"
    assert "power is negative" in found.reasons[0]


def test_an_early_end_asks_for_more_iterations(drawn):
    case, model = drawn("none", seed=4, wall="smooth", subject="glyph", noise=0.01)
    found = inverse.tv_deconvolve(case.image, model, max_iterations=20)
    assert found.status == "unconverged"
    assert "after 20 iterations" in found.reasons[0]


def test_a_fit_that_no_longer_moves_has_settled():
    steady, moving = [1.0] * 200, list(np.linspace(1.2, 1.0, 200))
    still, lively = [1e-4] * 200, [1e-2] * 200

    def settled(residual, change, converged=False):
        history = {"residual": residual, "change": change}
        return Ending(converged=converged, history=history).settled()

    assert settled(steady, still)
    assert not settled(steady, lively)
    assert not settled(moving, still)
    assert settled([], [], converged=True)
    assert not Ending(converged=False, history=NO_HISTORY).settled()


def test_excluded_pixels_are_not_taken_for_a_mismatch(drawn):
    case, model = drawn("none", seed=4, wall="smooth", subject="glyph", noise=0.01)
    out = np.random.default_rng(0).random(case.image.shape) < 0.02
    image, noise = np.where(out, 50.0, case.image), np.where(out, np.inf, case.noise_sigma)
    found = inverse.tv_deconvolve(inverse.Measurement(image, noise_sigma=noise), model)
    assert (found.status, found.reasons) == ("converged", ())


def test_other_pictures_in_a_scene_converge():
    """Dim pixels beside bright ones, soft edges and shades are no reason against an answer."""
    y, x = np.mgrid[:SIDE, :SIDE] / SIDE - 0.5
    shades = 0.5 + 0.5 * np.sin(9.0 * x + 4.0 * y) * np.cos(7.0 * y)
    soft = np.exp(-((x + 0.1) ** 2 + y**2) / 0.01) + 0.6 * np.exp(-((x - 0.2) ** 2 + y**2) / 0.02)
    model = lobe(0.6)
    for truth in (soft, np.where(np.hypot(x, y) < 0.4, shades, 0.0)):
        noise = 0.01 * np.random.default_rng(0).normal(size=truth.shape)
        found = inverse.tv_deconvolve(model.forward(truth) + noise, model)
        assert (found.status, found.reasons) == ("converged", ())
        assert inverse.registered_correlation(found, truth) > 0.99


@pytest.mark.thorough
def test_status_is_the_same_for_a_tensor(drawn):
    case, model = drawn("gradient", seed=3, wall="smooth", subject="glyph", noise=0.03)
    array, tensor = (
        inverse.tv_deconvolve(image, model) for image in (case.image, torch.tensor(case.image))
    )
    assert array.reasons == tensor.reasons


@pytest.mark.thorough
@pytest.mark.parametrize("noise", [0.01, 0.06])
def test_the_expected_error_is_that_found(drawn, noise):
    """Correlation and rms error of the pixels, each within a factor of two, over six walls."""
    lacks, errors = [], []
    for seed in range(6):
        case, model = drawn("none", seed=seed, wall="lobe", noise=noise)
        found = inverse.tv_deconvolve(case.image, model)
        told = found.physical_parameters
        expected = 1.0 - told["expected_correlation"]
        lacks.append((1.0 - inverse.registered_correlation(found, case.truth)) / expected)
        # the brightness that fits the truth best
        scale = (found.object * case.truth).sum() / (case.truth**2).sum()
        true = np.sqrt(np.mean((found.object - scale * case.truth) ** 2))
        errors.append(true / np.sqrt(np.mean(told["object_error"] ** 2)))
    assert 0.5 < np.exp(np.mean(np.log(lacks))) < 2.0
    assert 0.5 < np.exp(np.mean(np.log(errors))) < 2.0


def test_errors_are_larger_where_the_object_has_edges(drawn):
    case, model = drawn("none", seed=4, wall="lobe", subject="glyph", noise=0.01)
    found = inverse.tv_deconvolve(case.image, model)
    error = np.abs(found.object - case.truth / case.truth.max())
    worst = found.physical_parameters["object_error"] > np.quantile(
        found.physical_parameters["object_error"], 0.9
    )
    assert error[worst].mean() > 3.0 * error[~worst].mean()


def test_a_wider_model_keeps_its_brightness_and_the_given_model():
    """The variance of a Gaussian doubles."""
    model = lobe(2.0)
    before, point = model.transfer.copy(), np.zeros((SIDE, SIDE))
    point[32, 32] = 1.0
    wide = widened(model, np.sqrt(2.0))
    np.testing.assert_array_equal(model.transfer, before)
    x = np.arange(SIDE) - 32.0
    spread = wide.forward(point)
    assert spread.sum() == pytest.approx(1.0, abs=1e-3)
    assert (x**2 * spread).sum() / spread.sum() == pytest.approx(8.0, rel=0.05)
