"""Captures and volumes check their arguments."""

from __future__ import annotations

import numpy as np
import pytest

from nlosoptics.errors import SamplingError, SceneError
from nlosoptics.transient import TransientCapture, Volume, VolumeImage, wall_grid

GRID = wall_grid(2.0, 4)


def capture(**changes):
    given = {
        "H": np.zeros((6, 4, 4)),
        "laser_points": (0.0, 0.0, 0.0),
        "sensor_points": GRID,
        "delta_t": 0.01,
        "t_start": 1.0,
    }
    return TransientCapture(**{**given, **changes})


def test_wall_grid_is_of_cell_middles_row_0_lowest():
    assert GRID.shape == (4, 4, 3)
    assert tuple(GRID[0, 0]) == (-0.75, -0.75, 0.0)
    assert tuple(GRID[1, 0]) == (-0.75, -0.25, 0.0)


def test_one_laser_point_adds_no_axis_and_bins_have_edges():
    one = capture()
    assert (one.laser_shape, one.sensor_shape, one.n_bins) == ((), (4, 4), 6)
    assert one.edges[[0, -1]] == pytest.approx([1.0, 1.06])
    assert one.times[0] == pytest.approx(1.005)
    assert not one.is_confocal


def test_confocal_pairs():
    pairs = capture(laser_points=GRID, pairing="confocal")
    assert pairs.is_confocal
    assert not capture(laser_points=GRID + 0.1, pairing="confocal").is_confocal


@pytest.mark.parametrize(
    ("changes", "kind", "words"),
    [
        ({"H": np.zeros((6, 4))}, SamplingError, r"\(6, 4\), must be \(n_bins, 4, 4\)"),
        ({"H": np.full((6, 4, 4), np.nan)}, SceneError, "96 of 96 values"),
        ({"H": np.zeros((6, 4, 4), complex)}, SceneError, "complex128"),
        ({"delta_t": 0.0}, SceneError, "delta_t"),
        ({"pairing": "confocal"}, SamplingError, "not pairs"),
        ({"sensor_points": np.zeros((4, 2))}, SamplingError, r"\(4, 2\)"),
        ({"quantity": "lumen"}, SceneError, "lumen"),
        ({"standard_error": np.zeros(3)}, SamplingError, "standard_error"),
        ({"by_bounce": {3: np.zeros(3)}}, SamplingError, r"by_bounce\[3\]"),
        ({"by_bounce": {3: np.zeros((5, 4, 4))}}, SamplingError, r"by_bounce\[3\] has 5 bins"),
        ({"by_bounce": {3.5: np.zeros((6, 4, 4))}}, SceneError, "key of by_bounce = 3.5 is not"),
        ({"by_bounce": [np.zeros((6, 4, 4))]}, SceneError, "by_bounce is a list"),
        ({"standard_error": np.zeros((1, 4, 4))}, SamplingError, "standard_error has 1 bin,"),
        ({"sensor_normals": np.zeros(3)}, SamplingError, "sensor_normals"),
        ({"H": [[1.0, 2.0], [1.0]]}, SamplingError, "H has rows of several lengths"),
        ({"laser_points": [[0, 0, 0], [1]]}, SamplingError, "laser_points have rows of several"),
        ({"laser_points": "centre"}, SceneError, "laser_points of type <U6 are not real numbers"),
        ({"laser_points": (1j, 0, 0)}, SceneError, "laser_points of type complex128"),
    ],
)
def test_bad_captures(changes, kind, words):
    with pytest.raises(kind, match=words):
        capture(**changes)


def test_single_precision_is_kept_and_counts_become_floats():
    assert capture(H=np.zeros((6, 4, 4), np.float32)).H.dtype == np.float32
    assert capture(H=np.zeros((6, 4, 4), np.uint16)).H.dtype == np.float64


def test_volume_points_are_z_y_x():
    volume = Volume.box((0.1, 0.2, 1.0), (0.4, 0.2, 0.0), 0.1)
    assert volume.shape == (1, 2, 4)
    assert volume.points[0, 1, 2] == pytest.approx([0.15, 0.25, 1.0])
    same = Volume.before(2.0, 4, [1.0, 1.5])
    assert same.points[0, :, :, :2] == pytest.approx(GRID[..., :2])


def test_bad_volumes():
    with pytest.raises(SamplingError, match="rise evenly"):
        Volume([0.0, 0.1, 0.3], [0.0], [1.0])
    with pytest.raises(SceneError, match="not finite"):
        Volume([0.0], [np.inf], [1.0])
    with pytest.raises(SamplingError, match="like the volume"):
        VolumeImage(intensity=np.zeros((1, 1)), volume=Volume([0.0], [0.0], [1.0]), method="none")
    with pytest.raises(SceneError, match=r"volume\.x of type <U1 are not real numbers"):
        Volume("x", [0.0], [1.0])
    with pytest.raises(SamplingError, match="depths have rows of several lengths"):
        Volume.before(1.0, 4, [[1.0], [1.0, 2.0]])
    with pytest.raises(SceneError, match=r"\(0.5, 0.8\) must be \(near, far, step\)"):
        Volume.facing(GRID, (0.5, 0.8))
    with pytest.raises(SceneError, match="0.5 must be"):
        Volume.facing(GRID, 0.5)
    with pytest.raises(SamplingError, match=r"\(0, 4, 3\) are no grid"):
        Volume.facing(GRID[:0], (0.5, 0.8, 0.1))


def test_projection_takes_the_brightest():
    seen = np.zeros((2, 3, 4))
    seen[1, 2, 3] = 5.0
    image = VolumeImage(
        intensity=seen, volume=Volume(np.arange(4.0), np.arange(3.0), [1.0, 2.0]), method="none"
    )
    assert image.projection()[2, 3] == 5.0
    assert image.projection("x").shape == (2, 3)
    with pytest.raises(SceneError, match="axis = 'zy' is unknown"):
        image.projection("zy")


def test_points_of_single_precision_have_even_volumes():
    """Rounding moves points of 2 m by 1e-7 m, 1e-5 of the pitch."""
    points = wall_grid(1.9, 97, centre=(0.7, -0.3)).astype(np.float32)
    facing = Volume.facing(points, (0.5, 0.8, 0.1))
    assert np.ptp(np.diff(facing.x)) < 1e-12
    assert facing.x == pytest.approx(points[0, :, 0], abs=2e-7)
    line = points[0, :, 0]
    assert Volume(line, [0.0], [1.0]).shape == (1, 1, 97)
    with pytest.raises(SamplingError, match="pitches off an even grid"):
        Volume.facing(points + 0.01 * points[..., [1, 0, 2]], (0.5, 0.8, 0.1))
