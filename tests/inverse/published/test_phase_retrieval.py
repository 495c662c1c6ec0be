"""Phase retrieval: the case of the theory, exact autocorrelations, speckle, and bad input."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy import fft

from nlosoptics import inverse
from nlosoptics.errors import SamplingError, SceneError
from nlosoptics.imaging import ForwardModel
from nlosoptics.inverse import Measurement, registered_correlation
from nlosoptics.inverse.data.noisy_image import noisy_image
from nlosoptics.inverse.published.autocorrelations import image_lags, spectrum_modulus

from ..by_name import called

METHODS = ["alternating", "hio", "raar"]


def letter(size, unit):
    """An F of strokes one unit wide in the middle of a square."""
    picture = np.zeros((size, size))
    top, left = size // 2 - 5 * unit // 2, size // 2 - 2 * unit
    picture[top : top + 5 * unit, left : left + unit] = 1.0
    picture[top : top + unit, left : left + 4 * unit] = 1.0
    picture[top + 2 * unit : top + 3 * unit, left : left + 3 * unit] = 1.0
    return picture


def diffused(picture, seed, noise):
    """Image by a wall of random phases, lambda N = 2 pixels, and the wall's point spread."""
    size = len(picture)
    rng = np.random.default_rng(seed)
    axis = (np.arange(size) - size // 2) / (size / 4)
    pupil = np.where(np.hypot(axis[:, None], axis) <= 1.0, 1.0 + 0j, 0.0)
    pupil *= np.exp(2j * np.pi * rng.random(pupil.shape))
    spread = np.abs(fft.fftshift(fft.fft2(pupil))) ** 2
    spread /= spread.sum()
    clean = ForwardModel(spread, shape=picture.shape, boundary="circular").forward(picture)
    return clean + noise * clean.max() * rng.normal(size=clean.shape), spread


def autocorrelation(picture):
    return fft.fftshift(fft.ifft2(np.abs(fft.fft2(picture)) ** 2).real)[1:, 1:]


@pytest.mark.thorough
@pytest.mark.parametrize("method", METHODS)
def test_clean_autocorrelation_gives_the_object_up_to_place_and_half_a_turn(method):
    truth = letter(64, 4)
    found = inverse.object_from_autocorrelation(
        autocorrelation(truth), method=method, object_size=(20, 16), max_iterations=1000
    )
    framed = np.pad(found.object, ((0, 1), (0, 1)))
    # measured 0.969, 0.990, 0.990: the ground is taken from the lags' border, where the letter's
    # own are not quite 0; and 0.93, 0.99, 1.00
    assert registered_correlation(framed, truth, flip=True) > 0.95
    assert found.score > 0.91
    assert found.status == "converged"
    assert found.history["fourier_error"].shape == (12,)


@pytest.mark.parametrize("method", ["hio", "raar"])
def test_diffuser_hides_the_object_and_its_autocorrelation_tells_it(method):
    truth = letter(256, 4)
    image, _ = diffused(truth, 1, 0.01)
    assert registered_correlation(image, truth) < 0.5
    # by rounding none of HIO's first eight may end at the letter
    found = inverse.phase_retrieval(image, method=method, restarts=32)
    # measured 0.942 and 0.944; the number of grains in the frame sets the noise of the lags
    assert registered_correlation(found, truth, flip=True) > 0.88
    assert found.object.min() >= 0.0
    assert found.object.max() == 1.0
    assert found.physical_parameters["fourier_error"] == found.history["fourier_error"].min()


def test_modulus_of_a_known_wall_is_divided_out():
    """With the wall's transfer known but for its phases the lags have no speckle left."""
    truth = letter(128, 4)
    image, spread = diffused(truth, 2, 0.002)
    model = ForwardModel(spread, shape=truth.shape, boundary="circular")
    data = noisy_image(Measurement(image, noise_sigma=0.002 * image.max()), truth.shape)
    expected = autocorrelation(truth - truth.mean())
    expected[63, 63] = np.nan

    def likeness(lags):
        kept = np.isfinite(expected)
        return np.corrcoef(lags[kept], expected[kept])[0, 1]

    divided = image_lags(data, model)
    # measured 0.9998 against 0.65
    assert likeness(divided) > likeness(image_lags(data, None)) + 0.1
    found = inverse.phase_retrieval(image, model, method="raar", restarts=6)
    # measured 0.990; without the model 0.81
    assert registered_correlation(found, truth, flip=True) > 0.95


def test_extent_of_the_object_is_read_off_the_lags():
    truth = letter(256, 4)
    image, _ = diffused(truth, 3, 0.01)
    data = noisy_image(image, image.shape)
    rows, columns = spectrum_modulus(image_lags(data, None), None).object_size
    # the letter is 20 x 16, and there is room of 0.4
    assert 20 <= rows <= 32
    assert 16 <= columns <= 28


def test_grains_without_an_object_are_told_from_one():
    """White grains have the spectrum of noise, whatever noise is stated."""
    grains = np.random.default_rng(0).gamma(1.0, size=(128, 128))
    found = inverse.phase_retrieval(inverse.Measurement(grains, noise_sigma=0.01))
    assert found.status == "too_few_photons"
    assert not found.object.any()
    assert "spectrum is that of noise" in found.reasons[0]


@pytest.mark.parametrize("method", METHODS)
def test_seed_gives_the_bits_and_another_seed_others(method):
    image, _ = diffused(letter(128, 3), 0, 0.01)
    options = {"method": method, "restarts": 2, "max_iterations": 30, "object_size": (20, 16)}
    first = inverse.phase_retrieval(image, seed=1, **options).object
    assert inverse.phase_retrieval(image, seed=1, **options).object.tobytes() == first.tobytes()
    assert inverse.phase_retrieval(image, seed=2, **options).object.tobytes() != first.tobytes()


def test_tensor_gives_tensor_and_uniform_image_too_few_photons():
    image, _ = diffused(letter(128, 3), 0, 0.01)
    tensor = torch.from_numpy(image).to(torch.float32)
    found = inverse.phase_retrieval(tensor, restarts=2, max_iterations=5, object_size=(20, 16))
    assert found.object.dtype == torch.float32
    dark = inverse.phase_retrieval(np.full((32, 32), 3.0))
    assert dark.status == "too_few_photons"
    assert not dark.object.any()
    assert dark.score == 0.0


@pytest.mark.parametrize("method", METHODS)
def test_progress_and_an_early_end(method):
    image, _ = diffused(letter(128, 3), 0, 0.01)
    calls = []
    inverse.phase_retrieval(
        image,
        method=method,
        restarts=2,
        max_iterations=40,
        object_size=(20, 16),
        progress=lambda *call: calls.append(call),
    )

    def stop(text, done):
        raise inverse.Stop

    options = {"method": method, "restarts": 2, "object_size": (20, 16)}
    ended = inverse.phase_retrieval(image, progress=stop, **options)
    assert ended.status == "unconverged"
    assert np.isfinite(ended.object).all()
    assert calls
    assert all(0.0 <= done <= 1.0 and method in text for text, done in calls)


@pytest.mark.parametrize(
    ("change", "kind", "words"),
    [
        ({"image": np.full((32, 32), np.nan)}, SceneError, "image has 1024 of 1024 values"),
        ({"image": np.ones((2, 32, 32))}, SamplingError, r"image has shape \(2, 32, 32\)"),
        ({"image": [[1.0], [2.0, 3.0]]}, SceneError, "image of type list has rows"),
        ({"gain": 2.0}, SceneError, "gain or background_shape is given"),
        ({"background_shape": np.ones((64, 64))}, SceneError, "gain or background_shape is given"),
        ({"method": "er"}, SceneError, "method = 'er'"),
        ({"restarts": 1}, SceneError, "restarts = 1"),
        ({"object_size": (40, 8)}, SamplingError, "an object of 40 x 8 pixels has lags up to"),
        ({"object_size": 8}, SceneError, "object_size = 8 is not a size"),
        ({"model": np.ones((3, 3))}, SceneError, "model of type ndarray"),
    ],
)
def test_bad_input_is_refused_in_one_line(change, kind, words):
    image, _ = diffused(letter(64, 2), 0, 0.01)
    options = {"image": image, **change}
    with pytest.raises(kind, match=words) as caught:
        called(inverse.phase_retrieval, options.pop("image"), **options)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("lags", "kind", "words"),
    [
        (np.ones((8, 9)), SamplingError, r"autocorrelation has shape \(8, 9\)"),
        (np.ones((9, 9)), SceneError, "autocorrelation is 1 everywhere"),
        (np.full((9, 9), np.inf), SceneError, "81 of 81 values that are not finite"),
    ],
)
def test_bad_autocorrelation_is_refused(lags, kind, words):
    with pytest.raises(kind, match=words):
        inverse.object_from_autocorrelation(lags)


def test_lags_may_be_a_tensor_and_other_things_are_named():
    axis = np.arange(21.0) - 10.0
    lags = np.exp(-np.hypot(axis, axis[:, None]) / 3.0)
    options = {"max_iterations": 5, "object_size": (6, 6)}
    expected = inverse.object_from_autocorrelation(lags, **options)
    tensor = torch.tensor(lags, requires_grad=True)
    found = inverse.object_from_autocorrelation(tensor, **options)
    np.testing.assert_array_equal(found.object, expected.object)
    for wrong in ([["a"] * 5] * 5, lags + 0j):
        with pytest.raises(SceneError, match="not an array of real numbers; give"):
            inverse.object_from_autocorrelation(wrong)


@pytest.mark.parametrize("kind", [np.asarray, torch.from_numpy])
def test_complex_images_are_refused(kind):
    with pytest.raises(SceneError, match="not an array of real numbers"):
        inverse.phase_retrieval(kind(np.ones((16, 16)) + 1j))
