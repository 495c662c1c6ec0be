"""Light over time: streaks and frames."""

from __future__ import annotations

import numpy as np
import pytest

from nlosoptics import views
from nlosoptics.errors import SceneError
from nlosoptics.transient import TransientCapture, wall_grid

pytest.importorskip("matplotlib")

BINS = 6


@pytest.fixture
def capture():
    """A grid of 3 x 4 sensors and two lasers; every value differs, the first bin is dark."""
    points = wall_grid(1.0, 4)[:3]
    light = np.arange(BINS * 2 * 12, dtype=np.float64).reshape(BINS, 2, 3, 4)
    light[0] = 0.0
    lasers = np.array([[0.1, 0.2, 0.0], [-0.3, 0.0, 0.0]])
    return TransientCapture(
        H=light, laser_points=lasers, sensor_points=points, delta_t=0.5, t_start=1.0
    )


def cells(drawn):
    """Values of a mesh and the middles of its cells."""
    corners = drawn.get_coordinates()
    middles = (corners[:-1, :-1] + corners[1:, 1:]) / 2
    return np.asarray(drawn.get_array()), middles[..., 0], middles[..., 1]


def test_streak_and_frames_show_the_light_where_and_when_it_is(capture, assert_drawn):
    streak, frame = views.transient(capture, at=(2.6,), laser=1)
    light, x, path = cells(streak.collections[0])
    np.testing.assert_array_equal(light, capture.H[:, 1, 1])
    np.testing.assert_allclose(x[0], capture.sensor_points[1, :, 0])
    np.testing.assert_allclose(path[:, 0], capture.times)
    # facing the wall, -z, with y up, +x is on the right
    assert not streak.xaxis_inverted()
    assert streak.get_ylim() == (1.5, 4.0)  # without the dark bin
    assert (streak.get_xlabel(), streak.get_ylabel()) == ("x (m)", "optical path (m)")
    # 2.6 m is in the bin from 2.5 to 3 m
    light, x, y = cells(frame.collections[0])
    np.testing.assert_array_equal(light, capture.H[3, 1])
    np.testing.assert_allclose(x, capture.sensor_points[..., 0])
    np.testing.assert_allclose(y, capture.sensor_points[..., 1])
    assert not frame.xaxis_inverted()
    assert not frame.yaxis_inverted()
    assert frame.get_title() == "optical path 2.75 m"
    assert frame.lines[0].get_xydata()[0] == pytest.approx((-0.3, 0.0))
    assert streak.collections[0].norm is frame.collections[0].norm
    assert frame.child_axes[0].get_ylabel() == "irradiance per bin (W/m$^2$)"
    assert_drawn(streak)


def test_frames_are_taken_where_the_light_comes(capture):
    """Of a flash in one bin, all three are of that bin; axes that are given are drawn on."""
    light = np.zeros_like(capture.H)
    light[4] = 1.0
    flash = TransientCapture(
        H=light,
        laser_points=capture.laser_points,
        sensor_points=capture.sensor_points,
        delta_t=0.5,
        t_start=1.0,
        quantity="counts",
    )
    axes = views.transient(flash)
    assert [axis.get_title() for axis in axes[1:]] == ["optical path 3.25 m"] * 3
    assert axes[-1].child_axes[0].get_ylabel() == "counts per bin"
    assert views.transient(flash, axes=axes) == axes
    with pytest.raises(SceneError, match="4 axes were given, must be 2"):
        views.transient(flash, at=[3.0], axes=axes)


def test_lists_and_single_sensors_have_no_frames(capture, assert_drawn):
    points = capture.sensor_points.reshape(-1, 3)
    common = {"laser_points": capture.laser_points[0], "delta_t": 0.5, "t_start": 1.0}
    some = TransientCapture(H=capture.H[:, 0].reshape(BINS, -1), sensor_points=points, **common)
    (streak,) = views.transient(some)
    assert streak.get_xlabel() == "index of the sensor point"
    light, number, _ = cells(streak.collections[0])
    np.testing.assert_array_equal(light, some.H)
    np.testing.assert_allclose(number[0], np.arange(12), atol=1e-12)
    one = TransientCapture(H=some.H[:, 5], sensor_points=points[5], **common)
    (curve,) = views.transient(one)
    np.testing.assert_array_equal(curve.lines[0].get_data(), [one.times, one.H])
    assert curve.get_ylabel() == "irradiance per bin (W/m$^2$)"
    with pytest.raises(SceneError, match="no grid"):
        views.transient(some, at=[2.0])
    assert_drawn(streak)


def test_confocal_captures_have_one_laser_for_each_sensor(capture):
    points = capture.sensor_points
    seen = TransientCapture(
        H=capture.H[:, 0],
        laser_points=points,
        sensor_points=points,
        delta_t=0.5,
        pairing="confocal",
    )
    streak, frame = views.transient(seen, at=[1.0])
    np.testing.assert_array_equal(cells(streak.collections[0])[0], seen.H[:, 1])
    assert not frame.lines
    with pytest.raises(SceneError, match="laser = 1 is out of range, must be from 0 to 0"):
        views.transient(seen, laser=1)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"at": [9.0]}, "at = 9 m is out of range, must be from 1 to 4 m"),
        ({"laser": 2}, "laser = 2 is out of range, must be from 0 to 1"),
    ],
)
def test_times_and_lasers_that_are_not_there_are_refused(capture, options, message):
    with pytest.raises(SceneError, match=message):
        views.transient(capture, **options)
