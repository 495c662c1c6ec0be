"""What part of each triangle a point sees, against a line of sight for every point of a grid."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from nlosoptics.scene import Lambert
from nlosoptics.transient.rendering import _visibility_kernels as kernels
from nlosoptics.transient.rendering.surfaces import hidden_surfaces, neighbours, occluders

POINTS = ((0.0, 0.0, 0.0), (1.1, -0.7, 0.0))  # one where the things below are in line
GRID = 50


def plate(width: float, z: float, x: float = 0.0) -> trimesh.Trimesh:
    half = 0.5 * width
    corners = [(-half, -half, 0), (half, -half, 0), (half, half, 0), (-half, half, 0)]
    return trimesh.Trimesh(np.add(corners, (x, 0.0, z)), [[0, 2, 1], [0, 3, 2]], process=False)


def box(*extents: float, at: tuple[float, float, float]) -> trimesh.Trimesh:
    made = trimesh.creation.box(extents)
    made.apply_translation(at)
    return made


def ball() -> trimesh.Trimesh:
    made = trimesh.creation.icosphere(subdivisions=1, radius=0.25)
    made.apply_translation((0.1, 0.05, 0.9))
    return made


def seen(mesh: trimesh.Trimesh) -> tuple[np.ndarray, np.ndarray]:
    """Share of each triangle that each point sees, (points, triangles), and polygons of it."""
    world, names = occluders(hidden_surfaces([(mesh, Lambert(0.5))]))
    room = kernels.shadow_room()
    polygons = np.empty((kernels.PIECES, 2 * kernels.CORNERS))
    sizes = np.empty(kernels.PIECES, dtype=np.int64)
    shares = np.zeros((len(POINTS), len(names)))
    counts = np.zeros((len(POINTS), len(names)), dtype=np.int64)
    for number, point in enumerate(np.array(POINTS)):
        outlined = kernels.outline(world, point, kernels.outline_room(world))
        for t, name in enumerate(names):
            polygons[0, :6], sizes[0] = (0, 0, 1, 0, 0, 1), 3
            count = kernels.see(world, t, point, outlined, polygons, sizes, 1, room)
            corners = (polygons[m, : 2 * sizes[m]].reshape(-1, 2) for m in range(count))
            shares[number, name] = sum(area(part) for part in corners)
            counts[number, name] = count
    return shares, counts


def seen_by_lines(mesh: trimesh.Trimesh) -> np.ndarray:
    """The same shares by a line of sight for every point of a grid."""
    i, j = np.indices((GRID, GRID))
    u, v = ((part[i + j < GRID, None] + 1 / 3) / GRID for part in (i, j))
    shares = np.empty((len(POINTS), len(mesh.faces)))
    for number, point in enumerate(np.array(POINTS)):
        for t, (o, a, b) in enumerate(mesh.triangles):
            ends = o + u * (a - o) + v * (b - o)
            shares[number, t] = 1.0 - blocked(mesh, t, point, ends).mean()
    return shares


def area(corners: np.ndarray) -> float:
    """Of a polygon, over that of the triangle."""
    x, y = corners.T
    return float(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1)))


def blocked(mesh, t, point, ends) -> np.ndarray:
    """Whether a triangle stands between a point and each of ``ends``: a determinant for each."""
    a, b, c = np.moveaxis(mesh.triangles, 1, 0)[:, :, None]
    d = (ends - point)[None]
    across = np.cross(d, c - a)
    det = (across * (b - a)).sum(-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        u = (across * (point - a)).sum(-1) / det
        turned = np.cross(point - a, b - a)
        v = (turned * d).sum(-1) / det
        along = (turned * (c - a)).sum(-1) / det
        hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (along > 1e-9) & (along < 1 - 1e-9)
    hit[t] = False
    return hit.any(axis=0)


THINGS = {
    "ball before a plate": (ball(), plate(1.6, 1.6)),
    "plates through each other": (
        plate(1.0, 1.2),
        plate(0.8, 1.1).apply_transform(
            trimesh.transformations.rotation_matrix(0.9, (0.2, 1.0, 0.1), (0.1, 0.0, 1.2))
        ),
    ),
    "box that stands on a plate": (plate(1.2, 1.4), box(0.3, 0.3, 0.4, at=(0.1, 0.0, 1.2))),
    "box that is sunk into a plate": (plate(1.2, 1.4), box(0.3, 0.3, 0.6, at=(0.1, 0.0, 1.4))),
    "box of a level with a plate": (plate(1.2, 1.0), box(0.3, 0.3, 0.4, at=(0.8, 0.0, 1.2))),
    "beam over boxes": (
        box(1.4, 0.1, 0.1, at=(0.0, 0.0, 0.7)),
        box(0.4, 0.4, 0.2, at=(-0.3, 0.0, 1.1)),
        box(0.4, 0.4, 0.2, at=(0.3, 0.1, 1.3)),
    ),
    "dent": (
        trimesh.Trimesh(
            [(-0.4, 0, 0.8), (0, -0.4, 0.8), (0.4, 0, 0.8), (0, 0.4, 0.8), (0.05, 0, 1.5)],
            [[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]],
            process=False,
        ),
    ),
}


@pytest.mark.thorough
@pytest.mark.parametrize("name", THINGS)
def test_areas_are_those_of_lines_of_sight(name):
    mesh = trimesh.util.concatenate(THINGS[name])
    found, true = seen(mesh)[0], seen_by_lines(mesh)
    # a straight edge across a triangle is known to a part of the grid's pitch
    assert np.abs(found - true).max() < 0.02
    assert ((true > 0.05) & (true < 0.95)).any()  # so that shadows matter


@pytest.mark.parametrize("name", THINGS)
def test_triangles_may_go_around_either_way_and_be_apart(name):
    """Outlines are found where neighbours disagree on their side, and where there are none."""
    mesh = trimesh.util.concatenate(THINGS[name])
    plain, _ = seen(mesh)
    faces = mesh.faces.copy()
    faces[::3] = faces[::3, ::-1]
    flipped, _ = seen(trimesh.Trimesh(mesh.vertices, faces, process=False))
    # rounding of other corners first
    np.testing.assert_allclose(flipped, plain, atol=1e-9)
    apart = mesh.triangles.reshape(-1, 3)
    apart = apart * (1.0 + 1e-10 * np.random.default_rng(0).normal(size=apart.shape))
    torn = trimesh.Trimesh(apart, np.arange(len(apart)).reshape(-1, 3), process=False)
    # cracks of 1e-10, and rays through them: none here
    np.testing.assert_allclose(seen(torn)[0], plain, atol=1e-6)


def test_what_hides_nothing_leaves_no_cut():
    """A convex body cuts nothing of itself: each side is seen whole or not at all."""
    found, counts = seen(ball())
    assert set(np.unique(counts)) == {0, 1}
    assert set(np.unique(found)) == {0.0, 1.0}


def test_neighbours_share_a_side():
    mesh = ball()
    beyond = neighbours(mesh.triangles)
    assert (beyond >= 0).all()  # closed, and each goes around as it should
    pairs = {frozenset((t, mate)) for t, mates in enumerate(beyond) for mate in mates}
    assert pairs == set(map(frozenset, mesh.face_adjacency.tolist()))
    corners = plate(1.0, 1.0).triangles.copy()
    corners[1] = corners[1, ::-1]
    kinds = neighbours(corners)
    assert sorted(kinds.ravel()) == [kernels.FLIPPED - 1, kernels.FLIPPED, *[kernels.ALONE] * 4]
    # three at one side: nobody's neighbours
    fan = np.array([[(0, 0, 1), (0, 1, 1), (x, 0, 1 + x)] for x in (-1.0, 0.5, 1.0)])
    assert (neighbours(fan) == kernels.ALONE).all()
