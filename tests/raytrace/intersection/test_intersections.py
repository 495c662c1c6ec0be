"""Hits against high-precision arithmetic, against dense searches, and at every edge case."""

from __future__ import annotations

import os
import subprocess
import sys

import mpmath
import numpy as np
import pytest

from nlosoptics import raytrace
from nlosoptics.errors import SceneError
from nlosoptics.raytrace import Hits
from nlosoptics.scene import (
    ConcaveWall,
    ConvexWall,
    FlatWall,
    MeshWall,
    SumWall,
    WavyWall,
)

BEHIND, HIT, MISS, OUTSIDE, UNRESOLVED = (
    Hits.BEHIND,
    Hits.HIT,
    Hits.MISS,
    Hits.OUTSIDE,
    Hits.UNRESOLVED,
)

mpmath.mp.dps = 50


def sphere(radius, sign):
    """Sag of a vertex-at-origin sphere, positive toward the room for sign = +1."""

    def height(x, y):
        return sign * (radius - mpmath.sqrt(radius**2 - x**2 - y**2))

    return height


def wave(amplitude, period, phase=0.0, direction=0.0):
    def height(x, y):
        k = 2 * mpmath.pi / mpmath.mpf(period)
        turn = mpmath.mpf(direction)
        return mpmath.mpf(amplitude) * mpmath.cos(
            k * (x * mpmath.cos(turn) + y * mpmath.sin(turn)) + mpmath.mpf(phase)
        )

    return height


def wall_cases(size):
    """Walls about ``size`` across, each with its height in high precision."""
    r = mpmath.mpf(4 * size)
    return {
        "flat": (FlatWall(), lambda x, y: mpmath.mpf(0)),
        "concave sphere": (ConcaveWall(4 * size), sphere(r, 1)),
        "convex sphere": (ConvexWall(4 * size, size=2 * size), sphere(r, -1)),
        "cylinder about y": (
            ConcaveWall(4 * size, shape="cylinder", axis="y"),
            lambda x, y: sphere(r, 1)(x, 0),
        ),
        "convex cylinder about x": (
            ConvexWall(4 * size, shape="cylinder", axis="x"),
            lambda x, y: sphere(r, -1)(y, 0),
        ),
        "wavy": (
            WavyWall(0.01 * size, 0.2 * size, 0.3, direction=0.4),
            wave(0.01 * size, 0.2 * size, 0.3, 0.4),
        ),
        "sum": (
            SumWall(WavyWall(0.004 * size, 0.3 * size), ConvexWall(4 * size), size=3 * size),
            lambda x, y: wave(0.004 * size, 0.3 * size)(x, y) + sphere(r, -1)(x, y),
        ),
    }


def random_rays(count, size, seed):
    """Rays from the room to the middle of a wall, up to some 60 degrees oblique."""
    draw = np.random.default_rng(seed)
    origins = draw.uniform((-size, -size, 0.6 * size), (size, size, 1.4 * size), (count, 3))
    targets = draw.uniform((-0.4 * size, -0.4 * size, 0), (0.4 * size, 0.4 * size, 0), (count, 3))
    return origins, targets - origins


@pytest.mark.parametrize("name", wall_cases(1.0))
def test_points_and_normals_lie_on_the_surface(name):
    wall, _ = wall_cases(1.0)[name]
    origins, directions = random_rays(2000, 1.0, seed=2)
    hits = raytrace.intersect(wall, origins, directions)
    assert hits.hit.all()
    unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    # a few roundings of metres
    np.testing.assert_allclose(
        hits.points, origins + hits.distance[:, None] * unit, rtol=0, atol=2e-15
    )
    x, y, z = hits.points.T
    np.testing.assert_allclose(z, wall.height(x, y), rtol=0, atol=4e-15)
    np.testing.assert_allclose(hits.normals, wall.normal(x, y), rtol=0, atol=1e-14)
    assert ((unit * hits.normals).sum(axis=1) < 0).all()


def test_mesh_wall_is_met_on_its_bicubic_surface():
    analytic = ConvexWall(2.0, size=0.6)
    wall = MeshWall(analytic.to_mesh(max_sag_error=2e-6))
    origins, directions = random_rays(500, 0.5, seed=3)
    hits = raytrace.intersect(wall, origins, directions)
    inside = hits.hit
    assert inside.sum() > 400
    x, y, z = hits.points[inside].T
    # marched to 1e-13 of the ray's scale, then one Newton step
    np.testing.assert_allclose(z, wall.height(x, y), rtol=0, atol=1e-14)
    truth = raytrace.intersect(analytic, origins[inside], directions[inside])
    # the surface's own departure from the sphere, over the cosine
    departure = abs(wall.height(x, y) - analytic.height(x, y)).max()
    assert abs(truth.distance - hits.distance[inside]).max() < 4 * departure + 1e-14


def test_sphere_closed_form_agrees_with_the_march():
    """The same sphere as a sum of one wall is closed, with a plane it is marched."""
    origins, directions = random_rays(2000, 1.0, seed=4)
    for kind in (ConcaveWall, ConvexWall):
        closed = raytrace.intersect(kind(3.0), origins, directions)
        marched = raytrace.intersect(SumWall(kind(3.0), FlatWall()), origins, directions)
        np.testing.assert_array_equal(closed.status, marched.status)
        # rounding of both
        np.testing.assert_allclose(closed.distance, marched.distance, rtol=1e-14)


