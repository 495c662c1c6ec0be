"""Depths of pictures and meshes against shapes whose depths are known."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from nlosoptics.errors import SamplingError, SceneError
from nlosoptics.transient import (
    Volume,
    VolumeImage,
    depth_error,
    depth_map,
    true_depths,
)

X, Y, Z = np.linspace(-0.5, 0.5, 6), np.linspace(-0.4, 0.4, 5), np.linspace(0.6, 1.4, 41)
VOLUME = Volume(X, Y, Z)
SLOPE = 1.003 + 0.213 * X + 0.1 * Y[:, None]  # m, a tilted plane


def picture(depth, height=1.0, volume=VOLUME):
    """Gaussians along z about a depth (ny, nx)."""
    values = np.exp(-(((volume.z[:, None, None] - depth) / 0.05) ** 2))
    return VolumeImage(intensity=values * height, volume=volume, method="test")


def test_gaussians_are_found_between_the_voxels():
    found = depth_map(picture(SLOPE))
    # a Gaussian's logarithm is its own fit, up to rounding
    assert found.depth == pytest.approx(SLOPE, abs=1e-12)
    assert found.coverage == 1.0
    own = depth_map(picture(SLOPE), interpolate=False)
    assert np.isin(own.depth, Z).all()
    # at most half a voxel off, and half of that in the mean
    assert np.abs(own.depth - SLOPE).max() <= 0.5 * 0.02 + 1e-12
    assert np.abs(own.depth - SLOPE).max() > 1e-3


def test_interpolation_goes_no_farther_than_half_a_voxel_nor_off_the_axis():
    rng = np.random.default_rng(0)
    image = VolumeImage(intensity=rng.uniform(size=VOLUME.shape), volume=VOLUME, method="noise")
    step = np.abs(depth_map(image).depth - depth_map(image, interpolate=False).depth)
    assert step.max() <= 0.01 + 1e-12
    rising = VolumeImage(
        intensity=np.broadcast_to(Z[:, None, None], VOLUME.shape), volume=VOLUME, method="rising"
    )
    assert (depth_map(rising).depth == Z[-1]).all()
    one = Volume(X, Y, [0.7])
    flat = VolumeImage(intensity=np.ones(one.shape), volume=one, method="flat")
    assert (depth_map(flat).depth == 0.7).all()


def test_thresholds_and_dark_columns_leave_nan():
    height = np.linspace(0.0, 1.0, 30).reshape(5, 6)
    found = depth_map(picture(np.ones((5, 6)), height), threshold=0.5)
    assert np.array_equal(np.isnan(found.depth), height < 0.5)
    assert found.confidence == pytest.approx(height)
    assert np.isnan(depth_map(picture(np.ones((5, 6)), height)).depth).sum() == 1


def test_the_best_threshold_leaves_out_what_is_wrong():
    truth = np.full((5, 6), Z[20])
    truth[0] = np.nan
    seen, height = np.full((5, 6), Z[21]), np.full((5, 6), 0.8)  # a voxel off, 2 cm
    height[2, 2] = 1.0
    seen[4], height[4] = Z[10], 0.3  # dim and 20 cm off
    error = depth_error(picture(seen, height), truth, n_thresholds=20)
    assert error.mae == pytest.approx(0.02, abs=1e-12)
    assert error.median == pytest.approx(0.02, abs=1e-12)
    assert 0.3 < error.threshold <= 0.8
    assert error.coverage == pytest.approx(18 / 24)
    assert error.missed == pytest.approx(6 / 24)
    assert error.false == pytest.approx(6 / 24)  # the first row, of 24 that are found
    assert error.curve[0, 1] == pytest.approx((18 * 0.02 + 6 * 0.2) / 24, abs=1e-12)
    assert (np.diff(error.curve[:, 0]) >= 0.0).all()


def test_thresholds_leave_out_equal_shares():
    """Brightness over six orders of magnitude: the best threshold keeps just what it must."""
    truth = np.full((5, 6), Z[20])
    height = 10.0 ** np.linspace(-6.0, 0.0, 30).reshape(5, 6)
    seen = truth + 0.002 * np.arange(29, -1, -1).reshape(5, 6)  # m, the brighter the better
    error = depth_error(picture(seen, height), truth, n_thresholds=30)
    assert error.coverage == pytest.approx(0.5, abs=1 / 30)
    assert error.threshold < 0.01


def test_a_threshold_may_not_leave_too_few():
    seen, height = np.full((5, 6), Z[21]), np.full((5, 6), 0.5)
    seen[2, 2], height[2, 2] = Z[20], 1.0
    image, truth = picture(seen, height), np.full((5, 6), Z[20])
    assert depth_error(image, truth).coverage == 1.0
    assert depth_error(image, truth, min_coverage=0.0).mae == pytest.approx(0.0, abs=1e-12)


def ball(centre, radius=0.3):
    return trimesh.creation.icosphere(subdivisions=4, radius=radius).apply_translation(centre)


def test_rays_find_the_front_of_a_ball_and_the_nearer_of_two_meshes():
    x = y = np.linspace(-0.45, 0.45, 31)
    near = ball((0.1, 0.0, 1.0))
    plate = trimesh.creation.box((2.0, 2.0, 0.1)).apply_translation((0.0, 0.0, 1.55))
    found = true_depths([plate, near], Volume(x, y, [1.0]))
    off = np.hypot(x - 0.1, y[:, None])
    with np.errstate(invalid="ignore"):
        expected = np.where(off < 0.3, 1.0 - np.sqrt(0.09 - off**2), 1.5)
    inner = (off < 0.29) | (off > 0.31)
    # a ball of flat facets: sag of edges of 3 cm, at the rim seen aslant
    assert np.abs(found - expected)[inner].max() < 5e-3
    alone = true_depths(near, Volume(x, y, [1.0]))
    assert np.array_equal(np.isnan(alone), ~np.isfinite(alone))
    assert np.isnan(alone[off > 0.3]).all()


@pytest.mark.parametrize(
    ("call", "kind", "words"),
    [
        (lambda: depth_map(picture(SLOPE, 0.0)), SceneError, "must be above 0"),
        (lambda: depth_map(picture(SLOPE), threshold=1.5), SceneError, "threshold"),
        (lambda: depth_map(picture(SLOPE * np.nan)), SceneError, "finite"),
        (lambda: depth_error(picture(SLOPE), SLOPE.T), SamplingError, r"\(6, 5\)"),
        (lambda: depth_error(picture(SLOPE), SLOPE * np.nan), SceneError, "all NaN"),
        (lambda: depth_error(picture(SLOPE), "near"), SceneError, "not real numbers"),
        (
            lambda: depth_error(
                depth_map(picture(SLOPE, np.eye(5, 6)), threshold=0.5), SLOPE, min_coverage=0.9
            ),
            SamplingError,
            "limit 0.9",
        ),
        (lambda: true_depths([], VOLUME), SceneError, "no mesh"),
    ],
)
def test_bad_input_is_one_clear_line(call, kind, words):
    with pytest.raises(kind, match=words) as caught:
        call()
    assert "\n" not in str(caught.value)
