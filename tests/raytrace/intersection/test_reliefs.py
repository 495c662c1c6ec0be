"""Hits on walls of random facets and bumps, against triangles and dense searches."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh

from nlosoptics import raytrace
from nlosoptics.raytrace import Hits
from nlosoptics.scene import ConcaveWall, ConvexWall, FacetWall, GaussianWall, SumWall

HIT, MISS = Hits.HIT, Hits.MISS


def facet_mesh(wall, half):
    """The triangles of a wall of facets over at least a square of side 2 ``half``."""
    row = wall.compiled()[0][0]
    rise = math.sqrt(0.75) * wall.cell
    n = math.ceil(2 * half / wall.cell) + 4
    i, j = np.meshgrid(np.arange(-2 * n, 2 * n), np.arange(-n, n))
    x, y = row[5] + wall.cell * (i + j / 2), row[6] + rise * j
    # heights at nodes from just inside their facets would depend on rounding; 1e-13 does not
    vertices = np.stack([x, y, wall.height(x, y)], axis=-1).reshape(-1, 3)
    corner = (np.arange(2 * n - 1)[:, None] * 4 * n + np.arange(4 * n - 1)).ravel()
    lower = np.stack([corner, corner + 1, corner + 4 * n], axis=1)
    upper = np.stack([corner + 1, corner + 4 * n + 1, corner + 4 * n], axis=1)
    faces = np.concatenate([lower, upper])
    middles = vertices[faces].mean(axis=1)
    near = (np.abs(middles[:, :2]) < half + 2 * wall.cell).all(axis=1)
    mesh = trimesh.Trimesh(vertices, faces[near], process=False)
    mesh.remove_unreferenced_vertices()
    return mesh


def rays(count, half, steepest, flattest, seed):
    """Rays that aim at a square of the mean plane, at angles of elevation within limits, rad."""
    draw = np.random.default_rng(seed)
    target = np.append(draw.uniform(-half, half, (count, 2)), np.zeros((count, 1)), axis=1)
    turn = draw.uniform(0, 2 * np.pi, count)
    rise = np.exp(draw.uniform(math.log(flattest), math.log(steepest), count))
    unit = np.stack([np.cos(rise) * np.cos(turn), np.cos(rise) * np.sin(turn), np.sin(rise)], 1)
    return target, unit


@pytest.mark.parametrize(
    ("slope", "flattest"), [(2e-3, 0.3), (0.1, 0.3), (0.5, 0.3), (2e-3, 1e-3), (0.1, 0.03)]
)
def test_facet_hits_are_those_of_the_triangles(slope, flattest):
    wall, half = FacetWall(1e-2, slope, seed=4), 0.05
    reach = 1.05 * wall.max_height / flattest + 0.02
    target, unit = rays(3000, half, 1.5, flattest, seed=1)
    origins = target + unit * (1.05 * wall.max_height / unit[:, 2:] + 0.01)
    mesh = facet_mesh(wall, half + reach)
    truth = raytrace.intersect_mesh(mesh, origins, -unit)
    hits = raytrace.intersect(wall, origins, -unit)
    assert truth.hit.all()
    assert (hits.status == HIT).all()
    # rays that graze an edge may meet it or pass beyond it, by roundings
    far = np.abs(hits.distance - truth.distance) > 1e-12 / flattest
    assert far.sum() == 0
    agree = (hits.normals * truth.normals).sum(axis=1)
    # a hit within rounding of an edge may have either normal
    assert (agree < 1 - 1e-12).sum() <= 1
    assert np.abs(hits.points[:, 2] - wall.height(*hits.points.T[:2])).max() < 1e-14 / flattest


def test_rays_leave_facets_like_triangles():
    """Reflected and scattered rays that start on the surface, some of which meet it again."""
    wall, half = FacetWall(1e-2, 0.4, seed=5), 0.05
    mesh = facet_mesh(wall, half + 0.4)
    target, unit = rays(4000, half, 1.5, 0.2, seed=2)
    first = raytrace.intersect(wall, target + unit, -unit)
    on = first.hit & (np.abs(first.points[:, :2]) < half).all(axis=1)
    starts, normal = first.points[on], first.normals[on]
    leaving = rays(len(starts), half, 1.5, 0.02, seed=3)[1]
    # only directions above the facet itself; those close to its plane depend on rounding
    above = (leaving * normal).sum(axis=1) > 1e-3
    starts, leaving = starts[above], leaving[above]
    hits = raytrace.intersect(wall, starts, leaving)
    truth = raytrace.intersect_mesh(mesh, starts, leaving, min_distance=1e-9)
    assert 100 < truth.hit.sum() < len(starts) - 100
    assert (hits.hit == truth.hit).all()
    both = hits.hit
    assert np.abs(hits.distance[both] - truth.distance[both]).max() < 1e-11


def first_crossing(wall, origin, direction, low, high, count=20_000):
    """The first sign change of the ray's height above the wall, by dense samples and bisection."""
    t = np.linspace(low, high, count)

    def above(t):
        x, y, z = (origin + np.multiply.outer(t, direction)).T
        return z - wall.derivatives(x, y)[..., 0]

    f = above(t)
    below = np.flatnonzero(f < 0)
    if not len(below):
        return math.nan
    a, b = t[below[0] - 1], t[below[0]]
    for _ in range(60):
        middle = 0.5 * (a + b)
        a, b = (middle, b) if above(np.array([middle]))[0] >= 0 else (a, middle)
    return 0.5 * (a + b)


