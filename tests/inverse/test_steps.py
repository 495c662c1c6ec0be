"""All that leads to a reconstruction, on record: what every function returns on the way."""

import numpy as np
import pytest
import torch

from nlosoptics import inverse
from nlosoptics.imaging import ForwardModel
from nlosoptics.inverse import PupilPSF, SceneLeaves

from ..records import attempt
from ..runs.random_scenes import random_case
from ..steps import NEAR, steps

SHAPE = (18, 23)


def measured(boundary="padded"):
    rng = np.random.default_rng(3)
    truth = np.zeros(SHAPE)
    truth[5:12, 7:15] = rng.random((7, 8)) + 0.3
    kernel = np.outer(np.arange(1.0, 6.0), [1, 2, 4, 1])
    model = ForwardModel(kernel / kernel.sum(), shape=SHAPE, boundary=boundary)
    return model.forward(truth) + 0.1 + 0.02 * rng.normal(size=SHAPE), model


KNOWN = {
    "default": {},
    "known noise": {"noise_sigma": 0.03},
    "gain": {"fit_background": False, "background": 0.1, "gain": 1.3},
    "map": {"noise_sigma": np.linspace(0.02, 0.05, SHAPE[1]) * np.ones(SHAPE)},
}


@pytest.mark.parametrize("boundary", ["padded", "circular"])
@pytest.mark.parametrize("options", KNOWN)
def test_known_point_spreads(options, boundary, on_record):
    image, model = measured(boundary)
    solvers = (inverse.richardson_lucy, inverse.tv_deconvolve, inverse.wiener)

    def solved():
        attempt(inverse.inverse_filter, image, model, **KNOWN[options])
        for one in solvers:
            for most in (1, 3, 9):
                attempt(one, image, model, max_iterations=most, **KNOWN[options])
        tensor = torch.from_numpy(image)
        attempt(inverse.tv_deconvolve, tensor, model, max_iterations=3, **KNOWN[options])

    on_record(steps(solved, "inverse/known"), NEAR)


@pytest.mark.parametrize("method", ["alternating", "hio", "raar"])
def test_phase_retrieval(method, on_record):
    rng = np.random.default_rng(2)
    picture = np.zeros((20, 20))
    picture[4:12, 5:8] = picture[4:6, 5:11] = 0.8
    kernel = rng.random((20, 20)) ** 8
    image = ForwardModel(kernel / kernel.sum(), shape=picture.shape).forward(picture) + 0.1
    asked = {"method": method, "restarts": 3, "max_iterations": 3, "seed": 1}

    def found():
        attempt(inverse.phase_retrieval, image, object_size=(8, 6), **asked)
        attempt(inverse.phase_retrieval, image, **asked)

    on_record(steps(found, "inverse/published"), 1e-4)


@pytest.mark.parametrize("number", [0, 3, 6, 9])
def test_waves_of_a_scene(number, on_record):
    scene = random_case(number).scene
    asked = {"pitch": scene.camera.image_pitch, "shape": 16, "dtype": torch.float64}
    names = ["wall_radius", "object_position", "object_tilt", "camera_position", "focus_distance"]

    def made():
        psf = attempt(PupilPSF.from_scene, scene, [4, 5, 8], **asked)
        if isinstance(psf, PupilPSF):
            attempt(psf.image, torch.ones((16, 16), dtype=torch.float64), defocus=[0.0, 2e-7])
        for name in names:
            leaves = attempt(SceneLeaves, scene, [name], **asked)
            if isinstance(leaves, SceneLeaves):
                attempt(leaves)

    on_record(steps(made, "inverse/wave"), NEAR)
