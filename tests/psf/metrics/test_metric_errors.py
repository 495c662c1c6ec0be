"""Error bars of metrics cover the truth as often as they state."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from pytest import approx
from scipy.stats import t as student

from nlosoptics import psf
from nlosoptics.errors import SamplingError, SceneError

WAVELENGTH, RADIUS, DISTANCE = 632.8e-9, 5e-3, 0.1
UNIT = WAVELENGTH * DISTANCE / (2 * RADIUS)


def smooth():
    wave = psf.Wavefront.from_zernike(
        {4: 0.1 * WAVELENGTH},
        wavelength=WAVELENGTH,
        pupil_radius=RADIUS,
        image_distance=DISTANCE,
    )
    return psf.point_spread(wave, pitch=UNIT / 2, shape=32)


def speckled(mean, rng):
    """A pattern of fully developed speckle about a mean, each pixel for itself."""
    intensity = mean.intensity * rng.exponential(size=mean.shape)
    share = intensity.sum() / mean.intensity.sum()
    return replace(mean, intensity=intensity, enclosed_energy=mean.enclosed_energy * share)


METRICS = {
    "energy": lambda p: psf.encircled_energy(p, [UNIT, 3 * UNIT]),
    "mtf": lambda p: psf.mtf(p, 0.2 / UNIT),
    "centroid": psf.centroid,
}


@pytest.mark.parametrize("name", METRICS)
def test_error_bars_cover_the_truth(name):
    """400 draws of 12 patterns: within 1 and 2 standard errors as often as Student's t says."""
    mean, metric, rng = smooth(), METRICS[name], np.random.default_rng(3)
    truth = np.asarray(metric(mean))
    inside, draws, count = np.zeros(2), 400, 12
    for _ in range(draws):
        found = psf.metric_estimate(metric, [speckled(mean, rng) for _ in range(count)])
        pull = np.abs((found.value - truth) / found.standard_error)
        inside += [np.mean(pull < 1), np.mean(pull < 2)]
    expected = 1 - 2 * student.sf([1, 2], count - 1)
    # binomial, four times; the patterns' mean of exponentials is skewed by 2/sqrt(pixels)
    limit = 4 * np.sqrt(expected * (1 - expected) / draws) + 0.01
    assert np.all(np.abs(inside / draws - expected) < limit)


def test_linear_metric_has_the_textbook_error():
    mean, rng = smooth(), np.random.default_rng(8)
    patterns = [speckled(mean, rng) for _ in range(9)]
    values = [float(p.intensity[16, 20]) for p in patterns]
    found = psf.metric_estimate(lambda p: p.intensity[16, 20], patterns)
    assert found.value == approx(np.mean(values), rel=1e-14)
    assert found.standard_error == approx(np.std(values, ddof=1) / 3, rel=1e-12)
    assert found.n_patterns == 9


def test_rough_walls_are_their_exact_mean_within_the_error():
    """Energy in circles of drawn walls, against the mean in closed form."""
    wave = psf.Wavefront.from_zernike(
        {}, wavelength=WAVELENGTH, pupil_radius=RADIUS, image_distance=DISTANCE
    )
    roughness = psf.Roughness(height_rms=60e-9, correlation_length=1e-3)
    view = {"footprint": 0.5, "cos_sum": 2.0}
    grid = {"pitch": UNIT / 2, "shape": 96}
    radii = np.array([1.0, 4.0, 10.0]) * UNIT

    def energy(spread):
        return psf.encircled_energy(spread, radii)

    patterns = [
        psf.sample_point_spread(wave, roughness, seed=seed, effective_distance=0.5, **view, **grid)
        for seed in range(48)
    ]
    found = psf.metric_estimate(energy, patterns)
    exact = psf.mean_point_spread(wave, roughness, **view, **grid)
    truth = energy(exact)
    pull = (found.value - truth) / found.standard_error
    assert np.all(np.abs(pull) < 4)
    # an error bar, not a blanket
    assert np.all(found.standard_error < 0.05 * truth)


def test_what_is_refused():
    mean = smooth()
    with pytest.raises(SceneError, match="needs at least 2 patterns, got 1"):
        psf.metric_estimate(psf.centroid, [mean])
    with pytest.raises(SceneError, match="differ in pitch"):
        psf.metric_estimate(psf.centroid, [mean, replace(mean, pitch=2 * mean.pitch)])
    with pytest.raises(SamplingError, match="the metric is nan"):
        psf.metric_estimate(lambda p: np.nan, [mean, mean])
