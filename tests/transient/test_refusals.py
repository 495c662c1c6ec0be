"""What is refused, in one line that names value, limit and remedy; the last value is accepted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from nlosoptics.errors import NlosError
from nlosoptics.scene import PlanarObject
from nlosoptics.transient import (
    Detector,
    PhasorImage,
    TransientCapture,
    Volume,
    backprojection,
    depth_error,
    depth_map,
    distance_weighted,
    downsampled,
    fk_migration,
    gated,
    phasor_image,
    smoothed,
    true_depths,
    wall_grid,
)
from nlosoptics.transient.capture import foreign_files, layouts
from nlosoptics.transient.capture.wall_points import points_on_wall
from nlosoptics.transient.rendering import _three_bounce_kernels, three_bounces
from nlosoptics.transient.rendering.multiple_bounces import multiple_bounces
from nlosoptics.transient.rendering.scene import cut_out

# The sampling is meant to be coarse.
pytestmark = pytest.mark.filterwarnings("ignore::nlosoptics.errors.ValidityWarning")
GRID = wall_grid(1.0, 4)
ONES = np.ones((40, 4, 4))
LIST = {"data": np.ones((5, 1, 7)), "laserPos": np.ones((5, 3)), "cameraPos": np.ones(3)}
LIST |= {"t": 7, "deltat": 0.1}
VOLUME = Volume.before(0.9, 4, np.linspace(0.4, 0.9, 4))


def capture(**changes):
    given = {"H": np.ones((40, 4, 4)), "laser_points": GRID, "sensor_points": GRID}
    given |= {"delta_t": 0.05, "t_start": 0.3, "pairing": "confocal"}
    return TransientCapture(**given | changes)


def lasers(count, **options):
    """The picture of a transient camera for a capture of so many laser points."""
    spots = np.linspace(0.0, 0.1, count)[:, None] * np.array([1.0, 0.5, 0.0])
    light = np.random.default_rng(2).random((40, count, 4, 4))
    given = {"H": light, "laser_points": spots, "pairing": "all"} | options.pop("changes", {})
    asked = {"camera": "transient", "times": [0.0], "wl_mean": 0.5} | options
    return phasor_image(capture(**given), VOLUME, **asked)


def moved(z):
    return GRID + np.array([0.0, 0.0, z])


def nan_in(values):
    found = np.array(values, dtype=float)
    found.flat[-1] = np.nan
    return found


CAPTURES = {
    "points without a number": (
        lambda: capture(sensor_points=nan_in(GRID)),
        "have values that are not finite; give finite numbers in m",
    ),
    "points off the wall": (
        lambda: points_on_wall("points", moved(2e-9)),
        "are up to 2e-09 m off the wall z = 0, limit 1e-09 m; move them onto it",
    ),
    "pairs of numbers": (
        lambda: capture(sensor_points=GRID[..., :2]),
        "have shape (4, 4, 2), must be (..., 3); give x, y and z in m",
    ),
    "ragged": (lambda: capture(H=[[1.0], [1.0, 2.0]]), "H has rows of several lengths"),
    "words": (lambda: capture(H=[["a"]]), "is not an array of real numbers; give floats"),
    "too few points": (lambda: capture(H=np.ones((40, 4, 3))), "H has shape (40, 4, 3), must be"),
    "no bins": (lambda: capture(H=np.ones((0, 4, 4))), "H has shape (0, 4, 4), must be (n_bins"),
    "not finite": (
        lambda: capture(H=nan_in(np.ones((40, 4, 4)))),
        "H has 1 of 640 values that are not finite; replace them",
    ),
    "endless sum": (
        lambda: capture(H=np.full((40, 4, 4), 1e307)),
        "H has values up to 1e+307, whose sum is not finite; scale the capture",
    ),
    "bounces in a list": (
        lambda: capture(by_bounce=[np.ones((40, 4, 4))]),
        "by_bounce is a list, must be a mapping; give {number of reflections: bins}",
    ),
    "bounces of other bins": (
        lambda: capture(by_bounce={3: np.ones((39, 4, 4))}),
        "has 39 bins, must be 40 like H; crop both to the same bins",
    ),
    "normals": (
        lambda: capture(sensor_normals=np.ones((2, 4, 3))),
        "sensor_normals have shape (2, 4, 3), must be (4, 4, 3) like sensor_points",
    ),
    "gate between bins": (
        lambda: gated(capture(), start=0.31, stop=0.34),
        "holds no bin of this capture, which covers 0.3 to 2.3 m in steps of 0.05 m",
    ),
    "odd bins": (
        lambda: downsampled(capture(), bins=3),
        "the capture has 40 bins, no multiple of bins = 3; crop the capture with transient.gated",
    ),
    "odd grid": (
        lambda: downsampled(capture(), grid=3),
        "4 points along an axis are no multiple of grid = 3; give a divisor",
    ),
    "errors that a blur correlates": (
        lambda: smoothed(capture(standard_error=np.ones((40, 4, 4))), path=0.2),
        "the capture has standard errors, which a blur would correlate",
    ),
    "weight of no distance": (
        lambda: distance_weighted(capture(t_start=-0.025), -1.0),
        "bin 0 is at a path of 0 m, must be above 0; gate the capture with transient.gated first",
    ),
    "light along the wall alone": (
        lambda: fk_migration(
            capture(t_start=0.0, H=1e-3 * (np.arange(40) < 2)[:, None, None] * ONES)
        ),
        "fk_migration: 1e+02 % of the capture is direct light",
    ),
}
FILES = {
    "no structure": (
        lambda: foreign_files.read_phasor_field_2019({"dataset": 3}),
        "dataset is not a structure, must hold data, laserPos, cameraPos and more",
    ),
    "two sensors": (
        lambda: foreign_files.read_phasor_field_2019(
            {"dataset": LIST | {"cameraPos": np.ones((2, 3))}}
        ),
        "dataset.cameraPos has 2 points, limit 1 in this layout",
    ),
    "another count": (
        lambda: foreign_files.read_phasor_field_2019(
            {"dataset": LIST | {"data": np.ones((4, 1, 7))}}
        ),
        "dataset.data has shape (4, 1, 7), must be (5, 1, n_bins) for dataset.laserPos",
    ),
    "points of four": (
        lambda: foreign_files.read_phasor_field_2019(
            {"dataset": LIST | {"laserPos": np.ones((5, 4))}}
        ),
        "laserPos has shape (5, 4), must be (n, 3); correct the file",
    ),
    "pitch of nothing": (
        lambda: foreign_files.read_phasor_field_2020(
            {"rect_data": ONES, "ts": 1e-11, "sampling_spacing": None}
        ),
        "sampling_spacing is empty, must be the pitch of the scan in m; correct the file",
    ),
    "two numbers": (
        lambda: layouts.number({"t": [1.0, 2.0]}, "t"),
        "t has 2 values, must be one number; correct the file",
    ),
}
DETECTORS = {
    "tail alone": (
        lambda: Detector(tail=0.2),
        "detector.tail = 0.2 m with tail_share = 0 is incomplete; give both above 0, or neither",
    ),
    "share alone": (lambda: Detector(tail_share=0.2), "tail = 0 m with tail_share = 0.2 is incomp"),
    "seconds": (
        lambda: Detector(jitter=5e-11),
        "detector.jitter = 5e-11 is too short for a length in m, limit",
    ),
    "gate of one": (lambda: Detector(gate=(0.5,)), "detector.gate = (0.5,) is not a pair, must be"),
    "gate of a number": (lambda: Detector(gate=0.5), "detector.gate = 0.5 is not a pair"),
    "closed gate": (
        lambda: Detector(gate=(0.5, 0.5)),
        "detector.gate closes at 0.5 m, must be after it opens at 0.5 m; give (opens, closes)",
    ),
    "negative bin": (
        lambda: Detector().expected(capture(H=-np.ones((40, 4, 4)))),
        "the capture has a bin of -1, must be at least 0 to be an expected count",
    ),
    "dark": (
        lambda: Detector(photons=9.0).expected(capture(H=np.zeros((40, 4, 4)))),
        "the capture has no light, detector.photons = 9 cannot be reached",
    ),
}
VOLUMES = {
    "extent below 0": (
        lambda: Volume.box((0, 0, 1), (0.1, -0.1, 0.1), 0.05),
        "has an extent below 0; give extents from 0 up",
    ),
    "far before near": (
        lambda: Volume.facing(GRID, (0.5, 0.4, 0.1)),
        "far = 0.4 m is before near = 0.5 m; swap them",
    ),
    "two planes": (lambda: Volume.facing(GRID, (0.5, 0.6)), "planes = (0.5, 0.6) must be (near,"),
    "flat axis": (
        lambda: Volume(np.ones((2, 2)), [0.0], [1.0]),
        "volume.x has shape (2, 2), must be (n,); give a list in m",
    ),
    "no voxels": (lambda: Volume([0.0], [], [1.0]), "volume.y has shape (0,), must be (n,)"),
    "voxels nowhere": (
        lambda: Volume([0.0], [0.0], [np.inf]),
        "volume.z has values that are not finite; give finite numbers in m",
    ),
    "field of another shape": (
        lambda: PhasorImage(
            volume=VOLUME,
            intensity=np.ones((4, 4, 4)),
            method="phasor field",
            seconds=0.0,
            field=np.ones((4, 4, 3)),
            camera="transient",
            wl_mean=0.2,
            wl_sigma=0.2,
        ),
        "field has shape (4, 4, 3), must be (4, 4, 4); give one value per voxel and time",
    ),
    "late bins": (
        lambda: backprojection(capture(t_start=-3.0, delta_t=0.01)),
        "cover no complete plane in front of the wall points; give volume, or capture more bins",
    ),
    "short pulse": (
        lambda: phasor_image(capture(), VOLUME, wl_mean=0.2, wl_sigma=0.0124),
        "wl_sigma = 0.0124 m, limit 0.0125 m (0.25 bins), is too short for the bins",
    ),
    "paths outside": (
        lambda: phasor_image(capture(t_start=9.0), VOLUME, wl_mean=0.2),
        "outside the capture's 9 to 11 m; give another volume, or check t_start",
    ),
    "laser not named": (lambda: lasers(2), "needs laser for a capture of 2 laser points"),
    "laser after the last": (
        lambda: lasers(2, laser=2),
        "laser = 2 is out of range, must be from 0 to 1",
    ),
    "laser after the last of its axis": (lambda: lasers(2, laser=(2,)), "laser[0] = 2 is out of"),
    "two indices": (
        lambda: lasers(2, laser=(0, 1)),
        "laser has 2 indices, must be 1 for laser points of shape (2,); give one index per axis",
    ),
    "mask of no point": (
        lambda: lasers(1, aperture=np.zeros((4, 4), dtype=bool)),
        "aperture contains no wall point; give a larger one",
    ),
    "square of no point": (
        lambda: lasers(1, aperture=0.2499),
        "aperture = 0.2499 m contains none of 16 wall points; give a larger one",
    ),
    "table of times": (lambda: lasers(1, times=[[0.1]]), "times have shape (1, 1), must be (n,)"),
    "no times": (lambda: lasers(1, times=[]), "times have shape (0,), must be (n,)"),
    "convolution of pairs apart": (
        lambda: phasor_image(
            capture(laser_points=GRID + 0.1 * np.eye(3)[0]), VOLUME, wl_mean=0.5, method="fft"
        ),
        "pairs with different laser and sensor points have no convolution; give method='direct'",
    ),
}


def image(**changes):
    return replace(backprojection(capture(), VOLUME), **changes)


def shifted(x=0.0, y=0.0):
    """The image's own depths, on cells that are shifted."""
    found = depth_map(image())
    return replace(found, x=found.x + x, y=found.y + y)


