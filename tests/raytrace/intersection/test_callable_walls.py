"""Walls of Python functions against the same walls in compiled code, and parts of batches."""

from __future__ import annotations

import math

import numpy as np
import pytest

from nlosoptics import raytrace
from nlosoptics.raytrace import Hits
from nlosoptics.scene import CallableWall, ConvexWall, WavyWall

BEHIND, HIT, MISS, OUTSIDE = Hits.BEHIND, Hits.HIT, Hits.MISS, Hits.OUTSIDE


def of_functions(wall, top, curvature, size):
    """The same wall as functions of x and y, with its slopes and second derivatives."""
    return CallableWall(
        wall.height,
        lambda x, y: tuple(np.moveaxis(wall.derivatives(x, y), -1, 0)[1:3]),
        hessian=lambda x, y: tuple(np.moveaxis(wall.derivatives(x, y), -1, 0)[3:6]),
        size=size,
        max_height=top,
        max_curvature=curvature,
    )


def waves(size):
    return WavyWall(0.03, 0.4, 0.7, direction=0.6, size=size)


PAIRS = {
    "waves": (waves((1.3, 0.9)), 0.03, 0.03 * (2 * math.pi / 0.4) ** 2, (1.3, 0.9)),
    "endless waves": (waves(None), 0.03, 0.03 * (2 * math.pi / 0.4) ** 2, None),
    "pillar": (
        ConvexWall(1.1, shape="cylinder", axis="y", size=(0.9, 1.4)),
        *(0.1, 1.5, (0.9, 1.4)),
    ),
}


def rays(count, seed):
    """From above, within and below the wall's heights, over it and beside it, some along axes."""
    draw = np.random.default_rng(seed)
    origins = draw.uniform((-1.1, -0.9, -0.15), (1.1, 0.9, 0.4), (count, 3))
    origins[::4, 2] = draw.uniform(0.2, 3.0, len(origins[::4]))
    directions = draw.normal(size=(count, 3)) * (1.0, 1.0, 0.6) - (0.0, 0.0, 0.4)
    directions[1::9, 0] = directions[2::9, 1] = directions[3::9, 2] = 0.0
    directions[4::9, :2] = 0.0
    directions[5::18, 1:] = 0.0
    return origins, directions * draw.uniform(0.1, 5.0, (count, 1))


@pytest.mark.parametrize("name", PAIRS)
def test_functions_are_met_where_compiled_walls_are(name):
    wall, *limits = PAIRS[name]
    origins, directions = rays(900, 3)
    found = raytrace.intersect(of_functions(wall, *limits), origins, directions)
    wanted = raytrace.intersect(wall, origins, directions)
    assert (found.hit == wanted.hit).all()
    if name != "pillar":  # for which all that is in its circle counts as behind
        assert (found.status == wanted.status).all()
    for status in (HIT, MISS, OUTSIDE, BEHIND):
        expected = status != OUTSIDE or limits[-1] is not None
        assert ((wanted.status == status).sum() > 5) == expected
    hit = wanted.hit
    np.testing.assert_allclose(found.distance[hit], wanted.distance[hit], rtol=1e-11, atol=1e-13)
    np.testing.assert_allclose(found.points[hit], wanted.points[hit], rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.normals[hit], wanted.normals[hit], rtol=0, atol=1e-10)
    assert np.isnan(found.distance[found.status != HIT]).all()
    assert np.isnan(found.normals[found.status != HIT]).all()
    assert found.status.dtype == np.int8


def plane(height, along, up, *, size, top=None, curvature=0.0):
    """An inclined plane."""
    return CallableWall(
        lambda x, y: height + along * x + up * y,
        lambda x, y: (along + 0 * x, up + 0 * x),
        hessian=lambda x, y: (0 * x, 0 * x, 0 * x),
        size=size,
        max_height=(size[0] * abs(along) + size[1] * abs(up)) / 2 + height if top is None else top,
        max_curvature=curvature,
    )


def test_a_crest_at_the_greatest_height_is_met():
    wall = plane(0.25, 0.0, 0.0, size=(1.0, 0.6), top=0.25)
    hits = raytrace.intersect(wall, (0.1, 0.0, 1.0), [(0, 0, -1), (0.4, 0.1, -1), (0.3, 0.1, -1)])
    assert hits.status.tolist() == [HIT, HIT, HIT]
    steep = math.hypot(0.4, 0.1, 1.0), math.hypot(0.3, 0.1, 1.0)
    np.testing.assert_allclose(hits.distance, [0.75, *(0.75 * s for s in steep)], rtol=1e-13)


@pytest.mark.parametrize(
    ("origin", "direction", "status", "distance"),
    [
        ((0.1, 0.2, 0.7), (0.0, 0.0, -2.0), HIT, 0.45),
        ((0.1, 0.2, 0.25), (0.0, 0.0, -1.0), HIT, 0.0),  # starts on it
        ((0.1, 0.2, 0.25), (0.0, 0.0, 1.0), MISS, math.nan),
        ((0.1, 0.2, 0.7), (0.0, 0.0, 1.0), MISS, math.nan),
        ((0.1, 0.2, 0.7), (1.0, 0.0, 0.0), MISS, math.nan),  # level, above it
        ((0.6, 0.2, 0.7), (0.0, 0.0, -1.0), OUTSIDE, math.nan),  # beside one edge
        ((0.1, 0.4, 0.7), (0.0, 0.0, -1.0), OUTSIDE, math.nan),  # and the other
        ((0.6, 0.2, 0.7), (-1.0, 0.0, -1.0), HIT, 0.45 * math.sqrt(2)),  # comes over it
        ((0.6, 0.2, 0.1), (-1.0, 0.0, 0.0), MISS, math.nan),  # enters below it, level
        ((0.6, 0.2, 0.1), (-1.0, 0.0, -0.1), OUTSIDE, math.nan),  # enters below it
        ((0.1, 0.2, 0.2), (0.0, 0.0, -1.0), BEHIND, math.nan),
        ((0.1, 0.2, 0.2), (0.0, 0.0, 1.0), BEHIND, math.nan),
        ((0.1, 0.2, -0.9), (0.0, 0.0, 1.0), BEHIND, math.nan),
        ((0.1, 0.2, -0.9), (1.0, 0.0, 0.0), BEHIND, math.nan),
        ((0.9, 0.2, -0.9), (-1.0, 0.0, 1.0), BEHIND, math.nan),  # comes from behind
        ((0.9, 0.2, -0.9), (1.0, 0.0, 1.0), MISS, math.nan),  # beside it, and leaves
    ],
)
def test_status_of_rays_about_a_plateau(origin, direction, status, distance):
    wall = plane(0.25, 0.0, 0.0, size=(1.0, 0.6))
    hits = raytrace.intersect(wall, origin, direction)
    assert hits.status == status
    np.testing.assert_allclose(hits.distance, distance, rtol=1e-12, atol=1e-12)


def test_a_level_ray_between_plateau_and_greatest_height_is_a_miss():
    wall = plane(0.25, 0.0, 0.0, size=(1.0, 0.6), top=0.5)
    hits = raytrace.intersect(wall, (-2.0, 0.1, 0.4), [(1.0, 0.0, 0.0), (1.0, 0.01, 0.0)])
    assert hits.status.tolist() == [MISS, MISS]
