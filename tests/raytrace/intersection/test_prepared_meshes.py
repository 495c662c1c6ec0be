"""Prepared meshes are found by their contents alone."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import trimesh

from nlosoptics import raytrace
from nlosoptics.raytrace.intersection.triangles import Facets


def ball(subdivisions=2, radius=0.2):
    return trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)


def through_a_plain_view(mesh):
    np.asarray(mesh.vertices)[:, 2] *= 1.5


def through_a_slice_taken_before(mesh):
    first = mesh.vertices[:1]
    hash(mesh)  # after which trimesh believes that nothing changed
    first += 0.05


def by_a_triangle(mesh):
    np.asarray(mesh.faces)[5] = mesh.faces[6]


@pytest.mark.parametrize(
    "change", [through_a_plain_view, through_a_slice_taken_before, by_a_triangle]
)
def test_a_changed_mesh_is_met_where_it_is(change):
    mesh, aims = ball(), ball().triangles_center
    starts = 2.0 * aims
    raytrace.intersect_mesh(mesh, starts, aims - starts)
    change(mesh)
    found = raytrace.intersect_mesh(mesh, starts, aims - starts)
    copy = trimesh.Trimesh(mesh.vertices.copy(), mesh.faces.copy(), process=False)
    fresh = raytrace.intersect_mesh(copy, starts, aims - starts)
    assert np.array_equal(found.distance, fresh.distance, equal_nan=True)
    before = raytrace.intersect_mesh(ball(), starts, aims - starts)
    assert not np.array_equal(found.distance, before.distance, equal_nan=True)


def test_calls_with_equal_meshes_build_once(monkeypatch):
    numbers, original = [], Facets.__init__

    def counted(self, mesh, *rest, **options):
        numbers.append(len(mesh.faces))
        original(self, mesh, *rest, **options)

    monkeypatch.setattr(Facets, "__init__", counted)
    for _ in range(3):
        raytrace.occluded(ball(2, 0.123), (0.0, 0.0, 1.0), (0.0, 0.0, -1.0))
    assert numbers == [320]


def test_threads_do_not_mix_meshes():
    """Many threads ask for more meshes than are cached."""
    meshes = [ball(1, radius) for radius in np.linspace(0.1, 0.6, 12)]
    origin, up = np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]])
    expected = [float(raytrace.intersect_mesh(m, origin, up).distance[0]) for m in meshes]

    def ask(k):
        return float(raytrace.intersect_mesh(meshes[k % 12], origin, up).distance[0])

    with ThreadPoolExecutor(8) as pool:
        found = list(pool.map(ask, range(240)))
    assert found == [expected[k % 12] for k in range(240)]
    assert len(set(expected)) == 12


def test_without_embree_all_hits_are_searched_in_float64(monkeypatch):
    """As on machines for which there is no wheel."""
    draw = np.random.default_rng(3)
    aims, mesh = draw.normal(size=(500, 3)) * 0.2, ball(4, 0.31)
    starts = draw.normal(size=(500, 3)) + 1.0
    with_embree = raytrace.intersect_mesh(mesh, starts, aims - starts)
    monkeypatch.setattr("nlosoptics.raytrace.intersection.triangles.find_spec", lambda name: None)
    mesh = ball(4, 0.31)
    mesh.faces = np.roll(mesh.faces, 1, axis=0)  # another one for the cache
    without = raytrace.intersect_mesh(mesh, starts, aims - starts)
    assert with_embree.hit.any()
    assert np.array_equal(with_embree.hit, without.hit)
    # the same triangles in float64
    assert np.nanmax(abs(with_embree.distance - without.distance)) < 1e-14
