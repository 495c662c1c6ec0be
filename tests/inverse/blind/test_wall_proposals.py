"""The network proposes walls near the truth, for any frame and pitch that it applies to."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from nlosoptics.imaging import ForwardModel
from nlosoptics.inverse import PupilPSF
from nlosoptics.inverse.blind import wall_proposals as proposals
from nlosoptics.inverse.blind.evidence_search import random_walls
from nlosoptics.inverse.blind.wall_proposals import MODES, SIDE, WallNetwork, channels, twin_signs
from nlosoptics.inverse.wave.frames import frames_of

from ..by_name import called

WAVELENGTH = 632.8e-9
OPTICS = {"wavelength": WAVELENGTH, "pupil_radius": 0.9e-3, "image_distance": 51.2e-3}
NYQUIST = OPTICS["wavelength"] * OPTICS["image_distance"] / (4.0 * OPTICS["pupil_radius"])
TWIN = twin_signs().double().numpy()


def pupil(pitch=NYQUIST, shape=SIDE, modes=MODES, **options):
    return PupilPSF.from_zernike(
        modes, **{**OPTICS, **options}, pitch=pitch, shape=shape, pixel_integrated=True
    )


def picture(seed, side=SIDE):
    """Three bars and a ring that no training draws, turned and grey."""
    random = np.random.default_rng(seed)
    axis = (np.arange(side) + 0.5) / side * 2.0 - 1.0
    x, y = np.meshgrid(axis, axis)
    found = np.zeros((side, side))
    for _ in range(3):
        angle, place = random.uniform(0, np.pi), random.uniform(-0.3, 0.3, size=2)
        along = (x - place[0]) * np.cos(angle) + (y - place[1]) * np.sin(angle)
        across = (y - place[1]) * np.cos(angle) - (x - place[0]) * np.sin(angle)
        found[(np.abs(along) < 0.3) & (np.abs(across) < 0.08)] = random.uniform(0.5, 1.0)
    place = random.uniform(-0.3, 0.3, size=2)
    found[np.abs(np.hypot(x - place[0], y - place[1]) - 0.2) < 0.05] = 1.0
    return found


def image(truth, wall, pitch=NYQUIST, noise=0.01, seed=0, **options):
    """Image of a picture; the point spread has twice its room."""
    wide = pupil(pitch, 2 * max(truth.shape), **options)
    with torch.no_grad():
        spread = wide(torch.from_numpy(wall).float()).double().numpy()
    seen = ForwardModel(spread, shape=truth.shape).forward(truth)
    return seen + noise * seen.max() * np.random.default_rng(seed).normal(size=seen.shape)


def proposed(data, point_spread, count=32, seed=0, **options):
    """Walls that the network proposes, or None."""
    frames = called(frames_of, data, point_spread, **options)
    found = proposals.wall_proposals(frames, point_spread)
    return None if found is None else found.walls(count, np.random.default_rng(seed))


def distance(walls, truth):
    """Distance of walls from the truth or its twin, waves rms."""
    first, second = (
        np.linalg.norm(np.atleast_2d(walls) - t, axis=1) for t in (truth, truth * TWIN)
    )
    return np.minimum(first, second)


def walls(count, strength, seed):
    return random_walls(count, len(MODES), np.array([strength]), np.random.default_rng(seed))


@pytest.fixture(scope="module")
def cases():
    """Twenty images of unseen pictures and walls of half a wave."""
    truths = walls(20, 0.5, seed=77)
    return [(image(picture(n), wall, seed=n), wall) for n, wall in enumerate(truths)]


def nearer(network, cases):
    """Share of images whose proposals have one nearer to the truth than all of 32 random walls."""
    count = 0
    for n, (data, truth) in enumerate(cases):
        density = proposals.WallProposals(*proposals.at_nyquist(data, 0.01, 1.0), network)
        drawn = density.walls(32, np.random.default_rng(n))
        count += distance(drawn, truth).min() < distance(walls(32, 0.5, seed=n), truth).min()
    return count / len(cases)


@pytest.mark.thorough
def test_proposals_are_nearer_than_random_walls(cases):
    assert nearer(proposals.trained_network(), cases) >= 0.8


@pytest.mark.thorough
def test_a_network_of_shuffled_weights_is_no_better_than_chance(cases):
    shuffled = WallNetwork()
    order = torch.Generator().manual_seed(0)
    state = {}
    for name, values in proposals.trained_network().state_dict().items():
        mixed = torch.randperm(values.numel(), generator=order)
        state[name] = values.flatten()[mixed].reshape(values.shape)
    shuffled.load_state_dict(state)
    assert nearer(shuffled.eval(), cases) < 0.5


@pytest.mark.thorough
def test_the_expected_length_is_near_the_truth(cases):
    densities = [
        proposals.WallProposals(*proposals.at_nyquist(data, 0.01, 1.0), proposals.trained_network())
        for data, _ in cases
    ]
    # the cases' walls have 0.5 waves
    assert np.median([one.length for one in densities]) == pytest.approx(0.5, rel=0.3)


def test_weights_are_small_and_proposals_repeat(cases):
    assert proposals.WEIGHTS.stat().st_size < 5e6
    data, point_spread = cases[0][0], pupil()
    first, again, other = (proposed(data, point_spread, seed=seed) for seed in (1, 1, 2))
    assert np.array_equal(first, again)
    assert np.array_equal(first[0], other[0])  # the mean is not drawn
    assert not np.array_equal(first[1:], other[1:])


@pytest.mark.parametrize("number", range(8))
def test_a_turned_image_has_the_turned_wall(cases, number):
    turn, matrix = proposals._turns()[number]
    seen = torch.from_numpy(cases[1][0]).float()
    seen = seen - seen.median()
    network = proposals.trained_network()
    plain = proposals.WallProposals(seen, 0.01, network).mean
    turned = proposals.WallProposals(turn(seen), 0.01, network).mean
    # single precision
    assert distance(turned @ matrix.double().numpy(), plain)[0] < 1e-4


@pytest.mark.parametrize("number", range(8))
def test_matrices_of_turns_are_those_of_point_spreads(number):
    turn, matrix = proposals._turns()[number]
    wall = walls(1, 0.4, seed=5)[0]
    # W' of the turned point spread; its coefficients times the matrix are those of W
    turned = wall @ np.linalg.inv(matrix.double().numpy())
    wide = pupil(shape=SIDE + 1)
    with torch.no_grad():
        plain, other = wide(torch.from_numpy(np.stack([wall, turned])).float())
    spread = torch.fft.fftshift(plain) if plain.argmax() == 0 else plain
    # single precision
    assert torch.allclose(turn(spread), other, atol=1e-5 * float(plain.max()))


def test_finer_pixels_show_the_same_wall():
    """Twice as many pixels of half the pitch; noise and the picture's sampling differ."""
    truth, wall = picture(3), walls(1, 0.5, seed=3)[0]
    coarse = image(truth, wall, noise=1e-4)
    fine = image(np.kron(truth, np.ones((2, 2))), wall, pitch=NYQUIST / 2, noise=1e-4)
    network = proposals.trained_network()
    first, noise = proposals.at_nyquist(coarse, 0.01, 1.0)
    second, less = proposals.at_nyquist(fine, 0.02, 0.5)
    assert (noise, less) == (0.01, 0.01)
    # halves of pixels lie a quarter of a pixel off; the image changes by as much
    assert float((first / first.max() - second / second.max()).abs().max()) < 0.1
    means = [proposals.WallProposals(one, 0.01, network).mean for one in (first, second)]
    assert distance(means[0], means[1])[0] < 0.15


