"""Second-order optics in closed form against the wave that aimed rays give."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from nlosoptics import psf
from nlosoptics.psf.paraxial import wave_bends
from nlosoptics.scene import ConcaveWall, ConvexWall, FlatWall, WavyWall

# hollow, bulging, one-dimensional; the last is weak, so that its chief rays stay in place
WALLS = [
    ConcaveWall(8.0),
    ConvexWall(5.0),
    ConcaveWall(6.0, shape="cylinder", axis="y"),
    WavyWall(1e-6, 0.2, 0.3),
]


def fitted(scene, point):
    """Second derivatives over the lens at its centre, from a wave over a small stop."""
    small = replace(scene, camera=replace(scene.camera, stop_diameter=2e-3))
    wave = psf.wavefront(small, point)
    u, v, path = wave.u.ravel(), wave.v.ravel(), wave.aberration.ravel()
    terms = np.stack([u * 0 + 1, u, v, u * u / 2, u * v, v * v / 2, u**3, u * u * v, u * v * v])
    scaled = terms / np.abs(terms).max(axis=1)[:, None]
    found = np.linalg.lstsq(scaled.T, path, rcond=None)[0] / np.abs(terms).max(axis=1)
    return np.array([[found[3], found[4]], [found[4], found[5]]])


@pytest.mark.parametrize("wall", WALLS, ids=lambda w: type(w).__name__)
def test_bends_are_those_of_the_wave(flat_scene, wall):
    scene = replace(flat_scene, wall=wall)
    points = scene.object_point + np.array([[0.0, 0.0, 0.0], [0.1, 0.1, 0.0], [-0.1, 0.05, 0.0]])
    for point, bend in zip(points, wave_bends(scene, points), strict=True):
        exact = fitted(scene, point)
        # slopes of the wall are left out: a tenth of a radian at most
        assert np.abs(bend - exact).max() < 0.15 * np.abs(exact).max()


def test_flat_wall_leaves_the_focus(flat_scene):
    scene = replace(flat_scene, wall=FlatWall())
    point = scene.object_point + np.array([0.0, 0.0, 0.2])
    bend = wave_bends(scene, point[None])[0]
    exact = fitted(scene, point)
    assert np.abs(bend - exact).max() < 0.05 * np.abs(exact).max()
    assert np.abs(wave_bends(scene, scene.object_point[None])).max() < 1e-12
