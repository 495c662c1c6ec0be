"""Second-order optics in closed form against the wave that aimed rays give."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from nlosoptics import psf
from nlosoptics.psf.pupil.exit_pupil import exit_pupil
from nlosoptics.psf.pupil.paraxial import change_over_object, wave_bends
from nlosoptics.scene import (
    ConcaveWall,
    ConvexWall,
    FlatWall,
    Lambert,
    SpecularMicrofacet,
    SumMaterial,
    WavyWall,
)

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


def tilted(flat_scene, **changes):
    """A tall object turned out of focus, before a flat wall: bends are those of depth alone."""
    return replace(flat_scene, wall=FlatWall(), hidden=replace(flat_scene.hidden, **changes))


def depth_change(scene):
    """Largest |1/depth - 1/depth of the middle| over the nine points of the picture, 1/m."""
    right, up, _ = scene.hidden.axes
    width, height = scene.hidden.size
    lens, axis = np.array(scene.camera.position), scene.camera.axis
    depths = []
    for x, y in ((0, 0), (-0.5, -0.5), (-0.5, 0.5), (0.5, -0.5), (0.5, 0.5)):
        point = scene.object_point + x * width * right + y * height * up
        depths.append((point * (1, 1, -1) - lens) @ axis)
    return np.abs(1 / np.array(depths) - 1 / depths[0]).max()


@pytest.mark.parametrize("size", [(0.3, 0.1), (0.1, 0.35)])
@pytest.mark.parametrize("turn", [{"yaw": -0.5}, {"pitch": 0.4}])
def test_change_over_the_picture_is_the_least_of_three(flat_scene, size, turn):
    """Flat wall: bends are 1/depth - 1/focus; phase, tail and shift from their formulas."""
    scene = tilted(flat_scene, size=size, **turn)
    change, whole = depth_change(scene), exit_pupil(scene)
    assert change > 1e-2
    pitch, wavelength = scene.camera.image_pitch, scene.laser.wavelength
    distance = abs(whole.image_distance)
    # a tiny stop has the phase of little of a wave: rounding
    for radius in (3e-6, 6e-6):
        small = replace(whole, radius=radius, f_number=distance / (2 * radius))
        expected = 2 * np.pi / wavelength * change * radius**2
        assert change_over_object(scene, small) == pytest.approx(expected, rel=1e-9)
    # a stop whose diffraction fills a pixel moves less than a pixel's tail holds
    radius = wavelength * distance / pitch
    small = replace(whole, radius=radius, f_number=distance / (2 * radius))
    moved = 4 * radius * distance * change / pitch
    assert moved < min(0.2, 2 * np.pi / wavelength * change * radius**2)
    assert change_over_object(scene, small) == pytest.approx(moved, rel=1e-9)
    # a wide lens moves light from pixel to pixel, where the pixels are wide
    wide = replace(whole, radius=12e-3, f_number=distance / 24e-3)
    moved = 4 * 12e-3 * distance * change / max(pitch, wavelength * wide.f_number)
    tail = 0.4 * wavelength * wide.f_number / pitch
    focus = scene.object_point * (1, 1, -1) - np.array(scene.camera.position)
    assert scene.focus_distance == pytest.approx(focus @ scene.camera.axis)
    spot = 12e-3 * distance * change
    within = tail if spot < 0.3 * pitch else 1.0
    assert change_over_object(scene, wide) == pytest.approx(min(moved, within), rel=1e-9)


def test_slopes_of_a_lobe_hide_what_moves(flat_scene):
    """Blur by a slope widens the pixel by slope times distance."""
    scene = tilted(flat_scene, yaw=-0.5)
    pupil = exit_pupil(scene)
    lobe = SpecularMicrofacet(0.05, 1e-3)
    rough = replace(scene, wall_material=SumMaterial(Lambert(0.7), lobe))
    distance, core = abs(pupil.image_distance), scene.laser.wavelength * pupil.f_number
    pixel = max(scene.camera.image_pitch, core) + lobe.slope_rms * distance
    moved = 4 * pupil.radius * distance * depth_change(scene) / pixel
    spot = pupil.radius * distance * depth_change(scene)
    tail = 0.4 * core / scene.camera.image_pitch if spot < 0.3 * pixel else 1.0
    assert change_over_object(rough, pupil) == pytest.approx(min(moved, tail), rel=1e-9)
