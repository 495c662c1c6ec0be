"""Height maps: the surface through the samples, and the statistics of random ones."""

import numpy as np
import pytest

from nlosoptics.errors import SamplingError, SceneError
from nlosoptics.scene import HeightMapWall, WavyWall
from nlosoptics.scene.walls.height_maps import grid_limits


def sampled(wall, pitch=2e-3, nodes=201):
    """Map of a wall on a grid, taller than wide."""
    x = (np.arange(nodes) - (nodes - 1) / 2) * pitch
    y = (np.arange(nodes + 20) - (nodes + 19) / 2) * pitch
    return HeightMapWall(wall.height(x, y[:, None]), pitch)


def test_surface_follows_the_sampled_wall():
    wall = WavyWall(1e-4, 0.1, 0.3, direction=0.4)
    mapped = sampled(wall)
    assert mapped.size == pytest.approx((0.4, 0.44))
    x, y = np.random.default_rng(0).uniform(-0.19, 0.19, (2, 500))
    exact, found = wall.derivatives(x, y), mapped.derivatives(x, y)
    # (k pitch)^4 / 384 a = 6.5e-11 m for the height; slopes and bends lose one and two powers
    np.testing.assert_allclose(found[:, 0], exact[:, 0], rtol=0, atol=2e-10)
    np.testing.assert_allclose(found[:, 1:3], exact[:, 1:3], rtol=0, atol=2e-7)
    np.testing.assert_allclose(found[:, 3:], exact[:, 3:], rtol=0, atol=1e-3)


def test_slopes_are_continuous_across_cells():
    wall = HeightMapWall(np.random.default_rng(1).normal(size=(9, 12)), 0.1)
    y = np.linspace(-0.39, 0.39, 50)
    for edge in (-0.05, 0.35):
        below, above = wall.derivatives(edge - 1e-12, y), wall.derivatives(edge + 1e-12, y)
        # 2e-12 m apart, second derivatives of some 1e3 per m
        np.testing.assert_allclose(below[:, :3], above[:, :3], rtol=0, atol=1e-8)


def test_curvature_and_height_bounds_hold():
    wall = HeightMapWall(np.random.default_rng(2).normal(size=(9, 12)), 0.1)
    x, y = np.random.default_rng(3).uniform((-0.55, -0.4), (0.55, 0.4), (20_000, 2)).T
    h = wall.derivatives(x, y)
    bends = np.stack([h[:, [3, 4]], h[:, [4, 5]]], axis=1)
    largest = np.abs(np.linalg.eigvalsh(bends)).max()
    assert largest <= wall.max_curvature < 6 * largest
    term, table = wall.compiled()
    low, high, _ = grid_limits(term[0], table)
    assert low <= h[:, 0].min()
    assert h[:, 0].max() <= high


@pytest.mark.parametrize(
    ("autocorrelation", "law"),
    [("gaussian", lambda r: np.exp(-(r**2))), ("exponential", lambda r: np.exp(-r))],
)
def test_random_maps_have_their_rms_and_autocorrelation(autocorrelation, law):
    rms, length, pitch = 3e-6, 8e-3, 1e-3
    products, count = np.zeros(4), 40
    lags = np.array([0, 4, 8, 16])
    for seed in range(count):
        wall = HeightMapWall.random(
            height_rms=rms,
            correlation_length=length,
            size=0.2,
            pitch=pitch,
            autocorrelation=autocorrelation,
            seed=seed,
        )
        h = wall.heights
        assert h.shape == (201, 201)
        for k, lag in enumerate(lags):
            along_x = (h[:, lag:] * h[:, : h.shape[1] - lag]).mean()
            along_y = (h[lag:] * h[: h.shape[0] - lag]).mean()
            products[k] += (along_x + along_y) / 2 / count
    # independent cells: 40 walls of (0.2 / (sqrt(2 pi) 0.008))^2 = 100 for C^2, so 2 % ; 5 sigma
    np.testing.assert_allclose(products / rms**2, law(lags * pitch / length), rtol=0, atol=0.11)


def test_gaussian_slope_is_that_of_its_autocorrelation():
    """Per axis sqrt(2) rms / l, from the second derivative of C at 0."""
    wall = HeightMapWall.random(height_rms=1e-6, correlation_length=5e-3, size=0.5, pitch=5e-4)
    x, y = np.random.default_rng(5).uniform(-0.24, 0.24, (2, 20_000))
    slopes = wall.derivatives(x, y)[:, 1:3]
    # some 4000 independent patches: 1.1 %, four of them
    assert slopes.std() == pytest.approx(np.sqrt(2) * 1e-6 / 5e-3, rel=0.045)


def test_seed_and_grid_decide_the_wall():
    settings = {"height_rms": 1e-6, "correlation_length": 4e-3, "size": (0.03, 0.05), "pitch": 1e-3}
    first, again = (HeightMapWall.random(**settings, seed=7) for _ in range(2))
    assert first == again
    assert first.heights.shape == (51, 31)
    assert first != HeightMapWall.random(**settings, seed=8)


def test_bad_maps_are_refused(tmp_path):
    flat = np.zeros((6, 6))
    holed = flat.copy()
    holed[2, 3] = np.nan
    text = tmp_path / "a.npy"
    text.write_text("no array")
    np.save(tmp_path / "field.npy", flat * 1j)
    for arguments, message in (
        ((flat[:3], 0.1), r"wall.heights has shape \(3, 6\)"),
        ((holed, 0.1), r"wall.heights\[2, 3\] is NaN"),
        ((flat, 0.0), "wall.pitch = 0 m is out of range"),
        ((tmp_path / "none.npy", 0.1), "there is no file"),
        ((text, 0.1), "holds no array of numbers"),
        ((tmp_path / "field.npy", 0.1), "holds no array of numbers .*complex"),
        ((flat * 1j, 0.1), "wall.heights = .* is no array of numbers"),
    ):
        with pytest.raises(SceneError, match=message):
            HeightMapWall(*arguments)
    with pytest.raises(SceneError, match="exceeds the height map's 0.5 m"):
        HeightMapWall(flat, 0.1, size=0.51)
    with pytest.raises(SamplingError, match="below two pitches"):
        HeightMapWall.random(height_rms=1e-6, correlation_length=1e-3, size=0.1, pitch=1e-3)