@pytest.mark.parametrize("shape", [(50, 64), (64, 40), (90, 70), (24, 96)])
def test_frames_of_other_sizes(shape):
    truth = np.zeros((96, 96))
    truth[16:80, 16:80] = picture(4)
    rows, columns = ((96 - side) // 2 for side in shape)
    data = image(truth, walls(1, 0.3, seed=4)[0])
    data = data[rows : rows + shape[0], columns : columns + shape[1]]
    found = proposed(data, pupil(shape=shape))
    assert found.shape == (32, len(MODES))
    assert np.isfinite(found).all()


@pytest.mark.thorough
def test_other_modes_known_defocus_and_negative_distance(cases):
    data = cases[2][0]
    plain = proposed(data, pupil())
    few = proposed(data, pupil(modes=(5, 4, 25)))
    assert np.array_equal(few, np.stack([plain[:, 1], plain[:, 0], 0.0 * plain[:, 0]], axis=1))
    shifted = proposed(data, pupil(), defocus=[0.25 * WAVELENGTH])
    assert np.allclose(plain - shifted, 0.25 * (np.array(MODES) == 4))
    mirrored = proposed(data, pupil(image_distance=-OPTICS["image_distance"]))
    assert np.array_equal(mirrored, -plain)


@pytest.mark.parametrize(
    ("data", "point_spread", "options"),
    [
        (np.eye(SIDE), pupil(1.2 * NYQUIST), {}),
        (np.eye(20), pupil(shape=20), {}),
        (np.eye(100), pupil(shape=100), {}),
        (np.eye(SIDE), pupil(modes=(22, 23)), {}),
        (np.stack([np.eye(SIDE)] * 2), pupil(), {"defocus": [0.0, 0.5 * WAVELENGTH]}),
    ],
    ids=["wide pixels", "small", "large", "other modes", "two frames"],
)
def test_where_the_network_does_not_apply(data, point_spread, options):
    assert proposed(data + 0.0, point_spread, noise_sigma=0.01, **options) is None


def test_draws_hold_no_wall_twice():
    """A Gaussian that is drawn again gives a wall beside its mean."""
    data = image(picture(5), walls(1, 0.3, seed=6)[0])
    drawn = proposed(data, pupil(), count=96)
    assert len(np.unique(drawn.round(9), axis=0)) == 96


def test_what_the_network_sees_is_the_power_over_the_noise_and_its_transform():
    """By sums over pixels of the whole image, for a few frequencies and lags."""
    rng, sigma = np.random.default_rng(0), 0.5
    data = 40.0 * rng.random((SIDE, SIDE))
    found = channels(torch.tensor(data)[None], torch.tensor([sigma], dtype=torch.float64))[0]
    assert found.shape == (4, SIDE, SIDE)
    # the window rises to 1 over four pixels, by sines squared of 1/16 of a turn and so on
    rise = np.sin(np.pi / 16 * np.array([1, 3, 5, 7])) ** 2
    window = np.concatenate([rise, np.ones(SIDE - 8), rise[::-1]])
    scaled = data / data.max()
    waves = np.exp(-2j * np.pi * np.outer(np.arange(SIDE), np.arange(SIDE)) / SIDE)
    spectrum = waves @ (scaled * np.outer(window, window)) @ waves
    power = np.abs(spectrum) ** 2 / (SIDE * sigma / data.max()) ** 2
    logarithm = np.log1p(power)
    lags = (waves.conj() @ logarithm @ waves.conj()).real / SIDE**2
    lags[0, 0] = 0.0
    even = spectrum / np.abs(spectrum) * power / (1 + power)
    even = (waves.conj() @ even @ waves.conj()).real / SIDE**2
    centre = (SIDE // 2, SIDE // 2)
    expected = [
        4.0 * scaled - 0.5,
        np.roll(logarithm / 4.0 - 0.5, centre, (0, 1)),
        np.roll(16.0 * lags, centre, (0, 1)),
        40.0 * even,
    ]
    for part, exact in zip(found.numpy(), expected, strict=True):
        # the window is of single precision
        assert np.abs(part - exact).max() < 1e-5 * np.abs(exact).max()
