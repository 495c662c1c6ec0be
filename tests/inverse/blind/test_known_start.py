"""Blind fits with prior knowledge: a start, a known object, gains."""

from __future__ import annotations

import functools
import importlib.util
import sys

import numba
import numpy as np
import pytest
import torch

from nlosoptics import inverse
from nlosoptics.errors import NlosError, SamplingError, SceneError
from nlosoptics.imaging import ForwardModel
from nlosoptics.inverse import Measurement, PupilPSF, evidence_fit, pcin, registered_correlation
from nlosoptics.inverse.blind.free_energy import FreeEnergy
from nlosoptics.inverse.blind.search_settings import Stage
from nlosoptics.inverse.wave.frames import frames_of
from nlosoptics.inverse.wave.pupil_waves import noll_mode
from nlosoptics.psf import Wavefront, point_spread
from nlosoptics.scene import Scene

from ..by_name import called

# Walls that no schedule was tuned on.
WALL = 31


@pytest.fixture(scope="module")
def cases(root):
    """The benchmark's generator of images by unknown walls."""
    spec = importlib.util.spec_from_file_location("cases", root / "benchmarks/inverse/cases.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules["cases"] = module
    spec.loader.exec_module(module)
    module.case = functools.cache(module.case)
    return module


def unknown(data, coefficients, modes, **options):
    """Point spread that starts at given coefficients; its pitch is Nyquist's, 1e-4 off."""
    optics = dict(data.pupil)
    nyquist = optics["wavelength"] * optics["image_distance"] / (4 * optics["pupil_radius"])
    optics["pitch"] = min(optics["pitch"], nyquist)
    options = {"shape": data.truth.shape, **options}
    spread = PupilPSF.from_zernike(modes, **optics, **options)
    values = torch.tensor(np.asarray(coefficients), dtype=spread.coefficients.dtype)
    spread.coefficients = torch.nn.Parameter(values)
    return spread


@pytest.fixture(scope="module")
def near(cases):
    """One image, the start a tenth of a wave off, and the fit."""
    data = cases.case("F", WALL, rms_waves=0.4)
    first = cases.start(data.coefficients, 0.1, WALL)
    found = pcin(data.images[0], unknown(data, first, cases.MODES), start_error=0.1)
    return data, first, found


@pytest.mark.thorough
def test_one_image_and_a_start_a_tenth_of_a_wave_off(near):
    data, first, found = near
    # the goal for every wall; other walls' figures are in the benchmark
    assert registered_correlation(found, data.truth) >= 0.97
    assert found.status == "converged"
    coefficients = found.physical_parameters["coefficients"]
    assert coefficients.shape == first.shape
    assert np.linalg.norm(coefficients - data.coefficients) < 0.1


@pytest.mark.thorough
def test_a_start_rules_no_blur_out_where_free_energies_are_alike(cases):
    """Of a busy object no blur is as likely as the truth; what is known of the wall decides."""
    data = cases.case("hanzi_zhong", 5, rms_waves=0.5)
    first = cases.start(data.coefficients, 0.1, 5)
    found = pcin(data.images[0], unknown(data, first, cases.MODES), start_error=0.1)
    # not below it by the 50 that would be sufficient without the prior
    assert found.physical_parameters["margin"] > -50.0
    assert registered_correlation(found, data.truth) > 0.95
    assert found.status == "converged"


@pytest.mark.thorough
def test_score_and_background_are_those_of_the_answer(near):
    data, _, found = near
    wave = Wavefront.from_zernike(
        dict(zip(range(4, 22), found.physical_parameters["coefficients"] * 632.8e-9, strict=True)),
        **{name: data.pupil[name] for name in ("wavelength", "pupil_radius", "image_distance")},
    )
    pitch = data.pupil["wavelength"] * wave.f_number / 2 * (1 - 1e-9)
    kernel = point_spread(wave, pitch=pitch, shape=257, method="fft", tol=1e-4)
    seen = ForwardModel(kernel, shape=data.truth.shape).forward(found.object)
    known = found.physical_parameters
    residual = data.images[0] - known["gain"] * seen - known["background"]
    rms = np.sqrt(np.mean(residual**2)) / known["noise_sigma"]
    # the fit's period is 1.5 frames: light that the wave throws farther enters over its edges
    assert rms == pytest.approx(found.score, rel=0.1)
    assert abs(residual.mean()) < 0.2 * known["noise_sigma"]


@pytest.mark.thorough
def test_residuals_prefer_no_blur_and_free_energy_the_wall(near, cases):
    data = near[0]
    pupil = unknown(data, data.coefficients, cases.MODES)
    frames = frames_of(Measurement(data.images, noise_sigma=data.noise_sigma), pupil)
    energy = FreeEnergy(frames, pupil, grid=(96, 96))
    held = Stage(iterations=300, kappa=0.5, first=1.0, last=1.0, share=1.0, wave_rate=0.0)
    both = np.stack([np.zeros(18), data.coefficients])
    found = energy.descend(energy.starts(both, 1.0), held)
    assert np.array_equal(found.coefficients, both.astype(np.float32))
    assert found.chi_square[0, 0] < found.chi_square[1, 0]
    assert found.energy[0] > found.energy[1]


@pytest.mark.thorough
def test_a_known_object_tells_the_wall(cases):
    data = cases.case("R", WALL, rms_waves=0.5)
    start = unknown(data, np.zeros(18), cases.MODES)
    found = evidence_fit(data.images, start, known_object=data.truth)
    assert found.status == "converged"
    # what was given, up to its unit
    np.testing.assert_allclose(found.object, data.truth, atol=1e-6)
    image = cases.case("F", WALL, rms_waves=0.5)
    learnt = unknown(image, found.physical_parameters["coefficients"], cases.MODES)
    again = evidence_fit(image.images, learnt, start_error=0.1)
    assert registered_correlation(again, image.truth) >= 0.95


@pytest.mark.thorough
def test_modes_are_added_while_the_residual_exceeds_the_noise():
    """A quarter of a wave in trefoil, which is not among the given modes."""
    images, spread, defocus, truth = made(gains=(1.0, 1.0), hidden=0.25)
    found = evidence_fit(images, spread, defocus=defocus, start_error=0.1, max_iterations=1)
    settled = found.physical_parameters
    assert found.status == "converged"
    # coma and trefoil, orders up to 5 at least
    assert settled["more_modes"][:4].tolist() == [7, 8, 9, 10]
    assert settled["coefficients"] == pytest.approx(WAVE, abs=0.02)
    assert settled["more_coefficients"][2] == pytest.approx(0.25, abs=0.02)
    assert registered_correlation(found, truth) > 0.99
    images, spread, defocus, _ = made(gains=(1.0, 1.0))
    found = evidence_fit(images, spread, defocus=defocus, start_error=0.1, max_iterations=1)
    assert found.physical_parameters["more_modes"].size == 0


WAVE = (0.15, -0.1, 0.1)


def made(shape=(32, 40), gains=(1.0,), noise=0.01, hidden=0.0):
    """Images of a rectangle by three modes, and a ninth of given strength, waves."""
    optics = {"wavelength": 6e-7, "pupil_radius": 1e-3, "image_distance": 0.06, "pitch": 9e-6}
    spread = PupilPSF.from_zernike((4, 5, 6), **optics, shape=shape)
    twice = (2 * shape[0], 2 * shape[1])
    full = PupilPSF.from_zernike((4, 5, 6, 9), **optics, shape=twice)
    truth = np.zeros(shape)
    truth[10:20, 12:26] = 1.0
    defocus = [3e-7 * k for k in range(len(gains))]
    with torch.no_grad():
        spread.coefficients.copy_(torch.tensor(WAVE))
        spreads = full(torch.tensor([*WAVE, hidden]), defocus=defocus).double().numpy()
    light = np.stack([ForwardModel(s, shape=shape).forward(truth) for s in spreads])
    rng = np.random.default_rng(0)
    clean = light * np.array(gains)[:, None, None] * 500.0
    sigma = noise * clean.max()
    images = clean + sigma * rng.normal(size=clean.shape)
    return images, spread, np.array(defocus), truth


NEAR = {"start_error": 0.1, "max_iterations": 1}


@pytest.mark.thorough
def test_same_seed_same_bits_and_kinds_in_kinds_out():
    images, spread, defocus, _ = made(gains=(1.0, 1.0))
    with torch.no_grad():
        spread.coefficients.zero_()
    before = spread.coefficients.detach().clone()
    options = {"defocus": defocus, "max_iterations": 1}
    first = evidence_fit(images, spread, **options)
    threads = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        again = evidence_fit(images, spread, **options)
    finally:
        numba.set_num_threads(threads)
    assert first.object.tobytes() == again.object.tobytes()
    assert torch.equal(before, spread.coefficients)
    assert not first.history["residual"].flags.writeable
    other = evidence_fit(images, spread, seed=3, **options)
    assert other.object.tobytes() != first.object.tobytes()
    rounded = images.astype(np.float32)  # a search may go another way from there
    tensors = evidence_fit(torch.from_numpy(rounded), spread, **options)
    assert tensors.object.dtype == torch.float32
    arrays = evidence_fit(rounded.astype(float), spread, **options)
    np.testing.assert_allclose(tensors.object.numpy(), arrays.object, atol=1e-6)


@pytest.mark.thorough
def test_relative_gains_of_images():
    images, spread, defocus, truth = made(gains=(1.0, 0.6))
    found = evidence_fit(images, spread, defocus=defocus, **NEAR)
    gains = found.physical_parameters["image_gains"]
    # noise of 1 % on hundreds of lit pixels; the rest is the fit's bias to smooth objects
    assert gains[1] / gains[0] == pytest.approx(0.6, rel=0.02)
    assert registered_correlation(found, truth) > 0.98
    assert found.physical_parameters["background"].shape == (2,)


@pytest.mark.thorough
def test_pixels_of_infinite_noise_have_no_say():
    images, spread, defocus, truth = made(gains=(1.0, 1.0))
    noise = np.full(images.shape, 0.01 * images.max())
    hot = np.random.default_rng(4).random(images.shape) < 0.02
    noise[hot] = np.inf
    spoilt = [np.where(hot, value, images) for value in (0.0, 1e5)]
    options = {"defocus": defocus, **NEAR}
    found, other = (
        evidence_fit(Measurement(one, noise_sigma=noise), spread, **options) for one in spoilt
    )
    assert np.array_equal(found.object, other.object)
    assert found.status == "converged"
    assert registered_correlation(found, truth) > 0.98


@pytest.mark.thorough
def test_hot_pixels_are_found_and_named():
    images, spread, defocus, truth = made(gains=(1.0, 1.0))
    hot = np.zeros(images.shape, dtype=bool)
    hot[0, 5, 7] = hot[1, 20, 9] = hot[1, 12, 30] = True
    spoilt = np.where(hot, 4.0 * images.max(), images)
    found = evidence_fit(spoilt, spread, defocus=defocus, **NEAR)
    assert np.array_equal(found.physical_parameters["bad_pixel_map"], hot)
    assert found.physical_parameters["bad_pixels"] == 3
    assert registered_correlation(found, truth) > 0.98


@pytest.mark.thorough
def test_a_given_wall_of_unknown_error_is_one_more_start():
    """It is right, so that no other wall is tried; without it the first answer takes a search."""
    images, spread, defocus, truth = made(gains=(1.0, 1.0))
    told = []
    found = evidence_fit(
        images, spread, defocus=defocus, progress=lambda text, _: told.append(text)
    )
    assert found.status == "converged"
    assert registered_correlation(found, truth) > 0.99
    assert not any("random" in text for text in told)


@pytest.mark.thorough
def test_progress_grows_to_the_end():
    images, spread, _, _ = made()
    told = []
    evidence_fit(images, spread, progress=lambda text, done: told.append(done), **NEAR)
    assert told == sorted(told)
    assert 0.0 <= told[0] < 0.1
    assert told[-1] == 1.0


def test_light_of_nothing_with_a_known_object_is_finite():
    _, spread, _, truth = made()
    noise = 5.0 + np.random.default_rng(1).normal(size=(32, 40))
    found = evidence_fit(Measurement(noise, noise_sigma=1.0), spread, known_object=truth, **NEAR)
    assert found.status == "too_few_photons"
    assert not found.object.any()
    # 1 to four standard errors of an rms of 1280 values
    assert found.score == pytest.approx(1.0, abs=0.08)


@pytest.mark.thorough
def test_gradients_switched_off_outside_change_nothing():
    images, spread, _, _ = made()
    expected = evidence_fit(images, spread, **NEAR)
    with torch.inference_mode():
        found = evidence_fit(images, spread, **NEAR)
    np.testing.assert_array_equal(found.object, expected.object)


def test_a_scene_s_known_wave_is_part_of_the_model(examples):
    """Two modes of a scene's wall are fitted, and the rest is the scene's."""
    scene = Scene.load(examples / "scenes" / "letter_speckle.toml")
    optics = {"pitch": scene.camera.image_pitch, "pixel_integrated": True}
    spread = PupilPSF.from_scene(scene, [4, 5], shape=(32, 40), **optics)
    wide = PupilPSF.from_scene(scene, [4, 5], shape=(64, 80), **optics)
    frames = frames_of(
        Measurement(np.random.default_rng(0).normal(size=(32, 40)), noise_sigma=1.0), spread
    )
    energy = FreeEnergy(frames, spread, grid=(64, 80), dtype=np.float64)
    given = spread.coefficients.detach().double().numpy()[None]
    expected = wide.optics.resized((64, 80), energy_pitch(wide)).transfer(
        torch.from_numpy(wide.waves.rest_on(wide.optics))
        + sum(
            c * torch.from_numpy(noll_mode(m, wide.optics))
            for m, c in zip((4, 5), given[0], strict=True)
        )
    )
    found = energy._transfer(given)[0][0, 0].numpy() * energy._pixel[0]
    # float64 transforms of 64 x 80 samples
    np.testing.assert_allclose(found, expected.numpy(), atol=1e-12)


def energy_pitch(pupil):
    """Pitch of the engine's grid: at most Nyquist's if pixels are wider by rounding alone."""
    return min(pupil.pitch, pupil.optics.nyquist_pitch)


@pytest.mark.parametrize(
    ("change", "error", "says"),
    [
        ({"images": np.ones((2, 2, 32, 40))}, SamplingError, "(K, H, W) or (H, W)"),
        ({"images": np.full((32, 40), np.nan)}, SceneError, "not finite"),
        ({"images": np.full((32, 40), 3.0)}, SceneError, "estimated noise"),
        ({"images": np.eye(64)}, SamplingError, "larger"),
        ({"images": np.ones((32, 40, 3))}, SamplingError, "looks like a colour picture"),
        ({"images": np.ones((2, 32, 40))}, SceneError, "estimated noise"),
        (
            {"images": np.random.default_rng(0).normal(size=(2, 32, 40))},
            SamplingError,
            "2 images with 1 defocus",
        ),
        ({"defocus": [0.0, 1e-7]}, SamplingError, "one value per image"),
        ({"defocus": [0.5]}, SceneError, "metres, not waves"),
        ({"defocus": "far"}, SceneError, "defocus of type str is not an array"),
        ({"noise_sigma": [1.0, 2.0]}, SamplingError, "one for each"),
        ({"noise_sigma": -1.0}, SceneError, "noise_sigma"),
        ({"noise_sigma": [[1.0], [2.0, 3.0]]}, SceneError, "noise_sigma of type list has rows"),
        ({"known_object": np.ones((3, 3))}, SamplingError, "known_object"),
        ({"start_error": 0.0}, SceneError, "start_error"),
        ({"start_error": 0.5}, SceneError, "start_error = 0.5 waves"),
        ({"recipe": "magic"}, SceneError, "recipe"),
        ({"pupil_psf": 3.0}, SceneError, "PupilPSF"),
    ],
)
def test_bad_input_is_one_line(change, error, says):
    images, spread, _, _ = made()
    given = {"images": images, "pupil_psf": spread, **change}
    with pytest.raises(error, match=".") as caught:
        called(pcin, given.pop("images"), given.pop("pupil_psf"), **given)
    assert isinstance(caught.value, NlosError)
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_front_door_refuses_options_of_no_recipe():
    images, spread, _, _ = made()
    with pytest.raises(TypeError, match="colour"):
        pcin(images, spread, colour="red")
    assert inverse.pcin is pcin


def test_images_of_different_shapes_are_one_line():
    images, spread, _, _ = made(gains=(1.0, 1.0))
    with pytest.raises(SamplingError, match="differ in shape"):
        evidence_fit([images[0], images[1][:9]], spread)
