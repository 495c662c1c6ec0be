"""PCIN as published: its steps, its loss, cold and warm starts, and what its status says."""

from __future__ import annotations

import importlib
from dataclasses import replace

import numpy as np
import pytest

from nlosoptics import inverse
from nlosoptics.errors import SamplingError, SceneError
from nlosoptics.imaging import ForwardModel
from nlosoptics.inverse import Measurement
from nlosoptics.inverse.published.wu2024 import wu2024_fit

from ..by_name import called

SIDE = 32
MODES = range(4, 12)
COEFFICIENTS = np.array([0.15, -0.1, 0.12, 0.1, -0.08, 0.05, 0.1, -0.06])  # 0.28 waves rms
NOISE = 0.01


@pytest.fixture(scope="module")
def pupil_psf():
    return inverse.PupilPSF.from_zernike(
        MODES,
        wavelength=632.8e-9,
        pupil_radius=1e-3,
        image_distance=50e-3,
        pitch=632.8e-9 * 50e-3 / 2e-3 / 2,
        shape=SIDE,
    )


@pytest.fixture(scope="module")
def truth():
    picture = np.zeros((SIDE, SIDE))
    picture[6:26, 9:13] = 1.0
    picture[6:10, 9:23] = 1.0
    picture[14:18, 9:20] = 1.0
    return picture


@pytest.fixture(scope="module")
def image(pupil_psf, truth):
    wave = pupil_psf.coefficients.new_tensor(COEFFICIENTS)
    kernel = pupil_psf(wave).detach().double().numpy()
    blurred = ForwardModel(kernel, shape=(SIDE, SIDE), boundary="circular").forward(truth)
    noise = NOISE * blurred.max() * np.random.default_rng(0).normal(size=blurred.shape)
    return blurred + noise


@pytest.fixture(scope="module")
def sigma(image):
    return NOISE * image.max()


@pytest.fixture(scope="module")
def cold(image, pupil_psf, sigma):
    return wu2024_fit(Measurement(image, noise_sigma=sigma), pupil_psf, max_iterations=40, depth=3)


def test_steps_alternate(image, pupil_psf, sigma):
    """Angles move in step 1 and stand in step 2; each goes on where the other stopped."""
    found = wu2024_fit(
        Measurement(image, noise_sigma=sigma), pupil_psf, alternate=4, max_iterations=14, depth=3
    )
    moves = found.history["change"] > 0.0
    assert moves.tolist() == [True] * 4 + [False] * 4 + [True] * 4 + [False] * 2
    assert found.physical_parameters["iterations"] == 14
    objective = found.history["objective"]
    # no jump where one step hands over to the other: an Adam step of 0.01 changes it by far less
    assert abs(objective[4] - objective[3]) < 0.2 * objective[3]


def test_loss_is_that_of_the_paper(image, pupil_psf, sigma, cold):
    """W(9) by hand: squared error and total variation at the start of a warm run."""
    weight = 0.02
    warm = wu2024_fit(
        Measurement(image, noise_sigma=sigma),
        pupil_psf,
        start=cold,
        max_iterations=2,
        tv_weight=weight,
    )
    unit = image.max() - image.min()
    coefficients = pupil_psf.coefficients.new_tensor(cold.physical_parameters["coefficients"])
    kernel = pupil_psf(coefficients).detach().double().numpy()
    level = cold.object * cold.physical_parameters["gain"]
    seen = ForwardModel(kernel, shape=(SIDE, SIDE), boundary="circular").forward(level)
    seen = seen + cold.physical_parameters["background"]
    down, along = np.diff(level, axis=0)[:, :-1], np.diff(level, axis=1)[:-1]
    by_hand = ((seen - image) ** 2).sum() / unit**2
    by_hand += weight * np.hypot(down, along).sum() / unit
    # single precision, and a total variation that is rounded at a thousandth of the range
    assert warm.history["objective"][0] == pytest.approx(by_hand, rel=0.02)


