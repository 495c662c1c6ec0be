"""What is refused, in one line that names value, limit and remedy; the last value is accepted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from nlosoptics.errors import NlosError
from nlosoptics.transient import (
    Detector,
    PhasorImage,
    TransientCapture,
    Volume,
    backprojection,
    depth_error,
    depth_map,
    downsampled,
    gated,
    phasor_image,
    smoothed,
    true_depths,
    wall_grid,
)
from nlosoptics.transient.capture import foreign_files, layouts
from nlosoptics.transient.capture.wall_points import points_on_wall
from nlosoptics.transient.rendering.multiple_bounces import multiple_bounces

# The sampling is meant to be coarse.
pytestmark = pytest.mark.filterwarnings("ignore::nlosoptics.errors.ValidityWarning")
GRID = wall_grid(1.0, 4)
LIST = {"data": np.ones((5, 1, 7)), "laserPos": np.ones((5, 3)), "cameraPos": np.ones(3)}
LIST |= {"t": 7, "deltat": 0.1}
VOLUME = Volume.before(0.9, 4, np.linspace(0.4, 0.9, 4))


def capture(**changes):
    given = {"H": np.ones((40, 4, 4)), "laser_points": GRID, "sensor_points": GRID}
    given |= {"delta_t": 0.05, "t_start": 0.3, "pairing": "confocal"}
    return TransientCapture(**given | changes)


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
}


def image(**changes):
    return replace(backprojection(capture(), VOLUME), **changes)


DEPTHS = {
    "dark image": (
        lambda: depth_map(image(intensity=np.zeros((4, 4, 4)))),
        "the brightest voxel is 0, must be above 0 and finite; check the image",
    ),
    "no truth": (
        lambda: depth_error(image(), replace(depth_map(image()), depth=np.full((4, 4), np.nan))),
        "the true depths are all NaN; give at least one finite depth",
    ),
    "no mesh": (lambda: true_depths([], VOLUME), "no mesh was given; give at least one"),
    "no orders": (
        lambda: multiple_bounces([], GRID, GRID, delta_t=0.1, n_bins=9, orders=()),
        "orders are empty; give numbers of reflections such as (4, 5)",
    ),
}
TABLE = {"capture": CAPTURES, "files": FILES, "detector": DETECTORS, "volume": VOLUMES}
TABLE |= {"depth": DEPTHS}
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
    "both tails": lambda: Detector(tail=0.2, tail_share=1e-9),
}


@pytest.mark.parametrize("name", LAST)
def test_the_last_value_is_accepted(name):
    assert LAST[name]() is not None
