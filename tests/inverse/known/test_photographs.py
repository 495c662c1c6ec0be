"""Photographs with a known blur: light from beyond the frame, veils, colours, uneven noise."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy import ndimage, signal

from nlosoptics.errors import NlosError
from nlosoptics.imaging import ForwardModel, camera_image
from nlosoptics.inverse import Measurement, tv_deconvolve

Y, X = np.indices((9, 9)) - 4
DISC = (np.hypot(Y, X) <= 3.3).astype(float)


def view(seed: int) -> np.ndarray:
    """Overlapping discs on grey, 117 x 121 pixels; nothing ends at the edges."""
    rng, picture = np.random.default_rng(seed), np.full((117, 121), 0.4)
    y, x = np.indices(picture.shape)
    for _ in range(40):
        row, column, radius = rng.uniform(0, 120), rng.uniform(0, 120), rng.uniform(4, 20)
        picture[np.hypot(y - row, x - column) < radius] = rng.uniform(0.1, 1.0)
    return picture


def photographed(picture: np.ndarray, noise: float, seed: int = 0) -> np.ndarray:
    """Image of the part of a view that is 8 pixels away from its edges."""
    blurred = signal.fftconvolve(picture, DISC / DISC.sum(), mode="valid")[4:-4, 4:-4]
    return blurred + np.random.default_rng(seed).normal(0.0, noise, blurred.shape)


def correlation(one: np.ndarray, other: np.ndarray) -> float:
    return float(np.corrcoef(one.ravel(), other.ravel())[0, 1])


def test_light_from_beyond_the_frame_does_no_harm() -> None:
    truth = view(1)
    image = photographed(truth, 0.01)
    found = tv_deconvolve(image, 7.0 * DISC)  # in any unit
    assert found.status == "converged"
    assert found.object.shape == image.shape == (101, 105)
    assert correlation(found.object, truth[8:-8, 8:-8]) > 0.97
    assert "veil" not in found.physical_parameters
    level = found.object * found.physical_parameters["gain"]
    assert np.abs(level - truth[8:-8, 8:-8])[[0, -1]].mean() < 0.05  # also at the edges
    assert found.physical_parameters["noise_sigma"] == pytest.approx(0.01, rel=0.15)
    dark_beyond = tv_deconvolve(image, ForwardModel(DISC / DISC.sum(), shape=image.shape))
    assert dark_beyond.status == "does_not_fit"
    assert correlation(dark_beyond.object, truth[8:-8, 8:-8]) < 0.9
    spread = SimpleNamespace(intensity=np.pad(DISC, 20))  # a window far larger than the blur
    again = tv_deconvolve(camera_image(image), spread)
    assert np.array_equal(again.object, found.object)


def test_a_smooth_veil_is_taken_off() -> None:
    y, x = np.indices((117, 121)) / 60.0 - 1.0
    truth = np.zeros_like(x)
    truth[30:90, 40:52] = truth[30:42, 40:90] = 1.0
    veil = 2.0 * np.exp(-((x - 0.3) ** 2) - y**2)
    found = tv_deconvolve(photographed(truth + veil, 0.01), DISC)
    inside = np.s_[8:-8, 8:-8]
    assert correlation(found.object, truth[inside]) > 0.97
    rest = found.physical_parameters["veil"] - veil[inside]
    assert rest.std() < 0.08
    together = found.object * found.physical_parameters["gain"] + found.physical_parameters["veil"]
    assert correlation(together, (truth + veil)[inside]) > 0.99


def test_a_soft_object_is_no_veil() -> None:
    """Light is not negative: a shaded plate before a black wall is not a flat one less a veil."""
    truth = np.zeros((117, 121))
    truth[24:93, 24:97] = np.linspace(0.0, 1.0, 73)
    found = tv_deconvolve(photographed(truth, 0.01), DISC)
    assert found.status == "converged"
    assert np.min(found.physical_parameters.get("veil", 0.0)) >= 0.0
    assert correlation(found.object, truth[8:-8, 8:-8]) > 0.98


def test_colours_share_one_answer() -> None:
    image = np.stack([photographed(view(seed), 0.01)[:50, :60] for seed in (1, 2, 3)], axis=-1)
    dead = np.zeros(image.shape, dtype=bool)
    dead[20, 30, 1] = True
    image[dead] = np.nan
    found = tv_deconvolve(Measurement(image, masked=dead), DISC)
    assert found.object.shape == found.physical_parameters["object_error"].shape == image.shape
    alone = tv_deconvolve(image[..., 2], DISC)
    gain, own = (each.physical_parameters["gain"] for each in (found, alone))
    assert found.object[..., 2] * gain == pytest.approx(alone.object * own, rel=1e-12)
    assert found.object.max() == pytest.approx(1.0)


def test_noise_without_high_frequencies_is_not_underestimated() -> None:
    """As after demosaicing or compression: the noise of the detail counts."""
    truth = view(1)
    noise = np.random.default_rng(2).normal(0.0, 0.02, (101, 105))
    smooth = ndimage.gaussian_filter(noise, 0.7)
    image = photographed(truth, 0.0) + smooth
    found = tv_deconvolve(image, DISC)
    assert found.physical_parameters["noise_sigma"] == pytest.approx(smooth.std(), rel=0.2)
    assert correlation(found.object, truth[8:-8, 8:-8]) > 0.95


@pytest.mark.parametrize(
    ("image", "kernel", "words"),
    [
        (np.eye(6), DISC, "7 x 7 pixels, the image 6 x 6; crop"),
        (np.eye(32), 0.0 * DISC, "the sum 0, must be positive"),
        (np.eye(32), np.full((3, 3), np.nan), "not finite"),
        (np.eye(32), np.ones(3), "must be .ky, kx."),
        (np.zeros((4, 32, 32)), DISC, "must be .H, W. or .H, W, 3."),
    ],
)
def test_what_cannot_be_sharpened_is_refused_in_one_line(image, kernel, words) -> None:
    with pytest.raises(NlosError, match=words) as refused:
        tv_deconvolve(image, kernel)
    assert "\n" not in str(refused.value)