def test_nearly_flat_sphere_keeps_its_digits():
    """R = 1e9 m: the textbook quadratic would cancel to 1e-7."""
    origins, directions = random_rays(200, 1.0, seed=6)
    flat = raytrace.intersect(FlatWall(), origins, directions)
    x, y = flat.points[:, 0], flat.points[:, 1]
    cosine = -directions[:, 2] / np.linalg.norm(directions, axis=1)
    hits = raytrace.intersect(ConcaveWall(1e9), origins, directions)
    sag = (x**2 + y**2) / 2e9
    # second order in the sag of 1e-10 m, and rounding
    np.testing.assert_allclose(hits.distance, flat.distance - sag / cosine, rtol=0, atol=2e-15)


WALLS = {
    "flat": FlatWall(size=1.0),
    "concave": ConcaveWall(2.0, size=1.0),
    "convex": ConvexWall(2.0, size=1.0),
    "cylinder": ConcaveWall(2.0, size=1.0, shape="cylinder"),
    "wavy": WavyWall(0.01, 0.2, size=1.0),
    "sum": SumWall(ConcaveWall(2.0), WavyWall(0.001, 0.1), size=1.0),
    "mesh": MeshWall(ConvexWall(2.0, size=1.0).to_mesh(max_sag_error=1e-4)),
}


@pytest.mark.parametrize("wall", WALLS.values(), ids=WALLS)
@pytest.mark.parametrize(
    ("origin", "direction", "status"),
    [
        ((0.1, 0.1, 1.0), (0, 0, -1), HIT),
        ((0.1, 0.1, 1.0), (0, 0, 1), MISS),
        ((0.1, 0.1, 1.0), (1, 0.2, 0.5), MISS),
        ((0.1, 0.1, 1.0), (1, 0, -0.2), OUTSIDE),
        ((0.8, 0.1, 1.0), (0, 0, -1), OUTSIDE),
        ((0.1, 0.1, -0.5), (0, 0, 1), BEHIND),
        ((0.1, 0.1, -0.5), (0, 0, -1), BEHIND),
    ],
)
def test_status_says_why_there_is_no_hit(wall, origin, direction, status):
    hits = raytrace.intersect(wall, origin, direction)
    assert hits.status == status
    assert np.isfinite(hits.distance) == (status == HIT)
    assert np.isfinite(hits.points).all() == (status == HIT)


def test_ray_from_the_side_enters_a_bowl_below_its_continuation():
    """The bowl's continued sphere is above the ray, but no wall is there."""
    wall = ConcaveWall(2.0, size=0.5)
    hits = raytrace.intersect(wall, (1.9, 0.0, 0.3), (-1.9, 0.0, -0.29))
    assert hits.status == HIT
    assert raytrace.intersect(ConcaveWall(2.0), (1.9, 0.0, 0.3), (-1.9, 0.0, -0.29)).status == (
        BEHIND
    )


def test_rays_start_on_the_wall():
    """From a hollow wall to itself: the chord of a circle; from a flat or bulging one, nothing."""
    start = np.array([0.3, 0.0, 2.0 - np.sqrt(4.0 - 0.09)])
    direction = np.array([-1.0, 0.0, 0.05])
    unit = direction / np.linalg.norm(direction)
    chord = -2 * unit @ (start - (0, 0, 2.0))
    for wall in (ConcaveWall(2.0), SumWall(ConcaveWall(2.0), FlatWall())):
        hits = raytrace.intersect(wall, start, direction)
        # the start is on the sphere to its rounding only, which shifts the far end as much
        assert hits.distance == pytest.approx(chord, abs=1e-14)
    assert raytrace.intersect(FlatWall(), (0.3, 0, 0), (1, 0, 0.1)).status == MISS
    assert raytrace.intersect(ConvexWall(2.0), (0, 0, 0), (1, 0, 0.1)).status == MISS
    assert raytrace.intersect(FlatWall(), (0.3, 0, 0), (1, 0, -0.1)).distance == 0.0


def test_touching_rays_are_not_called_hits():
    wall = SumWall(WavyWall(0.01, 0.2), FlatWall(), size=1.0)
    assert raytrace.intersect(wall, (-0.4, 0, 0.01), (1, 0, 0)).status in (UNRESOLVED, MISS)


def test_shapes_broadcast_and_results_are_read_only():
    directions = np.array([[[0, 0, -1.0], [0.1, 0, -1]], [[0, 0.1, -1], [0, 0, 1]]])
    for wall in (FlatWall(), ConvexWall(2.0)):
        hits = raytrace.intersect(wall, (0, 0, 1), directions)
        assert hits.status.tolist() == [[HIT, HIT], [HIT, MISS]]
        assert hits.points.shape == (2, 2, 3)
        with pytest.raises(ValueError, match="read-only"):
            hits.distance[0] = 0.0


@pytest.mark.parametrize(
    ("origins", "directions", "message"),
    [
        ((0, 0, np.nan), (0, 0, -1), r"origins\[\] holds NaN"),
        (np.ones((2, 3)), [[0, 0, -1], [0, np.inf, 1]], r"directions\[1\] holds NaN"),
        ((0, 0, 1), [[0, 0, -1], [0, 0, 0]], r"directions\[1\] is zero"),
        ((0, 0, 1), (0, -1), r"directions has shape \(2,\); give"),
        (np.ones((2, 3)), np.ones((3, 3)), "do not broadcast"),
    ],
)
def test_bad_rays_are_refused(origins, directions, message):
    with pytest.raises(SceneError, match=message) as caught:
        raytrace.intersect(FlatWall(), origins, directions)
    assert "\n" not in str(caught.value)


def run(code, **environment):
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout


def test_flat_wall_needs_no_compiler():
    code = (
        "import sys\n"
        "from nlosoptics import raytrace, scene\n"
        "raytrace.intersect(scene.FlatWall(size=1.0), (0, 0, 1), (0, 0, -1))\n"
        "print('numba' in sys.modules)"
    )
    assert run(code).strip() == "False"
