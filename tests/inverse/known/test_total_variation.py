"""Total variation: closed forms, the discrepancy principle, scores at one per cent noise."""

from __future__ import annotations

import numpy as np
import pytest

from nlosoptics import inverse
from nlosoptics.imaging import ForwardModel


@pytest.mark.parametrize("tv_weight", [0.5, 2.0])
def test_stripe_loses_contrast_by_perimeter_over_area(tv_weight):
    """Denoising a periodic stripe of width w in n columns (Strong and Chan, CAM 96-46, 1996).

    With unit noise the stripe sinks by 2 tv_weight/w and the rest rises by 2 tv_weight/(n - w).
    """
    model = ForwardModel(np.ones((1, 1)), shape=(24, 32), boundary="circular")
    image = np.full((24, 32), 20.0)
    image[:, 5:13] = 100.0
    found = inverse.tv_deconvolve(
        inverse.Measurement(image, noise_sigma=1.0, fit_background=False, gain=1.0),
        model,
        tv_weight=tv_weight,
        max_iterations=3000,
        tolerance=1e-7,
    )
    expected = np.full((24, 32), 20.0 + 2.0 * tv_weight / 24)
    expected[:, 5:13] = 100.0 - 2.0 * tv_weight / 8
    # single precision of values near 100
    np.testing.assert_allclose(found.object, expected, atol=1e-3)


def test_object_is_never_negative():
    """Below zero the denoised stripe is cut: the object is clipped, not merely small."""
    model = ForwardModel(np.ones((1, 1)), shape=(24, 32), boundary="circular")
    image = np.full((24, 32), -5.0)
    image[:, 5:13] = 100.0
    found = inverse.tv_deconvolve(
        inverse.Measurement(image, noise_sigma=1.0, fit_background=False), model, tv_weight=1.0
    )
    assert found.object.min() == 0.0


def test_objective_is_what_is_minimised_from_the_first_step_on():
    """Without a kernel the first steps explain more than the noise, and their weight is infinite.

    The record is taken at the weight that was settled, and ends at the formula of the docstring.
    """
    truth = np.zeros((64, 64))
    truth[20:40, 25:45] = 100.0
    image = truth + 20.0 * np.random.default_rng(0).standard_normal(truth.shape)
    model = ForwardModel(np.ones((1, 1)), shape=truth.shape, boundary="circular")
    found = inverse.tv_deconvolve(
        inverse.Measurement(image, noise_sigma=20.0), model, tolerance=1e-6, max_iterations=3000
    )
    level = found.object * found.physical_parameters["gain"]
    slopes = [np.roll(level, -1, axis) - level for axis in (0, 1)]
    variation = found.physical_parameters["tv_weight"] * np.hypot(*slopes).sum() / 20.0
    objective = found.history["objective"]
    # edges and object are two copies, which the last steps bring together
    assert objective[-1] == pytest.approx(0.5 * image.size * found.score**2 + variation, rel=1e-3)
    # measured 1.44; the start is the image itself, with all its noise
    assert objective.max() < 2.0 * objective[-1]


@pytest.mark.parametrize("tv_weight", [1e4, 1e6])
def test_a_weight_above_all_light_leaves_the_background_alone(tv_weight):
    """Edges cost more than they explain, so the minimum is no object and the image's mean."""
    truth = np.zeros((32, 40))
    truth[8:20, 10:16] = 1.0
    model = ForwardModel(np.full((3, 3), 1 / 9), shape=truth.shape)
    image = model.forward(truth) + 0.02 * np.random.default_rng(0).normal(size=truth.shape)
    found = inverse.tv_deconvolve(
        inverse.Measurement(image, noise_sigma=0.02), model, tv_weight=tv_weight
    )
    # of the image's brightest; single precision
    np.testing.assert_allclose(found.object * found.physical_parameters["gain"], 0.0, atol=1e-5)
    assert found.physical_parameters["background"] == pytest.approx(image.mean(), abs=1e-5)


