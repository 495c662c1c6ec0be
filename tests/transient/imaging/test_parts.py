"""Parts of the reconstructions with generic arguments: grids, sizes, notes and bands, on record."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from nlosoptics.errors import NlosError, SamplingError
from nlosoptics.transient import TransientCapture, Volume, VolumeImage, wall_grid
from nlosoptics.transient.imaging import (
    camera_setup,
    confocal_grids,
    plane_convolutions,
    virtual_pulse,
)

WALL = (wall_grid(1.2, 6) * (1.0, 2.0 / 3.0, 1.0))[:5]


def volume(x_step, y_step, shift=0.0):
    start = WALL[0, 0] + shift * 0.2
    return Volume(
        start[0] + 0.2 * x_step * np.arange(4),
        start[1] + 0.8 / 6 * y_step * np.arange(3),
        np.array([0.5, 0.7]),
    )


def test_grids_may_deviate_by_the_limit_itself():
    """Steps and points that are off by exactly the limit, in numbers without rounding."""
    limit = 2.0**-10
    wavelength = limit / plane_convolutions.UNEVEN
    assert plane_convolutions.UNEVEN * wavelength == limit
    points = np.zeros((3, 4, 3))
    points[..., 0], points[..., 1] = 0.25 * np.arange(4), 0.5 * np.arange(3)[:, None]
    for axis, off, refused in itertools.product("xy", (1.0, 1.001), (True, False)):
        steps = {"x": 0.25, "y": 0.5}
        steps[axis] += limit / 4 * (off if refused else 1.0)
        wall = points.copy()
        wall[1, 2, "xy".index(axis)] += limit * (1.0 if refused else off)
        grid = Volume(steps["x"] * np.arange(4), steps["y"] * np.arange(4), [0.5])
        if off == 1.0:
            assert plane_convolutions.lattice(wall, grid, wavelength).size > 0
        else:
            told = "whole multiples" if refused else "off an even grid"
            with pytest.raises(SamplingError, match=told):
                plane_convolutions.lattice(wall, grid, wavelength)


def test_limits_of_notes_are_allowed_themselves(monkeypatch):
    """In numbers without rounding, and a little beyond."""
    monkeypatch.setattr(camera_setup, "UNEVEN", 2.0**-10)
    for part, wanted in ((2.0**-11, False), (2.0**-11 * 1.25, True)):
        x = np.array([0.0, 1.0 - part, 2.0 - part, 3.0])  # steps of 1 m on average
        points = np.zeros((2, 4, 3))
        points[..., 0], points[1, :, 1] = x, 1.0
        for grid in (points, points.swapaxes(0, 1)):
            assert bool(camera_setup.grid_note("points", grid, 9.0, 2)) is wanted
    assert camera_setup.bin_note(0.125, 0.5) is None
    assert "exceeds a quarter" in camera_setup.bin_note(0.25, 0.5)
    light = {"H": np.ones((8, 5, 6)), "laser_points": np.zeros(3), "sensor_points": WALL}
    capture = TransientCapture(**light, delta_t=0.25, t_start=1.0)
    assert capture.edges[[0, -1]].tolist() == [1.0, 3.0]
    for inside, outside in ((1.0, 0.99), (3.0, 3.01)):
        for count, noted in ((0, False), (1, False), (2, True)):
            paths = np.full(100, inside)
            paths[:count] = outside
            note = camera_setup.window_note(capture, volume(1.0, 1.0), paths)
            assert bool(note) is noted, (outside, count)


def confocal(points, H=None, **options):
    """A confocal capture of a little light."""
    H = np.full((9, *points.shape[:-1]), 0.5) if H is None else H
    given = {"laser_points": points, "sensor_points": points, "pairing": "confocal"}
    return TransientCapture(H=H, **given, delta_t=0.25, t_start=2.0, **options)


@pytest.mark.parametrize("off", [1.05, 0.95, -0.95, -1.05])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_confocal_points_deviate_either_way(axis, off):
    """By the share of the finer of both pitches, which is that along y; the corner stays."""
    points = WALL.copy()
    points[2, 3, axis] += off * confocal_grids.UNEVEN * 0.8 / 6
    if abs(off) < 1.0:
        grid = confocal_grids.confocal_grid(confocal(points), "lct")
        assert grid.x == pytest.approx(WALL[0, :, 0], abs=1e-12)
        assert grid.y == pytest.approx(WALL[:, 0, 1], abs=1e-12)
        assert (grid.start, grid.pitch, grid.n_bins) == (1.0, 0.125, 9)
    else:
        with pytest.raises(SamplingError, match=r"lct needs an even grid .* by up to 0\.00014 m"):
            confocal_grids.confocal_grid(confocal(points), "lct")


def test_confocal_grids_are_at_least_two_by_two_and_rise():
    for points in (WALL[:1], WALL[:, :1], WALL[0]):
        with pytest.raises(SamplingError, match="at least 2 x 2, sensor points have shape"):
            confocal_grids.confocal_grid(confocal(points), "lct")
    assert len(confocal_grids.confocal_grid(confocal(WALL[:2, 1:3]), "lct").x) == 2
    for points in (WALL[::-1], WALL[:, ::-1]):
        with pytest.raises(SamplingError, match="x and y rising, sensor points deviate by up to"):
            confocal_grids.confocal_grid(confocal(points), "lct")
    H = np.full((9, *WALL.shape[:-1]), 0.5)
    H[4, 2, 1] = 0.0
    assert confocal_grids.confocal_grid(confocal(WALL, H), "lct").n_bins == 9
    H[4, 2, 1] = -0.25
    with pytest.raises(NlosError, match=r"at least 0, the capture goes down to -0\.25"):
        confocal_grids.confocal_grid(confocal(WALL, H), "lct")


def test_the_dark_level_is_that_of_the_darkest_interval():
    """Mean and spread of the interval of four bins with the least light per path."""
    draw = np.random.default_rng(2)
    light = draw.random((64, 5)) + 3.0
    light[20:24] -= 2.5
    light[50:54] = 0.0  # a closed gate
    lit = light[np.r_[:50, 54:64]]
    starts = np.linspace(0, 60, 16, endpoint=False).astype(int)
    parts = np.split(lit, starts[1:])
    darkest = min(parts, key=np.mean)
    found = confocal_grids._dark_level(light.sum(1), (light**2).sum(1), np.full(64, 5.0))
    assert found == pytest.approx((darkest.mean(), darkest.std()), rel=1e-12)
    assert confocal_grids._dark_level(*np.zeros((3, 9))) == (0.0, 0.0)


def test_voxels_at_three_quarters_of_the_width_are_reached():
    """The limit itself, in numbers without rounding, along each axis and to either side."""
    x, y = 0.25 * np.arange(4), 0.5 * np.arange(5) - 0.25
    grid = confocal_grids.ConfocalGrid(x, y, 0.5, 0.125, 9)
    for off in (0.75, -0.75):
        at = [x[[0, -1]].mean() + off, y[[0, -1]].mean() + 2.5 * off]
        given = Volume(at[:1], at[1:], [0.6])
        assert confocal_grids.reached_volume(grid, given, "lct") is given
        for axis, limit in (("x", "0.75"), ("y", "1.875")):
            more = [at[k] + math.copysign(1e-6, off) * (axis == "xy"[k]) for k in range(2)]
            with pytest.raises(SamplingError, match=f"centre along {axis}, limit {limit} m"):
                confocal_grids.reached_volume(grid, Volume(more[:1], more[1:], [0.6]), "lct")


@pytest.mark.parametrize("columns", [0.5, 1.0, 2.0])
def test_long_responses_are_computed_by_few_at_a_time(columns, monkeypatch, memory_of):
    """As many as fit a block, at least one; the light and half its spectrum are in memory."""
    H = np.random.default_rng(5).random((1 << 14, 6))
    points = wall_grid(0.6, 6)[0]
    capture = TransientCapture(H=H, laser_points=np.zeros(3), sensor_points=points, delta_t=1e-3)
    band = virtual_pulse.pulse_band(capture, 0.4, 0.3, (0.0, 16.0), tol=1e-2)
    given = capture, band, np.arange(6), np.zeros(6), "float64"
    whole = virtual_pulse.responses(*given)
    one = 8.0 * (capture.n_bins + 2 * band.n_times)  # the copy of its bins comes first
    monkeypatch.setattr(virtual_pulse, "BLOCK", int(columns * 8 * band.n_times))
    peak, _ = memory_of(lambda: virtual_pulse.responses(*given))
    assert peak < max(columns, 1.0) * one
    # transforms of one column and of several at once differ by their rounding
    assert virtual_pulse.responses(*given) == pytest.approx(whole, rel=1e-9)


@pytest.mark.parametrize("late", [True, False])
def test_a_pulse_needs_half_a_bin(late):
    """The response at a time takes the bins within the pulse's reach of it."""
    capture = TransientCapture(
        H=np.ones((40, 4)),
        laser_points=np.zeros(3),
        sensor_points=WALL[0, :4],
        delta_t=0.03,
        t_start=4.0,
    )
    reach = 0.2 * math.sqrt(2.0 * math.log(4.0 / 0.01))
    away = reach + 0.5 * 0.03
    time = 5.2 + away if late else 4.0 - away
    with pytest.raises(SamplingError, match="outside the capture's 4 to 5.2 m"):
        virtual_pulse.pulse_band(capture, 0.3, 0.2, (time, time), tol=0.01)
    time += -0.03 if late else 0.03
    bins = virtual_pulse.pulse_band(capture, 0.3, 0.2, (time, time), tol=0.01).bins
    assert (bins.start, bins.stop) == ((39, 40) if late else (0, 1))


def test_details_of_an_image_are_its_own():
    given = {"snr": 3.0}
    image = VolumeImage(
        intensity=np.ones((2, 3, 4)), volume=volume(1, 1), method="m", details=given
    )
    given["snr"] = 4.0
    assert image.details["snr"] == 3.0
    with pytest.raises(TypeError):
        image.details["snr"] = 5.0


def test_planes_up_to_the_farthest():
    """The last plane is the farthest one if a whole number of steps leads there, to rounding."""
    for far, count in ((0.9, 6), (0.9 - 1e-6, 5), (0.9 + 1e-6, 6), (0.4, 1)):
        found = Volume.facing(WALL, (0.4, far, 0.1)).z
        assert found == pytest.approx(0.4 + 0.1 * np.arange(count), rel=1e-15)
