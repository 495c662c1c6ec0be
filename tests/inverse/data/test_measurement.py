"""Measurements: images with what is known of their noise and background."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from nlosoptics.errors import SamplingError, SceneError
from nlosoptics.imaging import ForwardModel
from nlosoptics.inverse import Measurement, PupilPSF, evidence_fit, tv_deconvolve
from nlosoptics.inverse.data.noisy_image import noisy_image

SHAPE = (24, 31)
MODEL = ForwardModel(np.outer([1.0, 3.0, 2.0], [2.0, 1.0, 1.0]) / 24.0, shape=SHAPE)
DRAW = np.random.default_rng(3)
IMAGE = MODEL.forward(np.pad(np.ones((9, 14)), ((6, 9), (8, 9)))) + 0.02 * DRAW.normal(size=SHAPE)
OUT = np.zeros(SHAPE, dtype=bool)
OUT[7:9, 10:13] = OUT[20, 3] = True


def test_an_array_is_a_measurement_with_the_defaults():
    plain, told = tv_deconvolve(IMAGE, MODEL), tv_deconvolve(Measurement(IMAGE), MODEL)
    assert told.object.tobytes() == plain.object.tobytes()


@pytest.mark.parametrize("noise", [0.02, np.linspace(0.01, 0.03, SHAPE[1]) * np.ones(SHAPE)])
@pytest.mark.parametrize("value", [np.nan, -np.inf, 1e3])
def test_masked_pixels_are_those_of_infinite_noise(noise, value):
    spoilt = np.where(OUT, value, IMAGE)
    masked = noisy_image(Measurement(spoilt, noise_sigma=noise, masked=OUT), MODEL)
    infinite = noisy_image(Measurement(IMAGE, noise_sigma=np.where(OUT, np.inf, noise)), MODEL)
    assert masked.sigma == infinite.sigma
    assert masked.counted == IMAGE.size - 7
    np.testing.assert_array_equal(masked.weights, infinite.weights)
    # the sum behind the mean has one order, but other values at weights of 0
    np.testing.assert_allclose(masked.data, infinite.data, rtol=1e-14)


def test_values_at_masked_pixels_of_noise_and_background_do_not_matter():
    known = {"noise_sigma": np.full(SHAPE, 0.02), "background": np.full(SHAPE, 0.1)}
    lost = {name: np.where(OUT, np.nan, value) for name, value in known.items()}
    one, other = (noisy_image(Measurement(IMAGE, masked=OUT, **k), MODEL) for k in (known, lost))
    np.testing.assert_array_equal(one.data, other.data)
    np.testing.assert_array_equal(one.weights, other.weights)


def test_noise_is_estimated_beside_masked_pixels():
    lost = np.random.default_rng(8).random(SHAPE) < 0.1
    told = [
        noisy_image(Measurement(np.where(lost, value, IMAGE), masked=lost), MODEL)
        for value in (np.nan, 7.0)
    ]
    assert told[0].sigma == told[1].sigma
    # sigma is a mean over all pixels, those of infinite noise among them
    own = told[0].sigma * np.sqrt(1.0 - lost.mean())
    # standard error of 7 %; the mean that fills a masked pixel is less noisy than a pixel
    assert own == pytest.approx(0.02, rel=0.3)
    assert noisy_image(np.where(lost, 7.0, IMAGE), MODEL).sigma > 2.0 * own


def test_a_mask_without_pixels_is_none():
    one, other = (noisy_image(Measurement(IMAGE, masked=m), MODEL) for m in (None, OUT & False))
    assert (one.weights == 1.0).all()
    assert (other.weights == 1.0).all()
    assert one.sigma == other.sigma


def test_each_image_gets_its_own_values():
    images, noise = np.stack([IMAGE, 2.0 * IMAGE, 3.0 * IMAGE]), [0.1, 0.2, 0.3]
    masks, veils = np.stack([OUT, ~OUT, OUT]), np.arange(3)[:, None, None] * np.ones(SHAPE)
    given = {"noise_sigma": noise, "masked": masks, "background": veils, "gain": 2.0}
    found = Measurement(images, fit_background=False, **given).each()
    assert [one.noise_sigma for one in found] == noise
    for i, one in enumerate(found):
        np.testing.assert_array_equal(one.image, images[i])
        np.testing.assert_array_equal(one.masked, masks[i])
        np.testing.assert_array_equal(one.background, veils[i])
        assert (one.gain, one.fit_background) == (2.0, False)
    shared = Measurement(images, noise_sigma=noise[0], masked=OUT, background=veils[1]).each()
    assert len(shared) == 3
    assert all(one.noise_sigma == 0.1 and one.masked is OUT for one in shared)
    (alone,) = Measurement(torch.from_numpy(IMAGE), noise_sigma=[0.4]).each()
    assert alone.image.shape == SHAPE
    assert isinstance(alone.image, torch.Tensor)
    assert alone.noise_sigma == 0.4


@pytest.mark.thorough
def test_masked_frames_of_a_blind_fit_need_no_noise():
    optics = {"wavelength": 6e-7, "pupil_radius": 9e-4, "image_distance": 0.05, "pitch": 8e-6}
    pupil = PupilPSF.from_zernike((4, 6), shape=24, **optics)
    frames = np.stack([IMAGE[:, :24], IMAGE[:, 7:]])
    told = [
        evidence_fit(
            Measurement(np.where(OUT[:, :24], value, frames), masked=OUT[:, :24]),
            pupil,
            defocus=[0.0, 3e-7],
            max_iterations=1,
        )
        for value in (np.nan, 1e4)
    ]
    assert told[0].object.tobytes() == told[1].object.tobytes()


@pytest.mark.parametrize(
    ("given", "error", "says"),
    [
        ({"masked": OUT.astype(int)}, SceneError, "masked has values of type int64, must be bool"),
        (
            {"masked": [[True], [True, False]]},
            SceneError,
            "masked of type list has rows that differ",
        ),
        ({"masked": OUT[1:]}, SamplingError, r"masked has shape \(23, 31\), must be \(24, 31\)"),
        ({"masked": ~(OUT & False)}, SceneError, "masked is True in every pixel"),
        ({"gain": -2.0}, SceneError, "gain = -2 is out of range"),
        ({"background": np.full(SHAPE, np.nan)}, SceneError, "744 of 744 values .*masked="),
    ],
)
def test_bad_values_are_refused(given, error, says):
    with pytest.raises(error, match=says) as caught:
        tv_deconvolve(Measurement(IMAGE, **given), MODEL)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("images", "given", "says"),
    [
        (np.ones((2, 8, 3)), {}, None),
        (np.ones((8, 9, 3)), {}, "looks like a colour picture"),
        (np.ones(8), {}, r"shape \(8,\), must be \(K, H, W\) or \(H, W\)"),
        (np.ones((0, 8, 9)), {}, r"shape \(0, 8, 9\)"),
        ([np.ones((8, 9)), np.ones((9, 9))], {}, "images differ in shape"),
        (np.ones((2, 8, 9)), {"noise_sigma": [1.0]}, "noise_sigma has 1 value for 2 images"),
        (np.ones((8, 9)), {"background": [1.0, 2.0]}, "background has 2 values for 1 image"),
    ],
)
def test_images_that_belong_together(images, given, says):
    if says is None:
        assert len(Measurement(images, **given).each()) == 2
        return
    with pytest.raises(SamplingError, match=says):
        Measurement(images, **given).each()


def test_large_arrays_are_named_not_printed():
    assert repr(Measurement(IMAGE, masked=OUT)).startswith(
        "Measurement(image=<24x31 float64>, noise_sigma=None, masked=<24x31 bool>"
    )
