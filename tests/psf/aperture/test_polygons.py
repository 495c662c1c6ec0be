"""Division of polygons into patches that have no sharp corners."""

import math

import numpy as np
import pytest

from nlosoptics.psf.aperture import polygons


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize(("sine", "patches"), [(0.049, 4), (0.051, 1)])
def test_patches_have_no_corner_sharper_than_a_twentieth(size, sine, patches):
    """A quadrangle with a nearly straight corner is a fan of triangles, whatever its size."""
    turn = math.asin(sine)
    last = [0.6 - 0.5 * math.cos(turn), 1.0 - 0.5 * math.sin(turn)]
    corners = size * np.array([[1.0, 0.0], [1.0, 1.0], [0.6, 1.0], last])
    assert len(polygons.straight_sides(corners, corners.mean(axis=0))) == patches


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
def test_even_polygons_are_fans_of_quadrangles(size):
    """Eight corners make four patches about the centre; without the centre's view, triangles."""
    angle = np.arange(8) * math.pi / 4
    ring = size * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    assert len(polygons.straight_sides(ring, np.zeros(2))) == 4
    star = ring * np.where(np.arange(8) % 2, 0.3, 1.0)[:, None]
    assert len(polygons.straight_sides(star, np.zeros(2))) == 8
    assert len(polygons.straight_sides(star, star[0] * 0.9)) == 6
