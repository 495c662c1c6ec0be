"""The evidence fit finds wall and object from random starts, and reports where it does not."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from nlosoptics.errors import SamplingError, SceneError
from nlosoptics.imaging import ForwardModel
from nlosoptics.inverse import Measurement, PupilPSF, evidence_fit, pcin, registered_correlation
from nlosoptics.inverse.blind.evidence_search import Search, children, random_walls
from nlosoptics.inverse.blind.free_energy import FreeEnergy
from nlosoptics.inverse.blind.search_settings import Neighbourhood, Stage
from nlosoptics.inverse.blind.verdict import Verdict
from nlosoptics.inverse.wave.frames import frames_of
from nlosoptics.inverse.wave.pupil_optics import PupilOptics
from nlosoptics.inverse.wave.pupil_waves import ZernikeWaves, noll_mode

from ..by_name import called

WAVELENGTH = 632.8e-9
OPTICS = {
    "wavelength": WAVELENGTH,
    "pupil_radius": 0.9e-3,
    "image_distance": 51.2e-3,
    "pitch": 9e-6,
    "pixel_integrated": True,
}
MODES = tuple(range(4, 16))
DEFOCUS = np.array([0.0, 0.5 * WAVELENGTH])


def letter(size):
    """A capital F in the middle half of a frame, 0 to 1."""
    picture = np.zeros((size, size))
    q = size // 8
    picture[2 * q : 6 * q, 3 * q - q // 2 : 3 * q + q // 2] = 1.0
    picture[5 * q : 6 * q, 3 * q - q // 2 : 5 * q + q // 2] = 1.0
    picture[4 * q - q // 2 : 4 * q + q // 4, 3 * q : 5 * q] = 1.0
    return picture


def images(size, coefficients, defocus=DEFOCUS, *, noise=0.01, background=0.2, seed=0):
    """Images on a period of two frames, whose point spread the fit never sees."""
    wide = PupilPSF.from_zernike(MODES, shape=2 * size, dtype=torch.float64, **OPTICS)
    with torch.no_grad():
        spreads = wide(torch.as_tensor(coefficients), defocus=defocus).numpy()
    models = [ForwardModel(spread, shape=(size, size)) for spread in spreads]
    seen = np.stack([model.forward(letter(size)) for model in models])
    sigma = noise * seen.max()
    return seen + background + sigma * np.random.default_rng(seed).normal(size=seen.shape), sigma


def wall(strength, seed=3):
    """Coefficients of a given length, waves rms."""
    return random_walls(1, len(MODES), np.array([strength]), np.random.default_rng(seed))[0]


@pytest.fixture(scope="module")
def pupil():
    return PupilPSF.from_zernike(MODES, shape=32, **OPTICS)


def framed(data, pupil, sigma, **options):
    """Frames of images, without anything else known of them."""
    return called(frames_of, data, pupil, noise_sigma=sigma, **options)


@pytest.fixture(scope="module")
def energy(pupil):
    """Two frames of 24 x 24 with different noise, in double precision."""
    data, sigma = images(24, wall(0.3))
    frames = framed(data, pupil, sigma * np.array([1.0, 2.0]), defocus=DEFOCUS)
    return FreeEnergy(frames, pupil, grid=(36, 36), dtype=np.float64)


@pytest.fixture(scope="module")
def general():
    """Two walls, 24 x 20 pixels wider than Nyquist's, a known wave, missing pixels, a prior."""
    coarse = {**OPTICS, "pitch": 1.5 * OPTICS["pitch"]}
    optics = PupilOptics(**coarse, shape=32)

    def known(optics):
        return 0.2 * WAVELENGTH * noll_mode(20, optics)

    pupil = PupilPSF(optics, ZernikeWaves(MODES, optics, known), np.zeros(len(MODES)))
    data, sigma = images(24, wall(0.3))
    data, noise = data[:, :, 2:22], np.full((2, 24, 20), sigma)
    noise[1, :, :5] *= 2.0
    noise[0, 3, 4] = noise[1, 7, 8:10] = np.inf
    shape = 1.0 + np.linspace(0.0, 1.0, 20) * np.ones((24, 1))
    options = {"defocus": DEFOCUS, "background_shape": shape}
    frames = framed(data, pupil, noise, **options)
    energy = FreeEnergy(frames, pupil, grid=(36, 40), dtype=np.float64)
    return energy.about(0.1 * np.ones(len(MODES)), 0.2)