@pytest.mark.thorough
@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("name", ["F", "cartoon_smile", "hanzi_zhong"])
@pytest.mark.parametrize(("wall", "limit"), [("smooth", 0.95), ("speckle", 0.99)])
def test_one_per_cent_noise(case, wall, limit, name, seed):
    data, model = case(name, wall, seed)
    found = inverse.tv_deconvolve(
        inverse.Measurement(data.image, noise_sigma=data.noise_sigma), model
    )
    # measured 0.9972 to 0.9986 smooth, 0.9929 to 0.9984 speckle
    assert inverse.registered_correlation(found, data.truth) > limit
    assert found.status == "converged"
    # the residual is sought at sqrt(1 - outline/pixels) of the noise, and stops within 0.01; the
    # noise itself, which is seen beyond the optics, has a standard error of 0.0055
    assert found.score == pytest.approx(np.sqrt(1 - 4 * 128 / 128**2), abs=0.022)
    assert found.physical_parameters["gain"] == pytest.approx(1.0, abs=0.2)
    assert {values.size for values in found.history.values()} == {len(found.history["change"])}


@pytest.mark.thorough
def test_less_noise_is_absorbed_in_faint_light(case):
    """The target rises from sqrt(1 - outline/pixels) of the noise to the noise itself."""
    data, model = case("F", "smooth", noise=1.0)
    options = {"tolerance": 5e-5, "max_iterations": 4000}
    image = inverse.Measurement(data.image, noise_sigma=data.noise_sigma)
    found = inverse.tv_deconvolve(image, model, **options)
    rest = data.image - data.image.mean()
    # the scale of the noise is measured, with a standard error of half a per cent
    energy = (rest**2).sum() / found.physical_parameters["noise_sigma"] ** 2 - rest.size
    taken = 512 * energy / (energy + 512)
    assert 50 < energy < 5000
    # the tolerance stops the residual within 0.0025; with the whole outline it would be 0.9864
    assert found.score == pytest.approx(np.sqrt(1 - taken / 128**2), abs=0.003)
    assert found.score > np.sqrt(1 - 512 / 128**2) + 0.004


@pytest.mark.parametrize(("wall", "limit"), [("smooth", 0.98), ("speckle", 0.98)])
def test_unknown_noise_costs_little(case, wall, limit):
    data, model = case("R", wall)
    found = inverse.tv_deconvolve(data.image, model)
    # measured 0.995 on both
    assert inverse.registered_correlation(found, data.truth) > limit


@pytest.mark.thorough
@pytest.mark.parametrize(("wall", "limit"), [("smooth", 0.98), ("speckle", 0.95)])
def test_five_per_cent_noise_beats_the_linear_filter(case, wall, limit):
    data, model = case("R", wall, 1, 0.05)
    found = inverse.tv_deconvolve(
        inverse.Measurement(data.image, noise_sigma=data.noise_sigma), model
    )
    linear = inverse.wiener(inverse.Measurement(data.image, noise_sigma=data.noise_sigma), model)
    # measured 0.992 and 0.973, against 0.963 and 0.881
    reached = inverse.registered_correlation(found, data.truth)
    assert reached > limit
    assert reached > inverse.registered_correlation(linear, data.truth)


@pytest.mark.thorough
def test_weight_that_was_found_gives_the_same_object_when_given(case):
    data, model = case("F", "speckle")
    tight = {"tolerance": 1e-5, "max_iterations": 4000}
    image = inverse.Measurement(data.image, noise_sigma=data.noise_sigma)
    sought = inverse.tv_deconvolve(image, model, **tight)
    weight = sought.physical_parameters["tv_weight"]
    given = inverse.tv_deconvolve(image, model, tv_weight=weight, **tight)
    # both stop at a relative change of 1e-5 per iteration, some hundred iterations deep
    np.testing.assert_allclose(given.object, sought.object, atol=2e-2)
    assert given.score == pytest.approx(sought.score, abs=1e-3)
    smoother = inverse.tv_deconvolve(image, model, tv_weight=10 * weight, **tight)
    assert smoother.score > given.score


