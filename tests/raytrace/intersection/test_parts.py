"""Limits of searches and structures of meshes, on record."""

import math

import numpy as np
import pytest
import trimesh

from nlosoptics import raytrace
from nlosoptics.raytrace.intersection import intersections, kept_meshes, triangles
from nlosoptics.scene import CallableWall, FlatWall

from ...records import attempt
from .test_kernels import WALLS, mesh, rays, triangle_rays

FUNCTIONS = {
    "bowl": (0.5, 0.3, 0.3, (1.2, 0.9)),
    "endless": (0.0, 0.2, 20.0, None),
    "saddle": (0.7, -0.6, 0.3, (1.0, 1.1)),
}


def wall(name):
    """A wall of Python functions: a paraboloid."""
    a, b, top, size = FUNCTIONS[name]
    return CallableWall(
        lambda x, y: 0.5 * (a * x**2 + b * y**2),
        lambda x, y: (a * x, b * y),
        hessian=lambda x, y: (a + 0 * x, 0 * x, b + 0 * x),
        size=size,
        max_height=top,
        max_curvature=0.7,
    )


@pytest.mark.parametrize("name", FUNCTIONS)
def test_walls_of_functions(name, on_record):
    origins, directions, _ = rays(400, 5)
    near = np.abs(origins).max(axis=1) < 10.0
    draw = np.random.default_rng(2)
    starts = draw.integers(-4, 5, (200, 3)) / 8.0
    axes = np.eye(3)[draw.integers(0, 3, 200)] * draw.choice((-1.0, 1.0), (200, 1))
    on_record(
        [
            raytrace.intersect(wall(name), origins[near], directions[near]),
            raytrace.intersect(wall(name), starts, axes),
            raytrace.intersect(FlatWall(size=(1.0, 0.5)), starts, axes),
            raytrace.intersect(FlatWall(size=(1.0, 0.5)), origins[near], directions[near]),
        ],
        1e-8,
    )


@pytest.mark.parametrize("name", WALLS)
def test_limits_of_a_search(name, on_record):
    on_record(intersections.search_bounds(WALLS[name], *WALLS[name].compiled()), 1e-8)


def test_rays_that_are_none(on_record):
    o, d = np.ones((2, 3, 3))
    bad = [
        (o[:, :2], d),
        (1.0, d),
        (o, d[:2]),
        (np.where(np.eye(3) == 1, np.nan, o), d),
        (o, np.where(np.arange(3)[:, None] == 1, 0.0, d)),
        (o, np.where(np.arange(3)[:, None] == 2, np.inf, d)),
    ]
    found = [
        attempt(raytrace.intersect, one, *pair)
        for pair in bad
        for one in (FlatWall(), WALLS["wave"], WALLS["bowl"])
    ]
    on_record([found, intersections._rays(o[0], 1e200 * d), intersections._rays(o, 1e-200 * d[0])])


def dust():
    """A plate with specks: near each other, far apart, and more than are searched one by one."""
    plate = trimesh.creation.box((1.0, 0.8, 0.1)).subdivide()
    draw = np.random.default_rng(6)

    def specks(count, reach):
        places = draw.uniform(-reach, reach, (count, 3)) + np.array([0.0, 0.0, 0.3])
        size = 1e-5 * draw.uniform(1.0, 2.0, count)
        return [
            trimesh.creation.box((s, 2 * s, 3 * s)).apply_translation(p)
            for s, p in zip(size, places, strict=True)
        ]

    join = trimesh.util.concatenate
    return [
        join([plate, *specks(3, 0.01)]),
        join([plate, *specks(3, 0.5)]),
        join([plate, *specks(40, 0.5)]),
        join(specks(2, 0.5)),
    ]


def test_structures_of_meshes(on_record):
    found = []
    for one in (mesh(False), mesh(True), *dust()):
        corners = np.asarray(one.triangles)
        sides = corners - corners[:, [1, 2, 0]]
        edges = np.sqrt((sides * sides).sum(axis=-1).max(axis=1))
        facets, kept = triangles.Facets(one), kept_meshes.KeptMesh(one, mesh(True))
        found.append([facets.names, facets.rows, facets.edges, facets.boxes, facets.limits])
        found.append([facets.reach, facets.centre, facets.sorts, len(facets.parts)])
        found.append([list(part) for part in triangles._small_parts(corners, edges)])
        found.append([kept.chart, kept.chart.area, kept.ball, kept.reach, kept.normals])
    flat = np.random.default_rng(2).random((9, 3)) * (1.0, 0.0, 2.0)
    found.append(triangles._along_a_curve(flat, flat.min(axis=0), flat.max(axis=0)))
    found.append([kept_meshes.cumulative(np.array(v)) for v in ([0.0, 0.0, 0.0], [0.5, 0.0, 2.0])])
    found.append([kept_meshes.chart_splits(np.array([0.0, 0.0, 1.0, 3.0, 0.5, 0.0, 2.0, 2.0]))])
    found += [list(kept_meshes._halved(np.random.default_rng(n).random((n, 3)))) for n in (1, 2, 9)]
    on_record(found, 1e-8)


