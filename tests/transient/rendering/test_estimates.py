"""Errors, reasons to stop and sizes of batches of light that is reflected many times."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh

from nlosoptics.scene import Lambert
from nlosoptics.transient.rendering import batches, three_bounces
from nlosoptics.transient.rendering import multiple_bounces as many
from nlosoptics.transient.rendering.surfaces import bounce_surfaces, hidden_surfaces

BATCHES = np.random.default_rng(1).gamma(2.0, size=(7, 3, 5))


def test_the_variance_is_that_of_students_distribution():
    """s^2/n times (n - 1)/(n - 3); rounding does not take it below 0."""
    found = many._variance(BATCHES.sum(0), (BATCHES**2).sum(0), 7)
    assert found == pytest.approx(BATCHES.var(0, ddof=1) / 7 * 6 / 4, rel=1e-12)
    assert many._variance(np.array([3.0]), np.array([9.0 / 7 - 1e-16]), 7).tolist() == [0.0]


def test_the_error_is_that_of_the_worst_lit_pair():
    total, squares = BATCHES.sum(0), (BATCHES**2).sum(0)
    each = np.sqrt(BATCHES.var(0, ddof=1) * 6 / 28).sum(1) / BATCHES.mean(0).sum(1)
    worst = math.sqrt(2.0 / math.pi) * each.max()
    assert many._l1(total, squares, 7) == pytest.approx(worst, rel=1e-12)
    total[each.argmax()] = squares[each.argmax()] = 0.0
    second = math.sqrt(2.0 / math.pi) * np.sort(each)[1]
    assert many._l1(total, squares, 7) == pytest.approx(second, rel=1e-12)
    assert many._l1(0.0 * total, 0.0 * squares, 7) == math.inf


@pytest.mark.parametrize(
    ("reached", "tol", "reason"),
    [
        ([0.01, 0.02], 0.02, "tol"),
        ([0.01, 0.021], 0.02, "paths"),
        ([0.01, 0.01], None, "paths"),
        ([0.01, math.inf], 0.02, "dark"),
        ([0.03, math.inf], 0.02, "paths"),
        ([math.inf, math.inf], 0.02, "dark"),
    ],
)
def test_reasons_to_stop(reached, tol, reason):
    assert many._stopped(reached, tol) == reason


def test_pairs_are_computed_alike_from_both_ends():
    """The end that more pairs share is first, else the lower one, whichever end has the laser."""
    draw = np.random.default_rng(4)
    points = np.round(draw.random((6, 3)), 2)
    one, other = points[draw.integers(0, 3, 40)], points[draw.integers(1, 6, 40)]
    for lasers, sensors in ((one, other), (other, one), (points[:1], points[1:2]), (one, one)):
        first, second, lights, sight, turned = three_bounces._shared(lasers, sensors)
        assert len(lights) == min(len(np.unique(side, axis=0)) for side in (lasers, sensors))
        assert np.array_equal(lights[sight], first)
        begun = np.where(turned[:, None], second, first)
        back = three_bounces._shared(sensors, lasers)
        assert np.array_equal(begun, np.where(back[4][:, None], back[1], back[0]))
        assert np.array_equal(begun + np.where(turned[:, None], first, second), lasers + sensors)


def polygon_share(p, normal, corners):
    """Share of cosine-weighted rays from p that meet a polygon above its horizon: Lambert 1760."""
    edges = corners - p
    edges /= np.linalg.norm(edges, axis=1)[:, None]
    found = 0.0
    for a, b in zip(edges, np.roll(edges, -1, axis=0), strict=True):
        across = np.cross(a, b)
        found += math.acos(a @ b) * (across @ normal) / np.linalg.norm(across)
    return abs(found) / (2.0 * math.pi)


def view_job(*triangles, sensors, n_seen):
    """A job that sends rays from ``sensors`` only, and one path from each first vertex."""
    corners = np.array(triangles)
    faces = np.arange(3 * len(corners)).reshape(-1, 3)
    mesh = trimesh.Trimesh(corners.reshape(-1, 3), faces, process=False)
    around = bounce_surfaces(hidden_surfaces([(mesh, Lambert(0.7))]), sensors, 1.0, None)
    return batches.Job(
        around=around,
        lasers=sensors,
        sensors=sensors,
        rows=np.array([[0, 0]]),
        orders=(4,),
        starts=np.zeros(1),
        rate=1.0,
        n_bins=4,
        seed=3,
        n_seen=n_seen,
        n_each=1,
        aimed=(0.0, 0.0),
    )


def test_rays_that_leave_are_counted():
    """One triangle over the wall and one upright beside it, each the first of its mesh once."""
    over = np.array([[-0.4, -0.5, 0.6], [0.5, -0.3, 0.6], [-0.1, 0.7, 0.6]])
    beside = np.array([[0.6, -0.4, 0.1], [0.6, 0.5, 0.15], [0.6, 0.1, 0.5]])
    sensors = np.array([[0.0, 0.1, 0.0], [0.2, -0.2, 0.0]])
    up, n = np.array([0.0, 0.0, 1.0]), 1 << 14
    seen = [[polygon_share(p, up, c) for c in (over, beside)] for p in sensors]
    # where the rays land, by the midpoints of small squares folded into the triangle
    u, v = (np.mgrid[:24, :24].reshape(2, -1) + np.array([[0.3], [0.6]])) / 24
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    again = 0.0
    for corners, normal, other in ((over, -up, beside), (beside, np.array([-1.0, 0, 0]), over)):
        a, b = corners[1:] - corners[0]
        points = corners[0] + u[:, None] * a + v[:, None] * b
        area = np.linalg.norm(np.cross(a, b)) / 2 / len(points)
        onward = np.array([polygon_share(p, normal, other) for p in points])
        for sensor in sensors:
            line = points - sensor
            r2 = (line * line).sum(axis=1)
            density = np.abs(line @ up * (line @ normal)) / (math.pi * r2 * r2)
            again += (density * onward).sum() * area
    wanted = 1.0 - np.sum(seen) / 2, 1.0 - again / np.sum(seen)
    for triangles in ((over, beside), (beside, over)):
        found = batches.openness(view_job(*triangles, sensors=sensors, n_seen=n))
        # two to three standard deviations of as many random rays; Sobol points do better
        assert found == pytest.approx(wanted, abs=0.006)
    edge_on = np.array([[0.0, 0.1, 0.3], [0.4, -0.5, 0.3], [0.2, -0.2, 0.8]])
    assert batches.openness(view_job(edge_on, sensors=sensors, n_seen=64)) == (1.0, 1.0)
