"""Images of one object prepared for a fit, and checks of what is known of them, from NumPy."""

from __future__ import annotations

import numpy as np
import pytest

from nlosoptics.errors import SamplingError, SceneError
from nlosoptics.inverse import Measurement, PupilPSF
from nlosoptics.inverse.wave.frames import frames_of

SIDES = (11, 14)
IMAGES = (
    np.random.default_rng(7).uniform(3.0, 9.0, (3, *SIDES))
    * np.array([1.0, 2.5, 0.4])[:, None, None]
)


def pupil(shape=SIDES, modes=(4, 6, 9)):
    return PupilPSF.from_zernike(
        modes, wavelength=6e-7, pupil_radius=1.1e-3, image_distance=0.07, pitch=7e-6, shape=shape
    )


def test_images_in_units_of_the_largest_range():
    noise = np.array([0.3, 0.5, 0.2])[:, None, None] * np.ones((3, *SIDES))
    noise[1, :4] *= 3.0
    noise[2, 5, 6:9] = np.inf
    ramp = 1.0 + np.arange(14) * np.ones((11, 1))
    given = {"background": [0.5, 0.7, 0.1], "background_shape": ramp}
    seen = Measurement(IMAGES, noise_sigma=noise, **given)
    found = frames_of(seen, pupil((16, 14)), defocus=[0.0, 2e-7, -3e-7])
    plain = IMAGES - np.array(given["background"])[:, None, None]
    held = np.isfinite(noise)
    assert found.scale == pytest.approx(max(np.ptp(one) for one in plain), rel=1e-6)
    off = np.abs(found.images * found.scale - plain)[held]
    assert off.max() < 1e-6 * plain.max()  # in single precision
    precision = noise**-2.0
    means = precision.mean(axis=(1, 2))
    assert found.counted.tolist() == [154.0, 154.0, 151.0]
    weights = np.stack([one.weights for one in found.measured])
    assert weights == pytest.approx(precision / means[:, None, None], rel=1e-5)
    assert found.sigmas * found.scale == pytest.approx(means**-0.5, rel=1e-6)
    assert found.shape == SIDES
    assert found.defocus.tolist() == [0.0, 2e-7, -3e-7]
    assert len(found.measured) == 3


def test_images_of_which_nothing_is_known():
    found = frames_of(Measurement(IMAGES[0], noise_sigma=0.2, fit_background=False), pupil())
    assert found.images.shape == (1, *SIDES)
    assert found.defocus.tolist() == [0.0]
    assert (found.measured[0].weights == 1.0).all()
    assert found.picture("prior", None) is None
    even = frames_of(Measurement(np.full((2, *SIDES), 4.0), noise_sigma=[0.2, 0.6]), pupil())
    assert even.scale == pytest.approx(0.6)
    assert even.sigmas == pytest.approx([1 / 3, 1.0])


def test_pictures_of_a_user():
    frames = frames_of(Measurement(IMAGES, noise_sigma=0.2), pupil())
    one = np.zeros(SIDES)
    one[0, 0] = 1e-9
    assert frames.picture("prior", one).tolist() == one.tolist()
    wrong = np.full(SIDES, 2.0)
    wrong[3, 4] = np.nan
    for bad, words in (
        (np.ones((14, 11)), r"prior has shape \(14, 11\), must be \(11, 14\) like the images"),
        (np.zeros(SIDES), "prior spans 0 to 0, must be finite and non-negative with some light"),
        (one - 1e-12, "prior spans -1e-12 to "),
        (wrong, "prior spans nan to nan"),
    ):
        with pytest.raises((SamplingError, SceneError), match=words):
            frames.picture("prior", bad)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"pupil_psf": 3.0}, "pupil_psf of type float is not a point spread with an unknown wave"),
        ({"pupil_psf": (10, 14)}, r"pupil_psf has shape \(10, 14\) and the images \(11, 14\)"),
        ({"pupil_psf": (11, 13)}, r"pupil_psf has shape \(11, 13\) and the images \(11, 14\)"),
        ({"noise_sigma": [0.2, 0.0, 0.1]}, "noise"),
        ({"defocus": [0.0, 1e-7]}, r"defocus has shape \(2,\), must be \(3,\); give one value per"),
        ({"defocus": [0.0, np.nan, 0.0]}, r"defocus = \[0.0, nan, 0.0\] m rms, limit"),
    ],
)
def test_images_that_do_not_fit_are_refused(change, words):
    asked = {"noise_sigma": 0.2, "pupil_psf": SIDES} | change
    spread = asked.pop("pupil_psf")
    spread = pupil(spread) if isinstance(spread, tuple) else spread
    seen = Measurement(IMAGES, noise_sigma=asked.pop("noise_sigma"))
    with pytest.raises((SamplingError, SceneError), match=words):
        frames_of(seen, spread, **asked)
