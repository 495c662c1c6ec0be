"""Random reliefs: statistics of surface and slopes, addresses of draws, bulk evaluation."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from nlosoptics.errors import SceneError
from nlosoptics.kernels import codes, relief
from nlosoptics.scene import (
    ConcaveWall,
    FacetWall,
    GaussianWall,
    SumWall,
)

CELL, SLOPE = 1e-3, 2e-2
SEEDS = 20


def _nodes(wall, i, j):
    """Positions (..., 2) of lattice nodes (i, j) of a wall of facets."""
    row = wall.compiled()[0][0]
    return np.stack(
        [row[5] + wall.cell * (i + j / 2), row[6] + wall.cell * math.sqrt(0.75) * j], axis=-1
    )


def _points(reach, count, seed=0):
    """Uniform points (2, count) over a square of half side ``reach``."""
    return np.random.default_rng(seed).uniform(-reach, reach, (2, count))


@pytest.fixture(scope="module")
def slopes():
    """Slopes of facets (SEEDS, n, 2), one point in each of many facets."""
    i, j = np.meshgrid(np.arange(-60, 60), np.arange(-60, 60))
    drawn = []
    for seed in range(SEEDS):
        wall = FacetWall(CELL, SLOPE, seed=seed)
        corners = _nodes(wall, i, j).reshape(-1, 2)
        middles = np.concatenate(
            [
                corners + CELL * np.array([0.5, math.sqrt(0.75) / 3]),
                corners + CELL * np.array([1.0, math.sqrt(0.75) * 2 / 3]),
            ]
        )
        drawn.append(wall.derivatives(*middles.T)[:, 1:3])
    return np.array(drawn)


def test_facet_slopes_are_gaussian_and_isotropic(slopes):
    # 576,000 facets from 288,000 independent nodes: the variance has a standard error of 0.3 %
    covariance = np.cov(slopes.reshape(-1, 2).T) / SLOPE**2
    assert covariance == pytest.approx(np.eye(2), abs=0.02)
    # a third direction, which would show a dependence on three-fold axes
    turned = slopes @ np.array([math.cos(0.6), math.sin(0.6)])
    assert turned.var() == pytest.approx(SLOPE**2, rel=0.02)
    # facets without a common node are independent: every fourth of each row and column
    apart = slopes.reshape(SEEDS, 2, 120, 120, 2)[:, 0, ::4, ::4].reshape(SEEDS, -1, 2)
    for axis in range(2):
        values = [
            stats.chisquare(
                np.histogram(stats.norm.cdf(one / SLOPE), bins=12, range=(0, 1))[0]
            ).pvalue
            for one in apart[..., axis]
        ]
        # the least of 20 uniform values is below 1e-4 in 0.2 % of all draws, which are fixed here
        assert min(values) > 1e-4


def test_facet_normals_follow_their_density(slopes):
    """Facet tilts per mean-plane area: tan^2(t) is exponential, the azimuth uniform."""
    apart = slopes.reshape(SEEDS, 2, 120, 120, 2)[:, 1, ::4, ::4].reshape(SEEDS, -1, 2)
    for one in apart:
        tilt = np.exp(-(one**2).sum(axis=1) / (2 * SLOPE**2))
        azimuth = np.arctan2(one[:, 1], one[:, 0]) / (2 * np.pi) % 1.0
        table = np.histogram2d(tilt, azimuth, bins=(5, 6), range=((0, 1), (0, 1)))[0]
        assert stats.chisquare(table.ravel()).pvalue > 1e-4


def test_facets_join_at_their_edges():
    wall = FacetWall(CELL, SLOPE, seed=3)
    i, j = (v.ravel() for v in np.meshgrid(np.arange(-40, 40), np.arange(-40, 40)))
    a, b, c = _nodes(wall, i, j), _nodes(wall, i + 1, j), _nodes(wall, i, j + 1)
    d = _nodes(wall, i + 1, j + 1)
    lower = wall.derivatives(*((a + b + c) / 3).T)[:, 1:3]
    upper = wall.derivatives(*((b + c + d) / 3).T)[:, 1:3]
    # the slopes of both facets of an edge agree along it, so that no loop has a curl
    for edge, one, other in (
        (c - b, lower, upper),
        (
            (d - c).reshape(80, 80, 2)[:-1],
            upper.reshape(80, 80, 2)[:-1],
            lower.reshape(80, 80, 2)[1:],
        ),
        (
            (d - b).reshape(80, 80, 2)[:, :-1],
            upper.reshape(80, 80, 2)[:, :-1],
            lower.reshape(80, 80, 2)[:, 1:],
        ),
    ):
        jump = (edge * (one - other)).sum(axis=-1)
        assert np.abs(jump).max() < 1e-12 * CELL
    # one facet's slopes are constant and give its height differences
    x, y = (0.2 * a + 0.5 * b + 0.3 * c).T
    first = wall.derivatives(x, y)
    middle = wall.derivatives(*((a + b + c) / 3).T)
    assert np.abs(first[:, 1:3] - middle[:, 1:3]).max() == 0.0
    assert not first[:, 3:].any()
    step = np.stack([x, y], axis=-1) - (a + b + c) / 3
    assert first[:, 0] - middle[:, 0] == pytest.approx(
        (step * first[:, 1:3]).sum(axis=1), abs=1e-18
    )


@pytest.mark.thorough
def test_gaussian_relief_has_its_autocorrelation():
    length, rms = 2e-3, 1e-6
    lags = length * np.array([0.0, 0.3, 0.7, 1.0, 1.6, 2.5])
    turns = np.array([0.0, 0.6, math.pi / 2])
    # points 4 l apart are independent: C = exp(-16)
    x, y = (v.ravel() for v in np.meshgrid(*2 * [4 * length * np.arange(40)]))
    sums = np.zeros((len(turns), len(lags)))
    for seed in range(SEEDS):
        wall = GaussianWall(rms, length, seed=seed)
        base = wall.height(x, y)
        for m, turn in enumerate(turns):
            moved = [wall.height(x + d * math.cos(turn), y + d * math.sin(turn)) for d in lags]
            sums[m] += np.mean(base * np.array(moved), axis=1) / SEEDS
    truth = np.exp(-((lags / length) ** 2))
    # 32,000 independent products, whose variance is 1 + C^2: four standard errors
    assert np.abs(sums / rms**2 - truth).max() < 4 * math.sqrt(2 / (1600 * SEEDS))
    assert wall.slope_rms == pytest.approx(math.sqrt(2) * rms / length, rel=1e-14)
    drawn = wall.derivatives(x, y)
    # 1600 independent draws: standard errors of 2 %, five of them
    assert drawn[:, 1].std() == pytest.approx(wall.slope_rms, rel=0.1)
    assert drawn[:, 3].std() == pytest.approx(math.sqrt(12) * rms / length**2, rel=0.1)
    assert drawn[:, 4].std() == pytest.approx(2 * rms / length**2, rel=0.1)


def test_gaussian_derivatives_match_differences():
    wall = GaussianWall(1e-6, 1e-3, seed=2**40 + 3)
    x, y = _points(0.02, 300)
    exact, step = wall.derivatives(x, y), 1e-7

    def slope(column, dx, dy):
        ahead, behind = wall.derivatives(x + dx, y + dy), wall.derivatives(x - dx, y - dy)
        return (ahead - behind)[:, column] / (2 * step)

    # relative error of central differences: (step / l)^2, and rounding 1e-16 l / step
    pairs = ((1, 0, step, 0), (2, 0, 0, step), (3, 1, step, 0), (4, 1, 0, step), (5, 2, 0, step))
    for column, parent, dx, dy in pairs:
        scale = exact[:, column].std()
        assert slope(parent, dx, dy) == pytest.approx(exact[:, column], abs=1e-7 * scale)


@pytest.mark.thorough
def test_bounds_hold_and_zero_roughness_is_flat():
    x, y = _points(1.0, 20_000)
    for wall in (FacetWall(1e-2, 0.1), GaussianWall(1e-4, 1e-2)):
        h = wall.derivatives(x, y)
        assert np.abs(h[:, 0]).max() < wall.max_height
        bend = np.abs(h[:, 3] + h[:, 5]) / 2 + np.hypot((h[:, 3] - h[:, 5]) / 2, h[:, 4])
        assert bend.max() <= wall.max_curvature
        assert not wall.is_flat
    assert relief.node(np.uint64(0), np.uint64(0), 0, 0) < codes.EXTREME
    for wall in (FacetWall(1e-2, 0.0), GaussianWall(0.0, 1e-2)):
        assert wall.is_flat
        assert not wall.height(x, y).any()


def test_mesh_of_facets_keeps_its_sag_error():
    sphere = ConcaveWall(2.0)
    for wall in (FacetWall(0.02, 0.1, size=0.1), SumWall(sphere, FacetWall(0.02, 0.1), size=0.1)):
        mesh = wall.to_mesh(max_sag_error=3e-4)
        middles = mesh.triangles.mean(axis=1)
        gap = np.abs(wall.height(*middles.T[:2]) - middles[:, 2]).max()
        assert 1e-5 < gap < 3e-4


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: FacetWall(0.0, 0.1), r"wall.cell = 0 m is out of range, must be above 0 m"),
        (lambda: FacetWall(1e-3, 1.1), r"wall.slope_rms = 1.1 rad .* from 0 to 1 rad"),
        (lambda: FacetWall(1e-3, 0.1, seed=0.5), r"wall.seed = 0.5 is not a whole number"),
        (lambda: GaussianWall(-1e-6, 1e-3), r"wall.height_rms = -1e-06 m is out of range"),
        (lambda: GaussianWall(1e-3, 1e-3), r"slope rms 1.41421, limit 1"),
        (lambda: FacetWall(1e-3, 0.1).height(3e6, 0.0), r"more than 2\^31 cells"),
    ],
)
def test_bad_input_is_refused(make, message):
    with pytest.raises(SceneError, match=message):
        make()