def told(status):
    """What is said of three bounces of which the second pair was given up."""
    report = np.full((3, _three_bounce_kernels.STATUS + 1), float(_three_bounce_kernels.DONE))
    report[1:, _three_bounce_kernels.STATUS] = status
    points = GRID[:3, 0]
    three_bounces._check_done(report, points, points[::-1].copy(), 0.01)


def picture(pixels):
    return PlanarObject(pixels, position=(0.0, 0.0, 1.0), size=(0.2, 0.2))


THIN = np.zeros((256, 256))
THIN[2, 2] = 1.0
RENDERED = {
    "shadows in parts": (
        lambda: told(_three_bounce_kernels.TOO_FINE),
        "wall points (-0.375, -0.125) m and (-0.375, -0.125) m: shadows cut one triangle into",
    ),
    "surface in parts": (
        lambda: told(_three_bounce_kernels.TOO_MANY),
        "wall points (-0.375, -0.125) m and (-0.375, -0.125) m: three bounces need more than",
    ),
    "picture of thin lines": (
        lambda: cut_out(picture(THIN)),
        "hidden.image has no white area; give an image with bright pixels",
    ),
    "starts without a number": (
        lambda: multiple_bounces([], GRID, GRID, delta_t=0.1, n_bins=9, starts=np.nan),
        "starts have values that are not finite; give finite numbers in m",
    ),
}
DEPTHS = {
    "dark image": (
        lambda: depth_map(image(intensity=np.zeros((4, 4, 4)))),
        "the brightest voxel is 0, must be above 0 and finite; check the image",
    ),
    "no truth": (
        lambda: depth_error(image(), replace(depth_map(image()), depth=np.full((4, 4), np.nan))),
        "the true depths are all NaN; give at least one finite depth",
    ),
    "cells to the left": (
        lambda: depth_error(image(), shifted(x=-1.01e-6)),
        "shifted by up to 1.01e-06 m from the reconstructed ones, limit 1e-06 m; use one grid",
    ),
    "cells below": (lambda: depth_error(image(), shifted(y=-1.01e-6)), "by up to 1.01e-06 m from"),
    "cells above": (lambda: depth_error(image(), shifted(y=1.01e-6)), "by up to 1.01e-06 m from"),
    "no mesh": (lambda: true_depths([], VOLUME), "no mesh was given; give at least one"),
    "no orders": (
        lambda: multiple_bounces([], GRID, GRID, delta_t=0.1, n_bins=9, orders=()),
        "orders are empty; give numbers of reflections such as (4, 5)",
    ),
}
TABLE = {"capture": CAPTURES, "files": FILES, "detector": DETECTORS, "volume": VOLUMES}
TABLE |= {"rendered": RENDERED, "depth": DEPTHS}
CASES = [(part, name) for part, rows in TABLE.items() for name in rows]


