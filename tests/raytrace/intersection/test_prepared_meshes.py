"""Prepared meshes are found by their contents alone, and only so many of them are kept."""

from __future__ import annotations

import pickle
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from nlosoptics.raytrace.intersection.kept_meshes import kept_mesh

from nlosoptics import Scene, raytrace
from nlosoptics.raytrace.intersection import kept_meshes
from nlosoptics.raytrace.intersection.triangles import Facets, _Room
from nlosoptics.scene import Camera, FlatWall, Lambert, Laser, MeshObject, Occluder


@pytest.fixture(autouse=True)
def nothing_kept(monkeypatch):
    monkeypatch.setattr(kept_meshes, "_kept", [])


@pytest.fixture
def built(monkeypatch):
    """Numbers of triangles of the search structures that are built."""
    numbers, original = [], Facets._scene
    monkeypatch.setattr(
        Facets,
        "_scene",
        lambda self, corners: numbers.append(len(corners)) or original(self, corners),
    )
    return numbers


def ball(subdivisions=2, radius=0.2):
    return trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)


def screen():
    return trimesh.creation.box((0.2, 0.4, 0.01))


def room(mesh, occluders=()):
    return Scene(
        Laser(
            wavelength=633e-9,
            power=1.0,
            beam_diameter=0.003,
            position=(-0.1, 0.5, 1.0),
            aim=(0.1, 0.1, 0.0),
        ),
        FlatWall(size=2.0),
        MeshObject(mesh=mesh, position=(0.4, 0.0, 0.8)),
        Camera(
            position=(-0.4, 0.0, 0.8),
            aim=(0.0, 0.0, 0.0),
            focal_length=0.05,
            stop_diameter=0.02,
            focus_distance=1.0,
        ),
        wall_material=Lambert(0.7),
        occluders=occluders,
    )


def flux(scene):
    return raytrace.trace(scene, n_rays=512, max_bounces=3, seed=1).flux


def through_a_plain_view(mesh):
    np.asarray(mesh.vertices)[:, 2] *= 1.5


def through_a_slice_taken_before(mesh):
    first = mesh.vertices[:1]
    hash(mesh)  # after which trimesh believes that nothing changed
    first += 0.05


def by_one_rounding(mesh):
    np.asarray(mesh.vertices)[7, 1] = np.nextafter(mesh.vertices[7, 1], 2.0)


def by_a_triangle(mesh):
    np.asarray(mesh.faces)[5] = mesh.faces[6]


def by_assigning(mesh):
    mesh.vertices = mesh.vertices * 1.2


@pytest.mark.parametrize(
    "change",
    [
        through_a_plain_view,
        through_a_slice_taken_before,
        by_one_rounding,
        by_a_triangle,
        by_assigning,
    ],
)
def test_a_changed_mesh_never_meets_the_old_structures(change):
    mesh = ball()
    hash(mesh)
    old = kept_mesh(mesh)
    assert kept_mesh(mesh) is old
    change(mesh)
    new = kept_mesh(mesh)
    assert new is not old
    fresh = Facets(mesh)
    np.testing.assert_array_equal(new.facets.rows, fresh.rows)
    np.testing.assert_array_equal(new.facets.names, fresh.names)
    found = {tuple(row) for row in new.chart.triangles[:, :3].tolist()}
    assert found == {tuple(row) for row in mesh.vertices[mesh.faces[:, 0]].tolist()}


@pytest.mark.parametrize("which", ["hidden", "occluder"])
def test_a_trace_sees_a_mesh_that_was_changed_in_place(which):
    """The flux is that of a scene built from the changed mesh, and not the former one."""
    scene = room(ball(), (Occluder(screen(), position=(0.2, 0.0, 0.4)),))
    before = flux(scene)
    mesh = scene.hidden.surface if which == "hidden" else scene.occluding_mesh
    np.asarray(mesh.vertices)[:] += (0.1, 0.05, 0.1)
    after = flux(scene)
    kept_meshes._kept.clear()
    assert after == flux(scene)
    assert after != before


