"""Registered correlation: independent of position, scale and offset, and of nothing else."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy import fft, ndimage

from nlosoptics.errors import SamplingError, SceneError
from nlosoptics.inverse import registered_correlation


def blobs(shape=(48, 50), seed=0):
    return ndimage.gaussian_filter(np.random.default_rng(seed).normal(size=shape), 2.0, mode="wrap")


def moved(picture, dy, dx):
    # the band-limited shift
    fy = fft.fftfreq(picture.shape[0])[:, None]
    fx = fft.fftfreq(picture.shape[1])
    ramp = np.exp(-2j * np.pi * (fy * dy + fx * dx))
    return fft.ifft2(fft.fft2(picture) * ramp).real


def test_equal_pictures_correlate_fully_wherever_and_however_bright():
    truth = blobs()
    # rounding of the transforms
    assert registered_correlation(truth, truth) == pytest.approx(1.0, abs=1e-12)
    assert registered_correlation(3 * np.roll(truth, (-7, 11), (0, 1)) + 5, truth) == (
        pytest.approx(1.0, abs=1e-12)
    )


@pytest.mark.parametrize("shift", [(0.35, -2.6), (11.5, 0.05), (-0.85, 0.95)])
def test_shift_between_pixels_is_found_to_the_step(shift):
    truth = blobs()
    # every shift here is a whole number of twentieths
    assert registered_correlation(moved(truth, *shift), truth) == pytest.approx(1.0, abs=1e-9)
    assert registered_correlation(moved(truth, *shift), truth, upsampling=1) < 0.9999


def test_value_is_pearsons_at_the_best_shift():
    first, second = blobs(seed=1), blobs(seed=2)
    best = max(
        np.corrcoef(np.roll(first, (i, j), (0, 1)).ravel(), second.ravel())[0, 1]
        for i in range(48)
        for j in range(50)
    )
    found = registered_correlation(first, second, upsampling=1)
    assert found == pytest.approx(best, abs=1e-12)  # rounding
    assert best <= registered_correlation(first, second) < best + 0.05


def test_negative_is_not_a_match():
    assert registered_correlation(-blobs(), blobs()) < 0.6


def test_half_a_turn_counts_only_where_it_is_allowed():
    truth = blobs()
    turned = np.roll(truth[::-1, ::-1], (4, -9), (0, 1))
    assert registered_correlation(turned, truth) < 0.6
    # rounding of the transforms
    assert registered_correlation(turned, truth, flip=True) == pytest.approx(1.0, abs=1e-12)
    assert registered_correlation(truth, truth, flip=True) == pytest.approx(1.0, abs=1e-12)


def test_uniform_picture_has_no_correlation():
    assert registered_correlation(np.full((48, 50), 0.1), blobs()) == 0.0


def test_tensors_are_taken():
    truth = blobs()
    assert registered_correlation(torch.from_numpy(truth), truth) == pytest.approx(1.0, abs=1e-12)


def test_bad_pictures_are_refused():
    with pytest.raises(SamplingError, match=r"\(48, 50\) and truth \(50, 48\)"):
        registered_correlation(blobs(), blobs().T)
    with pytest.raises(SamplingError, match="give one image"):
        registered_correlation(blobs()[None], blobs())
    with pytest.raises(SceneError, match=r"truth has 1 of \d+ values that are not finite"):
        registered_correlation(blobs(), np.where(blobs() == blobs().max(), np.nan, blobs()))
    with pytest.raises(SceneError, match="upsampling = 0"):
        registered_correlation(blobs(), blobs(), upsampling=0)


@pytest.mark.parametrize(
    ("picture", "kind"),
    [
        ("F.png", SceneError),
        ([[1.0], [2.0, 3.0]], SceneError),
        (np.ones((4, 4)) + 1j, SceneError),
        (np.ones((0, 4)), SamplingError),
    ],
)
def test_what_is_no_picture_is_named(picture, kind):
    with pytest.raises(kind, match="truth"):
        registered_correlation(np.ones((4, 4)), picture)