def fixed_energy(energy, starts, walls, noise):
    """Free energy at the covariance and weights of one place, as a function of another.

    Of F only the terms that its gradient sees: the squared residuals, the quadratic of the prior
    and the trace of the transfer function's square, by sums that share nothing with the kernels.
    """
    at = np.ascontiguousarray(walls)
    mean = energy.objects(starts)
    transfer = energy._transfer(at)[0].numpy() * energy._pixel * starts.gains[..., None, None]
    values = energy.evaluate(starts, at, noise, 0.5, False)[0]
    return values["squares"].sum(axis=1) / noise**2, (np.abs(transfer) ** 2).sum(axis=1), mean


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["energy", "general"])
def test_gradient_is_that_of_the_energy_at_fixed_covariance(name, request):
    energy = request.getfixturevalue(name)
    noise, kappa, step = 2.0, 0.5, 1e-5
    walls = random_walls(2, len(energy.modes), np.array([0.3, 0.5]), np.random.default_rng(0))
    starts = energy.starts(walls, 3.0)
    starts.gains[:] = 1.0 if name == "energy" else [[1.1, 0.9], [0.7, 1.4]]
    _, by_data, by_prior, slope = energy.evaluate(starts, walls, noise, kappa, False)
    # posterior covariance, from the definition
    _, power, mean = fixed_energy(energy, starts, walls, noise)
    (rows, columns), (down, along) = mean.shape[1:], energy.grid
    padded = np.pad(mean, ((0, 0), (1, 1), (1, 1)))
    weights = [
        kappa / (np.diff(padded[:, 1:-1], axis=2) ** 2 + starts.variances[:, 0, None, None]),
        kappa / (np.diff(padded[:, :, 1:-1], axis=1) ** 2 + starts.variances[:, 1, None, None]),
    ]
    rough = [2 - 2 * np.cos(2 * np.pi * np.arange(n) / n) for n in (down, along)]
    precision = 1 / (noise * energy.sigma) ** 2
    half = along // 2 + 1
    prior = [w.mean(axis=(1, 2))[:, None, None] for w in weights]
    prior = prior[0] * rough[1][:half] + prior[1] * rough[0][:, None] + 1e-6
    covariance = 1 / (power * precision + prior)
    twice = np.where(np.isin(np.arange(half), [0, half - 1]), 1.0, 2.0)
    share = rows * columns / (down * along)

    def value(starts, walls):
        squares, power, mean = fixed_energy(energy, starts, walls, noise)
        padded = np.pad(mean, ((0, 0), (1, 1), (1, 1)))
        across = (weights[0] * np.diff(padded[:, 1:-1], axis=2) ** 2).sum(axis=(1, 2))
        above = (weights[1] * np.diff(padded[:, :, 1:-1], axis=1) ** 2).sum(axis=(1, 2))
        trace = share * precision * (covariance * power * twice).sum(axis=(1, 2))
        return 0.5 * (squares + across + above + trace) + energy.held(walls)

    for mode in (0, 5, len(energy.modes) - 1):
        change = np.zeros_like(walls)
        change[:, mode] = step
        found = (value(starts, walls + change) - value(starts, walls - change)) / (2 * step)
        # central differences err by the third derivative times step^2, 1e-6 of the largest slope
        assert np.abs(found - slope[:, mode]).max() < 1e-6 * np.abs(slope).max()
    total = by_data[:, :rows, :columns] + by_prior
    bend = 0.5 * (1 + starts.free / np.sqrt(starts.free**2 + 0.1**2))
    for place in ((0, 0), (11, 13), (23, 7), (5, 6)):
        change = np.zeros_like(starts.free)
        change[:, place[0], place[1]] = step
        more, less = (value(replace(starts, free=starts.free + s * change), walls) for s in (1, -1))
        expected = (total * bend)[:, place[0], place[1]]
        assert np.abs((more - less) / (2 * step) - expected).max() < 1e-6 * np.abs(total).max()


