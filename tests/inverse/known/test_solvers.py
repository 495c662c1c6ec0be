"""Properties common to all solvers: array types, status, progress, one-line errors."""

from __future__ import annotations

import inspect
import subprocess
import sys

import numpy as np
import pytest
import torch

from nlosoptics import inverse
from nlosoptics.errors import SamplingError, SceneError
from nlosoptics.imaging import ForwardModel
from nlosoptics.inverse import Measurement

from ..by_name import NAMES, called

SOLVERS = [inverse.inverse_filter, inverse.richardson_lucy, inverse.tv_deconvolve, inverse.wiener]


@pytest.fixture(params=SOLVERS, ids=lambda solver: solver.__name__)
def solver(request):
    return request.param


@pytest.fixture(scope="module")
def small():
    rng = np.random.default_rng(0)
    truth = np.zeros((32, 40))
    truth[8:20, 12:26] = 1.0
    model = ForwardModel(np.full((5, 5), 0.04), shape=truth.shape)
    return model.forward(truth) + 0.02 * rng.normal(size=truth.shape), model


def test_array_gives_array_and_tensor_gives_tensor(solver, small):
    image, model = small
    found = solver(Measurement(image, noise_sigma=0.02), model)
    assert isinstance(found.object, np.ndarray)
    assert found.object.dtype == np.float64
    assert found.object.max() == 1.0
    assert found.seconds > 0.0
    for dtype in (torch.float32, torch.float64):
        tensor = solver(Measurement(torch.from_numpy(image).to(dtype), noise_sigma=0.02), model)
        assert tensor.object.dtype == dtype
        # the image was rounded to single precision
        np.testing.assert_allclose(tensor.object.numpy(), found.object, atol=1e-4)


@pytest.mark.thorough
def test_same_bits_again_and_on_any_number_of_threads(solver, case):
    data, model = case("F", "speckle")
    before = torch.get_num_threads()
    results = []
    try:
        for threads in (1, 1, 2):
            torch.set_num_threads(threads)
            results.append(
                solver(Measurement(data.image, noise_sigma=data.noise_sigma), model).object
            )
    finally:
        torch.set_num_threads(before)
    first, again, two = results
    assert again.tobytes() == first.tobytes()
    assert two.tobytes() == first.tobytes()


def test_reconstruction_is_read_only(solver, small):
    found = called(solver, *small, noise_sigma=0.02)
    with pytest.raises(ValueError, match="read-only"):
        found.history["residual"][0] = 0.0
    with pytest.raises(AttributeError):
        found.status = "converged"


def test_progress_ends_at_one_when_converged(solver, small):
    calls = []
    found = called(solver, *small, noise_sigma=0.02, progress=lambda *call: calls.append(call))
    assert found.status == "converged"
    assert calls[-1][1] == 1.0
    assert all(0.0 <= done <= 1.0 and text for text, done in calls)


@pytest.mark.parametrize("noise_sigma", [None, 1.0, "map"])
def test_noise_alone_is_too_few_photons(solver, small, noise_sigma):
    _, model = small
    image = 100.0 + np.random.default_rng(3).normal(size=model.shape)
    sigma = np.full(model.shape, 1.0) if noise_sigma == "map" else noise_sigma
    found = solver(Measurement(image, noise_sigma=sigma), model)
    assert found.status == "too_few_photons"
    assert not found.object.any()
    # mean of 1280 unit normals
    assert found.physical_parameters["background"] == pytest.approx(100.0, abs=0.1)
    assert found.history["residual"].size == 0


@pytest.mark.parametrize("level", [0.0, 5.0])
@pytest.mark.parametrize("noise_sigma", [None, 0.1])
def test_uniform_image_is_too_few_photons(solver, small, level, noise_sigma):
    _, model = small
    found = solver(Measurement(np.full(model.shape, level), noise_sigma=noise_sigma), model)
    assert found.status == "too_few_photons"
    assert not found.object.any()
    assert found.score == 0.0
    assert found.physical_parameters["background"] == level


