"""Light on the relay wall, against view factors and the tracer's power balance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from pytest import approx
from scipy.ndimage import uniform_filter
from scipy.stats import norm

from nlosoptics.errors import SceneError
from nlosoptics.raytrace import trace, wall_irradiance
from nlosoptics.scene import Camera, ConcaveWall, FlatWall, Lambert, Laser, PlanarObject, Scene

WIDTH, HEIGHT, DISTANCE, X, Y = 0.3, 0.4, 0.6, 0.2, 0.1


def plate_scene(picture=None, wall=None):
    """A white plate parallel to the wall."""
    return Scene(
        Laser(wavelength=633e-9, power=1.0, beam_diameter=1e-3, position=(-0.2, 0.1, 0.9)),
        FlatWall(size=(1.4, 1.0)) if wall is None else wall,
        PlanarObject(
            np.ones((4, 3)) if picture is None else picture,
            (WIDTH, HEIGHT),
            position=(X, Y, DISTANCE),
        ),
        Camera(
            position=(-0.6, 0, 0.8),
            aim=(0, 0, 0),
            focal_length=0.05,
            stop_diameter=1e-5,
            focus_distance=2.0,
        ),
        wall_material=Lambert(0.8),
    )


def corner_factor(a, b):
    """View factor from a point to a parallel rectangle a by b at distance 1, corner above it.

    Howell, Menguc and Siegel, Thermal Radiation Heat Transfer, configuration factor B-3.
    """
    p, q = np.sqrt(1 + a * a), np.sqrt(1 + b * b)
    return (a / p * np.arctan(b / p) + b / q * np.arctan(a / q)) / (2 * np.pi)


def plate_irradiance(x, y):
    """Of a plate of 1 W/m^2 exitance, W/m^2."""
    a = [(X + s * WIDTH / 2 - x) / DISTANCE for s in (-1, 1)]
    b = [(Y + s * HEIGHT / 2 - y) / DISTANCE for s in (-1, 1)]
    return sum((1 if i == j else -1) * corner_factor(a[i], b[j]) for i in (0, 1) for j in (0, 1))


def cell_means(x, y):
    """Means over cells, by six Gauss points a side: exact to 1e-12 for fields this smooth."""
    nodes, weights = np.polynomial.legendre.leggauss(6)
    dx, dy = x[1] - x[0], y[1] - y[0]
    xs = x[:, None] + nodes * dx / 2
    ys = y[:, None] + nodes * dy / 2
    values = plate_irradiance(xs[None, :, None, :], ys[:, None, :, None])
    return np.einsum("yxjk,j,k->yx", values, weights, weights) / 4


@pytest.mark.thorough
def test_plate_lights_the_wall_by_view_factors():
    """Every cell within its standard error, family-wise; independent numbers."""
    found = wall_irradiance(
        plate_scene(),
        source="object",
        max_bounces=0,
        n_rays=1 << 20,
        sampler="philox",
        shape=(50, 70),
        seed=1,
    )
    exact = cell_means(found.x, found.y)
    # 32 groups tell a cell's variance to a quarter; with its neighbours', to 3 %
    spread = np.sqrt(uniform_filter(found.standard_error**2, 9, mode="nearest"))
    off = (found.irradiance - exact) / spread
    assert np.abs(off).max() < norm.isf(1e-3 / off.size / 2)
    # 3,500 cells tell the spread of these to 1.2 %
    assert off.std() == approx(1.0, abs=0.05)
    assert np.median(spread / exact) < 0.06


@pytest.mark.thorough
def test_plate_lights_the_wall_in_total():
    found = wall_irradiance(
        plate_scene(), source="object", max_bounces=0, n_rays=1 << 21, shape=(50, 70)
    )
    exact = cell_means(found.x, found.y).sum() * 1.4 / 70 * 1.0 / 50
    assert found.power_error < 1e-4 * exact
    # scrambled Sobol points: the standard error is some 2.5e-5
    assert found.power == approx(exact, rel=1e-4)
    assert found.irradiance.sum() * 1.4 / 70 / 50 == approx(found.power, rel=1e-12)


def test_picture_is_what_glows():
    """Half the plate's light from half the plate; none from a black one."""
    half = np.ones((4, 4))
    half[:, :2] = 0.0
    options = {"source": "object", "max_bounces": 0, "n_rays": 1 << 14, "shape": (5, 7)}
    whole, part, none = (
        wall_irradiance(plate_scene(p), **options) for p in (None, half, np.zeros((2, 2)))
    )
    assert whole.power > 0.0
    # the bright half is the picture's right, toward -x, where more of the wall is
    assert 0.5 * whole.power < part.power < 0.6 * whole.power
    assert none.power == 0.0


@pytest.mark.thorough
def test_laser_light_returns_as_the_ledger_says():
    """On a hollow wall with no object to speak of: what returns from wall to wall."""
    scene = replace(
        plate_scene(np.zeros((2, 2)), ConcaveWall(1.5, size=(1.4, 1.0))),
        hidden=PlanarObject(np.zeros((2, 2)), 1e-6, position=(0, 0.3, 0.8)),
    )
    found = wall_irradiance(scene, max_bounces=2, n_rays=1 << 16, shape=(6, 8), seed=2)
    ledger = trace(scene, n_rays=1 << 19, max_bounces=2, analog=True, seed=3)
    # a plain walk tells it to 0.4 %
    assert found.power == approx(ledger.wall_to_wall, rel=0.02)
    # evenly, as in an integrating sphere, per area of the curved wall
    even = found.irradiance / found.irradiance.mean() - 1
    error = found.standard_error / found.irradiance.mean()
    limit = norm.isf(1e-3 / even.size / 2) * 1.5  # 32 groups: Student's tails are wider
    assert np.abs(even / error).max() < limit


def test_unbounded_wall_needs_a_size():
    scene = plate_scene(wall=FlatWall())
    with pytest.raises(SceneError, match=r"wall.size is unbounded, .*; give size"):
        wall_irradiance(scene)
    found = wall_irradiance(scene, size=(1.4, 1.0), n_rays=1000, shape=(2, 3))
    assert found.irradiance.shape == (2, 3)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"shape": (0, 3)}, r"shape\[0\] = 0"),
        ({"size": (1.0, -1.0)}, "size"),
        ({"source": "sun"}, "sun"),
        ({"n_rays": 0}, "n_rays = 0"),
        ({"max_bounces": 0}, "max_bounces = 0"),
        ({"max_bounces": 63}, "max_bounces = 63"),
    ],
)
def test_bad_option_is_refused(options, message):
    with pytest.raises(SceneError, match=message):
        wall_irradiance(plate_scene(), **options)
