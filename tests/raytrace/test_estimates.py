"""Means, errors and ends of runs from the sums of groups of rays."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import skew

from nlosoptics.errors import SceneError
from nlosoptics.raytrace.light import trace as tracing
from nlosoptics.raytrace.light.trace import GROUPS, mean_map, mean_of, skewness_of
from nlosoptics.scene import Lambert

from .light.draws import scene

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


def test_three_rays_have_no_error():
    assert mean_of(np.r_[1.0, 2.0, 4.0, np.zeros(29)], 3) == (7.0 / 3.0, math.inf)


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


@pytest.fixture(scope="module")
def job():
    matt = scene(paint=Lambert(0.5), material=Lambert(0.5))
    return tracing.job_of(replace(matt, occluders=()), 2, "sobol", 0)


def run(job, power, told, spread=0.3, **limits):
    """Trace rays whose light has a mean and a relative spread per ray, in blocks."""

    def blocks(start, end):
        for first in range(start, end, tracing.FIRST):
            n = min(tracing.FIRST, end - first)
            sums = np.zeros((GROUPS, job.columns))
            light = 1.0 + spread * math.sqrt(GROUPS / n) * np.cos(np.arange(GROUPS) + first)
            sums[:, 1] = power * n / GROUPS * light
            yield [sums], Counter(rays=n), []

    asked = {"n_rays": None, "tol": None, "max_seconds": None} | limits
    return tracing.until_done(job, blocks, progress=lambda *step: told.append(step), **asked)


def test_a_number_of_rays_is_traced_and_told(job):
    told = []
    found = run(job, 2.0, told, n_rays=10000)
    assert (found.n_rays, found.stopped) == (10000, "rays")
    done = [*range(tracing.FIRST, 10000, tracing.FIRST), 10000, 10000]
    assert told == [("rays", n / 10000) for n in done]
    assert found.flux == pytest.approx(2.0, rel=0.02)
    assert run(job, 2.0, []).n_rays == 1 << 16


@pytest.mark.parametrize("tol", [0.02, 0.002])
def test_rays_are_doubled_until_the_error_is_met(job, tol):
    """The fraction told before is what the last error says of the next."""
    told = []
    found = run(job, 2.0, told, tol=tol, n_rays=1 << 24)
    assert found.stopped == "tol"
    assert found.standard_error <= tol * found.flux
    rays = tracing.FIRST
    for text, share in told[:-1]:
        before = run(job, 2.0, [], n_rays=rays)
        assert before.standard_error > tol * before.flux
        wanted = min(0.99, (tol * before.flux / before.standard_error) ** 2)
        assert (text, share) == ("rays", pytest.approx(wanted, rel=1e-9))
        rays *= 2
    assert told[-1] == ("rays", 1.0)
    assert found.n_rays == rays


def test_rays_end_where_the_error_is_not_met(job):
    found = run(job, 2.0, [], tol=1e-6, n_rays=3 * tracing.FIRST)
    assert (found.stopped, found.n_rays) == ("rays", 3 * tracing.FIRST)


def test_a_time_is_kept(job):
    """It ends the first block that takes longer."""
    told = []
    found = run(job, 2.0, told, max_seconds=1e-9)
    assert (found.stopped, found.n_rays) == ("time", tracing.FIRST)
    assert told == [("rays", 1.0)] * 2


def test_a_dark_detector_is_given_up(job):
    with pytest.raises(SceneError, match=f"no light of {tracing.GIVE_UP} rays reached the dete"):
        run(job, 0.0, [], tol=0.1)
    assert run(job, 0.0, [], tol=0.1, n_rays=tracing.GIVE_UP // 2).flux == 0.0