def test_warm_start_goes_on_where_the_cold_one_stopped(image, pupil_psf, sigma, cold):
    warm = wu2024_fit(
        Measurement(image, noise_sigma=sigma), pupil_psf, start=cold, max_iterations=2
    )
    # one Adam step of the network was made after the last entry of the history
    assert warm.history["residual"][0] == pytest.approx(cold.score, rel=1e-3)
    again = wu2024_fit(
        Measurement(image, noise_sigma=sigma), pupil_psf, start=warm, max_iterations=20
    )
    assert again.score < cold.score


def test_published_numbers_of_steps(image, pupil_psf, sigma, cold, monkeypatch):
    allowed = []
    # the package's own name of that kind is the function
    module = importlib.import_module("nlosoptics.inverse.published.wu2024")

    def done(solver):
        allowed.append(solver.max_iterations)
        return True

    monkeypatch.setattr(module._Pcin, "done", done)
    for start, expected in ((None, 4000), (cold, 1800)):
        allowed.clear()
        wu2024_fit(Measurement(image, noise_sigma=sigma), pupil_psf, start=start, depth=3)
        assert set(allowed) == {expected}


def test_cold_start_is_random_and_of_the_rms_asked_for(image, pupil_psf, sigma):
    options = {"max_iterations": 2, "learning_rate": 1e-9, "depth": 3}
    image = Measurement(image, noise_sigma=sigma)
    found = [
        wu2024_fit(image, pupil_psf, start_rms=0.4, seed=seed, **options).physical_parameters[
            "coefficients"
        ]
        for seed in (0, 0, 1)
    ]
    assert found[0].tobytes() == found[1].tobytes()
    assert np.abs(found[0] - found[2]).max() > 0.05
    for coefficients in found:
        # rms over the pupil's square cells, not over the disc
        assert np.linalg.norm(coefficients) == pytest.approx(0.4, rel=0.15)
    assert not pupil_psf.coefficients.detach().any()


@pytest.mark.thorough
def test_the_wall_is_not_kept(image, truth, pupil_psf, sigma, cold):
    """Started within 0.03 waves of the wall it drifts to "no blur", and says so."""
    start = replace(
        cold, physical_parameters={**cold.physical_parameters, "coefficients": COEFFICIENTS + 0.01}
    )
    found = wu2024_fit(
        Measurement(image, noise_sigma=sigma), pupil_psf, start=start, max_iterations=600
    )
    assert inverse.registered_correlation(found, truth) < 0.9
    assert found.status == "ambiguous"


@pytest.mark.thorough
def test_no_blur_is_told(truth, pupil_psf):
    """A sharp image by a perfect wave has the trivial answer, and it is called by its name."""
    found = wu2024_fit(
        Measurement(truth, noise_sigma=0.05), pupil_psf, start_rms=0.02, max_iterations=200, depth=3
    )
    assert inverse.registered_correlation(found, truth) > 0.95
    assert found.status == "ambiguous"


def test_an_object_unlike_the_image_is_unconverged(image, pupil_psf, sigma, cold):
    """A network turned round sees dark where the image is bright."""
    turned = {
        **cold.physical_parameters,
        "network_weights": -cold.physical_parameters["network_weights"],
    }
    found = wu2024_fit(
        Measurement(image, noise_sigma=[sigma]),
        pupil_psf,
        start=replace(cold, physical_parameters=turned),
        max_iterations=1,
    )
    assert inverse.registered_correlation(found, image) < 0.95
    assert found.status == "unconverged"


def test_last_reconstruction_may_be_fed_back(image, pupil_psf, sigma, cold):
    found = wu2024_fit(
        Measurement(image, noise_sigma=sigma),
        pupil_psf,
        max_iterations=40,
        depth=3,
        network_input="reconstruction",
    )
    assert np.isfinite(found.object).all()
    # the first turn is the same, until the network is fed anew
    same = found.history["objective"][:20] == cold.history["objective"][:20]
    assert same.all()
    assert found.object.tobytes() != cold.object.tobytes()


