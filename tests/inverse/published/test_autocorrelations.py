"""Lags of an image by sums over its pixels, the modulus that follows, and refused lags."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import fft

from nlosoptics.errors import SamplingError, SceneError
from nlosoptics.imaging import ForwardModel
from nlosoptics.inverse import Measurement
from nlosoptics.inverse.data.noisy_image import noisy_image
from nlosoptics.inverse.published.autocorrelations import checked_lags, image_lags, spectrum_modulus

DRAW = np.random.default_rng(3)
IMAGE = DRAW.random((6, 9)) + 2.0


def measured(image, model=None, noise=0.1):
    return noisy_image(Measurement(image, noise_sigma=noise), model or image.shape)


def mean_lag(values, valid, down, right):
    """Mean product of pairs of valid pixels that lie ``down`` and ``right`` of each other."""
    products = [
        values[i, j] * values[i + down, j + right]
        for i in range(values.shape[0])
        for j in range(values.shape[1])
        if 0 <= i + down < values.shape[0]
        and 0 <= j + right < values.shape[1]
        and valid[i, j]
        and valid[i + down, j + right]
    ]
    return sum(products) / max(len(products), 1)


@pytest.mark.parametrize("shape", [(6, 9), (5, 4), (3, 7)])
@pytest.mark.parametrize("kept", [None, "most", "few"])
def test_lags_are_means_over_pairs_of_valid_pixels(shape, kept):
    image, valid = IMAGE[: shape[0], : shape[1]].copy(), np.full(shape, kept != "few")
    noise = 0.1
    if kept:
        valid[1, 2] = valid[2, 0] = kept == "few"
        valid[0, 1] = True
        image[~valid] = 40.0
        noise = np.where(valid, 0.1 + 0.02 * np.arange(shape[1]), np.inf)
    values = image - image[valid].mean()
    found = image_lags(measured(image, noise=noise), None)
    reach = [(n - 1) // 2 for n in shape]
    wanted = [
        [mean_lag(values, valid, i, j) for j in range(-reach[1], reach[1] + 1)]
        for i in range(-reach[0], reach[0] + 1)
    ]
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-14)  # rounding of the transforms


def test_lags_of_a_known_wall_are_wiener_filtered():
    """Against the formula for each frequency of the model's grid, by sums of cosines."""
    draw = np.random.default_rng(8)
    kernel = draw.random((3, 5)) ** 4
    model = ForwardModel(kernel / kernel.sum(), shape=IMAGE.shape)
    optics = model
    data = measured(IMAGE, model, 0.05)
    rows, columns = optics.grid
    assert (rows, columns) > IMAGE.shape
    padded = np.zeros((rows, columns))
    padded[:6, :9] = IMAGE - IMAGE.mean()
    power = np.abs(np.fft.fft2(padded)) ** 2
    response = np.zeros((rows, columns))
    response[:3, :5] = kernel / kernel.sum()
    passed = np.abs(np.fft.fft2(response)) ** 2
    half = slice(0, columns // 2 + 1)  # whose means set the level of the filter
    noise = 0.05**2 * IMAGE.size
    mean = power[:, half].mean()
    floor = noise / (mean - noise) * passed[:, half].mean()
    object_power = np.maximum(power - noise, 0.0) * passed / (passed**2 + floor**2)
    down, right = np.arange(-2, 3)[:, None], np.arange(-4, 5)
    turns = 2j * np.pi * np.arange(rows)[:, None] / rows, 2j * np.pi * np.arange(columns) / columns
    wanted = [
        [(object_power * np.exp(turns[0] * i + turns[1] * j)).real.mean() for j in right]
        for i in down.ravel()
    ]
    found = image_lags(data, optics)
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-9 * found.max())


OBJECT = DRAW.random((4, 6)) + 0.2


