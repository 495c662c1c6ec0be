"""Rays at the limits of every wall: 50 digits, grazing, starts on the wall, small features.

Batches and threads must not change a bit of it.
"""

from __future__ import annotations

import mpmath
import numpy as np
import pytest

from nlosoptics import raytrace
from nlosoptics.raytrace import Hits
from nlosoptics.scene import (
    CallableWall,
    ConcaveWall,
    ConvexWall,
    FlatWall,
    HeightMapWall,
    MeshWall,
    SumWall,
    WavyWall,
)

BEHIND, HIT, MISS, UNRESOLVED = Hits.BEHIND, Hits.HIT, Hits.MISS, Hits.UNRESOLVED

mpmath.mp.dps = 50
mpf = mpmath.mpf


def exact_height(wall, x, y):
    """Height in 50 digits; of height maps, that of the bicubic surface through their table."""
    if isinstance(wall, SumWall):
        return sum(exact_height(term, x, y) for term in wall.terms)
    if isinstance(wall, WavyWall):
        turn = mpf(wall.direction)
        along = x * mpmath.cos(turn) + y * mpmath.sin(turn)
        k = 2 * mpmath.pi / mpf(wall.period)
        return mpf(wall.amplitude) * mpmath.cos(k * along + mpf(wall.phase))
    if isinstance(wall, ConcaveWall | ConvexWall):
        r = mpf(wall.radius)
        square = x**2 + y**2
        if wall.shape == "cylinder":
            square = x**2 if wall.axis == "y" else y**2
        sag = r - mpmath.sqrt(r**2 - square)
        return sag if isinstance(wall, ConcaveWall) else -sag
    if isinstance(wall, HeightMapWall):
        return hermite(wall, x, y)
    if isinstance(wall, CallableWall):
        width = mpf(wall.finest_period)
        return mpf(wall.max_height) * mpmath.exp(-(x**2 + y**2) / width**2)
    return mpf(0)


def hermite(wall, x, y):
    (row,), table = wall.compiled()
    x0, y0, sx, sy = (mpf(float(v)) for v in row[1:5])
    nx, ny = int(row[5]), int(row[6])
    v, vx, vy, vxy = np.asarray(table).reshape(4, ny, nx)
    i, j = (
        min(max(int(mpmath.floor(a)), 0), n - 2)
        for a, n in (((x - x0) / sx, nx), ((y - y0) / sy, ny))
    )
    u, w = (x - x0) / sx - i, (y - y0) / sy - j

    def basis(t, step):
        return (
            ((1 + 2 * t) * (1 - t) ** 2, t * (1 - t) ** 2 * step),
            (t * t * (3 - 2 * t), t * t * (t - 1) * step),
        )

    total = mpf(0)
    for di, (bx, cx) in enumerate(basis(u, sx)):
        for dj, (by, cy) in enumerate(basis(w, sy)):
            at = (j + dj, i + di)
            total += bx * by * mpf(float(v[at])) + cx * by * mpf(float(vx[at]))
            total += bx * cy * mpf(float(vy[at])) + cx * cy * mpf(float(vxy[at]))
    return total


def bump(height, width):
    """height exp(-r^2/width^2), as a user's own functions."""

    def h(x, y):
        return height * np.exp(-(x * x + y * y) / width**2)

    def slopes(x, y):
        return -2 * x / width**2 * h(x, y), -2 * y / width**2 * h(x, y)

    return CallableWall(
        h, slopes, max_height=height, max_curvature=2.1 * height / width**2, finest_period=width
    )


def walls(size):
    """Every kind of wall that has no closed form of one term, some ``size`` across."""
    grid = np.random.default_rng(1).normal(size=(9, 11)) * 4e-3 * size
    return {
        "wavy": WavyWall(0.01 * size, 0.2 * size, 0.3, direction=0.4),
        "two waves": SumWall(
            WavyWall(0.004 * size, 0.3 * size), WavyWall(0.003 * size, 0.2 * size, direction=1.3)
        ),
        "sphere and cylinder": SumWall(
            ConcaveWall(5 * size), ConvexWall(7 * size, shape="cylinder"), size=2 * size
        ),
        "nested sum": SumWall(
            SumWall(ConvexWall(4 * size, shape="cylinder", axis="y"), FlatWall()),
            WavyWall(1e-3 * size, 0.1 * size),
            size=2 * size,
        ),
        "height map": HeightMapWall(grid, 0.2 * size),
        "height map and sphere": SumWall(
            HeightMapWall(grid, 0.2 * size), ConcaveWall(6 * size), size=1.6 * size
        ),
        "callable bump": bump(0.01 * size, 0.3 * size),
        "callable bump of 1e-15": bump(1e-15 * size, 0.3 * size),
    }


def rays(count, size, seed):
    """From the room to the middle of a wall, up to some 60 degrees oblique."""
    draw = np.random.default_rng(seed)
    o = draw.uniform((-size, -size, 0.6 * size), (size, size, 1.4 * size), (count, 3))
    return o, draw.uniform(
        (-0.4 * size, -0.4 * size, 0), (0.4 * size, 0.4 * size, 0), (count, 3)
    ) - o


def exact_distance(wall, origin, direction, near):
    """Root of the height above the wall next to ``near``, in 50 digits."""
    o, d = ([mpf(float(c)) for c in v] for v in (origin, direction))
    norm = mpmath.sqrt(sum(c * c for c in d))

    def above(t):
        x, y, z = (a + t * b / norm for a, b in zip(o, d, strict=True))
        return z - exact_height(wall, x, y)

    start = mpf(float(near))
    return mpmath.findroot(above, (start, start * (1 + mpf(10) ** -9) + mpf(10) ** -20))


