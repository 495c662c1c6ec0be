"""Mesh walls: the smooth surface fitted to the triangles, and its error."""

import numpy as np
import pytest
import trimesh
from pytest import approx
from scipy.spatial import Delaunay

from nlosoptics.errors import SceneError
from nlosoptics.scene import ConcaveWall, MeshWall, WavyWall


def scattered(wall, n=4000, half=0.5, seed=0):
    """Mesh of a wall with vertices at random places."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-half, half, (n, 2))
    corners = half * np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]])
    xy = np.concatenate([xy, corners])
    faces = Delaunay(xy).simplices
    mesh = trimesh.Trimesh(np.column_stack([xy, wall.height(*xy.T)]), faces, process=False)
    flipped = mesh.face_normals[:, 2] < 0
    faces[flipped] = faces[flipped][:, ::-1]
    return trimesh.Trimesh(mesh.vertices, faces, process=False)


@pytest.mark.parametrize("wall", [ConcaveWall(2.0, size=1.0), WavyWall(1e-4, 0.4, size=1.0)])
def test_residual_bounds_the_true_error_of_the_surface(wall):
    rng = np.random.default_rng(1)
    x, y = rng.uniform(-0.45, 0.45, (2, 500))
    for mesh in (wall.to_mesh(max_sag_error=2e-6), scattered(wall)):
        fitted = MeshWall(mesh)
        error = abs(fitted.height(x, y) - wall.height(x, y)).max()
        # vertices see the misfit at most points, so twice it holds between them
        assert error <= 2 * fitted.fit_residual + 1e-15
        assert fitted.fit_residual < 1e-6


def test_slopes_and_bends_are_those_of_the_sphere():
    wall = ConcaveWall(2.0, size=1.0)
    fitted = MeshWall(wall.to_mesh(max_sag_error=2e-6))
    x, y = np.random.default_rng(2).uniform(-0.4, 0.4, (2, 200))
    exact, found = wall.derivatives(x, y), fitted.derivatives(x, y)
    # cell 4 mm: a bicubic's slope errs by h^3 f''''/12 = 1e-9, its bend by h^2 f''''/12 = 2e-6
    assert found[:, 1:3] == approx(exact[:, 1:3], abs=1e-8)
    assert found[:, 3:] == approx(exact[:, 3:], abs=2e-5)
    assert fitted.max_curvature == approx(0.5, rel=0.25)


def test_surface_is_continuous_with_its_slope():
    fitted = MeshWall(scattered(WavyWall(1e-3, 0.3, size=1.0)))
    term = fitted.compiled()[0][0]
    edge = term[1] + 5 * term[3]  # a border between two patches
    below, above = fitted.derivatives([edge - 1e-12, edge + 1e-12], [0.1, 0.1])
    # 2e-12 m apart: slope times that, and rounding
    assert below[:3] == approx(above[:3], abs=1e-10)


def gridded(wall, n, width):
    """Mesh of a wall on a square grid of n by n vertices, each square cut in two."""
    nodes = np.linspace(-width / 2, width / 2, n)
    x, y = (a.ravel() for a in np.meshgrid(nodes, nodes))
    a = np.arange(n * n).reshape(n, n)
    a, b, c, d = (v.ravel() for v in (a[:-1, :-1], a[:-1, 1:], a[1:, :-1], a[1:, 1:]))
    faces = np.concatenate([np.stack([a, b, d], axis=1), np.stack([a, d, c], axis=1)])
    return trimesh.Trimesh(np.stack([x, y, wall.height(x, y)], axis=1), faces, process=False)


@pytest.mark.thorough
@pytest.mark.parametrize(("n", "error"), [(65, 5.1e-6), (257, 0.32e-6), (1025, 20e-9)])
def test_triangles_of_a_sphere_err_by_the_sag_below_their_chords(n, error):
    radius, width = 2.0, 0.5
    found = MeshWall(gridded(ConcaveWall(radius), n, width)).mesh_error
    pitch = width / (n - 1)
    # a sphere bends more than its paraboloid, by about the mean of r^2 / R^2, 1 %
    assert found == approx(pitch**2 / (6 * radius), rel=0.02)
    assert found == approx(error, rel=0.03)  # two digits


def test_triangles_of_a_cylinder_err_by_half_of_a_spheres():
    """Mean sag of a right triangle of pitch h across a cylinder: h^2 / 12R."""
    found = MeshWall(gridded(ConcaveWall(2.0, shape="cylinder"), 65, 0.5)).mesh_error
    assert found == approx((0.5 / 64) ** 2 / 24, rel=0.03)  # as above, 2 % at the rim


def test_one_rule_says_what_is_wave_grade():
    wall = MeshWall(gridded(ConcaveWall(2.0), 65, 0.5))
    limit = 20 * wall.fit_residual
    assert wall.wave_grade(1.0001 * limit)
    assert not wall.wave_grade(0.9999 * limit)
    with pytest.raises(SceneError, match="wavelength = 0"):
        wall.wave_grade(0.0)


def of_disc(half=0.5, rings=40):
    """Plane mesh of a disc."""
    r, t = np.meshgrid(half * np.arange(1, rings + 1) / rings, np.arange(120) * np.pi / 60)
    xy = np.stack([r * np.cos(t), r * np.sin(t)], axis=-1).reshape(-1, 2)
    return trimesh.Trimesh(np.column_stack([xy, 0 * xy[:, 0]]), Delaunay(xy).simplices)


def with_hole(mesh, radius):
    """Mesh without the triangles within ``radius`` of the point (0.2, 0)."""
    x, y, _ = mesh.triangles_center.T
    mesh.update_faces(np.hypot(x - 0.2, y) > radius)
    mesh.remove_unreferenced_vertices()
    return mesh


def upright():
    """Plane mesh that faces along y, as files of programs do in which y is up."""
    x, y = np.meshgrid(np.linspace(-0.5, 0.5, 9), np.linspace(-0.5, 0.5, 9))
    flat = np.column_stack([x.ravel(), y.ravel()])
    points = np.column_stack([x.ravel(), 6e-17 * y.ravel(), y.ravel()])  # as turned by 90 deg
    return trimesh.Trimesh(points, Delaunay(flat).simplices, process=False)


@pytest.mark.parametrize(
    ("mesh", "message"),
    [
        (of_disc(), "no vertices near x = -0.4.* m, y = -0.4.* m"),
        (with_hole(scattered(WavyWall(1e-4, 0.3, size=1.0)), 0.1), "no vertices near x = 0.[12]"),
        (upright(), "turn the mesh"),
        (trimesh.creation.box((1, 1, 1)), "folds back"),
        (trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]), "must surround"),
        (trimesh.Trimesh([[-1, -1, 0], [1, -1, 0], [0, 1, 0]], [[0, 1, 2]]), "too few"),
    ],
)
def test_meshes_that_are_no_wall(mesh, message):
    with pytest.raises(SceneError, match=message):
        MeshWall(mesh).height(0.0, 0.0)