def test_backgrounds_and_gains_are_the_best_ones(general):
    """Least squares over both, by numpy; the gains take several steps of limited size."""
    walls = random_walls(1, len(general.modes), np.array([0.3]), np.random.default_rng(2))
    starts = general.starts(walls, 3.0)
    for _ in range(20):
        starts = replace(starts, gains=general.evaluate(starts, walls, 1.0, 0.5, False)[0]["gains"])
    transfer = general._transfer(walls)[0].numpy() * general._pixel
    spectrum = np.fft.rfft2(general.objects(starts), s=general.grid)[:, None]
    seen = np.fft.irfft2(transfer * spectrum, s=general.grid)[0, :, :24, :20]
    best = []
    for k in range(2):
        root = np.sqrt(general._weights[k]).ravel()
        design = np.stack([seen[k].ravel(), general._shapes[k].ravel()], axis=1) * root[:, None]
        fit = np.linalg.lstsq(design, root * general._images[k].ravel(), rcond=None)
        best.append(fit[0][0])
    # limits rounding in products of a thousand pixels
    assert starts.gains[0, 1] / starts.gains[0, 0] == pytest.approx(best[1] / best[0], rel=1e-9)


def test_a_descent_lowers_the_energy(energy):
    starts = energy.starts(np.zeros((1, len(MODES))), 2.0)
    short, long = (
        energy.descend(
            starts, Stage(iterations=n, kappa=0.5, first=2.0, last=1.0, share=0.5, wave_rate=0.01)
        )
        for n in (10, 80)
    )
    assert long.energy[0] < short.energy[0]


def test_held_walls_keep_their_length(energy):
    walls = random_walls(3, len(MODES), np.array([0.4]), np.random.default_rng(1))
    stage = Stage(iterations=5, kappa=1.0, first=5.0, last=2.0, share=0.9, wave_rate=0.02)
    found = energy.descend(energy.starts(walls, 5.0, 0.4), stage)
    assert np.linalg.norm(found.coefficients, axis=1) == pytest.approx(0.4, rel=1e-12)
    assert np.abs(found.coefficients - walls).max() > 1e-3


def test_twin_has_the_same_point_spread(pupil, energy):
    walls = np.stack([wall(0.4), energy.twin * wall(0.4)])
    with torch.no_grad():
        first, second = pupil(torch.as_tensor(walls, dtype=torch.float32))
    # single precision
    assert torch.allclose(first, second, atol=1e-6)


def test_children_differ_from_their_parents_and_repeat(energy):
    walls = random_walls(4, len(MODES), np.array([0.4]), np.random.default_rng(1))
    parents = energy.starts(walls, 5.0)
    breeding = Neighbourhood(1, 12, flips=0.1, noise=0.3)
    one, two = (
        children(parents, 12, energy.twin, breeding, np.random.default_rng(5)) for _ in range(2)
    )
    assert np.array_equal(one, two)
    assert min(np.abs(child - walls).max(axis=1).min() for child in one) > 1e-3


