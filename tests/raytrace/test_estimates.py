"""Means, errors and ends of runs from the sums of groups of rays."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import skew

from nlosoptics.raytrace.light.trace import mean_map, mean_of, skewness_of

EVEN = 5.0 + np.sin(np.arange(32.0) ** 2)  # sums of groups, hardly skewed
SKEWED = np.exp(np.sin(np.arange(32.0) ** 2) * 2.0) ** 2


def error_of(sums, groups, rays):
    """Standard error of the mean over the rays, by the spread of the groups."""
    return sums[:groups].std(ddof=1) * math.sqrt((groups - 1) / (groups - 3) * groups) / rays


@pytest.mark.parametrize(("rays", "groups"), [(64, 32), (32, 32), (31, 31), (9, 9), (4, 4)])
def test_the_error_of_a_mean_is_students(rays, groups):
    sums = np.where(np.arange(32) < groups, EVEN, 0.0)
    mean, error = mean_of(sums, rays)
    assert mean == pytest.approx(sums.sum() / rays, rel=1e-14)
    assert abs(skewness_of(sums, rays)) < 1.0
    assert error == pytest.approx(error_of(sums, groups, rays), rel=1e-9)


@pytest.mark.parametrize("scale", [1.0, -1.0, 1e-200])
def test_skewed_groups_have_wider_errors(scale):
    """The error grows by the root of 1 + 0.75 (s^2 - 1)."""
    sums, s = scale * SKEWED, np.sign(scale) * skew(SKEWED)
    assert s**2 > 1.0
    assert skewness_of(sums, 64) == pytest.approx(s, rel=1e-9)
    wider = math.sqrt(1.0 + 0.75 * (s**2 - 1.0))
    assert mean_of(sums, 64)[1] == pytest.approx(abs(scale) * wider * error_of(SKEWED, 32, 64))
    assert skewness_of(np.full(32, scale), 64) == 0.0


def test_errors_of_a_map_are_those_of_its_pixels():
    sums = np.stack([np.roll(EVEN, k) * (k + 1.0) for k in range(6)], axis=1).reshape(32, 2, 3)
    for rays, groups in ((64, 32), (20, 20), (4, 4)):
        mean, variance = mean_map(np.where(np.arange(32)[:, None, None] < groups, sums, 0.0), rays)
        for place in np.ndindex(2, 3):
            part = sums[:groups, *place]
            assert mean[place] == pytest.approx(part.sum() / rays, rel=1e-14)
            assert variance[place] == pytest.approx(error_of(part, groups, rays) ** 2, rel=1e-9)
    assert np.isinf(mean_map(sums, 3)[1]).all()
