"""First steps of the published methods, and their training pairs, on record."""

import numpy as np
import pytest

from nlosoptics import inverse
from nlosoptics.imaging import ForwardModel

SINGLE = 1e-3  # rounding of some steps in single precision
SIDE = 20


@pytest.fixture(scope="module")
def picture():
    values = np.zeros((SIDE, SIDE))
    values[4:12, 5:8] = 1.0
    values[4:6, 5:11] = 0.7
    return values


@pytest.mark.parametrize("method", ["alternating", "hio", "raar"])
def test_phase_retrieval(method, picture, on_record):
    kernel = np.random.default_rng(2).random((SIDE, SIDE)) ** 8
    image = ForwardModel(kernel / kernel.sum(), shape=picture.shape).forward(picture) + 0.1
    power = np.abs(np.fft.fft2(picture, (2 * SIDE - 1,) * 2)) ** 2
    lags = np.fft.fftshift(np.fft.ifft2(power).real)
    asked = {"method": method, "restarts": 4, "max_iterations": 6}
    found = [
        inverse.phase_retrieval(image, seed=1, object_size=(8, 6), **asked),
        inverse.object_from_autocorrelation(lags, **asked),
    ]
    on_record([[one.object, one.score, dict(one.history)] for one in found], SINGLE)


@pytest.mark.parametrize("waves", [0.1, 0.6])
def test_training_pairs(waves, examples, on_record):
    from nlosoptics import Scene

    scene = Scene.load(examples / "scenes" / "letter_flat.toml")
    told = []
    asked = {"size": 32, "waves": waves, "progress": lambda *step: told.append(step)}
    on_record([inverse.training_pairs(scene, 3, seed=2, **asked), told], SINGLE)


def test_training(examples, on_record):
    """The texts' numbers are rounded to what single precision can repeat."""
    from nlosoptics import Scene

    scene = Scene.load(examples / "scenes" / "letter_flat.toml")
    pairs, told = inverse.training_pairs(scene, 6, size=32, waves=0.3, seed=1), []
    asked = {"base": 8, "depth": 2, "epochs": 3, "batch": 2, "validation": 0.4, "seed": 2}
    found = inverse.train_cnn(pairs, progress=lambda *step: told.append(step), **asked)
    steps = [[text.split(",")[0].split(" 0.")[0], share] for text, share in told]
    on_record([found, steps, len(told)], SINGLE)


def test_fits(picture, on_record):
    optics = {"wavelength": 6e-7, "pupil_radius": 1e-3, "image_distance": 0.05, "pitch": 7e-6}
    pupil = inverse.PupilPSF.from_zernike({4: 3e-8, 6: 6e-8}, shape=SIDE, **optics)
    kernel = pupil().detach().numpy().astype(float)
    model = ForwardModel(kernel / kernel.sum(), shape=picture.shape)
    image = model.forward(picture) + 0.01 * np.random.default_rng(1).normal(size=picture.shape)
    small = {"base": 8, "depth": 2, "max_iterations": 4}
    image = inverse.Measurement(image, noise_sigma=0.01)
    found = [
        inverse.deep_image_prior(image, model, **small),
        inverse.deep_image_prior(image, model, guide="noise", tv_weight=0.01, **small),
        inverse.wu2024_fit(image, pupil, **small),
        inverse.wu2024_fit(image, pupil, alternate=1, seed=3, **small),
    ]
    on_record([[one.object, dict(one.physical_parameters)] for one in found], SINGLE)
