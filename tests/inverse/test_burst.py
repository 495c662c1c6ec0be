"""Burst of images through independent speckle: laws of the model, an end-to-end case, refusals."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import fft

from nlosoptics import inverse, psf
from nlosoptics.errors import SamplingError, SceneError
from nlosoptics.inverse.burst.speckle_likelihood import BurstLikelihood, speckle_power

PITCH, SIDE = 1e-6, 64
LENS = psf.Wavefront.from_zernike({}, wavelength=500e-9, pupil_radius=6.25e-3, image_distance=50e-3)
SPREAD = psf.point_spread(LENS, pitch=PITCH, shape=16)  # lambda N is two pixels


def letter(size=SIDE):
    picture = np.zeros((size, size))
    top = left = size // 2 - 6
    picture[top : top + 13, left : left + 3] = picture[top : top + 3, left : left + 9] = 1.0
    picture[top + 6 : top + 8, left : left + 7] = 1.0
    return picture


def speckled(picture, count, seed=0, light=2e3, still=True):
    """Images by random pupils of radius 1/4 cycle per pixel, cut from twice the frame, and noise.

    The envelope is Gaussian: white complex noise under its root is cut to the pupil.
    """
    rng, n = np.random.default_rng(seed), 2 * len(picture)
    y, x = np.meshgrid(*[np.arange(n) - n // 2] * 2, indexing="ij")
    pupil = np.hypot(*np.meshgrid(*[np.fft.fftfreq(n)] * 2)) < 0.25
    envelope = np.exp(-(x**2 + y**2) / (4.0 * (0.35 * len(picture)) ** 2))
    images = []
    for k in range(count):
        shown = picture if still or 2 * k < count else np.rot90(picture)
        white = rng.normal(size=(2, n, n))
        field = fft.ifft2(pupil * fft.fft2(envelope * (white[0] + 1j * white[1])))
        spread = np.abs(field) ** 2 / (np.abs(field) ** 2).sum()
        waves = fft.fft2(np.pad(shown, len(picture) // 2)) * fft.fft2(fft.ifftshift(spread))
        image = fft.ifft2(waves).real[n // 4 : -(n // 4), n // 4 : -(n // 4)]
        images.append(image * light / image.mean())
    return rng.poisson(np.maximum(images, 0.0)).astype(float)


def likelihood(images):
    power = speckle_power(images.shape[1:], 0.5, pixel_integrated=False, patterns=1)
    return BurstLikelihood.of(images, power, 0.5)


def test_mean_power_and_third_cumulant_are_those_of_speckle_through_the_object():
    truth = letter() / letter().sum()
    data = likelihood(speckled(letter(), 32))
    waves = fft.rfft2(truth)
    model = data.spectrum(waves)
    strong = data.used & (model > 10.0 * data.noise)
    # 563 frequencies of 32 images: 1 %; the envelope hardly changes over the object: the rest
    assert np.mean(data.power[strong] / model[strong]) == pytest.approx(1.0, abs=0.1)
    measured, expected = data.cumulants(waves)
    # measured 0.69: far from 0 the overlap of three pupils is less than the product of three roots
    assert 0.55 < measured / expected < 1.1
    assert abs(data.cumulants(np.conj(waves))[0]) < 0.1 * expected  # half a turn: wrong phases


def test_gradients_are_those_of_finite_differences():
    data = likelihood(speckled(letter(), 6))
    rng = np.random.default_rng(1)
    level, along = rng.random((2, SIDE, SIDE)) * letter() / letter().sum()
    model = data.spectrum(fft.rfft2(level))
    for term in (data.second, lambda waves: data.third(waves, model)):
        step = 1e-5
        ends = [term(fft.rfft2(level + sign * step * along))[0] for sign in (1.0, -1.0)]
        slope = float((term(fft.rfft2(level))[1] * along).sum())
        assert (ends[0] - ends[1]) / (2.0 * step) == pytest.approx(slope, rel=1e-4)


@pytest.fixture(scope="module")
def answer():
    return inverse.burst_fit(speckled(letter(), 12), SPREAD)


def test_object_is_found_with_its_orientation(answer):
    assert answer.status == "converged", answer.reasons
    assert inverse.registered_correlation(answer, letter()) > 0.93
    assert inverse.registered_correlation(answer.object[::-1, ::-1], letter()) < 0.8


@pytest.mark.thorough
def test_same_seed_gives_same_bits(answer):
    again = inverse.burst_fit(speckled(letter(), 12), SPREAD)
    assert np.array_equal(again.object, answer.object)


@pytest.mark.thorough
def test_object_that_turns_halfway_does_not_fit():
    images = speckled(letter(), 12, still=False)
    assert inverse.burst_fit(images, SPREAD).status != "converged"


@pytest.mark.thorough
def test_dark_burst_has_too_few_photons():
    images = speckled(letter(), 12, light=0.5)
    assert inverse.burst_fit(images, SPREAD).status == "too_few_photons"


def test_callback_stops_the_fit():
    def stop(text, share):
        raise inverse.Stop

    images = speckled(letter(), 6)
    assert inverse.burst_fit(images, SPREAD, progress=stop).status != "converged"


def wide():
    return psf.point_spread(LENS, pitch=2.0 * PITCH, shape=16, pixel_integrated=True)


@pytest.mark.parametrize(
    ("images", "spread", "error", "words"),
    [
        (np.ones((4, 32, 32)), lambda: SPREAD, SamplingError, "K of 6 or more"),
        (np.ones((6, 32, 32)), wide, SamplingError, "limit 0.6.*narrower pixels"),
        (np.zeros((6, 32, 32)), lambda: SPREAD, SceneError, "mean of 0.*leave dark images out"),
        (np.ones((6, 32, 32)), lambda: "mean", SceneError, "no point spread; give"),
        (np.full((6, 32, 32), np.nan), lambda: SPREAD, SceneError, "images"),
    ],
)
def test_bad_input_is_refused_with_a_remedy(images, spread, error, words):
    with pytest.raises(error, match=words):
        inverse.burst_fit(images, spread())
