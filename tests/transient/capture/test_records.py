"""Steps before a reconstruction, and detectors, on record."""

import numpy as np
import pytest

from nlosoptics.transient import (
    Detector,
    TransientCapture,
    distance_weighted,
    downsampled,
    gated,
    smoothed,
    wall_grid,
    without_outer_legs,
)

from ...records import attempt


@pytest.fixture(params=["confocal", "all"])
def capture(request):
    sensors = wall_grid(1.0, 6)
    lasers = sensors if request.param == "confocal" else np.array([0.1, 0.0, 0.0])
    light = np.random.default_rng(1).random((50, 6, 6))
    given = {"laser_points": lasers, "sensor_points": sensors, "delta_t": 0.05, "t_start": 0.3}
    given |= {"laser_origin": (0.0, 0.5, 1.0), "sensor_origin": (0.2, 0.5, 1.0)}
    return TransientCapture(H=light, **given, pairing=request.param, outer_legs=True)


def test_steps(capture, on_record):
    on_record(
        [
            attempt(gated, capture, start=0.7, stop=1.9),
            attempt(downsampled, capture, bins=3, grid=2),
            attempt(smoothed, capture, path=0.2, grid=0.3),
            attempt(distance_weighted, capture, 2.0),
            attempt(without_outer_legs, capture),
        ]
    )


@pytest.mark.parametrize("options", [{}, {"gate": (0.5, 1.5), "tail": 0.2, "tail_share": 0.3}])
def test_detectors(options, capture, on_record):
    detector = Detector(photons=1e4, efficiency=0.3, jitter=0.04, dark_counts=3.0, **options)
    found = [attempt(detector.expected, capture), attempt(detector.measure, capture, seed=2)]
    on_record([found, detector.mean_delay, detector.spread])