def test_mesh_changed_while_it_is_prepared_does_not_spoil_the_entry():
    mesh = ball()
    kept = kept_mesh(mesh)
    mesh.vertices *= 2.0  # before anything was built from the copies
    assert kept.reach == pytest.approx(0.2, rel=1e-12)
    assert kept.chart.area == pytest.approx(mesh.area / 4, rel=1e-12)
    assert kept.facets.reach == pytest.approx(0.2, rel=1e-12)


def test_calls_with_equal_meshes_build_once(built):
    scene = room(ball())
    first = flux(scene)
    assert built == [320]
    moved = replace(scene, camera=replace(scene.camera, stop_diameter=0.03))
    assert flux(moved) != first
    assert flux(pickle.loads(pickle.dumps(scene))) == first
    assert flux(room(ball())) == first
    assert built == [320]


def test_hidden_and_occluding_triangles_are_joined_once(built):
    scene = room(ball(), (screen().apply_translation((0.2, 0.0, 0.4)),))
    first = flux(scene)
    assert built == [332]
    assert flux(pickle.loads(pickle.dumps(scene))) == first
    assert flux(replace(scene, wall_material=Lambert(0.6))) != first
    assert built == [332]
    assert flux(replace(scene, occluders=())) != first  # the order of parts tells them apart
    assert built == [332, 320]


def test_scenes_pickle_without_what_is_kept():
    scene = room(ball(4))
    size = len(pickle.dumps(scene))
    flux(scene)
    assert len(pickle.dumps(scene)) == size


def test_kept_triangles_are_bounded(monkeypatch):
    monkeypatch.setattr(kept_meshes, "MOST_TRIANGLES", 700)
    meshes = [ball(2, radius) for radius in (0.1, 0.2, 0.3, 0.4)]
    first, second, third = (kept_mesh(mesh) for mesh in meshes[:3])
    assert kept_meshes._kept == [first, second, third]
    assert kept_mesh(meshes[0]) is first  # and is the latest now
    kept_mesh(meshes[3])
    assert second not in kept_meshes._kept
    assert kept_mesh(meshes[0]) is first
    large = kept_mesh(ball(4))
    assert large in kept_meshes._kept  # the latest is kept whatever its size
    kept_mesh(meshes[0])
    assert large not in kept_meshes._kept


def test_number_of_kept_meshes_is_bounded():
    for k in range(kept_meshes.MOST_MESHES + 5):
        kept_mesh(ball(0, 0.1 + 0.01 * k))
    assert len(kept_meshes._kept) == kept_meshes.MOST_MESHES


def test_threads_share_and_evict_without_mixing_meshes(monkeypatch):
    """Many threads ask for few meshes, of which not all can be kept."""
    monkeypatch.setattr(kept_meshes, "MOST_MESHES", 3)
    radii = np.linspace(0.1, 0.6, 6)
    meshes = [ball(1, radius) for radius in radii]
    origin, up = np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]])
    expected = [float(raytrace.intersect_mesh(m, origin, up).distance[0]) for m in meshes]

    def ask(k):
        return float(raytrace.intersect_mesh(meshes[k % 6], origin, up).distance[0])

    with ThreadPoolExecutor(8) as pool:
        found = list(pool.map(ask, range(600)))
    assert found == [expected[k % 6] for k in range(600)]
    assert len(set(expected)) == 6
    assert len(kept_meshes._kept) == 3


def test_room_of_rays_begins_at_cache_lines_and_grows_only():
    room = _Room()
    starts = []
    for count in (5, 1000, 100_000, 7, 1000):
        rays, cells, ordered = room.arrays(count)
        assert (rays.shape, cells.shape, ordered.shape) == ((count, 8), (count,), (count, 8))
        assert rays.ctypes.data % 64 == ordered.ctypes.data % 64 == 0
        rays[:], ordered[:] = 1.0, 2.0
        assert (rays == 1.0).all()  # apart from each other
        starts.append(rays.ctypes.data)
    assert starts[2] == starts[3] == starts[4]