@pytest.mark.thorough
@pytest.mark.parametrize(
    "wall",
    [
        SumWall(ConcaveWall(10.0), FacetWall(1e-2, 0.05, seed=6), size=1.0),
        SumWall(ConvexWall(10.0), FacetWall(1e-2, 0.05, seed=6), size=1.0),
        SumWall(FacetWall(1e-2, 0.05, seed=7), FacetWall(3e-3, 0.05, seed=7), size=1.0),
        SumWall(FacetWall(1e-2, 0.05, seed=8), GaussianWall(1e-4, 1e-2, seed=8), size=1.0),
        GaussianWall(5e-4, 1e-2, seed=9, size=1.0),
    ],
    ids=["concave", "convex", "two lattices", "bumps and facets", "bumps"],
)
def test_hits_are_first_crossings(wall):
    target, unit = rays(25, 0.2, 1.2, 0.1, seed=4)
    origins = target + unit
    hits = raytrace.intersect(wall, origins, -unit)
    assert hits.hit.all()
    for origin, direction, distance in zip(origins, -unit, hits.distance, strict=True):
        # the dense search starts where the ray enters 4 cm below, far from any other crossing
        truth = first_crossing(wall, origin, direction, 0.5, 1.3)
        assert distance == pytest.approx(truth, abs=1e-12)


def test_grazing_rays_end_and_hit_or_miss_as_triangles_do():
    wall, half = FacetWall(1e-2, 0.05, seed=10, size=0.2), 0.1
    mesh = facet_mesh(wall, half)
    draw = np.random.default_rng(5)
    height = draw.uniform(-1, 4, 2000) * wall.height_rms
    turn = draw.uniform(0, 2 * np.pi, 2000)
    unit = np.stack([np.cos(turn), np.sin(turn), np.zeros(2000)], axis=1)
    origins = -0.3 * unit + np.stack([0 * turn, 0 * turn, height], axis=1)
    hits = raytrace.intersect(wall, origins, unit)
    # the mesh is larger than the wall: it is asked from the wall's edge on
    entry = 0.3 - half / np.abs(unit[:, :2]).max(axis=1)
    starts = origins + entry[:, None] * unit
    truth = raytrace.intersect_mesh(mesh, starts, unit)
    x, y, _ = truth.points.T
    # a ray that enters below the surface passes beside the wall and sees its back at most
    expected = truth.hit & wall.contains(x, y) & (starts[:, 2] > wall.height(*starts.T[:2]))
    assert set(np.unique(hits.status)) == {HIT, MISS}
    assert 200 < expected.sum() < 1800
    assert (hits.hit == expected).all()
    up = hits.hit
    assert np.abs(hits.distance[up] - entry[up] - truth.distance[up]).max() < 1e-10
    # along lattice lines, whose crossings are degenerate
    row = wall.compiled()[0][0]
    for turn in (0.0, math.pi / 3, 2 * math.pi / 3):
        line = np.array([math.cos(turn), math.sin(turn), -1e-2])
        start = np.array([row[5], row[6], 0.0]) - line
        one = raytrace.intersect(wall, start, line)
        assert one.status == HIT
        assert abs(one.points[2] - wall.height(*one.points[:2])) < 1e-14
