"""Pictures of volumes: what is left, right, up and down in each view."""

from __future__ import annotations

import numpy as np
import pytest

from nlosoptics import views
from nlosoptics.transient import Volume, VolumeImage

pytest.importorskip("matplotlib")


@pytest.fixture
def image():
    """One bright voxel at x = 2, y = 30, z = 500, far from the middle of each axis."""
    volume = Volume(np.arange(5.0), 10.0 * np.arange(6), 100.0 * np.arange(4, 8))
    light = np.zeros(volume.shape)
    light[1, 3, 2], light[2, 0, 0] = 8.0, 2.0
    return VolumeImage(intensity=light, volume=volume, method="made")


@pytest.mark.parametrize(
    ("axis", "place", "names"),
    [("z", (2, 30), ("x", "y")), ("y", (2, 500), ("x", "z")), ("x", (500, 30), ("z", "y"))],
)
def test_the_brightest_voxel_lies_where_it_is(image, axis, place, names):
    axes = views.volume(image, axis=axis)
    (drawn,) = axes.images
    seen = np.asarray(drawn.get_array())
    left, right, low, high = drawn.get_extent()
    row, column = np.unravel_index(seen.argmax(), seen.shape)
    across = left + (column + 0.5) * (right - left) / seen.shape[1]
    up = low + (row + 0.5) * (high - low) / seen.shape[0]
    assert drawn.origin == "lower"
    assert (across, up) == pytest.approx(place)
    assert seen.max() == 1.0
    assert (axes.get_xlabel(), axes.get_ylabel()) == tuple(f"{name} (m)" for name in names)


def test_x_grows_to_the_left_where_the_wall_looks(image):
    """Facing +z with y up, +x is on the left."""
    assert views.volume(image).xaxis_inverted()
    assert views.volume(image, axis="y").xaxis_inverted()
    assert not views.volume(image, axis="x").xaxis_inverted()