def test_meshes_that_are_none(on_record):
    hole = mesh(True)
    hole.vertices[3] = np.nan
    line = trimesh.Trimesh([[0, 0, 0], [1, 1, 1], [2, 2, 2]], [[0, 1, 2]], process=False)
    partly = trimesh.Trimesh(
        [[0, 0, 0], [1, 1, 1], [2, 2, 2], [0, 1, 0]], [[0, 1, 2], [0, 1, 3]], process=False
    )
    on_record([attempt(triangles.Facets, one) for one in (hole, line)], 1e-8)
    assert triangles.Facets(partly).names.tolist() == [1]


@pytest.mark.parametrize("number", range(4))
def test_specks(number, on_record):
    """First hits and all hits of meshes that are searched in parts, aimed at triangles."""
    one = dust()[number]
    origins, _ = triangle_rays(False, 120)
    aims = one.triangles_center[np.arange(120) * 7 % len(one.faces)]
    found = [
        raytrace.intersect_mesh(one, origins, aims - origins, min_distance=nearest)
        for nearest in (0.0, 0.4)
    ]
    hits = [(hit.hit, np.nan_to_num(hit.distance), np.nan_to_num(hit.points)) for hit in found]
    seen = raytrace.occluded(one, origins, aims + 1e-3 * (aims - origins))
    counts = raytrace.all_hits(one, origins, aims - origins)
    on_record([hits, seen, counts.distance if hasattr(counts, "distance") else counts], 1e-7)


def test_uses_of_a_wall_change_no_number():
    """Tables of drawn facets are made for many uses alone, and hold the same facets."""
    few, many = (intersections.compiled_wall(WALLS["facets"], uses) for uses in (1, math.inf))
    assert np.array_equal(few[3], many[3])
    assert np.array_equal(few[4], many[4])


def test_triangles_are_sorted_by_the_interleaved_bits_of_their_places():
    """Twenty bits along each axis, x lowest; places that differ in high and in low bits alone."""
    draw = np.random.default_rng(8)
    cells = draw.integers(0, 2**20 - 1, (500, 3)) >> draw.integers(0, 20, (500, 1))
    cells[::3] += 704512 - (cells[::3] & 704512)  # so that low bits decide beside high ones
    cells = np.minimum(cells, 2**20 - 2)
    low, high = np.array([-0.3, 0.2, 5.0]), np.array([1.1, 0.4, 5.5])
    points = low + (cells + 0.5) / (2**20 - 1) * (high - low)
    codes = [
        sum(
            (int(cell) >> bit & 1) << (3 * bit + axis)
            for bit in range(20)
            for axis, cell in enumerate(row)
        )
        for row in cells
    ]
    order = triangles._along_a_curve(points, low, high)
    assert order.tolist() == sorted(range(500), key=codes.__getitem__)


def test_rays_beside_an_edge_are_near_it_on_every_side():
    """Up to three margins aside, by copies in three directions, one of them within 60 degrees."""
    for turn in np.linspace(0.0, 2.0 * np.pi, 13):
        corners = np.exp(1j * (turn + np.array([0.0, 1.7, 4.1])))
        flat = np.column_stack([corners.real, corners.imag, np.zeros(3)])
        facets = triangles.Facets(trimesh.Trimesh(flat, [[0, 1, 2]], process=False))
        middle = (corners + np.roll(corners, -1)) / 2
        out = -1j * (np.roll(corners, -1) - corners) / abs(np.roll(corners, -1) - corners)
        for away, near in ((1.0, True), (3.5, False), (20.0, False)):
            place = middle + away * triangles.MARGIN * facets.reach * out
            rays = np.zeros((3, 8), np.float32)
            start = np.column_stack([place.real, place.imag, np.ones(3)]) - facets.centre
            rays[:, :3], rays[:, 5] = start / facets.reach, -1.0
            assert facets._near(rays).tolist() == [near] * 3, (turn, away)


@pytest.mark.parametrize("away", [3.0, 1e4, 1e8])
def test_a_far_start_does_not_shade_the_triangle_itself(away):
    """Points on a triangle are free from afar, where rounding exceeds 1e-9 of its extent."""
    floor = trimesh.Trimesh([[-1, -1, 0], [2, -1, 0], [-1, 2, 0.0]], [[0, 1, 2]], process=False)
    draw = np.random.default_rng(9)
    points = np.column_stack([draw.uniform(-0.9, 0.4, (200, 2)), np.zeros(200)])
    starts = away * draw.uniform((-0.3, -0.3, 0.8), (0.3, 0.3, 1.0), (200, 3))
    assert not raytrace.occluded(floor, starts, points).any()
    assert not raytrace.occluded(floor, points, starts).any()
    behind = points - np.array([0.0, 0.0, 1e-6 + 4e-14 * away])
    assert raytrace.occluded(floor, starts, behind).all()
