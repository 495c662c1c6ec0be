"""The Wiener filter: its closed form, its optimality in a frame, its scores."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import fft

from nlosoptics import inverse
from nlosoptics.imaging import ForwardModel


@pytest.fixture
def periodic():
    rng = np.random.default_rng(0)
    model = ForwardModel(rng.random((7, 6)), shape=(32, 28), boundary="circular")
    truth = np.zeros((32, 28))
    truth[8:20, 9:15] = 1.0
    sigma = 0.05
    return model, model.forward(truth) + sigma * rng.normal(size=truth.shape), sigma


@pytest.mark.parametrize("even", [False, True])
def test_periodic_frame_gives_the_closed_form(periodic, even):
    """X = H* Y / (|H|^2 + sigma^2 n / S), S = strength / (f^2 + f_0^2), without background."""
    model, image, sigma = periodic
    if even:
        image = 0.04 + sigma * np.random.default_rng(1).normal(size=image.shape)
    transfer = fft.fft2(np.roll(np.pad(model.kernel, ((0, 25), (0, 22))), (-3, -3), (0, 1)))
    rows, columns = image.shape
    prior = 1 / (
        fft.fftfreq(rows)[:, None] ** 2 + fft.fftfreq(columns) ** 2 + 1 / max(rows, columns) ** 2
    )
    passed = np.abs(transfer) ** 2 * prior
    found = inverse.wiener(
        inverse.Measurement(image, noise_sigma=sigma, fit_background=False, gain=1.0), model
    )
    sigma = found.physical_parameters["noise_sigma"]
    excess = (image**2).sum() - image.size * sigma**2
    penalty = sigma**2 * image.size / (prior * image.size * excess / passed.sum())
    spectrum = np.conj(transfer) * fft.fft2(image) / (np.abs(transfer) ** 2 + penalty)
    expected = fft.ifft2(spectrum).real
    assert found.status == ("too_few_photons" if even else "converged")
    assert found.history["residual"].size == 1
    # rounding of the transforms
    np.testing.assert_allclose(found.object, expected, rtol=0, atol=1e-12 * expected.max())


def test_padded_solution_has_the_least_objective(case):
    """Any small step away from the solution costs more: it is the minimum, edge included."""
    data, model = case("F", "smooth")
    found = inverse.wiener(inverse.Measurement(data.image, noise_sigma=data.noise_sigma), model)
    objective = found.history["objective"]
    # conjugate gradients lower it at every step, up to rounding
    assert (np.diff(objective) <= 1e-9 * objective[:-1]).all()
    assert objective[-3] - objective[-1] < 1e-6 * objective[-1]


def test_an_object_cut_by_no_taper_is_recovered_at_the_edge(case):
    """A bright bar along the frame's edge: padding knows that nothing lies outside."""
    _, model = case("F", "smooth")
    bar = np.zeros(model.shape)
    bar[:6, 20:100] = 1.0
    clean = model.forward(bar)
    sigma = 0.01 * clean.max()
    image = clean + sigma * np.random.default_rng(0).normal(size=clean.shape)
    found = inverse.wiener(inverse.Measurement(image, noise_sigma=sigma), model)
    framed = ForwardModel(model.kernel[64:192, 64:192], shape=(128, 128), boundary="circular")
    periodic = inverse.wiener(inverse.Measurement(image, noise_sigma=sigma), framed)
    # measured 0.948 against 0.527
    assert inverse.registered_correlation(found, bar) > 0.93
    assert inverse.registered_correlation(periodic, bar) < 0.8


@pytest.mark.parametrize("wall", ["smooth", "speckle"])
@pytest.mark.parametrize("name", ["F", "cartoon_smile", "hanzi_zhong"])
def test_one_per_cent_noise(case, wall, name):
    data, model = case(name, wall)
    found = inverse.wiener(inverse.Measurement(data.image, noise_sigma=data.noise_sigma), model)
    # measured 0.959 to 0.978
    assert inverse.registered_correlation(found, data.truth) > 0.94


