"""Steps of phase retrieval and of fitted networks, each by plain numpy."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
import torch
from pytest import approx

from nlosoptics import inverse
from nlosoptics.imaging import ForwardModel
from nlosoptics.inverse.published.autocorrelations import SpectrumModulus
from nlosoptics.inverse.published.phase_retrieval import _framed
from nlosoptics.inverse.published.projections import (
    allowed,
    alternating_minimisation,
    averaged,
    fourier_errors,
    onto,
    projected,
    settled,
    spectral_start,
)
from nlosoptics.inverse.published.unet import UNetObject

GRIDS = [(5, 7), (6, 8)]


def case(grid):
    """Two objects of either sign, a modulus of another one, and a support of generic size."""
    draw = np.random.default_rng(8)
    objects = draw.normal(size=(2, *grid))
    support = np.zeros(grid, dtype=bool)
    support[:3, :4] = True
    modulus = np.abs(np.fft.fft2(np.abs(draw.normal(size=grid)) * support))
    return objects, modulus, support


def torched(objects, modulus, support):
    half = modulus[:, : modulus.shape[1] // 2 + 1].copy()
    return torch.from_numpy(objects), torch.from_numpy(half), torch.from_numpy(support)


def with_modulus(objects, modulus):
    spectrum = np.fft.fft2(objects)
    return np.fft.ifft2(modulus * spectrum / np.abs(spectrum)).real


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("method", ["hio", "raar"])
@pytest.mark.parametrize("grid", GRIDS)
def test_a_step_is_that_of_its_author(grid, method, share):
    objects, modulus, support = case(grid)
    given, half, allowed_there = torched(objects, modulus, support)
    near = with_modulus(objects, modulus)
    if method == "hio":  # Fienup 1982, feedback from 2 to 0
        kept = support & (near > 0.0)
        wanted = np.where(kept, near, objects - 2.0 * (1.0 - share) * near)
    else:  # Luke 2005, relaxation from 0.9 to 0.5
        beta = 0.9 - 0.4 * share
        reflected = 2.0 * near - objects
        bright = np.where(support & (reflected > 0.0), reflected, 0.0)
        wanted = beta * (bright + objects) + (1.0 - 2.0 * beta) * near
    found = projected(given, half, allowed_there, method, share)
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-13)


@pytest.mark.parametrize("grid", GRIDS)
def test_last_steps_alternate_between_both_constraints(grid):
    objects, modulus, support = case(grid)
    given = torched(objects, modulus, support)
    for _ in range(50):
        objects = np.where(support, np.maximum(with_modulus(objects, modulus), 0.0), 0.0)
    np.testing.assert_allclose(settled(*given), objects, rtol=0, atol=1e-11)
    np.testing.assert_array_equal(allowed(given[0], given[2])[0] < 0.0, np.zeros(grid, dtype=bool))
    assert not allowed(given[0], given[2])[:, 3:].any()


@pytest.mark.parametrize("grid", GRIDS)
def test_errors_are_relative_differences_of_whole_spectra(grid):
    objects, modulus, support = case(grid)
    found = fourier_errors(*torched(objects, modulus, support)[:2])
    misfit = np.abs(np.fft.fft2(objects)) - modulus
    wanted = np.sqrt((misfit**2).sum(axis=(1, 2)) / (modulus**2).sum())
    np.testing.assert_allclose(found, wanted, rtol=1e-13)


@pytest.mark.parametrize("grid", GRIDS)
def test_restarts_as_good_as_the_best_are_averaged_where_they_match(grid):
    """Shifted and turned copies are moved back; those of over 2 % more error are left out."""
    draw = np.random.default_rng(8)
    first = draw.random(grid)
    near = first + 0.1 * draw.random(grid)
    turned = np.roll(np.flip(near), (2, -3), (0, 1))
    objects = torch.from_numpy(np.stack([draw.random(grid), turned, first, draw.random(grid)]))
    errors = torch.tensor([0.1021, 0.1019, 0.1, 0.5], dtype=torch.float64)
    np.testing.assert_allclose(averaged(objects, errors), (first + near) / 2, rtol=1e-14)
    np.testing.assert_array_equal(onto(objects[1], objects[2]), near)
    moved = torch.from_numpy(np.roll(first, (-1, 3), (0, 1)))
    np.testing.assert_array_equal(onto(moved, 5.0 - 2.0 * (1.0 - objects[2])), first)


def test_start_is_the_leading_eigenvector_of_the_used_measurements():
    """Without those above three times the rms."""
    draw = np.random.default_rng(8)
    matrix = draw.normal(size=(40, 5)) + 1j * draw.normal(size=(40, 5))
    sizes = np.abs(matrix @ (draw.normal(size=5) + 1j * draw.normal(size=5)))
    used = np.arange(40) % 4 > 0
    sizes[2] = 5.0 * np.sqrt((sizes[used] ** 2).mean())
    limit = 3.0 * np.sqrt((sizes[used] ** 2).mean())
    assert sizes[2] > limit > np.delete(sizes, 2).max()
    kept = used & (sizes < limit)
    _, vectors = np.linalg.eigh((matrix[kept].conj().T * sizes[kept] ** 2) @ matrix[kept])
    a = torch.from_numpy(matrix)
    found = spectral_start(
        torch.from_numpy(sizes),
        lambda v: a @ v,
        lambda y: a.conj().T @ y,
        first=torch.ones(5, dtype=torch.complex128),
        used=torch.from_numpy(used),
    ).numpy()
    assert np.linalg.norm((matrix @ found)[used]) == approx(np.linalg.norm(sizes[used]))
    likeness = abs(found.conj() @ vectors[:, -1]) / np.linalg.norm(found)
    assert likeness == approx(1.0, abs=1e-3)  # 50 iterations


@pytest.mark.parametrize(("most", "tolerance"), [(2, 0.0), (200, 1e-3), (1, 1e-3)])
def test_alternating_minimisation_ends_at_a_small_change_or_at_the_last_step(most, tolerance):
    draw = np.random.default_rng(8)
    matrix = draw.normal(size=(14, 3))
    sizes = np.abs(matrix @ draw.normal(size=3))
    start = draw.normal(size=3)
    solve = np.linalg.pinv(matrix)
    vector = start
    for _ in range(most):
        new = solve @ (sizes * np.sign(matrix @ vector))
        change = np.linalg.norm(new - vector) / np.linalg.norm(new)
        vector = new
        if change <= tolerance:
            break
    asked, a, b = [], torch.from_numpy(matrix), torch.from_numpy(solve)
    found, error = alternating_minimisation(
        torch.from_numpy(sizes),
        lambda v: a @ v,
        lambda y: asked.append(1) or b @ y,
        torch.from_numpy(start),
        max_iterations=most,
        tolerance=tolerance,
    )
    np.testing.assert_allclose(found, vector, rtol=0, atol=1e-12)
    misfit = np.linalg.norm(np.abs(matrix @ vector) - sizes)
    assert error == approx(misfit / np.linalg.norm(sizes), abs=1e-12)
    assert len(asked) <= most
    assert (len(asked) < most) == (most == 200)


@pytest.mark.parametrize(("shape", "top", "left"), [((9, 12), 3, 4), ((4, 5), 0, 1)])
def test_objects_are_framed_in_the_middle(shape, top, left):
    draw = np.random.default_rng(8)
    spectrum = SpectrumModulus(modulus=np.ones((8, 5)), grid=(8, 8), object_size=(3, 3))
    objects = torch.from_numpy(draw.random((8, 8)) * 4.0)
    found = _framed(objects, spectrum, shape).numpy()
    box = objects[:3, :3].numpy()
    np.testing.assert_allclose(found[top : top + 3, left : left + 3], box / box.max())
    assert found.shape == shape
    assert np.count_nonzero(found) == 9
    dark = _framed(torch.full((8, 8), -1.0), spectrum, shape).numpy()
    assert dark.min() == -1.0


def test_pairs_of_the_front_door_agree_with_an_autocorrelation_of_any_scale():
    """Object, error and options of a whole retrieval, of an object without noise."""
    draw = np.random.default_rng(8)
    truth = np.zeros((17, 21))
    truth[5:9, 6:12] = draw.random((4, 6)) + 0.5
    power = np.abs(np.fft.fft2(truth, (33, 41))) ** 2
    lags = np.fft.fftshift(np.fft.ifft2(power).real)[8:-8, 10:-10]
    asked = {"object_size": (6, 8), "restarts": 4, "max_iterations": 150}
    found = inverse.object_from_autocorrelation(3.0 * lags + 2.0, **asked)
    assert inverse.registered_correlation(found, truth, flip=True) > 0.95  # without a zero lag
    assert found.object.shape == lags.shape
    assert found.object.max() == 1.0
    errors = found.history["fourier_error"]
    assert len(errors) == 4
    assert found.physical_parameters == {"fourier_error": errors.min(), "object_size": (6, 8)}


@pytest.fixture
def blurred():
    draw = np.random.default_rng(8)
    picture = np.zeros((12, 15))
    picture[3:8, 4:7], picture[3:5, 4:12] = 1.0, 0.6
    kernel = draw.random((3, 3))
    model = ForwardModel(kernel / kernel.sum(), shape=picture.shape)
    return model.forward(picture) + 0.02 * draw.normal(size=picture.shape) + 0.3, model


@pytest.fixture
def outputs(monkeypatch):
    """Objects that the network gave, and the rates of its steps."""
    seen, rates = [], []
    forward, step = UNetObject.forward, torch.optim.Adam.step

    def noted(self):
        found = forward(self)
        seen.append(found.detach().double().numpy())
        return found

    def stepped(self, *given):
        rates.append((len(self.param_groups[0]["params"]), self.param_groups[0]["lr"]))
        return step(self, *given)

    monkeypatch.setattr(UNetObject, "forward", noted)
    monkeypatch.setattr(torch.optim.Adam, "step", stepped)
    return seen, rates


@pytest.mark.parametrize(("steps", "weight"), [(9, 0.0), (40, 0.05)])
def test_prior_returns_the_average_or_the_best_of_the_iterates(blurred, outputs, steps, weight):
    (image, model), (seen, rates) = blurred, outputs
    noise = 0.004  # less than there is, so that no fit reaches it
    found = inverse.deep_image_prior(
        inverse.Measurement(image, noise_sigma=noise),
        model,
        **{"guide": "noise", "tv_weight": weight, "base": 8, "depth": 1},
        max_iterations=steps,
        learning_rate=0.02,
    )
    assert len(seen) == steps
    shares = [0.5 + 0.5 * math.cos(math.pi * k / steps) for k in range(steps)]
    assert [rate for _, rate in rates] == approx([0.02 * (0.05 + 0.95 * s) for s in shares])

    def fitted(picture):
        """Objective, rms residual over the noise, and the object in image units."""
        columns = np.stack([model.forward(picture).ravel(), np.ones(image.size)], axis=1)
        (gain, _), left, *_ = np.linalg.lstsq(columns, image.ravel(), rcond=None)
        square = float(left[0]) / image.size / noise**2
        down, along = np.diff(picture, axis=0)[:, :-1], np.diff(picture, axis=1)[:-1]
        edges = (np.sqrt(down**2 + along**2 + 1e-6) - 1e-3).sum() * gain / noise
        return 0.5 * square + weight * edges / image.size, math.sqrt(square), gain * picture

    objectives, residuals, levels = zip(*map(fitted, seen), strict=True)
    assert found.history["objective"] == approx(objectives, rel=1e-3)
    assert found.history["residual"] == approx(residuals, rel=1e-3)
    before = [np.zeros(image.shape), *levels]
    changes = [np.linalg.norm(b - a) / np.linalg.norm(b) for a, b in pairwise(before)]
    assert found.history["change"] == approx(changes, rel=1e-2, abs=1e-4)
    wanted = levels[int(np.argmin(objectives))]
    if steps > 26:
        average = levels[25]
        for level in levels[26:]:
            average = average + 0.04 * (level - average)
        if fitted(average)[0] <= min(objectives):
            wanted = average
    level = found.object * found.physical_parameters["gain"]
    np.testing.assert_allclose(level, wanted, rtol=0, atol=2e-3 * wanted.max())
    assert found.physical_parameters["iterations"] == steps
    assert found.physical_parameters["tv_weight"] == weight
    assert found.status != "converged"


@pytest.mark.parametrize("fed", ["image", "reconstruction"])
def test_published_steps_move_angles_and_network_in_turn(outputs, fed, monkeypatch):
    """Two of each; at the end of a turn, and of the fit, the network may see its own object."""
    draw = np.random.default_rng(8)
    optics = {"wavelength": 6e-7, "pupil_radius": 1e-3, "image_distance": 0.05, "pitch": 7e-6}
    pupil = inverse.PupilPSF.from_zernike([4, 6, 8], shape=(14, 17), **optics)
    image = 5.0 + np.outer(np.hanning(14), np.hanning(17)) + 0.01 * draw.normal(size=(14, 17))
    (_, rates), guides = outputs, []
    real = UNetObject.set_guide
    monkeypatch.setattr(
        UNetObject,
        "set_guide",
        lambda self, guide: guides.append((len(rates), guide.numpy().copy())) or real(self, guide),
    )
    found = inverse.wu2024_fit(
        inverse.Measurement(image, noise_sigma=0.01),
        pupil,
        **{"base": 8, "depth": 1, "alternate": 2, "max_iterations": 7, "learning_rate": 0.02},
        network_input=fed,
    )
    network = rates[2][0]
    assert [count for count, _ in rates] == [1, 1, network, network, 1, 1, network]
    assert {rate for _, rate in rates} == {0.02}
    assert network > 5
    assert [after for after, _ in guides] == ([4, 7] if fed == "reconstruction" else [])
    if guides:
        assert found.object == approx(guides[-1][1] / guides[-1][1].max(), abs=0.5)
    assert found.physical_parameters["network_base"] == 8.0
    assert found.physical_parameters["network_depth"] == 1.0
    spread = pupil(torch.tensor(found.physical_parameters["coefficients"]).float())
    flat = pupil(torch.zeros(3))
    strehl = float(spread.max() / flat.max())
    assert found.physical_parameters["strehl"] == approx(strehl, rel=1e-4)


def test_published_start_has_the_rms_asked_for_and_its_residual():
    """With a rate that moves nothing; over the pupil's cells, weighted by their shares."""
    draw = np.random.default_rng(8)
    optics = {"wavelength": 6e-7, "pupil_radius": 1e-3, "image_distance": 0.05, "pitch": 7e-6}
    pupil = inverse.PupilPSF.from_zernike([2, 4, 6], shape=(16, 21), **optics)
    image = 5.0 + np.outer(np.hanning(16), np.hanning(21)) + 0.01 * draw.normal(size=(16, 21))
    asked = {"base": 8, "depth": 1, "max_iterations": 3, "learning_rate": 1e-30}
    for rms, wanted in ((0.2, 0.2), (None, 0.5)):
        found = inverse.wu2024_fit(
            inverse.Measurement(image, noise_sigma=0.02), pupil, start_rms=rms, **asked
        )
        angles = torch.tensor(found.physical_parameters["coefficients"]).float()
        waves = pupil.aberration(angles).detach().double().numpy() / 6e-7
        share = pupil.optics.share
        mean = np.average(waves, weights=share)
        assert np.sqrt(np.average((waves - mean) ** 2, weights=share)) == approx(wanted, rel=1e-4)
    kernel = pupil(angles).detach().double().numpy()
    model = ForwardModel(kernel, shape=image.shape, boundary="circular")
    columns = np.stack([model.forward(found.object).ravel(), np.ones(image.size)], axis=1)
    _, left, *_ = np.linalg.lstsq(columns, image.ravel(), rcond=None)
    residual = math.sqrt(float(left[0]) / image.size) / 0.02
    assert found.history["residual"] == approx([residual] * 3, rel=1e-3)
    assert found.score == approx(residual, rel=1e-3)
    assert (found.history["change"] < 1e-12).all()