def object_lags(shape, level=0.0):
    """Autocorrelation of the object in the middle of an odd array, on a ground."""
    lags = np.full(shape, level)
    rows, columns = (n // 2 for n in shape)
    for i in range(-3, 4):
        for j in range(-5, 6):
            pairs = OBJECT[max(0, -i) : 4 - max(0, i), max(0, -j) : 6 - max(0, j)]
            moved = OBJECT[max(0, i) : 4 - max(0, -i), max(0, j) : 6 - max(0, -j)]
            lags[rows + i, columns + j] += (pairs * moved).sum()
    return lags


def transformed(window, grid):
    """Real transform of an odd window about its middle, by sums."""
    i, j = (np.arange(n) - n // 2 for n in window.shape)
    rows = np.exp(-2j * np.pi * np.outer(np.arange(grid[0]), i) / grid[0])
    columns = np.exp(-2j * np.pi * np.outer(np.arange(grid[1] // 2 + 1), j) / grid[1])
    return (rows @ window @ columns.T).real


@pytest.mark.parametrize(("shape", "size"), [((13, 17), (6, 8)), ((7, 11), (4, 6))])
def test_modulus_is_that_of_the_object(shape, size):
    """On a ground that the border of the object's rectangle tells, and with any zero lag."""
    lags = object_lags(shape, 7.0)
    middle = shape[0] // 2, shape[1] // 2
    beside = [lags[middle[0] + i, middle[1] + j] for i, j in ((0, 1), (0, -1), (1, 0), (-1, 0))]
    lags[middle] = -50.0
    lags[middle[0], middle[1] + 1] += 0.5
    lags[middle[0] + 1, middle[1]] -= 0.3
    given = lags.copy()
    found = spectrum_modulus(lags, size)
    np.testing.assert_array_equal(lags, given)
    np.testing.assert_allclose(
        spectrum_modulus(1e-9 * lags, size).modulus, found.modulus, atol=1e-6
    )
    assert found.object_size == size
    assert found.grid == tuple(fft.next_fast_len(3 * n - 2, real=True) for n in size)
    lags[middle] = np.mean(beside) + (0.5 - 0.3) / 4
    rows, columns = (slice(m - n + 1, m + n) for m, n in zip(middle, size, strict=True))
    window = lags[rows, columns]
    edge = np.ones(window.shape, dtype=bool)
    edge[1:-1, 1:-1] = False
    corners = window[[0, 0, -1, -1], [0, -1, 0, -1]]  # which count for both of their sides
    power = transformed(window - np.median([*window[edge], *corners]), found.grid)
    wanted = np.sqrt(np.maximum(power / power.max(), 0.0))
    np.testing.assert_allclose(found.modulus, wanted, rtol=0, atol=1e-7)  # root of the rounding
    assert found.modulus.shape == (found.grid[0], found.grid[1] // 2 + 1)
    if size == (6, 8):  # beyond the object the lags are the ground
        assert np.median([*window[edge], *corners]) == 7.0


def noisy_lags(height, sizes):
    """Lags of noise with a plateau, whose height is in deviations of the averaged background."""
    draw = np.random.default_rng(5)
    lags = draw.normal(size=(41, 61)) + 3.0
    lags += lags[::-1, ::-1].copy()
    # the outermost lags, averaged over 3 x 3 with the last ones repeated
    framed = np.pad(lags, 1, mode="symmetric")
    smooth = sum(framed[i : i + 41, j : j + 61] for i in range(3) for j in range(3)) / 9
    down, right = np.abs(np.arange(41) - 20)[:, None], np.abs(np.arange(61) - 30)
    far = smooth[(down > 0.85 * 20) | (right > 0.85 * 30)]
    level = np.median(far)
    spread = 1.4826 * np.median(np.abs(far - level))
    rows, columns = (slice(m - n, m + n + 1) for m, n in zip((20, 30), sizes, strict=True))
    lags[rows, columns] = level + height * spread
    return lags


@pytest.mark.parametrize("sizes", [(3, 7), (6, 2), (1, 1)])
def test_extent_is_that_of_the_lags_above_the_background(sizes):
    lags = noisy_lags(1e4, sizes)
    lags[5:7, 9:12] = lags[20, 30]  # not around the centre
    # far above it: one more lag on each side, by the average over 3 x 3
    found = spectrum_modulus(lags, None).object_size
    assert found == tuple(math.ceil(1.4 * (2 * n + 3) / 2) + 1 for n in sizes)


@pytest.mark.parametrize(
    ("lags", "size", "words"),
    [
        (np.ones((3, 1)), (1, 1), r"holds 3 x 1 lags, limit 3 x 3; give one of at least 3 x 3"),
        (object_lags((7, 11)), (5, 6), r"an object of 5 x 6 .* up to 4 x 5, beyond the 3 x 5 that"),
        (object_lags((7, 11)), (4, 7), r"an object of 4 x 7 .* up to 3 x 6, beyond the 3 x 5 that"),
        (object_lags((13, 17)) * 0.0, (6, 8), "no positive power within the object's extent; give"),
    ],
)
def test_lags_of_no_object_are_refused(lags, size, words):
    with pytest.raises(SamplingError, match=words):
        spectrum_modulus(lags, size)


def test_given_lags_become_symmetric():
    draw = np.random.default_rng(8)
    lags = draw.random((5, 9))
    found = checked_lags(lags.tolist())
    np.testing.assert_allclose(found, (lags + np.flip(lags)) / 2, rtol=1e-15)


@pytest.mark.parametrize(
    ("lags", "error", "words"),
    [
        (np.eye(6)[:, :5], SamplingError, r"shape \(6, 5\), must be \(odd, odd\) .*; cut one row"),
        (np.eye(6)[:5], SamplingError, r"shape \(5, 6\), must be"),
        (np.eye(5)[:3], SamplingError, r"shape \(3, 5\), .* at least 5 x 5"),
        (np.zeros((5, 5, 5)), SamplingError, r"shape \(5, 5, 5\), must be"),
        (np.where(np.eye(5) > 0, np.nan, 1.0), SceneError, "has 5 of 25 values that are not fin"),
        (np.full((5, 7), 2.5), SceneError, "is 2.5 everywhere; give one that falls from its cen"),
    ],
)
def test_other_lags_are_refused(lags, error, words):
    with pytest.raises(error, match=words):
        checked_lags(lags)
