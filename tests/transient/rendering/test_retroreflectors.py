"""Retroreflecting surfaces: the law of distance, the blur of the returned light, and a chart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh

import nlosoptics
from nlosoptics.errors import SceneError
from nlosoptics.scene import Retroreflector
from nlosoptics.transient import Scan, Volume, fk_migration, lct, phasor_image, render, wall_grid

ANGLE, SIZE = 0.01, 0.03


def small_plate(distance, material, tilt=0.0):
    plate = trimesh.creation.box((1e-3, 1e-3, 1e-6))
    plate.apply_transform(trimesh.transformations.rotation_matrix(tilt, (0, 1, 0)))
    plate.apply_translation((0.0, 0.0, distance))
    return [(plate, material)]


def light(surfaces, lasers, sensors, pairing="all"):
    bins = {"t_start": 0.1, "delta_t": 20.0, "n_bins": 1}
    return render(
        surfaces,
        Scan(
            laser_points=lasers,
            sensor_points=sensors,
            pairing=pairing,
            **bins,
        ),
        max_bounces=3,
    ).H[0]


@pytest.mark.parametrize("size", [0.0, SIZE])
def test_confocal_light_falls_with_the_square_of_the_distance(size):
    """Closed form, ``albedo A/(pi d^2) / (2 pi (size^2 + angle^2 d^2))``: d^-2 within the size."""
    d = np.array([0.3, 0.6, 1.2])
    sheet = Retroreflector(0.6, ANGLE, size)
    got = [float(light(small_plate(z, sheet), np.zeros(3), np.zeros(3))) for z in d]
    spot = 2.0 * np.pi * (size**2 + (ANGLE * d) ** 2)
    assert got == pytest.approx(0.6 * 1e-6 / (np.pi * d**2) / spot, rel=1e-4)
    power = np.log(got[0] / got[-1]) / np.log(d[-1] / d[0])
    assert power == pytest.approx(4.0 if size == 0.0 else 2.0, abs=0.15)


@pytest.mark.parametrize(("apart", "tol"), [((0.0, 0.0), 1e-3), ((0.02, -0.01), 0.02)])
def test_a_size_blurs_the_light_on_the_wall(apart, tol):
    """The Gaussian mean over 41 x 41 sensor points of the lobe alone, seen aslant by 28 deg.

    The size leaves cosines and distances as they are; they change by apart/distance.
    """
    laser = np.array([0.5, 0.2, 0.0])
    sensor = laser + np.array([*apart, 0.0])
    steps = np.linspace(-4.0, 4.0, 41)
    weights = np.exp(-0.5 * steps**2)
    weights /= weights.sum()
    around = np.zeros((41, 41, 3))
    around[..., 0] = sensor[0] + SIZE * steps
    around[..., 1] = sensor[1] + SIZE * steps[:, None]
    alone = light(small_plate(1.0, Retroreflector(0.6, 0.02), 0.3), laser, around)
    both = light(small_plate(1.0, Retroreflector(0.6, 0.02, SIZE), 0.3), laser, sensor)
    assert float(both) == pytest.approx(weights @ alone @ weights, rel=tol)


def test_a_chart_is_rendered_and_read():
    """Two bars of sheeting; each method finds both, at their depth, and the gap between them."""
    bars = []
    for x in (-0.15, 0.15):
        bar = trimesh.creation.box((0.1, 0.4, 1e-3)).apply_translation((x, 0.0, 0.6))
        bars.append((bar, Retroreflector(0.6, 0.005, 0.02)))
    grid = wall_grid(1.0, 32)
    capture = render(
        bars,
        Scan(
            laser_points=grid,
            sensor_points=grid,
            pairing="confocal",
            t_start=1.1,
            delta_t=0.01,
            n_bins=200,
        ),
        max_bounces=3,
        tol=1e-2,
    )
    volume = Volume.facing(grid, (0.56, 0.74, 0.02))
    for image in (
        fk_migration(capture, volume, target="retroreflective"),
        lct(capture, volume, target="retroreflective"),
        phasor_image(capture, volume, wl_mean=0.125),
    ):
        row = image.projection()[12:20].mean(axis=0)
        at = np.abs(np.abs(grid[0, :, 0]) - 0.15) < 0.05
        assert row[at].min() > 4.0 * row[np.abs(grid[0, :, 0]) < 0.07].max(), image.method
        depth = image.peak_depth()[12:20][:, at]
        assert np.median(depth) == pytest.approx(0.6, abs=0.01), image.method


def test_a_relay_wall_is_no_retroreflector():
    with pytest.raises(SceneError, match="wall.material is a retroreflector"):
        replace(nlosoptics.example("letter_flat"), wall_material=Retroreflector(0.5, 0.01))