@pytest.mark.thorough
def test_units_background_and_gain_change_nothing_but_their_parameters(case):
    data, model = case("R", "smooth")
    plain = inverse.tv_deconvolve(
        inverse.Measurement(data.image, noise_sigma=data.noise_sigma), model
    )
    ramp = np.linspace(0.0, 30.0, 128)[:, None] * np.ones(128)
    moved = inverse.tv_deconvolve(
        inverse.Measurement(
            50.0 * data.image + ramp + 7.0, noise_sigma=50.0 * data.noise_sigma, background=ramp
        ),
        model,
    )
    # single precision, amplified by a few hundred iterations
    np.testing.assert_allclose(moved.object, plain.object, atol=2e-3)
    first, second = plain.physical_parameters, moved.physical_parameters
    assert second["gain"] == pytest.approx(50.0 * first["gain"], rel=1e-3)
    assert second["background"] == pytest.approx(50.0 * first["background"] + 7.0, abs=0.02)
    assert second["tv_weight"] == pytest.approx(first["tv_weight"], rel=1e-2)
    known = inverse.tv_deconvolve(
        inverse.Measurement(data.image, noise_sigma=data.noise_sigma, gain=2.0), model
    )
    assert known.object.max() * 2.0 == pytest.approx(first["gain"], rel=1e-9)


@pytest.mark.thorough
def test_background_far_above_the_noise_costs_nothing(case):
    data, model = case("R", "smooth")
    level = 1e6 * data.noise_sigma
    found = inverse.tv_deconvolve(
        inverse.Measurement(data.image + level, noise_sigma=data.noise_sigma), model
    )
    plain = inverse.tv_deconvolve(
        inverse.Measurement(data.image, noise_sigma=data.noise_sigma), model
    )
    # single precision of the image without its background, amplified by the iterations
    np.testing.assert_allclose(found.object, plain.object, atol=2e-3)


@pytest.mark.thorough
def test_known_background_is_not_fitted_twice(case):
    data, model = case("R", "smooth")
    found = inverse.tv_deconvolve(
        inverse.Measurement(
            data.image + 3.0, noise_sigma=data.noise_sigma, background=3.0, fit_background=False
        ),
        model,
    )
    assert found.physical_parameters["background"] == 0.0
    assert inverse.registered_correlation(found, data.truth) > 0.99


@pytest.mark.thorough
def test_noise_map_is_used(case):
    data, model = case("R", "speckle")
    sigma = data.noise_sigma * np.where(np.arange(128) < 64, 0.5, 5.0) * np.ones((128, 1))
    image = model.forward(data.truth) + sigma * np.random.default_rng(0).normal(size=(128, 128))
    even = inverse.tv_deconvolve(
        inverse.Measurement(image, noise_sigma=float(np.sqrt((sigma**2).mean()))), model
    )
    mapped = inverse.tv_deconvolve(inverse.Measurement(image, noise_sigma=sigma), model)
    better = inverse.registered_correlation(mapped, data.truth)
    assert better > inverse.registered_correlation(even, data.truth) + 0.01
    uniform = inverse.tv_deconvolve(
        inverse.Measurement(data.image, noise_sigma=np.full((128, 128), data.noise_sigma)), model
    )
    plain = inverse.tv_deconvolve(
        inverse.Measurement(data.image, noise_sigma=data.noise_sigma), model
    )
    # Newton's steps against the closed form of even noise, in single precision
    np.testing.assert_allclose(uniform.object, plain.object, atol=1e-3)


def test_periodic_and_oblong_frames():
    rng = np.random.default_rng(0)
    truth = np.zeros((40, 66))
    truth[10:25, 20:50] = 1.0
    for boundary in ("padded", "circular"):
        model = ForwardModel(rng.random((9, 6)) / 54, shape=truth.shape, boundary=boundary)
        clean = model.forward(truth) + 2.0
        image = clean + 0.01 * rng.normal(size=clean.shape)
        found = inverse.tv_deconvolve(inverse.Measurement(image, noise_sigma=0.01), model)
        assert inverse.registered_correlation(found, truth) > 0.99
        assert found.physical_parameters["background"] == pytest.approx(2.0, abs=0.02)


@pytest.mark.thorough
def test_low_noise_runs_in_double_precision(case):
    data, model = case("F", "smooth", 0, 1e-5)
    found = inverse.tv_deconvolve(
        inverse.Measurement(data.image, noise_sigma=data.noise_sigma), model
    )
    assert np.isfinite(found.object).all()
    # the kernel's integral over pixels is off by more than such noise, which does no harm
    assert found.score > 2.0
    assert found.status == "converged"
    assert inverse.registered_correlation(found, data.truth) > 0.99
