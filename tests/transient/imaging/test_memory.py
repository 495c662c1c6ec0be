"""Stated needs of memory against what pictures of captures take, for large captures and volumes."""

import numpy as np
import pytest

from nlosoptics.transient import (
    TransientCapture,
    Volume,
    backprojection,
    fk_migration,
    lct,
    phasor_image,
    wall_grid,
)

METHODS = {
    "fk_migration": fk_migration,
    "fk_migration in full": lambda *given: fk_migration(*given, dtype="float64"),
    "lct": lct,
    "lct in full": lambda *given: lct(*given, dtype="float64"),
    "backprojection": backprojection,
    "backprojection, filtered": lambda *given: backprojection(*given, filter="laplacian"),
    "phasor_image": lambda capture, volume: phasor_image(capture, volume, wl_mean=0.4, tol=1e-2),
}
#: Points along the wall's sides, bins, voxels along x and y and along z, and their pitch in z, m.
SIZES = {
    "capture": (40, 500, 8, 8, 0.05),
    "volume": (12, 120, 72, 64, 0.006),
    "fine": (12, 120, 6, 5, 2e-4),
}


@pytest.mark.thorough
@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("method", METHODS.values(), ids=METHODS)
def test_memory_is_what_was_stated(method, size, memory_of):
    count, n_bins, across, deep, pitch = SIZES[size]
    if method is METHODS["phasor_image"] and size != "volume":
        pytest.skip("it takes blocks of a fixed size, larger than what these captures need")
    points = wall_grid(1.0, count)
    axis = np.linspace(-0.4, 0.4, across)
    volume = Volume(axis, axis, 0.5 + pitch * np.arange(deep))
    capture = TransientCapture(
        H=np.random.default_rng(0).random((n_bins, count, count)),
        laser_points=points,
        sensor_points=points,
        delta_t=3.3 / n_bins,
        pairing="confocal",
    )
    peak, stated = memory_of(lambda: method(capture, volume))
    assert 0.3 * stated < peak < stated
