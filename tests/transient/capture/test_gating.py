"""Cropped and coarser captures, and captures without outer legs, keep their light."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from nlosoptics.errors import SamplingError, SceneError
from nlosoptics.transient import (
    TransientCapture,
    Volume,
    downsampled,
    fk_migration,
    gated,
    normal_moveout,
    wall_grid,
    without_outer_legs,
)

GRID = wall_grid(2.0, 4)
RNG = np.random.default_rng(3)


def capture(**changes):
    given = {
        "H": RNG.uniform(size=(12, 4, 4)),
        "laser_points": GRID,
        "sensor_points": GRID,
        "delta_t": 0.1,
        "t_start": 1.0,
        "pairing": "confocal",
    }
    return TransientCapture(**{**given, **changes})


def test_a_gate_keeps_whole_bins_in_their_place():
    whole = capture(by_bounce={3: np.ones((12, 4, 4))}, standard_error=np.ones((12, 4, 4)))
    kept = gated(whole, start=1.25, stop=1.8)
    assert kept.edges == pytest.approx(whole.edges[3:9])
    assert np.array_equal(kept.H, whole.H[3:8])
    assert kept.by_bounce[3].shape == kept.standard_error.shape == (5, 4, 4)
    assert gated(whole).n_bins == 12
    assert gated(whole, start=1.0 + 3 * 0.1).n_bins == 9  # an edge but for rounding


def test_coarse_bins_keep_the_light_and_its_time():
    whole = capture(by_bounce={4: np.ones((12, 4, 4))}, standard_error=np.full((12, 4, 4), 2.0))
    coarse = downsampled(whole, bins=3, grid=2)
    assert coarse.H.shape == (4, 2, 2)
    # means over four points of sums over three bins
    assert coarse.H.sum() == pytest.approx(whole.H.sum() / 4, rel=1e-14)
    assert coarse.H[1, 0, 1] == pytest.approx(whole.H[3:6, :2, 2:].sum() / 4, rel=1e-14)
    assert coarse.edges == pytest.approx(whole.edges[::3])
    assert np.array_equal(coarse.sensor_points, wall_grid(2.0, 2))
    assert coarse.is_confocal
    # the root of three squares of four means of independent errors
    assert coarse.standard_error == pytest.approx(2.0 * np.sqrt(3 / 4))
    assert coarse.by_bounce[4] == pytest.approx(3.0)


def test_one_laser_point_stays_and_grids_of_both_are_coarser():
    one = capture(laser_points=(0.1, 0.2, 0.0), pairing="all")
    assert downsampled(one, grid=2).laser_shape == ()
    assert downsampled(one, grid=2).laser_points == pytest.approx([0.1, 0.2, 0.0])
    H = one.H.reshape(len(one.H), 1, 1, *one.sensor_shape)
    grid = replace(one, H=H, laser_points=one.laser_points.reshape(1, 1, 3), standard_error=H + 1.0)
    coarse = downsampled(grid, grid=2)
    assert coarse.laser_shape == (1, 1)
    assert coarse.H[:, 0, 0] == pytest.approx(downsampled(one, grid=2).H)
    # of four independent values
    expected = np.sqrt((grid.standard_error[:, 0, 0, :2, :2] ** 2).sum(axis=(1, 2))) / 4
    assert coarse.standard_error[:, 0, 0, 0, 0] == pytest.approx(expected)
    both = capture(
        H=RNG.uniform(size=(12, 4, 4, 4, 4)), pairing="all", sensor_normals=GRID * 0 + [0, 0, 1.0]
    )
    coarse = downsampled(both, grid=4)
    assert coarse.H.shape == (12, 1, 1, 1, 1)
    assert coarse.H.mean() == pytest.approx(both.H.mean(), rel=1e-14)
    assert coarse.sensor_normals == pytest.approx(np.array([[[0, 0, 1.0]]]))


@pytest.mark.parametrize("pairing", ["confocal", "all"])
def test_outer_legs_are_taken_away_path_by_path(pairing):
    laser, sensor = np.array([0.3, -0.2, 1.0]), np.array([-0.4, 0.1, 0.7])
    lasers = GRID if pairing == "confocal" else np.array([[0.2, 0.5, 0.0], [-0.3, 0.1, 0.0]])
    first = np.linalg.norm(lasers - laser, axis=-1)
    last = np.linalg.norm(GRID - sensor, axis=-1)
    legs = first + last if pairing == "confocal" else first[:, None, None] + last
    delta, inner = 0.01, 1.5
    # all light in one place of every histogram, at inner + legs: shared by the two next middles
    H = np.zeros((600, *legs.shape))
    place = (inner + legs) / delta - 0.5
    low = np.floor(place).astype(int)
    for at, where in np.ndenumerate(place):
        H[(low[at], *at)], H[(low[at] + 1, *at)] = 1 - (where - low[at]), where - low[at]
    outer = capture(
        H=H, laser_points=lasers, pairing=pairing, delta_t=delta, t_start=0.0, outer_legs=True,
        laser_origin=laser, sensor_origin=sensor,
    )  # fmt: skip
    plain = without_outer_legs(outer)
    assert not plain.outer_legs
    assert plain.H.sum(axis=0) == pytest.approx(1.0, rel=1e-12)
    # shared linearly twice, which keeps the mean time to rounding
    mean = np.tensordot(plain.times, plain.H, axes=(0, 0))
    assert mean == pytest.approx(inner, abs=1e-12)
    assert without_outer_legs(plain) is plain


@pytest.mark.parametrize("swapped", [False, True])
def test_moveout_makes_a_capture_confocal(swapped):
    """The pulse of a point arrives after twice its distance from each confocal point."""
    lone, grid, step = np.array([0.1, -0.2, 0.0]), wall_grid(1.0, 16), 0.004
    at = np.array([0.12, 0.03, 0.7])

    def path(sensors):
        return np.linalg.norm(sensors - at, axis=-1) + np.linalg.norm(lone - at)

    times = step * (np.arange(150, 800) + 0.5)
    H = np.exp(-0.5 * ((times[:, None, None] - path(grid)) / 0.02) ** 2)
    points = (grid, lone) if swapped else (lone, grid)
    moved = normal_moveout(
        TransientCapture(
            H=H, laser_points=points[0], sensor_points=points[1], delta_t=step, t_start=150 * step
        )
    )
    assert moved.is_confocal
    assert moved.sensor_points == pytest.approx(0.5 * (lone + grid), abs=1e-15)
    # of all ellipsoids of sensors on a line, the one that gives the longest path touches the point
    aim = 2.0 * (moved.sensor_points - lone)
    away = np.linalg.norm(aim, axis=-1, keepdims=True)
    apart = away * np.linspace(0.501, 3.0, 2500)
    sensors = lone + apart[..., None] * (aim / away)[..., None, :]
    paths = (path(sensors) ** 2 - apart**2) * (1.0 - (away / apart - 1.0) ** 2)
    inside = (np.abs(sensors[..., :2]) <= 0.46).all(axis=-1)
    best = np.where(inside, paths, 0.0).argmax(axis=-1)
    within = np.take_along_axis(inside, best[..., None] + [-150, 0, 150], axis=-1).all(axis=-1)
    within &= away[..., 0] > 0.14  # near the laser, the light of a point is weak
    expected = 2.0 * np.linalg.norm(moved.sensor_points - at, axis=-1)
    assert np.sqrt(paths.max(axis=-1))[within] == pytest.approx(expected[within], rel=1e-6)
    assert within.sum() > 100
    # half of a bin, and sensors as far apart as the pulse is long
    found = moved.times[moved.H.argmax(axis=0)]
    assert found[within] == pytest.approx(expected[within], abs=0.012)
    assert np.mean(np.abs(found - expected)[within]) < 0.004
    volume = Volume.box(centre=at, size=(0.3, 0.3, 0.2), pitch=0.02)
    image = fk_migration(moved, volume, amplitude="light")
    z, y, x = np.unravel_index(image.intensity.argmax(), volume.shape)
    assert volume.points[z, y, x] == pytest.approx(at, abs=0.021)


def test_moveout_fills_the_points_between_a_laser_and_a_grid_beside_it():
    grid, at, lone = wall_grid(1.0, 16), np.array([-0.3, 0.03, 0.7]), np.array([-1.1, 0.1, 0.0])
    times = 0.01 * (np.arange(400) + 0.5)
    paths = np.linalg.norm(grid - at, axis=-1) + np.linalg.norm(lone - at)
    H = np.exp(-0.5 * ((times[:, None, None] - paths) / 0.03) ** 2)
    moved = normal_moveout(
        TransientCapture(H=H, laser_points=lone, sensor_points=grid, delta_t=0.01)
    )
    # half of the points lie beside the grid of sensors
    assert (np.ptp(moved.H, axis=0) > 0.0).mean() > 0.95
    expected = 2.0 * np.linalg.norm(moved.sensor_points - at, axis=-1)
    found = moved.times[moved.H.argmax(axis=0)]
    for part in (slice(0, 8), slice(8, 16)):
        assert np.median(np.abs(found - expected)[2:-2, part]) < 0.02


@pytest.mark.parametrize(
    ("call", "kind", "words"),
    [
        (
            lambda: normal_moveout(capture(H=np.ones((12, 4, 4, 4, 4)), pairing="all")),
            SamplingError,
            r"the capture has \(4, 4\) and \(4, 4\) with pairing = 'all'",
        ),
        (lambda: gated(capture(), start=2.15), SamplingError, "holds no bin"),
        (lambda: gated(capture(), start=float("nan")), SceneError, "start"),
        (
            lambda: downsampled(capture(), bins=5),
            SamplingError,
            "the capture has 12 bins, no multiple",
        ),
        (lambda: downsampled(capture(), grid=3), SamplingError, "4 points along an axis"),
        (lambda: downsampled(capture(), bins=0), SceneError, "bins"),
        (
            lambda: without_outer_legs(capture(outer_legs=True, sensor_origin=(0, 0, 1))),
            SceneError,
            "laser_origin",
        ),
        (
            lambda: without_outer_legs(
                capture(outer_legs=True, laser_origin=(0, 0, 0), sensor_origin=(0, 0, 0))
            ),
            SamplingError,
            "give a capture with more bins",
        ),
    ],
)
def test_bad_input_is_one_clear_line(call, kind, words):
    with pytest.raises(kind, match=words) as caught:
        call()
    assert "\n" not in str(caught.value)


def test_nothing_is_changed_in_place():
    whole = capture()
    before = whole.H.copy()
    for other in (gated(whole), downsampled(whole)):
        assert other is not whole
    assert np.array_equal(replace(whole).H, before)


def test_one_laser_and_one_sensor_point_have_outer_legs_too():
    H = RNG.uniform(size=12)
    places = {"laser_points": (0.0, 0.0, 0.0), "sensor_points": (0.4, 0.0, 0.0), "pairing": "all"}
    origins = {"laser_origin": (0.0, 0.0, 0.5), "sensor_origin": (0.4, 0.3, 0.4)}
    inner = without_outer_legs(capture(H=H, outer_legs=True, **places, **origins))
    assert np.array_equal(inner.H, H)
    assert inner.t_start == pytest.approx(1.0 - 0.5 - 0.5)


def test_one_bin_may_be_left_without_the_outer_legs():
    """Legs of 1 and 1.6 m differ by 2.4 bins, of which the last takes parts of two."""
    H = np.random.default_rng(6).random((4, 2))
    given = {"laser_points": np.zeros(3), "delta_t": 0.25, "t_start": 3.0, "outer_legs": True}
    given |= {"laser_origin": (0.0, 0.6, 0.8), "sensor_origin": (0.0, 0.0, 0.8)}
    given["sensor_points"] = np.array([[0.6, 0.0, 0.0], [0.0, np.sqrt(1.92), 0.0]])
    found = without_outer_legs(TransientCapture(H=H, **given))
    assert found.H.shape == (1, 2)
    assert found.H[0] == pytest.approx([H[0, 0], 0.6 * H[2, 1] + 0.4 * H[3, 1]], rel=1e-12)
    assert (found.t_start, found.outer_legs) == (pytest.approx(1.0, rel=1e-12), False)
    with pytest.raises(SamplingError, match=r"legs differ by 0\.6 m, limit 2 bins of 0\.25 m"):
        without_outer_legs(TransientCapture(H=H[:3], **given))
