"""Division of polygons into patches that have no sharp corners."""

import math

import numpy as np
import pytest

from nlosoptics import psf
from nlosoptics.errors import SceneError
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


def test_corners_that_nearly_coincide_are_refused_and_less_of_them_are_not():
    """Five spikes that meet within a ten-billionth of their length have no ear to rounding."""
    angle = np.arange(10) * math.pi / 5
    radius = np.where(np.arange(10) % 2, 1e-10, 1.0) * (1 + 0.1 * np.sin(3 * angle))
    spikes = radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    with pytest.raises(SceneError, match="cannot be divided into triangles .* nearly coincide"):
        psf.Aperture.polygon(spikes)
    psf.Aperture.polygon(np.where(radius[:, None] < 0.5, 1e6 * spikes, spikes))
