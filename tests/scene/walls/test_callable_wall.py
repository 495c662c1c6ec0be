"""Walls of a user's own functions: waves, rays, and the bounds they must keep."""

from dataclasses import replace

import numpy as np
import pytest

from nlosoptics import raytrace
from nlosoptics.errors import SceneError
from nlosoptics.psf.pupil.wall_wavefront import aim
from nlosoptics.scene import CallableWall, ConvexWall, WavyWall


def bump(h0, *, hessian=True):
    """h0 exp(-r^2 / 0.01)."""

    def height(x, y):
        return h0 * np.exp(-100 * (x * x + y * y))

    def gradient(x, y):
        return -200 * x * height(x, y), -200 * y * height(x, y)

    def bends(x, y):
        h = height(x, y)
        return (4e4 * x * x - 200) * h, 4e4 * x * y * h, (4e4 * y * y - 200) * h

    return CallableWall(
        height,
        gradient,
        hessian=bends if hessian else None,
        max_height=abs(h0),
        max_curvature=200 * abs(h0),
        finest_period=0.1,
    )


def as_callable(wall, *, max_height, size=None):
    """A compiled wall behind Python functions."""
    return CallableWall(
        wall.height,
        lambda x, y: np.moveaxis(wall.derivatives(x, y)[..., 1:3], -1, 0),
        hessian=lambda x, y: np.moveaxis(wall.derivatives(x, y)[..., 3:], -1, 0),
        size=size,
        max_height=max_height,
        max_curvature=2 * wall.max_curvature,
        finest_period=wall.finest_period,
    )


@pytest.mark.parametrize("hessian", [True, False])
def test_bump_wave_aberration(hessian):
    """|O-H| + |H-p| - |O'-p| at the top of a bump of 1 um, where x = 0 is stationary exactly."""
    wall = bump(1e-6, hessian=hessian)
    o, p = np.array([-0.6, 0.0, 1.0]), np.array([0.6, 0.0, 1.0])
    exact = -1.714985624441499961956e-6  # 2 hypot(0.6, 1 - h0) - 2 hypot(0.6, 1), 50 digits
    axis = np.array([-0.6, 0.0, -1.0]) / np.hypot(0.6, 1.0)
    rays = aim(wall, o, p[None], axis)
    assert rays.excess[0] == pytest.approx(exact, abs=1e-15)


@pytest.mark.parametrize(
    ("wall", "size"),
    [
        (WavyWall(0.01, 0.1, 0.3, direction=0.4), None),
        (WavyWall(0.01, 0.1, 0.3, size=0.8), 0.8),
        (ConvexWall(2.0, size=0.9), 0.9),
    ],
)
def test_rays_meet_it_as_the_compiled_wall(wall, size):
    draw = np.random.default_rng(1)
    o = draw.uniform((-1, -1, -0.05), (1, 1, 0.8), (400, 3))
    d = np.where(draw.uniform(size=(400, 1)) < 0.7, draw.uniform(-0.4, 0.4, (400, 3)) - o, o)
    if isinstance(wall, ConvexWall):
        inner = ConvexWall(2.0)
        own = replace(as_callable(inner, max_height=0.12, size=size), max_curvature=0.6)
        keep = o[:, 2] > 0.0  # where a slab search and a closed form name the same reason
        o, d = o[keep], d[keep]
    else:
        own = as_callable(wall, max_height=0.01, size=size)
    found, exact = raytrace.intersect(own, o, d), raytrace.intersect(wall, o, d)
    assert set(exact.status.tolist()) >= {raytrace.Hits.HIT, raytrace.Hits.MISS}
    np.testing.assert_array_equal(found.hit, exact.hit)
    # rounding of both marches, over the cosine of oblique rays
    np.testing.assert_allclose(found.distance, exact.distance, rtol=1e-12)
    np.testing.assert_allclose(found.normals, exact.normals, rtol=0, atol=1e-10)


def test_functions_that_break_their_word_are_named():
    good = bump(1e-6)
    for changes, message in (
        ({"max_height": 1e-9}, "wall.max_height = 1e-09 is exceeded by"),
        ({"max_curvature": 1e-5}, "wall.max_curvature = 1e-05 is exceeded by"),
        ({"height": lambda x, y: np.zeros(3)}, r"wall.height returned shape \(3,\)"),
        ({"height": lambda x, y: np.nan}, "wall.height returned NaN"),
        ({"gradient": lambda x, y: (x, y, x)}, "wall.gradient returned 3 values"),
        ({"hessian": lambda x, y: (x, y)}, "wall.hessian returned 2 values"),
    ):
        with pytest.raises(SceneError, match=message):
            replace(good, **changes).derivatives([0.0, 1e-3], [0.0, 0.0])
    with pytest.raises(SceneError, match="is not callable"):
        replace(good, height=1.0)
    with pytest.raises(SceneError, match="wall.max_curvature = inf is not finite"):
        CallableWall(good.height, good.gradient, max_height=1.0)