@pytest.mark.parametrize(("part", "name"), CASES, ids=["-".join(case) for case in CASES])
def test_refused_in_one_line(part, name, on_record):
    call, words = TABLE[part][name]
    with pytest.raises(NlosError) as caught:
        call()
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)
    on_record(caught.value)  # with the values of all remedies


@pytest.mark.parametrize("axes", [(0, 1, 2), (2, 1, 0)])
def test_a_list_of_points_in_either_order(axes):
    """(laser, sensor, t), and the reverse, of a fixed sensor."""
    light = np.random.default_rng(1).random((5, 1, 7))
    found = foreign_files.read_phasor_field_2019(
        {"dataset": LIST | {"data": light.transpose(axes)}}
    )
    assert np.array_equal(found.H, light[:, 0].T)


LAST = {
    "points on the wall": lambda: points_on_wall("points", moved(0.9999e-9)),
    "one bin": lambda: gated(capture(), start=0.3, stop=0.35),
    "extent of 0": lambda: Volume.box((0, 0, 1), (0.1, 0.0, 0.1), 0.05),
    "one plane": lambda: Volume.facing(GRID, (0.5, 0.5, 0.1)),
    "short pulse": lambda: phasor_image(capture(), VOLUME, wl_mean=0.2, wl_sigma=0.0125),
    "light of nothing": lambda: Detector().expected(capture(H=np.zeros((40, 4, 4)))),
    "cells within rounding": lambda: depth_error(image(), shifted(x=-0.99e-6, y=0.99e-6)),
    "last laser": lambda: lasers(2, laser=1),
    "square of four points": lambda: lasers(1, aperture=0.2501),
    "both tails": lambda: Detector(tail=0.2, tail_share=1e-9),
}


@pytest.mark.parametrize("name", LAST)
def test_the_last_value_is_accepted(name):
    assert LAST[name]() is not None


def test_a_laser_is_named_by_its_index_or_by_one_per_axis():
    """The picture is that of a capture with this laser point alone."""
    light = np.random.default_rng(3).random((40, 2, 3, 4, 4))
    spots = 0.2 * GRID[:2, :3]
    whole = {"H": light, "laser_points": spots}
    for row, column in ((0, 0), (0, 2), (1, 1)):
        alone = {"H": light[:, row, column], "laser_points": spots[row, column]}
        wanted = lasers(1, changes=alone).field
        for index in ((row, column), 3 * row + column):
            found = lasers(6, changes=whole, laser=index).field
            assert found == pytest.approx(wanted, rel=1e-12, abs=1e-12)
    assert np.array_equal(lasers(1, changes=alone, laser=()).field, wanted)
