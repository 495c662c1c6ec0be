"""Light that a creased wall absorbs: rays against the flat wall and exact radiosity in a groove."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest
from pytest import approx

from nlosoptics.raytrace import trace
from nlosoptics.scene import Camera, Lambert, Laser, OrenNayar, PlanarObject, Scene, WavyWall

PERIOD = 20e-3
DEPTHS = (0.0, 0.1, 0.25, 0.5, 1.0)  # periods, peak to valley; slopes up to pi


@cache
def lit(depth, material, *, incidence=0.0, n_rays=1 << 15, **options):
    """Paths of 1 W that fall on 40 periods of a wave, at an angle of incidence in rad.

    The period is small against the wall, so that next to no light leaves along the grooves. The
    object is a black speck, and the lens takes 1e-4 of the light.
    """
    source = (1.2 * math.sin(incidence), 0.0, 1.2 * math.cos(incidence))
    scene = Scene(
        Laser(wavelength=633e-9, power=1.0, beam_diameter=0.8, position=source),
        WavyWall(depth * PERIOD / 2, PERIOD, size=(2.0, 2.0)),
        PlanarObject(np.zeros((2, 2)), 1e-6, position=(0.6, 0.0, 0.8)),
        Camera(
            position=(-0.6, 0.0, 0.8),
            aim=(0.0, 0.0, 0.0),
            focal_length=0.05,
            stop_diameter=0.025,
            focus_distance=2.0,
            pixel_pitch=1e-4,
            pixels=(64, 64),
            binning=1,
        ),
        wall_material=material,
    )
    return trace(scene, n_rays=n_rays, max_bounces=40, seed=5, **options)


def loss(paths):
    return paths.ledger["absorbed by wall"], paths.ledger_error["absorbed by wall"]


def radiosity_loss(depth, albedo, n=400):
    """Absorbed fraction of light that falls straight onto h = cos(2 pi x) depth/2, without rays.

    A line from trough to trough would pass through the crest between them, so one period is closed
    in itself. A Lambertian strip sends cos_i cos_j/(2 d) of its light to a unit of arc length at
    the distance d in the plane of the profile.
    """
    x = (np.arange(n) + 0.5) / n
    height, slope = depth / 2 * np.cos(2 * np.pi * x), -np.pi * depth * np.sin(2 * np.pi * x)
    arc = np.sqrt(1 + slope**2)
    dx, dh = x - x[:, None], height - height[:, None]
    seen = np.zeros((n, n), dtype=bool)
    for i in range(n):
        # what lies to the right is seen if no point before it appears at a larger elevation
        elevation = dh[i, i + 1 :] / dx[i, i + 1 :]
        seen[i, i + 1 :] = elevation >= np.maximum.accumulate(elevation)
    seen |= seen.T
    out = np.maximum(dh - slope[:, None] * dx, 0.0)  # distance times cosine times arc
    to = np.maximum(slope * dx - dh, 0.0)
    squared = dx**2 + dh**2 + np.eye(n)
    share = seen * out * to / (2 * squared**1.5) / (n * arc[:, None])
    arriving = np.linalg.solve(np.eye(n) - albedo * share.T, np.full(n, 1 / n))
    return (1 - albedo) * float(arriving.sum())


@pytest.mark.parametrize("incidence", [0.0, 0.7])
@pytest.mark.parametrize("material", [Lambert(0.75), Lambert(0.9), OrenNayar(0.75, 0.3)])
def test_flat_wall_loses_one_minus_albedo(material, incidence):
    paths = lit(0.0, material, incidence=incidence, analog=True)
    found, error = loss(paths)
    assert error < 1e-4
    # 1e-12 is rounding, for lobes of which every ray loses the same fraction
    assert found == approx(1 - float(material.albedo(incidence)), abs=4 * error + 1e-12)
    assert paths.trapped == 0.0


@pytest.mark.parametrize("analog", [True, False])
@pytest.mark.parametrize("albedo", [0.75, 0.9])
@pytest.mark.parametrize("depth", DEPTHS[1:])
def test_loss_is_that_of_exact_radiosity(depth, albedo, analog):
    found, error = loss(lit(depth, Lambert(albedo), analog=analog))
    # halving the cells changes the radiosity by 2e-6 at most
    exact = radiosity_loss(depth, albedo)
    assert error < 1e-2 * exact
    assert found == approx(exact, abs=4 * error + 1e-5)


@pytest.mark.parametrize("depth", DEPTHS[1:])
def test_balance_of_connected_paths_closes(depth):
    """Connections and roulette balance on average only."""
    found = lit(depth, Lambert(0.75), analog=False)
    # the standard deviation of a sum is at most the sum of the standard deviations
    error = sum(found.ledger_error.values())
    assert error < 5e-3
    assert sum(found.ledger.values()) == approx(1.0, abs=4 * error)
