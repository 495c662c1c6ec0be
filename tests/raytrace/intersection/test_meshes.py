"""Rays on triangle meshes: the exact facet, no leak, and every degenerate case."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys

import numpy as np
import pytest
import trimesh

from nlosoptics import raytrace
from nlosoptics.errors import SceneError
from nlosoptics.raytrace import Hits

HIT, MISS = Hits.HIT, Hits.MISS


def brute(mesh, origins, directions, *, tolerance=1e-13):
    """First distance over all triangles, in float64."""
    units = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    a, b, c = np.moveaxis(np.asarray(mesh.triangles), 1, 0)
    ab, ac = b - a, c - a
    first = np.full(len(units), np.inf)
    for i, (o, d) in enumerate(zip(origins, units, strict=True)):
        p, s = np.cross(d, ac), o - a
        with np.errstate(divide="ignore", invalid="ignore"):
            det = (ab * p).sum(axis=1)
            u, q = (s * p).sum(axis=1) / det, np.cross(s, ab)
            v, t = q @ d / det, (ac * q).sum(axis=1) / det
            inside = (u >= -tolerance) & (v >= -tolerance) & (u + v <= 1 + tolerance) & (t >= 0)
        first[i] = t[inside].min(initial=np.inf)
    return first


def bumpy(subdivisions, seed=0):
    """Closed surface about the origin, radius 0.9 to 1.1."""
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions)
    x, y, z = mesh.vertices.T
    radius = 1 + 0.1 * np.sin(3 * x + seed) * np.cos(4 * y) * np.sin(5 * z + 1)
    return trimesh.Trimesh(mesh.vertices * radius[:, None], mesh.faces, process=False)


SPHERE = bumpy(3)


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e3])
@pytest.mark.parametrize("away", [0.0, 1e4])
def test_hits_are_those_of_all_triangles(scale, away):
    """Features of 1e-6 m, at 1e4 m too, where coordinates themselves are rounded to 1.8e-12 m."""
    mesh = trimesh.Trimesh(scale * SPHERE.vertices + away, SPHERE.faces, process=False)
    draw = np.random.default_rng(0)
    origins = scale * draw.normal(size=(600, 3)) * 1.5 + away
    targets = scale * draw.uniform(-1, 1, (600, 3)) + away
    hits = raytrace.intersect_mesh(mesh, origins, targets - origins)
    exact = brute(mesh, origins, targets - origins)
    np.testing.assert_array_equal(hits.hit, np.isfinite(exact))
    assert 100 < hits.hit.sum() < 600
    # a few roundings of the ray's length and of the coordinates
    slack = 1e-12 * np.abs(exact[hits.hit]).max() * 0.01 + 4e-15 * away
    np.testing.assert_allclose(hits.distance[hits.hit], exact[hits.hit], rtol=0, atol=slack)
    facets = np.asarray(mesh.triangles)[hits.triangle[hits.hit]]
    normal = np.cross(facets[:, 1] - facets[:, 0], facets[:, 2] - facets[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    height = ((hits.points[hits.hit] - facets[:, 0]) * normal).sum(axis=1)
    # of the exact facet: 1e-12 of the size, and the rounding of coordinates
    assert np.abs(height).max() <= 1e-14 * scale + 4e-16 * away * 4
    units = targets - origins
    assert ((hits.normals * units).sum(axis=1)[hits.hit] < 0).all()
    np.testing.assert_allclose(
        np.abs((hits.normals[hits.hit] * normal).sum(axis=1)), 1, rtol=0, atol=1e-12
    )


def rays_at(mesh, where, count, seed, outside):
    """Rays from within, or from outside at triangles that face them, at vertices or edges."""
    draw = np.random.default_rng(seed)
    origins = draw.normal(size=(count, 3))
    origins *= (3.0 if outside else 0.3) / np.linalg.norm(origins, axis=1, keepdims=True)
    vertices, edges = np.asarray(mesh.vertices), np.asarray(mesh.edges_unique)
    if where == "vertices":
        targets = vertices[draw.integers(len(vertices), size=count)]
    else:
        a, b = np.moveaxis(vertices[edges[draw.integers(len(edges), size=count)]], 1, 0)
        targets = a + draw.uniform(size=(count, 1)) * (b - a)
    if outside:
        seen = ((origins - targets) * targets).sum(axis=1) > 1.5
        origins, targets = origins[seen], targets[seen]
    return origins, targets


@pytest.mark.thorough
def test_no_random_ray_leaks_out_of_a_closed_mesh():
    mesh, draw = bumpy(6), np.random.default_rng(1)
    for _ in range(4):
        origins, directions = draw.uniform(-0.4, 0.4, (250_000, 3)), draw.normal(size=(250_000, 3))
        hits = raytrace.intersect_mesh(mesh, origins, directions)
        assert hits.hit.all()
        radius = np.linalg.norm(hits.points, axis=1)
        assert 0.89 < radius.min()
        assert radius.max() < 1.11


@pytest.mark.thorough
@pytest.mark.parametrize("outside", [False, True])
@pytest.mark.parametrize("where", ["vertices", "edges"])
def test_no_ray_leaks_at_vertices_and_edges(where, outside):
    mesh = bumpy(5)
    origins, targets = rays_at(mesh, where, 1_000_000, 2, outside)
    hits = raytrace.intersect_mesh(mesh, origins, targets - origins)
    leaks = ~(hits.distance <= np.linalg.norm(targets - origins, axis=1) * (1 + 1e-9))
    assert len(leaks) > 50_000
    assert leaks.mean() <= 1e-6
    some = np.flatnonzero(hits.hit)[:100_000]
    shares = trimesh.triangles.points_to_barycentric(
        np.asarray(mesh.triangles)[hits.triangle[some]], hits.points[some]
    )
    # within the triangle itself, to rounding over sides of 0.03; float32 would be off by 1e-5
    assert shares.min() > -1e-11


@pytest.mark.thorough
@pytest.mark.parametrize("count", [1, 4, 40])
def test_small_parts_of_a_large_mesh_are_hit_as_if_alone(count):
    """Balls of 1 mm, 10 m above a floor of 20 km: alone, with structures of their own, or many."""
    draw = np.random.default_rng(11)
    ball = bumpy(2)
    centres = np.column_stack([draw.uniform(-9e3, 9e3, (count, 2)), np.full(count, 10.0)])
    parts = [trimesh.Trimesh(1e-3 * ball.vertices + c, ball.faces, process=False) for c in centres]
    floor = trimesh.Trimesh(
        1e4 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]),
        [[0, 1, 2], [0, 2, 3]],
        process=False,
    )
    room = trimesh.util.concatenate([floor, *parts])
    for k in range(0, count, 13):
        targets = centres[k] + draw.uniform(-1e-3, 1e-3, (400, 3))
        origins = centres[k] + draw.uniform(-1, 1, (400, 3)) + (0, 0, 3)
        together = raytrace.intersect_mesh(room, origins, targets - origins)
        alone = raytrace.intersect_mesh(parts[k], origins, targets - origins)
        assert together.hit.all()
        # the same arithmetic, whether the floor is there or not
        np.testing.assert_array_equal(together.triangle >= 2, alone.hit)
        assert 200 < alone.hit.sum() < 400
        np.testing.assert_array_equal(together.distance[alone.hit], alone.distance[alone.hit])
        faces = alone.triangle[alone.hit] + 2 + k * len(ball.faces)
        np.testing.assert_array_equal(together.triangle[alone.hit], faces)
        past = together.points[~alone.hit]
        # the rounding of a coordinate of 10 km
        np.testing.assert_allclose(past[:, 2], 0, rtol=0, atol=1e-11)
        blocked = raytrace.occluded(room, origins, 2 * targets - origins)
        np.testing.assert_array_equal(
            blocked, raytrace.occluded(parts[k], origins, 2 * targets - origins)
        )
        first = raytrace.all_hits(room, origins, targets - origins)
        _, begins = np.unique(first.ray, return_index=True)
        np.testing.assert_array_equal(first.distance[begins], together.distance)


def one_triangle():
    return trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], process=False)


def test_one_triangle_with_its_edges_and_vertices():
    targets = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0.5, 0.5, 0], [0.3, 0, 0], [0.2, 0.2, 0]])
    for height in (1.0, -1e-3, 1e3):
        origins = np.tile([0.25, 0.25, height], (6, 1))
        hits = raytrace.intersect_mesh(one_triangle(), origins, targets - origins)
        assert hits.status.tolist() == [HIT] * 6
        np.testing.assert_allclose(hits.points, targets, rtol=0, atol=1e-13)
        beside = targets[:5] + 1e-9 * (targets[:5] - (0.25, 0.25, 0))
        hits = raytrace.intersect_mesh(one_triangle(), origins[:5], beside - origins[:5])
        assert hits.status.tolist() == [MISS] * 5
        assert (hits.triangle == -1).all()
        assert np.isnan(hits.distance).all()


def test_rays_in_the_plane_and_grazing_it():
    mesh = one_triangle()
    assert raytrace.intersect_mesh(mesh, (-1, 0.2, 0), (1, 0, 0)).status == MISS
    hits = raytrace.intersect_mesh(mesh, (-1.0, 0.2, 1e-7), (1.0, 0, -0.8e-7))
    assert hits.status == HIT
    assert hits.points[0] == pytest.approx(0.25, abs=1e-8)


def test_degenerate_and_non_manifold_triangles():
    vertices = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0, -1, 0], [2, 0, 0]]
    # a line, a point, and three triangles on one edge
    faces = [[0, 1, 5], [2, 2, 2], [0, 1, 2], [0, 1, 3], [0, 1, 4]]
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    hits = raytrace.intersect_mesh(mesh, [[0.2, 0.2, 1], [0.2, -0.2, 1], [0.2, 1, 0.2]],
                                   [[0, 0, -1], [0, 0, -1], [0, -1, 0]])  # fmt: skip
    assert hits.triangle.tolist() == [2, 4, 3]
    assert raytrace.intersect_mesh(mesh, (0.2, 0.5, 0.5), (0, -1, -1)).status == HIT
    with pytest.raises(SceneError, match="no triangle with an area"):
        raytrace.intersect_mesh(
            trimesh.Trimesh(vertices, faces[:2], process=False), (0, 0, 1), (0, 0, -1)
        )


def test_rays_leave_the_mesh_beyond_a_least_distance():
    first = raytrace.intersect_mesh(SPHERE, np.zeros((50, 3)), np.eye(3)[np.arange(50) % 3])
    back = raytrace.intersect_mesh(SPHERE, first.points, -first.points, min_distance=1e-9)
    assert back.hit.all()
    assert (back.distance > 1.5).all()
    with pytest.raises(SceneError, match="min_distance = -1 m is out of range"):
        raytrace.intersect_mesh(SPHERE, (0, 0, 0), (0, 0, 1), min_distance=-1.0)


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e4])
def test_points_of_a_convex_mesh_see_each_other_inside_only(scale):
    mesh = trimesh.creation.icosphere(subdivisions=4, radius=scale)
    draw = np.random.default_rng(3)
    points = raytrace.intersect_mesh(mesh, np.zeros((2000, 3)), draw.normal(size=(2000, 3))).points
    a, b = points[:1000], points[1000:]
    apart = np.linalg.norm(a - b, axis=1) > 0.3 * scale
    assert not raytrace.occluded(mesh, a[apart], b[apart]).any()
    # 3 scales out, the far side is hidden and the near side is not
    away = 3 * a / np.linalg.norm(a, axis=1, keepdims=True) * scale
    assert not raytrace.occluded(mesh, a, away).any()
    assert raytrace.occluded(mesh, -a, away).all()
    np.testing.assert_array_equal(
        raytrace.occluded(mesh, a, -away), raytrace.occluded(mesh, -away, a)
    )


def test_a_screen_hides_only_what_is_behind_it():
    screen = trimesh.Trimesh(
        [[-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]], [[0, 1, 2], [0, 2, 3]], process=False
    )
    targets = np.array([[0, 0, 0], [0, 0, 1 + 1e-6], [0, 0, 1], [3, 0, 0], [0, 0, 3], [1.4, 0, 0]])
    hidden = raytrace.occluded(screen, (0.1, 0.1, 2), targets)
    assert hidden.tolist() == [True, False, False, False, False, True]
    with pytest.raises(SceneError, match="zero"):
        raytrace.occluded(screen, (0, 0, 0), (0, 0, 0))
    with pytest.raises(SceneError, match="do not broadcast"):
        raytrace.occluded(screen, np.ones((2, 3)), np.ones((3, 3)))


def test_rays_that_start_on_a_triangle_meet_it_there():
    box = trimesh.creation.box((2, 2, 2))
    draw = np.random.default_rng(6)
    origins = np.append(draw.uniform(-0.9, 0.9, (500, 2)), np.ones((500, 1)), axis=1)
    directions = draw.normal(size=(500, 3))
    steep = np.abs(directions[:, 2]) > np.sin(np.radians(10)) * np.linalg.norm(directions, axis=1)
    for mesh in (box, box.subdivide().subdivide().subdivide().subdivide()):
        hits = raytrace.intersect_mesh(mesh, origins, directions)
        # the face lies in z = 1 without rounding
        assert (hits.distance[steep] == 0).all()
        np.testing.assert_array_equal(hits.points[steep], origins[steep])
        whole = raytrace.all_hits(mesh, origins, directions)
        assert (np.bincount(whole.ray[whole.distance == 0], minlength=500) == 1).all()
        beyond = raytrace.intersect_mesh(mesh, origins, directions, min_distance=1e-9)
        np.testing.assert_array_equal(beyond.hit, directions[:, 2] < 0)


@pytest.mark.parametrize("away", [0.0, 1e4])
def test_all_hits_are_those_of_every_triangle(away):
    mesh = trimesh.Trimesh(SPHERE.vertices + away, SPHERE.faces, process=False)
    draw = np.random.default_rng(7)
    origins, directions = draw.normal(size=(300, 3)) * 1.5 + away, draw.normal(size=(300, 3))
    hits = raytrace.all_hits(mesh, origins, directions)
    units = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    a, b, c = np.moveaxis(np.asarray(mesh.triangles), 1, 0)
    for i, (o, d) in enumerate(zip(origins, units, strict=True)):
        # d as a sum of the corners seen from o, with none of another sign
        seen = np.stack([a - o, b - o, c - o], axis=-1)
        shares = np.linalg.solve(seen, np.broadcast_to(d[:, None], (len(a), 3, 1)))[..., 0]
        met = np.flatnonzero((shares > 0).all(axis=1))
        distances = 1 / shares[met].sum(axis=1)
        order = np.argsort(distances)
        mine = hits.ray == i
        np.testing.assert_array_equal(hits.triangle[mine], met[order])
        # coordinates 1e4 m away are rounded to 1.8e-12 m, and rays are not normal to triangles
        slack = 1e-12 + 4e-15 * away
        np.testing.assert_allclose(hits.distance[mine], distances[order], rtol=0, atol=slack)
    first = raytrace.intersect_mesh(mesh, origins, directions)
    some, where = np.unique(hits.ray, return_index=True)
    np.testing.assert_array_equal(some, np.flatnonzero(first.hit))
    np.testing.assert_array_equal(hits.distance[where], first.distance[first.hit])
    np.testing.assert_array_equal(hits.points[where], first.points[first.hit])
    np.testing.assert_array_equal(hits.triangle[where], first.triangle[first.hit])
    beyond = raytrace.all_hits(mesh, origins, directions, min_distance=1.0)
    assert (beyond.distance == hits.distance[hits.distance >= 1.0]).all()


def test_rays_from_outside_meet_a_closed_mesh_an_even_number_of_times():
    torus = trimesh.creation.torus(1.0, 0.4, major_sections=64, minor_sections=32)
    draw = np.random.default_rng(8)
    origins = draw.normal(size=(100_000, 3))
    origins *= 3 / np.linalg.norm(origins, axis=1, keepdims=True)
    hits = raytrace.all_hits(torus, origins, draw.uniform(-1, 1, origins.shape) - origins)
    times = np.bincount(hits.ray, minlength=len(origins))
    assert not (times % 2).any()
    assert {0, 2, 4} <= set(times)
    assert (np.diff(hits.ray) >= 0).all()
    assert (np.diff(hits.distance)[np.diff(hits.ray) == 0] > 0).all()


def test_edges_and_vertices_that_triangles_share_count_once():
    mesh = trimesh.creation.icosphere(subdivisions=4)
    for where in ("vertices", "edges"):
        origins, targets = rays_at(mesh, where, 100_000, 9, outside=False)
        hits = raytrace.all_hits(mesh, origins, targets - origins)
        np.testing.assert_array_equal(hits.ray, np.arange(len(origins)))
        gap = np.linalg.norm(hits.points - targets, axis=1).max()
        assert gap < 1e-14  # rounding of a metre, some times
    box = trimesh.creation.box((2, 2, 2))
    # through a diagonal of two faces; past an edge, in and out; through a corner
    hits = raytrace.all_hits(box, [[0, 0, 5], [2, 0, 0], [5, 5, 5]],
                             [[0, 0, -1], [-1, 1, 0], [-1, -1, -1]])  # fmt: skip
    np.testing.assert_array_equal(hits.ray, [0, 0, 1, 1, 2, 2])
    np.testing.assert_allclose(
        hits.distance,
        [4, 6, np.sqrt(2), np.sqrt(2), 4 * np.sqrt(3), 6 * np.sqrt(3)],
        rtol=0,
        atol=1e-14,
    )


@pytest.mark.thorough
def test_bits_do_not_depend_on_the_number_of_threads():
    code = (
        "import hashlib, numpy as np, trimesh\n"
        "from nlosoptics import raytrace\n"
        "draw = np.random.default_rng(0)\n"
        "o, d = draw.normal(size=(2, 300_000, 3))\n"
        "hits = raytrace.intersect_mesh(trimesh.creation.icosphere(), o, d)\n"
        "print(hashlib.sha256(hits.points.tobytes() + hits.triangle.tobytes()).hexdigest())"
    )
    prints = {
        subprocess.run(
            [sys.executable, "-c", code],
            env={**os.environ, "NUMBA_NUM_THREADS": threads},
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for threads in ("1", "2")
    }
    assert len(prints) == 1
    assert len(prints.pop().strip()) == 2 * hashlib.sha256().digest_size


@pytest.mark.parametrize(
    ("origins", "directions", "message"),
    [
        ([[0, 0, 1], [0, 0, np.nan]], [[0, 0, 1]] * 2, r"origins\[1\] holds NaN"),
        ([[0, 0, 1]] * 2, [[0, 0, 1], [0, 0, 0]], r"directions\[1\] is zero"),
        ((0, 0, 1), (np.inf, 0, 0), r"directions\[\] holds NaN"),
    ],
)
def test_bad_rays_are_refused(origins, directions, message):
    with pytest.raises(SceneError, match=message):
        raytrace.intersect_mesh(SPHERE, origins, directions)


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
