"""Light over time: streaks, frames, films, and the files that films are written to."""

from __future__ import annotations

from html.parser import HTMLParser

import numpy as np
import pytest

from nlosoptics import views
from nlosoptics.errors import SamplingError, SceneError
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
    with pytest.raises(SceneError, match="no grid"):
        views.transient_film(one)
    assert_drawn(streak)


def test_dark_captures_and_negative_values_are_drawn(capture, assert_drawn):
    dark = TransientCapture(
        H=-np.ones((BINS, 3, 4)),
        laser_points=capture.laser_points[0],
        sensor_points=capture.sensor_points,
        delta_t=0.5,
    )
    axes = views.transient(dark)
    assert {float(np.max(axis.collections[0].get_array())) for axis in axes} == {0.0}
    assert_drawn(axes)


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


def test_sensors_of_three_axes_are_refused(capture):
    points = capture.sensor_points.reshape(3, 2, 2, 3)
    odd = TransientCapture(
        H=np.ones((2, 3, 2, 2)), laser_points=(0, 0, 0), sensor_points=points, delta_t=1.0
    )
    with pytest.raises(SamplingError, match=r"shape \(3, 2, 2\) are neither a grid nor a list"):
        views.transient(odd)


def frames_of(film):
    """Titles and values of all frames."""
    axes = film._fig.axes[0]
    for number in range(len(list(film.new_frame_seq()))):
        film._draw_next_frame(number, blit=False)
        yield axes.get_title(), np.asarray(axes.collections[0].get_array())


def test_frames_of_a_film_add_up_to_the_light(capture, tmp_path):
    film = views.transient_film(capture, most=3)
    shown = list(frames_of(film))
    # five bins with light, two a frame
    assert [title for title, _ in shown] == [
        "optical path 2.000 m",
        "optical path 3.000 m",
        "optical path 3.750 m",
    ]
    np.testing.assert_allclose(sum(light for _, light in shown), capture.H[1:, 0].sum(axis=0))
    np.testing.assert_array_equal(shown[0][1], capture.H[1, 0] + capture.H[2, 0])
    assert film._fig.axes[0].child_axes[0].get_ylabel() == "irradiance per 2 bins (W/m$^2$)"


def test_films_begin_and_end_where_they_are_told(capture):
    film = views.transient_film(capture, between=(2.1, 2.9))
    assert [title for title, _ in frames_of(film)] == [
        "optical path 2.250 m",
        "optical path 2.750 m",
    ]
    for between, message in (((3.0, 2.0), "decreases"), ((0.0, 2.0), "between = 0 m")):
        with pytest.raises(SceneError, match=message):
            views.transient_film(capture, between=between)


class Sources(HTMLParser):
    """Addresses that a page names, and its pictures' words."""

    def __init__(self):
        super().__init__()
        self.addresses, self.words, self.tags = [], [], []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        for name, value in attrs:
            if name in ("src", "href", "srcset"):
                self.addresses.append(value)
            if name in ("alt", "aria-label"):
                self.words.append(value)


def test_films_are_written_as_gif_and_as_a_page_of_its_own(capture, tmp_path):
    from PIL import Image

    views.save(views.transient_film(capture), tmp_path / "light.gif")
    with Image.open(tmp_path / "light.gif") as gif:
        assert gif.n_frames == 5
        first = np.asarray(gif.convert("RGB"))
        gif.seek(4)
        assert np.abs(np.asarray(gif.convert("RGB")).astype(int) - first).max() > 100
    views.save(views.transient_film(capture), tmp_path / "light.html")
    page = (tmp_path / "light.html").read_text()
    found = Sources()
    found.feed(page)
    assert not [a for a in found.addresses if not a.startswith("data:")]
    assert "link" not in found.tags
    assert "://" not in page.replace("http://www.w3.org/2000/svg", "")
    assert {"Transient signal on the relay wall", "Frame", "Play"} <= set(found.words)
    assert page.count("data:image/png;base64") == 5
    assert sorted(path.name for path in tmp_path.iterdir()) == ["light.gif", "light.html"]


def test_other_films_are_refused(capture, tmp_path):
    film = views.transient_film(capture)
    with pytest.raises(SceneError, match="must be one of .gif, .html for a film"):
        views.save(film, tmp_path / "light.mp4")
    with pytest.raises(SceneError, match="there is no folder"):
        views.save(film, tmp_path / "none" / "light.gif")
