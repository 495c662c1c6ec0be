"""Contribution of one triangle to the bins, against sums over points."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from nlosoptics.scene import Lambert
from nlosoptics.transient.rendering._three_bounce_kernels import (
    COLUMNS,
    _is_whole,
    _may_hide,
    _piece,
    _whole,
    spread,
)

N = 400  # points along a side: middles of N^2 equal parts
AREA, START, WIDTH, COUNT = 0.3, 1.0, 0.1, 8


def shares():
    """Barycentric coordinates (N^2, 3) of the middles of a triangle's equal parts."""
    i, j = np.meshgrid(np.arange(N), np.arange(N), indexing="ij")
    up, down = i + j < N, i + j < N - 1
    u = np.concatenate([i[up] + 1 / 3, i[down] + 2 / 3]) / N
    v = np.concatenate([j[up] + 1 / 3, j[down] + 2 / 3]) / N
    return np.stack([1 - u - v, u, v], axis=1)


def by_points(paths, light):
    """Bins of the sum, with what is before and after at the ends."""
    at = np.floor((shares() @ paths - START) / WIDTH).astype(int)
    values = AREA / N**2 * (shares() @ light)
    return np.bincount(np.clip(at + 1, 0, COUNT + 1), weights=values, minlength=COUNT + 2)


def in_closed_form(paths, light):
    bins = np.zeros(COUNT + 2)
    spread(*map(float, paths), *map(float, light), AREA, START, WIDTH, bins)
    return bins


PATHS = {
    "middle corner low": (1.03, 1.17, 1.71),
    "middle corner high": (1.03, 1.62, 1.71),
    "two first": (1.03, 1.03, 1.71),
    "two last": (1.03, 1.71, 1.71),
    "beyond both ends": (0.52, 1.38, 2.36),
    "within a bin": (1.23, 1.25, 1.28),
}


@pytest.mark.parametrize("light", [(4.0, 1.0, 0.5), (0.5, 1.0, 4.0), (1.0, 4.0, 0.5)], ids=str)
@pytest.mark.parametrize("paths", PATHS.values(), ids=PATHS)
def test_light_that_falls_or_rises_along_the_path(paths, light):
    found, true = in_closed_form(paths, light), by_points(np.array(paths), np.array(light))
    assert found.sum() == pytest.approx(AREA * np.mean(light), rel=1e-12)
    # parts that a bin's edge cuts go to one side: up to a row of N of the N^2 parts
    assert np.abs(found - true).max() < 2.0 / N * AREA * max(light)
    # and the same for corners in any order
    for order in itertools.permutations(range(3)):
        turned = in_closed_form(np.array(paths)[list(order)], np.array(light)[list(order)])
        assert turned == pytest.approx(found, rel=1e-9, abs=1e-15)


def test_the_slope_of_the_light_has_its_sign():
    """Light up to a share t of the paths from one corner to two: ``t^2 (3 f0 + 2 t (f - f0))/3``.

    The two, whose side has no span, are on the last bin's edge.
    """
    paths, light = (1.0, 1.8, 1.8), (1.0, 4.0, 4.0)
    t = WIDTH * np.arange(COUNT + 1) / 0.8
    below = AREA * t**2 * (3 * light[0] + 2 * t * (light[1] - light[0])) / 3
    # closed forms of both, up to rounding
    assert in_closed_form(paths, light)[1:-1] == pytest.approx(np.diff(below), rel=1e-9)
    backward = in_closed_form((1.0, 1.0, 1.8), (4.0, 4.0, 1.0))[1:-1]
    assert backward == pytest.approx(np.diff(below)[::-1], rel=1e-9)


@pytest.mark.parametrize("side", [0.05, 0.1])
def test_undivided_triangle_is_exact_to_the_second_degree(side):
    """A plate parallel to the wall: light is the mean of z^4/(pi^2 r1^4 r2^4) over its points."""
    corners = np.array([[0.1, 0.0, 1.0], [0.1 + side, 0.0, 1.0], [0.1, side, 1.0]])
    laser, sensor, area = np.array([-0.2, 0.1, 0.0]), np.array([0.3, 0.2, 0.0]), side**2 / 2
    piece = np.array([*corners.ravel(), area, 1.0, 1.0, 0.0])
    pair, lobes = (*laser[:2], *sensor[:2], 1.0, 1.0), Lambert(0.5).lobe_table()
    bins, stack = np.zeros(3), np.zeros((4, COLUMNS))
    parts = _piece(piece, pair, lobes, 0, 1, 1.0, np.inf, 0.0, 10.0, bins, stack)
    assert parts == 1
    points = shares() @ corners
    r1, r2 = (np.linalg.norm(points - end, axis=1) for end in (laser, sensor))
    exact = 0.5 * area * (1 / (np.pi**2 * (r1 * r2) ** 4)).mean()
    # three corners and the centroid are exact to the second degree, the middles to side^2/N^2
    assert bins.sum() == pytest.approx(exact, rel=0.1 * side**3)


