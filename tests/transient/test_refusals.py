"""What is refused, in one line that names value, limit and remedy; the last value is accepted."""

from __future__ import annotations

import numpy as np
import pytest

from nlosoptics.errors import NlosError
from nlosoptics.transient import (
    Detector,
    PhasorImage,
    TransientCapture,
    Volume,
    phasor_image,
    wall_grid,
)

# The sampling is meant to be coarse.
pytestmark = pytest.mark.filterwarnings("ignore::nlosoptics.errors.ValidityWarning")
GRID = wall_grid(1.0, 4)
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
    "short pulse": (
        lambda: phasor_image(capture(), VOLUME, wl_mean=0.2, wl_sigma=0.0124),
        "wl_sigma = 0.0124 m, limit 0.0125 m (a quarter of a bin), is too short for the bins",
    ),
    "paths outside": (
        lambda: phasor_image(capture(t_start=9.0), VOLUME, wl_mean=0.2),
        "outside the capture's 9 to 11 m; give another volume, or check t_start",
    ),
    "laser not named": (lambda: lasers(2), "needs one laser point, the capture has 2"),
    "laser after the last": (
        lambda: capture(H=np.ones((40, 2, 4, 4)), laser_points=GRID[0, :2], pairing="all").of_laser(
            2
        ),
        "index = 2 is out of range, must be from 0 to 1",
    ),
    "laser of pairs": (lambda: capture().of_laser(0), "a confocal capture has no laser point for"),
    "square of no point": (
        lambda: lasers(1, aperture=0.2499),
        "aperture = 0.2499 m contains none of 16 wall points; give a larger one",
    ),
    "no times": (lambda: lasers(1, times=[]), "times have shape (0,), must be (n,)"),
    "convolution of pairs apart": (
        lambda: phasor_image(
            capture(laser_points=GRID + 0.1 * np.eye(3)[0]), VOLUME, wl_mean=0.5, method="fft"
        ),
        "pairs with different laser and sensor points have no convolution; give method='direct'",
    ),
}


@pytest.mark.parametrize(("call", "words"), [*DETECTORS.values(), *VOLUMES.values()])
def test_refused_in_one_line(call, words):
    with pytest.raises(NlosError) as caught:
        call()
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


LAST = {
    "extent of 0": lambda: Volume.box((0, 0, 1), (0.1, 0.0, 0.1), 0.05),
    "one plane": lambda: Volume.facing(GRID, (0.5, 0.5, 0.1)),
    "short pulse": lambda: phasor_image(capture(), VOLUME, wl_mean=0.2, wl_sigma=0.0125),
    "light of nothing": lambda: Detector().expected(capture(H=np.zeros((40, 4, 4)))),
    "square of four points": lambda: lasers(1, aperture=0.2501),
}


@pytest.mark.parametrize("name", LAST)
def test_the_last_value_is_accepted(name):
    assert LAST[name]() is not None


def test_a_laser_is_named_by_its_index():
    """Its part is the capture with this laser point alone."""
    light = np.random.default_rng(3).random((40, 2, 3, 4, 4))
    spots = 0.2 * GRID[:2, :3]
    whole = capture(H=light, laser_points=spots, pairing="all", by_bounce={3: light})
    for row, column in ((0, 0), (0, 2), (1, 1)):
        alone = whole.of_laser(3 * row + column)
        assert np.array_equal(alone.H, light[:, row, column])
        assert np.array_equal(alone.by_bounce[3], alone.H)
        assert np.array_equal(alone.laser_points, spots[row, column])
        assert phasor_image(alone, VOLUME, camera="transient", times=[0.0], wl_mean=0.5)