def test_children_of_a_wall_and_its_twin_change_one_of_them():
    """Their mixture is the wall itself, since the second parent is replaced by its twin."""
    rng, count = np.random.default_rng(3), 4000
    wall, twin = rng.normal(size=9), np.where(np.arange(9) % 2, -1.0, 1.0)
    parents = np.array([wall, twin * wall])
    starts = SimpleNamespace(coefficients=parents)
    found = children(starts, count, twin, Neighbourhood(1, 12, flips=0.0, noise=0.1), rng)
    away = np.linalg.norm(found[:, None] - parents, axis=2) / np.linalg.norm(wall)
    nearest = away.min(axis=1)
    mixed = np.isclose(nearest, 0.15, rtol=1e-9)
    flipped = (np.isclose(np.abs(found), np.abs(wall), rtol=1e-12)).all(axis=1)
    mirrored = np.isclose(found[:, None], -parents).all(axis=2).any(axis=1)
    one = (found[:, None] != parents).sum(axis=2).min(axis=1) == 1
    moved = ~mixed & ~flipped
    assert (flipped == (one | mirrored)).all()
    assert nearest[moved].min() > 0.05
    assert nearest[moved].max() < 0.15
    shares = np.array([mixed.mean(), (one & ~mirrored).mean(), moved.mean(), mirrored.mean()])
    expected = np.array([0.35, 0.3, 0.3, 0.05])
    # five standard errors
    assert (np.abs(shares - expected) < 5 * np.sqrt(expected * (1 - expected) / count)).all()
    best = (away[mixed | moved].argmin(axis=1) == 0).mean()
    assert best == pytest.approx(1 / 1.2, abs=0.04)


@pytest.mark.thorough
def test_two_frames_are_enough():
    data, sigma = images(32, wall(0.4))
    found = pcin(
        Measurement(data, noise_sigma=sigma),
        PupilPSF.from_zernike(MODES, shape=32, **OPTICS),
        defocus=DEFOCUS,
        max_iterations=1,
        seed=1,
    )
    assert found.status == "converged"
    assert registered_correlation(found, letter(32)) > 0.95
    settled = found.physical_parameters
    # the object's own flux lets 1 % of the range through to the background
    assert settled["background"] == pytest.approx([0.2, 0.2], abs=0.02)
    assert np.linalg.norm(settled["coefficients"] - wall(0.4)) < 0.1


@pytest.mark.thorough
def test_a_wall_that_no_mode_holds_is_not_called_right(pupil):
    """Two different objects, one in each frame: no wall explains both."""
    data, sigma = images(32, wall(0.4))
    data[1] = data[1].T[::-1]
    found = evidence_fit(
        Measurement(data, noise_sigma=sigma), pupil, defocus=DEFOCUS, max_iterations=1
    )
    assert found.status == "unconverged"
    assert "beyond the noise" in found.reasons[0]


def test_distances_of_walls_are_those_of_their_point_spreads(pupil):
    data, sigma = images(24, wall(0.3), defocus=np.zeros(1))
    energy = FreeEnergy(framed(data, pupil, sigma), pupil, grid=(36, 36), dtype=np.float64)
    walls = np.stack([wall(0.4), energy.twin * wall(0.4), wall(0.4, seed=4)])
    starts = energy.starts(walls, 3.0)
    spreads = [energy.point_spread(starts[row : row + 1]) for row in range(3)]
    expected = [np.linalg.norm(s - spreads[0]) / np.linalg.norm(spreads[0]) for s in spreads]
    found = energy.apart(starts, walls[:1])
    # the amplitudes of rounding errors are clipped in the point spreads
    assert found == pytest.approx(expected, abs=1e-6)
    assert found[1] < 1e-6 < 0.3 < found[2]
    squares = [np.square(spread).sum() for spread in spreads]
    assert energy.sharpness(walls) == pytest.approx(squares, rel=1e-6)