@pytest.mark.parametrize(
    ("edge", "counts"),
    [(-1.1, False), (-0.9, True), ("high", True), ("above", False)],
    ids=["below the shortest path", "above it", "below the longest path", "above that"],
)
@pytest.mark.parametrize("share", [1e-3, 0.5, 3.0])
def test_a_triangle_is_divided_where_its_error_is_above_the_limit(share, edge, counts):
    """The error is that of the light, and of the light that a bent path moves past a bin's edge.

    ``share`` is the shift of the path relative to a bin. ``edge`` is the place of the first bin's
    start, relative to the path of the nearest corner in units of the shift.
    """
    corners = np.array([[0.1, 0.0, 0.6], [0.5, 0.0, 0.6], [0.1, 0.4, 0.6]])
    laser, sensor, area = np.array([-0.2, 0.1, 0.0]), np.array([0.3, 0.2, 0.0]), 0.08
    points = np.array([*corners, corners.mean(axis=0)])
    r1, r2 = (np.linalg.norm(points - end, axis=1) for end in (laser, sensor))
    paths, light = r1 + r2, 0.5 * 0.6**4 / (np.pi**2 * (r1 * r2) ** 4)
    # of a quadratic, 3/4 of the difference between the centroid and the mean of the corners
    shift, lift = (0.75 * (values[3] - values[:3].mean()) for values in (paths, light))
    assert shift < 0.0
    low, high = paths[:3].min(), paths[:3].max()
    at = {"high": high - 1e-6, "above": high + 1e-6}.get(edge) or low - edge * shift
    wrong, delta = area * abs(lift), abs(shift) / share
    if counts or (edge == -1.1 and delta < high - low):
        wrong += area * light[3] * min(1.0, share)
    piece = np.array([*corners.ravel(), area, 0.6, 0.6, 0.0])
    pair, lobes = (*laser[:2], *sensor[:2], 0.6, 0.6), Lambert(0.5).lobe_table()

    def parts(limit):
        bins, stack = np.zeros(3000), np.zeros((200, COLUMNS))
        return _piece(piece, pair, lobes, 0, 1, 1.0, limit, at, delta, bins, stack)

    assert parts(wrong * (1 + 1e-6)) == 1
    assert parts(wrong * (1 - 1e-6)) > 1


@pytest.mark.parametrize(("tilt", "turn"), [(0.5, 0.1), (0.5, 0.45), (0.2, 0.3), (1.55, 0.1)])
def test_a_narrow_lobe_may_peak_within_a_part(tilt, turn):
    """Light rises towards the mirror direction by at most exp(tan^2/sharp^2)."""
    sharp, least = 0.1, max(tilt - turn, 0.0)
    rise = (math.tan(min(tilt, 1.5)) ** 2 - math.tan(min(least, 1.5)) ** 2) / sharp**2
    limit = 3e-9
    most = limit * math.exp(-min(rise, 700.0))
    assert _may_hide(1.001 * most, tilt, turn, sharp, limit)
    assert not _may_hide(0.999 * most, tilt, turn, sharp, limit)
    # without light at the centroid, or a limit, parts that come near the peak are divided
    for light, lim, near in ((0.0, limit, 26.0), (1.0, math.inf, 5.0)):
        if least > 0.0:
            assert _may_hide(light, tilt, turn, least / near * 1.001, lim)
            assert not _may_hide(light, tilt, turn, least / near * 0.999, lim)
        else:
            assert _may_hide(light, tilt, turn, 1e-3, lim)


def test_only_the_whole_triangle_is_told_as_whole():
    polygons, sizes = np.zeros((1, 10)), np.zeros(1, dtype=np.int64)
    _whole(polygons, sizes)
    assert sizes[0] == 3
    assert polygons[0, :6].tolist() == [0.0, 0.0, 1.0, 0.0, 0.0, 1.0]
    assert _is_whole(polygons[0], 3)
    assert not _is_whole(polygons[0], 4)
    for k in range(6):
        part = polygons[0].copy()
        part[k] = 0.5
        assert not _is_whole(part, 3)
