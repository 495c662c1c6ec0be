"""Albedo fitted to the photons of confocal captures, beside the phasor field."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import exponnorm

from nlosoptics import transient
from nlosoptics.errors import SamplingError
from nlosoptics.transient.imaging.confocal_grids import confocal_grid
from nlosoptics.transient.imaging.confocal_model import ConfocalModel

WALL = transient.wall_grid(1.0, 32)
BIN, DEPTH = 0.012, 0.62
EDGES = 0.9 + BIN * np.arange(141)
#: Ends (y, x) of the cells of two bars, which meet at a corner.
BARS = ((slice(8, 24), slice(9, 13)), (slice(8, 12), slice(9, 22)))


def shape():
    """Which cells the bars fill."""
    filled = np.zeros((32, 32), dtype=bool)
    for bar in BARS:
        filled[bar] = True
    return filled


def expected(power=4, pulse=None):
    """Sum of 3 x 3 points in each filled cell; ``pulse`` is its integral up to a path."""
    share = np.linspace(-1, 1, 3) / 96
    light = np.zeros((140, 32, 32))
    for y, x in np.argwhere(shape()):
        for dx, dy in np.stack(np.meshgrid(share, share), -1).reshape(-1, 2):
            r = np.linalg.norm(WALL - (WALL[y, x, 0] + dx, WALL[y, x, 1] + dy, DEPTH), axis=-1)
            late = EDGES[:, None, None] - 2.0 * r
            before = (late > 0.0).astype(float) if pulse is None else pulse(late)
            light += np.diff(before, axis=0) * DEPTH**power / r ** (2 * power)
    return light / light.max()


def capture(light, photons=None, seed=0):
    """Counts of this light with a background of 0.2, or the light itself."""
    H = light
    if photons is not None:
        H = np.random.default_rng(seed).poisson(photons * (light + 0.2)).astype(float)
    return transient.TransientCapture(
        H=H,
        laser_points=WALL,
        sensor_points=WALL,
        delta_t=BIN,
        t_start=EDGES[0],
        pairing="confocal",
    )


def overlap(depths):
    seen = np.isfinite(depths.depth)
    return np.sum(seen & shape()) / np.sum(seen | shape())


def fitted(shot, advice=None):
    image = transient.inverse_image(shot, advice=advice)
    return image, transient.depth_map(image, threshold=image.details["threshold"])


@pytest.fixture(scope="module")
def light():
    return expected()


def test_the_model_is_a_direct_sum(light):
    grid = confocal_grid(capture(light), "test")
    model = ConfocalModel(grid, DEPTH + 1e-4 * np.array([-1.0, 0.0, 1.0]), None)
    albedo = np.zeros((3, 32, 32))
    albedo[1] = shape()
    found = model.light(albedo)
    scale = np.sum(found * light) / np.sum(found**2)
    totals, right = scale * found.sum(axis=0), light.sum(axis=0)
    assert np.abs(totals / right - 1.0).max() < 0.02
    # cells are taken as Gaussian in path
    assert np.linalg.norm(scale * found - light) < 0.12 * np.linalg.norm(light)


def test_the_adjoint_has_the_same_products(light):
    model = ConfocalModel(confocal_grid(capture(light), "test"), np.linspace(0.5, 0.8, 7), None)
    rng = np.random.default_rng(0)
    albedo, other = rng.uniform(size=(7, 32, 32)), rng.uniform(size=(140, 32, 32))
    there, back = model.light(albedo), model.adjoint(other)
    assert np.sum(there * other) == pytest.approx(np.sum(albedo * back), rel=1e-5)


@pytest.mark.parametrize(
    ("photons", "gain"), [(10.0, 0.05), pytest.param(3.0, 0.0, marks=pytest.mark.thorough)]
)
def test_a_letter_is_sharper_than_in_the_phasor_field(light, photons, gain):
    shot = capture(light, photons)
    advice = transient.advise(shot)
    image, depths = fitted(shot, advice)
    assert overlap(depths) > overlap(advice.depths) + gain
    assert np.nanmedian(np.abs(depths.depth - DEPTH)) < 0.003
    assert image.details["misfit"] == pytest.approx(1.0, abs=0.05)
    seen = np.isfinite(depths.depth)
    # 95 % by intention; a quarter of the distance of planes is more than this facing letter needs
    assert np.mean(np.abs(depths.depth - DEPTH)[seen] < 1.96 * depths.standard_error[seen]) > 0.92
    assert np.isnan(depths.standard_error[~seen]).all()


def test_pixels_may_have_different_backgrounds_that_vary_slowly(light):
    """Dark counts with an exponential distribution over pixels, a hot one, and a slow ripple."""
    rng = np.random.default_rng(3)
    dark = rng.exponential(2.0, (32, 32))
    dark[5, 7] = 200.0
    ripple = 1.0 + 0.2 * np.sin(np.arange(140) / 25.0)
    shot = capture(light, 10.0)
    H = shot.H + rng.poisson(dark * ripple[:, None, None])
    assert overlap(fitted(replace(shot, H=H))[1]) > 0.6


@pytest.mark.thorough
def test_standard_errors_hold_the_scatter_between_captures(light):
    """Depths differ between captures of the same light by no more than one of them says."""
    maps = [fitted(capture(light, 2.0, seed))[1] for seed in range(4)]
    seen = np.all([np.isfinite(d.depth) for d in maps], axis=0)
    scatter = np.std([d.depth[seen] for d in maps], axis=0, ddof=1)
    told = np.mean([d.standard_error[seen] for d in maps], axis=0)
    systematic = 0.25 * 0.45 / 31  # m, of the distance of planes, which is 0.45 pitches
    assert np.mean(scatter**2) < np.mean(told**2)
    assert np.median(told) > 1.02 * systematic  # there is noise in it


@pytest.mark.parametrize("power", [4, pytest.param(2, marks=pytest.mark.thorough)])
def test_direct_light_is_the_pulse(power):
    """Jitter of 1 cm and a tail of 6 cm; a target that returns light has another falloff."""

    paths = np.linspace(-0.1, 1.0, 1101)

    def pulse(path):
        return np.interp(path, paths, exponnorm.cdf(paths, 6.0, scale=0.01))

    early = BIN * np.arange(-8, 76)
    direct = 1e5 * np.diff(pulse(early))[:, None, None] * np.ones((32, 32))
    H = np.concatenate([direct, 5.0 * expected(power, pulse)])
    H = np.random.default_rng(0).poisson(H + 0.2).astype(float)
    shot = replace(capture(H), t_start=early[0])
    advice = transient.advise(shot)
    image, depths = fitted(shot, advice)
    assert overlap(depths) > overlap(advice.depths) + 0.05
    # the phasor field takes the pulse's delay for depth
    assert np.nanmedian(depths.depth) == pytest.approx(DEPTH, abs=0.004)
    assert image.details["misfit"] == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda c: replace(c, H=c.H + 0.5), "not whole numbers"),
        (lambda c: replace(c, pairing="all", laser_points=np.zeros(3)), "needs a confocal capture"),
        (
            lambda c: replace(c, H=np.random.default_rng(0).poisson(1.0, c.H.shape) * 1.0),
            "no object above the noise",
        ),
        (lambda c: of_points(c, 4), r"more than 4 wall points .* the capture has \(4, 4\)"),
    ],
)
def test_captures_that_it_cannot_fit_are_refused(light, change, words):
    with pytest.raises(SamplingError, match=words):
        transient.inverse_image(change(capture(light, 1000.0)))


def of_points(shot, n):
    """Part of a capture: every few of its wall points, n along each side."""
    every = np.arange(n) * (shot.H.shape[1] // n)
    points = shot.sensor_points[every][:, every]
    H = shot.H[:, every][:, :, every]
    return replace(shot, H=H, laser_points=points, sensor_points=points)


def test_advice_of_another_capture_is_refused(light):
    shot = capture(light, 10.0)
    advice = transient.advise(shot)
    moved = shot.sensor_points + np.array([1.0, 0.0, 0.0])
    for other in (
        of_points(shot, 16),
        replace(shot, H=shot.H[:40]),
        replace(shot, laser_points=moved, sensor_points=moved),
    ):
        with pytest.raises(SamplingError, match=r"advice is that of another capture.*leave it out"):
            transient.inverse_image(other, advice=advice)