@pytest.mark.parametrize("size", [0.1, 1.0, 10.0, 1000.0])
@pytest.mark.parametrize("name", walls(1.0))
def test_distance_is_the_root_in_fifty_digits(name, size):
    wall = walls(size)[name]
    origins, directions = rays(5, size, seed=1)
    hits = raytrace.intersect(wall, origins, directions)
    assert hits.hit.all()
    for o, d, distance in zip(origins, directions, hits.distance, strict=True):
        root = exact_distance(wall, o, d, distance)
        # asked for 1e-12; coordinates, phases and cells leave some roundings
        assert float(abs(distance - root) / root) < 2e-14


HERE = {
    "flat": FlatWall(),
    "concave": ConcaveWall(4.0),
    "convex cylinder": ConvexWall(4.0, shape="cylinder"),
    **walls(1.0),
}


@pytest.mark.parametrize("wall", HERE.values(), ids=HERE)
def test_rays_that_start_on_the_wall_leave_it_or_stay(wall):
    """Up and away is a miss; straight down is a hit at 0, to the rounding of the start."""
    draw = np.random.default_rng(2)
    x, y = draw.uniform(-0.3, 0.3, (2, 50))
    start = np.stack([x, y, wall.height(x, y)], axis=1)
    normal = wall.normal(x, y)
    away = raytrace.intersect(wall, start, normal)
    # a start below the surface by its rounding may still be told to be behind it
    assert set(away.status.tolist()) <= {MISS, UNRESOLVED, BEHIND}
    assert (away.status == MISS).mean() > 0.9
    down = raytrace.intersect(wall, start, -normal)
    landed = down.hit
    assert landed.mean() > 0.9
    assert (down.status[~landed] == BEHIND).all()
    # height and normal are good to an ulp of a metre, times a few
    assert down.distance[landed].max() < 1e-12
    lifted = raytrace.intersect(wall, start + 1e-9 * normal, -normal)
    np.testing.assert_allclose(lifted.distance, 1e-9, rtol=0, atol=1e-12)


@pytest.mark.parametrize("wall", HERE.values(), ids=HERE)
def test_grazing_rays_meet_the_wall_or_say_that_they_do_not(wall):
    """Down by 1e-2 to 1e-6 along the wall: what is hit lies on the wall, at the first crossing."""
    draw = np.random.default_rng(3)
    turn, tilt = draw.uniform(0, 2 * np.pi, 40), 10 ** draw.uniform(-6, -2, 40)
    directions = np.stack([np.cos(turn), np.sin(turn), -tilt], axis=1)
    x, y = draw.uniform(-0.1, 0.1, (2, 40))
    start = np.stack([x, y, wall.height(x, y) + 2e-3], axis=1)
    hits = raytrace.intersect(wall, start, directions)
    assert set(hits.status.tolist()) <= {HIT, MISS, 2, UNRESOLVED}
    x, y, z = hits.points[hits.hit].T
    # 1e-13 of the ray's scale, by a slope of 1e-2 at most where the wall is steep
    np.testing.assert_allclose(
        z, wall.height(x, y), rtol=0, atol=1e-12 * (1 + (abs(x) + abs(y)).max(initial=0))
    )
    unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    for i in np.flatnonzero(hits.hit)[:10]:
        t = np.linspace(0, min(hits.distance[i], 50.0), 4001)[1:-1]
        p = start[i] + t[:, None] * unit[i]
        inside = wall.contains(p[:, 0], p[:, 1])
        above = p[inside, 2] - wall.height(*p[inside, :2].T)
        assert above.min(initial=1.0) > -1e-12


@pytest.mark.parametrize(
    "wall",
    [
        FlatWall(),
        WavyWall(0.01, 0.2, 0.3, direction=0.4),
        ConcaveWall(4e4),
        ConvexWall(5e4, shape="cylinder", axis="x"),
        SumWall(WavyWall(0.01, 0.3), WavyWall(0.005, 0.2, direction=1.0)),
        SumWall(WavyWall(0.01, 0.3), ConcaveWall(4e4), size=3e4),
    ],
    ids=["flat", "wavy", "concave", "convex cylinder", "two waves", "wave and sphere"],
)
@pytest.mark.parametrize("away", [1.0, 1e4])
def test_coordinates_of_ten_kilometres(wall, away):
    """The hit is at 1e4 m; the start beside it, or as far away."""
    draw = np.random.default_rng(5)
    x, y = 1e4 + draw.uniform(-1, 1, (2, 5))
    target = np.stack([x, y, wall.height(x, y)], axis=1)
    directions = np.column_stack([draw.uniform(-0.5, 0.5, (5, 2)), -np.ones(5)])
    origins = target - away * directions
    hits = raytrace.intersect(wall, origins, directions)
    assert hits.hit.all()
    for o, d, distance in zip(origins, directions, hits.distance, strict=True):
        root = exact_distance(wall, o, d, distance)
        # 1e-12 of the distance, and the rounding of coordinates and of the phase 3e5 rad
        assert float(abs(distance - root)) < 1e-12 * float(root) + 8 * np.spacing(1e4)


def test_a_sphere_of_a_micrometre_beside_its_rim_is_missed():
    """Straight down, outside a bowl's radius."""
    assert not raytrace.intersect(ConcaveWall(1e-6), (1.1e-6, 0, 1e-3), (0, 0, -1)).hit


ALL = {
    **HERE,
    "wavy with edges": WavyWall(0.01, 0.1, size=0.8),
    "mesh": MeshWall(ConvexWall(2.0, size=1.0).to_mesh(max_sag_error=1e-4)),
}