@pytest.mark.parametrize(
    ("change", "kind", "words"),
    [
        ({"image": np.full((32, 40), np.nan)}, SceneError, "image has 1280 of 1280 values"),
        ({"image": np.zeros((40, 32))}, SamplingError, r"image has shape \(40, 32\), must be"),
        ({"image": "F.png"}, SceneError, "image of type str is not an array"),
        ({"model": "disc"}, SceneError, "model of type str is not an image model"),
        ({"noise_sigma": -1.0}, SceneError, "noise_sigma = -1 is out of range"),
        ({"noise_sigma": 0.0}, SceneError, "noise_sigma = 0 is out of range"),
        ({"noise_sigma": np.zeros((32, 40))}, SceneError, "noise_sigma = 0 is out of range"),
        ({"noise_sigma": np.ones((3, 3))}, SamplingError, r"noise_sigma has shape \(3, 3\)"),
        ({"noise_sigma": np.inf}, SceneError, "noise_sigma = inf is not finite"),
        ({"background": np.ones((3, 3))}, SamplingError, r"background has shape \(3, 3\)"),
        ({"background": [[1.0], [2.0, 3.0]]}, SceneError, "background of type list has rows"),
        ({"noise_sigma": [[1.0], [2.0, 3.0]]}, SceneError, "noise_sigma of type list has rows"),
        ({"background": np.nan}, SceneError, "background = nan is not finite"),
        ({"gain": 0.0}, SceneError, "gain = 0 is out of range"),
        ({"max_iterations": 0}, SceneError, "max_iterations = 0 is out of range"),
        ({"tolerance": -1e-3}, SceneError, "tolerance = -0.001 is out of range"),
        ({"tolerance": 1.0}, SceneError, "tolerance = 1 is out of range"),
    ],
)
def test_bad_input_is_refused_in_one_line(solver, small, change, kind, words):
    if not change.keys() - NAMES <= inspect.signature(solver).parameters.keys():
        pytest.skip(f"{solver.__name__} does not iterate")
    image, model = small
    options = {"image": image, "model": model, **change}
    with pytest.raises(kind, match=words) as caught:
        called(solver, options.pop("image"), options.pop("model"), **options)
    assert "\n" not in str(caught.value)


def test_bad_weight_is_refused(small):
    with pytest.raises(SceneError, match="tv_weight = 0 is out of range"):
        inverse.tv_deconvolve(*small, tv_weight=0.0)


def test_without_torch_the_remedy_is_one_line():
    code = (
        "import sys; sys.modules['torch'] = None\n"
        "import nlosoptics\n"
        "from nlosoptics.errors import MissingExtraError\n"
        "try:\n    nlosoptics.inverse.wu2024_fit\n"
        "except MissingExtraError as error:\n    print(error)\n"
    )
    run = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120
    )
    assert run.stdout.strip() == (
        "nlosoptics.inverse.wu2024_fit needs torch, which is not installed; pip install "
        "'nlosoptics[inverse]'"
    )


@pytest.mark.thorough
def test_total_variation_and_scores_load_no_torch():
    code = (
        "import sys, numpy as np\n"
        "from nlosoptics import imaging, inverse\n"
        "model = imaging.ForwardModel(np.full((3, 3), 1 / 9), shape=(16, 16))\n"
        "truth = np.pad(np.ones((6, 6)), 5)\n"
        "image = inverse.Measurement(model.forward(truth), noise_sigma=0.01)\n"
        "found = inverse.tv_deconvolve(image, model)\n"
        "assert inverse.registered_correlation(found, truth) > 0.95\n"
        "sys.exit('torch' in sys.modules)\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=120)


def test_background_of_known_shape_and_unknown_strength_is_taken_out(solver, small):
    """A sloping veil is recovered with its strength; a uniform one in its place is not enough."""
    image, model = small
    veil = np.linspace(0.2, 1.8, image.shape[1]) * np.ones(image.shape)
    veiled = image + 3.0 * veil
    clean = solver(Measurement(image, noise_sigma=0.02, fit_background=False), model)
    shaped = solver(Measurement(veiled, noise_sigma=0.02, background_shape=veil, gain=1.0), model)
    flat = solver(Measurement(veiled, noise_sigma=0.02, gain=1.0), model)
    truth = clean.object * clean.physical_parameters["gain"]

    def error(found):
        return np.abs(found.object - truth).mean()

    # 0.02 of noise over 1280 pixels fixes the strength to 1e-3; edges share it with the object
    assert shaped.physical_parameters["background"] == pytest.approx(3.0, abs=0.02)
    assert error(shaped) < 0.02
    assert error(flat) > 10 * error(shaped)


def test_uniform_shape_is_the_default(solver, small):
    image, model = small
    plain = solver(Measurement(image, noise_sigma=0.02), model).object
    shaped = solver(
        Measurement(image, noise_sigma=0.02, background_shape=np.full(image.shape, 7.0)), model
    )
    # the same sums in another order, in single precision
    np.testing.assert_allclose(shaped.object, plain, atol=1e-4)


@pytest.mark.parametrize("shape", [np.zeros((32, 40)), np.full((32, 40), -1.0)])
def test_background_shape_without_light_is_refused(solver, small, shape):
    image, model = small
    with pytest.raises(SceneError, match="background_shape spans"):
        solver(Measurement(image, background_shape=shape), model)