@pytest.mark.thorough
def test_units_background_and_gain_change_nothing_but_their_parameters(case):
    data, model = case("R", "smooth")
    plain = inverse.wiener(
        inverse.Measurement(data.image, noise_sigma=data.noise_sigma), model, tolerance=1e-9
    )
    ramp = np.linspace(0.0, 30.0, 128)[:, None] * np.ones(128)
    moved = inverse.wiener(
        inverse.Measurement(
            50.0 * data.image + ramp + 7.0, noise_sigma=50.0 * data.noise_sigma, background=ramp
        ),
        model,
        tolerance=1e-9,
    )
    # both solved to 1e-9 of the right-hand side, times the filter's gain of about 1e3
    np.testing.assert_allclose(moved.object, plain.object, atol=1e-5)
    first, second = plain.physical_parameters, moved.physical_parameters
    assert second["gain"] == pytest.approx(50.0 * first["gain"], rel=1e-6)
    assert second["background"] == pytest.approx(50.0 * first["background"] + 7.0, abs=1e-4)
    known = inverse.wiener(
        inverse.Measurement(data.image, noise_sigma=data.noise_sigma, gain=2.0), model
    )
    explained = 2.0 * model.forward(known.object) + known.physical_parameters["background"]
    sigma = known.physical_parameters["noise_sigma"]
    residual = np.sqrt(np.mean((data.image - explained) ** 2)) / sigma
    assert known.score == pytest.approx(residual, rel=1e-9)  # the same sum


@pytest.mark.thorough
def test_noisy_half_counts_less_with_a_noise_map(case):
    data, model = case("R", "smooth")
    sigma = data.noise_sigma * np.where(np.arange(128) < 64, 0.5, 10.0) * np.ones((128, 1))
    image = model.forward(data.truth) + sigma * np.random.default_rng(0).normal(size=(128, 128))
    even = inverse.wiener(
        inverse.Measurement(image, noise_sigma=float(np.sqrt((sigma**2).mean()))), model
    )
    mapped = inverse.wiener(inverse.Measurement(image, noise_sigma=sigma), model)
    better = inverse.registered_correlation(mapped, data.truth)
    assert better > inverse.registered_correlation(even, data.truth) + 0.01


def test_too_few_iterations_are_reported(case):
    data, model = case("F", "speckle")
    found = inverse.wiener(
        inverse.Measurement(data.image, noise_sigma=data.noise_sigma), model, max_iterations=3
    )
    assert found.status == "unconverged"
    assert found.history["change"].size == 3


def test_same_as_scikit_images_with_our_prior(periodic):
    """A periodic frame, their balance and regulariser being our noise over our prior."""
    restoration = pytest.importorskip("skimage.restoration")
    model, image, sigma = periodic
    found = inverse.wiener(
        inverse.Measurement(image, noise_sigma=sigma, fit_background=False, gain=1.0), model
    )
    rows, columns = image.shape
    prior = 1 / (
        fft.fftfreq(rows)[:, None] ** 2 + fft.rfftfreq(columns) ** 2 + 1 / max(rows, columns) ** 2
    )
    # the strength that the image's variance gives, from what the answer does to its spectrum
    spectrum = fft.rfft2(image)
    ratio = np.conj(model.transfer[3, 3]) * spectrum[3, 3] / fft.rfft2(found.object)[3, 3]
    balance = (ratio.real - np.abs(model.transfer[3, 3]) ** 2) * prior[3, 3]
    theirs = restoration.wiener(
        image, model.kernel, balance, reg=1.0 / np.sqrt(prior) + 0j, clip=False
    )
    # rounding of the transforms
    np.testing.assert_allclose(theirs, found.object, rtol=0, atol=1e-10 * found.object.max())


@pytest.mark.parametrize("shape", [(1, 1), (32, 32)])
def test_even_light_without_a_background_is_the_object(shape):
    """An image that is even to its noise leaves no variance to match the prior to."""
    kernel = np.ones((3, 3)) / 9 if shape[0] > 1 else np.ones((1, 1))
    model = ForwardModel(kernel, shape=shape, boundary="circular")
    image = 100.0 + np.random.default_rng(0).normal(size=shape)
    found = inverse.wiener(
        inverse.Measurement(image, noise_sigma=1.05, fit_background=False, gain=1.0), model
    )
    # its mean is known, and no detail
    assert found.status == ("converged" if shape == (1, 1) else "too_few_photons")
    # the residual is noise, and so is the mean's error, 1/32 of 100, shrunk by as little
    assert found.score < 1.1
    assert found.object.mean() == pytest.approx(image.mean(), rel=1e-3)


@pytest.mark.parametrize("fit_background", [True, False])
def test_kernel_that_passes_the_mean_alone_gives_an_even_object(fit_background):
    """The image's structure is none of the object's; what is left of it is in the score."""
    model = ForwardModel(np.ones((4, 4)) / 16, shape=(4, 4), boundary="circular")
    image = 9.0 * np.random.default_rng(1).random((4, 4))
    found = inverse.wiener(
        inverse.Measurement(image, noise_sigma=0.1, fit_background=fit_background), model
    )
    assert np.ptp(found.object) < 1e-9
    assert found.score == pytest.approx(image.std() / 0.1, rel=1e-3)