@pytest.mark.parametrize(
    ("margin", "rival", "expected", "reason"),
    [
        (-80.0, 0.0, np.nan, None),
        (0.0, np.inf, 0.3, None),
        (0.0, 99.0, 0.3, "another wall"),
        (0.0, np.nan, 0.3, "another wall"),
        (0.0, np.inf, 0.4, "a wave of 0.4 waves rms"),
        (0.0, np.inf, np.nan, "a wave of unknown strength"),
    ],
)
def test_a_small_margin_needs_the_expected_wave_without_a_rival(
    pupil, margin, rival, expected, reason
):
    data, sigma = images(32, wall(0.2), defocus=np.zeros(1))
    frames = framed(data, pupil, sigma)
    energy = FreeEnergy(frames, pupil, grid=(48, 48))
    best = replace(energy.starts(wall(0.2)[None], 1.0), chi_square=np.ones((1, 1)))
    sharp = -0.2 * data.size
    faults = Verdict(frames, MODES, several=False).faults(
        best, (margin, sharp), rival, expected=expected, held=np.nan, start_error=None
    )
    assert faults == () if reason is None else faults[0].startswith(reason)


@pytest.mark.thorough
def test_no_blur_is_flagged(pupil):
    """One frame and no search: the answer is the image itself."""
    data, sigma = images(32, wall(0.3), defocus=np.zeros(1))
    found = evidence_fit(
        Measurement(data, noise_sigma=sigma), pupil, max_iterations=1, max_seconds=1e-9
    )
    assert found.status == "ambiguous"
    assert "give a second image" in found.reasons[0]
    assert found.physical_parameters["margin"] == 0.0


@pytest.mark.thorough
def test_a_weak_wall_is_told_from_the_image_taken_as_sharp(pupil):
    """The descent from no blur ends at the wall, and the search finds no different one."""
    data, sigma = images(32, wall(0.2, seed=4), defocus=np.zeros(1))
    found = evidence_fit(Measurement(data, noise_sigma=sigma), pupil, max_iterations=1)
    settled = found.physical_parameters
    assert -10.0 < settled["margin"] <= 0.0
    assert found.status == "converged"
    # the data's point spread has two frames of room, the fit's one and a half
    assert registered_correlation(found, letter(32)) > 0.99


@pytest.mark.parametrize(("share", "kept"), [(0.9, False), (1.1, True)])
def test_modes_are_added_by_schwarz_s_criterion(energy, share, kept):
    """A parameter has to lower the energy by half the logarithm of the number of pixels."""
    flat = replace(energy.starts(np.zeros((1, len(energy.modes))), 1.0), energy=np.array([-5.0]))
    pixels, added = 2 * 24**2, 21 - 15
    gain = share * 0.5 * added * np.log(pixels)

    class Wide:
        modes = tuple(range(4, 22))

        def descend(self, starts, _):
            return replace(starts, energy=flat.energy - gain)

    verdict = SimpleNamespace(
        modes=MODES, several=True, vague=False, pixels=pixels, structured=lambda best: True
    )
    options = dict.fromkeys(("start_error", "strength", "proposals", "state"))
    energies = lambda padding, modes: energy if modes == MODES else Wide()  # noqa: E731
    search = Search(energies, verdict, first=np.zeros(12), rounds=1, seed=0, **options)
    search.place.best = flat
    assert search._widen(np.random.default_rng(0)) == "widen"
    assert (search.place.modes == Wide.modes) is kept
    assert search.place.best.coefficients.shape[1] == (18 if kept else 12)


def test_noise_alone_is_too_few_photons(pupil):
    data = np.random.default_rng(0).normal(size=(2, 32, 32))
    found = evidence_fit(Measurement(data, noise_sigma=1.0), pupil, defocus=DEFOCUS)
    assert found.status == "too_few_photons"
    assert not np.any(found.object)


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        (lambda d: np.where(d == d.max(), np.nan, d), SceneError, "not finite"),
        (lambda d: np.zeros_like(d), SceneError, "noise"),
        (lambda d: d[:1], SamplingError, "defocus"),
    ],
)
def test_bad_images_are_refused(pupil, change, error, message):
    data = images(32, wall(0.3))[0]
    with pytest.raises(error, match=message):
        evidence_fit(change(data), pupil, defocus=DEFOCUS)