def test_known_defocus_is_part_of_the_model(image, pupil_psf, sigma):
    options = {"max_iterations": 2, "depth": 3}
    one, stack = (Measurement(data, noise_sigma=sigma) for data in (image, image[None]))
    plain = wu2024_fit(one, pupil_psf, **options).score
    # no defocus, said so, and of one frame in a stack
    assert wu2024_fit(stack, pupil_psf, defocus=[0.0], **options).score == plain
    assert wu2024_fit(one, pupil_psf, defocus=[300e-9], **options).score != plain


def test_uniform_image_is_too_few_photons(pupil_psf):
    found = wu2024_fit(np.full((SIDE, SIDE), 2.0), pupil_psf)
    assert found.status == "too_few_photons"
    assert not found.object.any()


@pytest.mark.parametrize(
    ("change", "kind", "words"),
    [
        ({"images": np.ones((3, SIDE, SIDE))}, SamplingError, "images has 3 frames"),
        ({"images": np.ones((8, 8))}, SamplingError, r"image has shape \(8, 8\)"),
        ({"images": np.full((SIDE, SIDE), np.nan)}, SceneError, "values that are not finite"),
        ({"pupil_psf": 3}, SceneError, "pupil_psf of type int"),
        ({"defocus": [0.0, 1e-7]}, SamplingError, "defocus has shape"),
        ({"defocus": [0.5]}, SceneError, "metres, not waves"),
        ({"defocus": "far"}, SceneError, "defocus of type str is not an array"),
        ({"start": "kept.npz"}, SceneError, "start of type str is no Reconstruction"),
        ({"images": [[1.0], [2.0, 3.0]]}, SamplingError, "images differ in shape"),
        ({"noise_sigma": [[1.0], [2.0, 3.0]]}, SceneError, "noise_sigma of type list has rows"),
        ({"start_rms": 0.0}, SceneError, "start_rms = 0 is out of range"),
        ({"alternate": 0}, SceneError, "alternate = 0 is out of range"),
        ({"max_iterations": -1}, SceneError, "max_iterations = -1 is out of range"),
        ({"network_input": "both"}, SceneError, "network_input = 'both' is unknown"),
    ],
)
def test_bad_input_is_refused_in_one_line(image, pupil_psf, change, kind, words):
    options = {"images": image, "pupil_psf": pupil_psf, **change}
    with pytest.raises(kind, match=words) as caught:
        called(wu2024_fit, options.pop("images"), options.pop("pupil_psf"), **options)
    assert "\n" not in str(caught.value)


def test_start_of_another_solver_is_refused(image, pupil_psf, cold):
    model = ForwardModel(np.ones((1, 1)), shape=(SIDE, SIDE))
    with pytest.raises(SceneError, match="start has no coefficients"):
        wu2024_fit(image, pupil_psf, start=inverse.wiener(image, model))
    short = {**cold.physical_parameters, "coefficients": np.zeros(3)}
    with pytest.raises(SamplingError, match=r"start has coefficients of shape \(3,\)"):
        wu2024_fit(image, pupil_psf, start=replace(cold, physical_parameters=short))
    cut = {**cold.physical_parameters, "network_weights": np.zeros(5, np.float32)}
    with pytest.raises(SamplingError, match="start has 5 network_weights"):
        wu2024_fit(image, pupil_psf, start=replace(cold, physical_parameters=cut))


def test_noise_and_background_may_be_those_of_a_list_of_one(image, pupil_psf, sigma):
    options = {"max_iterations": 2}
    veil = np.full(image.shape, 0.1)
    expected = wu2024_fit(
        Measurement(image, noise_sigma=sigma, background=veil), pupil_psf, **options
    ).physical_parameters
    for noise, known in (([sigma], veil), (np.full((1, SIDE, SIDE), sigma), veil[None])):
        found = wu2024_fit(
            Measurement(image[None], noise_sigma=noise, background=known), pupil_psf, **options
        ).physical_parameters
        # rounding of the mean of a map of noise
        assert found["background"] == pytest.approx(expected["background"], rel=1e-4)


def test_no_iterations_are_refused(image, pupil_psf, sigma):
    with pytest.raises(SceneError, match="max_iterations = 0"):
        wu2024_fit(Measurement(image, noise_sigma=sigma), pupil_psf, max_iterations=0)
