"""Where pixels look: orientation, mirror geometry, Fermat's principle, and exact averages."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import optimize

from nlosoptics.imaging.geometry import (
    Footprints,
    area_average,
    chief_rays,
    picture_coordinates,
    pixel_centres,
    pixel_edges,
    wall_visibility,
)
from nlosoptics.scene import ConcaveWall, ConvexWall, FlatWall, WavyWall

LETTER_F = np.array(
    [
        [0, 1, 1, 1, 1, 0],
        [0, 1, 0, 0, 0, 0],
        [0, 1, 1, 1, 0, 0],
        [0, 1, 0, 0, 0, 0],
        [0, 1, 0, 0, 0, 0],
        [0, 1, 0, 0, 0, 0],
    ],
    dtype=float,
)


def picture_image(scene):
    corners = chief_rays(scene, *pixel_edges(scene.camera))
    column, row = picture_coordinates(scene.hidden, corners)
    return area_average(scene.hidden.reflectance, column, row)


def hidden_point(hidden, column, row):
    """World point of texel coordinates."""
    rows, columns = hidden.reflectance.shape
    right, up, _ = hidden.axes
    across = (column / columns - 0.5) * hidden.size[0]
    upward = (0.5 - row / rows) * hidden.size[1]
    return np.array(hidden.position) + across * right + upward * up


def pinhole(scene, point):
    """Detector coordinates of a world point seen straight through the lens's centre."""
    x, y, depth = scene.camera.frame @ (point - np.array(scene.camera.position))
    return -scene.image_distance * x / depth, -scene.image_distance * y / depth


def test_letter_is_upright_and_mirror_reversed_with_row_0_on_top(flat_scene):
    """One reflection reverses handedness; the lens's own inversion is undone by drawing row 0 on
    top. So the stem of the F stands on the right and its arms point left."""
    image = picture_image(replace(flat_scene, hidden=replace(flat_scene.hidden, image=LETTER_F)))
    rows, columns = np.nonzero(image > 0.5)
    # perspective cuts the outermost pixels
    letter = image[rows.min() + 1 : rows.max(), columns.min() + 1 : columns.max()] > 0.5
    height, width = letter.shape
    assert letter[:, int(0.9 * width)].all()  # stem
    assert letter[int(0.08 * height)].all()  # top arm
    assert not letter[int(0.9 * height), : int(0.7 * width)].any()  # nothing below the arms
    assert letter[int(0.42 * height), int(0.45 * width) :].all()  # middle arm ...
    assert not letter[int(0.42 * height), : int(0.2 * width)].any()  # ... is the shorter one


def test_flat_wall_is_a_pinhole_view_of_the_mirrored_object(flat_scene):
    hidden = replace(flat_scene.hidden, yaw=0.3, pitch=-0.2, roll=0.1)
    scene = replace(flat_scene, hidden=hidden)
    for column, row in ((0.0, 0.0), (3.2, 30.1), (31.9, 7.0), (16.0, 16.0)):
        mirrored = hidden_point(hidden, column, row) * (1, 1, -1)
        x, y = pinhole(scene, mirrored)
        rays = chief_rays(scene, np.array([x]), np.array([y]))
        back = picture_coordinates(hidden, rays)
        # a picture of 32 texels over some metres of path: rounding
        np.testing.assert_allclose(np.ravel(back), (column, row), rtol=0, atol=1e-11)


@pytest.mark.parametrize(
    "wall",
    [
        ConvexWall(2.0),
        ConcaveWall(3.0),
        ConvexWall(2.0, shape="cylinder"),
        WavyWall(5e-5, 0.1, 0.4, direction=0.5),
    ],
    ids=lambda wall: type(wall).__name__,
)
def test_reflection_point_has_a_stationary_path(flat_scene, wall):
    """Fermat: between lens and object the path by way of the wall is stationary at the hit."""
    scene = replace(flat_scene, wall=wall)
    rays = chief_rays(scene, np.array([-2e-3, 1e-3]), np.array([0.5e-3, -3e-3]))
    column, row = picture_coordinates(scene.hidden, rays)
    lens = np.array(scene.camera.position)
    for index in np.ndindex(column.shape):
        target = hidden_point(scene.hidden, column[index], row[index])

        def slope(xy, target=target):
            h, hx, hy, *_ = wall.derivatives(*xy)
            point = np.array([*xy, h])
            pull = sum((point - end) / np.linalg.norm(point - end) for end in (lens, target))
            return [pull[0] + hx * pull[2], pull[1] + hy * pull[2]]

        start = rays.points[index][:2] + 1e-3
        found = optimize.root(slope, start, tol=1e-15)
        # the root finder stops at rounding of the slopes, 1e-16, over a curvature of some 1/m
        np.testing.assert_allclose(found.x, rays.points[index][:2], rtol=0, atol=1e-11)


def test_chief_rays_pass_the_lens_and_obey_the_mirror_law(flat_scene):
    scene = replace(flat_scene, wall=ConcaveWall(3.0))
    rays = chief_rays(scene, *pixel_centres(scene.camera))
    x, y = pixel_centres(scene.camera)
    local = rays.directions @ scene.camera.frame.T
    d = scene.image_distance
    np.testing.assert_allclose(local[..., 0] / local[..., 2], np.tile(-x / d, (64, 1)), atol=1e-15)
    np.testing.assert_allclose(local[..., 1], -y[:, None] / d * local[..., 2], atol=1e-15)
    np.testing.assert_allclose(rays.cos_axis, local[..., 2], atol=1e-15)
    before, after = ((v * rays.normals).sum(-1) for v in (rays.directions, rays.reflected))
    np.testing.assert_allclose(before, -after, atol=1e-15)
    plane = np.cross(rays.directions, rays.normals)
    np.testing.assert_allclose((plane * rays.reflected).sum(-1), 0, atol=1e-15)


def test_picture_is_seen_from_its_front_only(flat_scene):
    turned = replace(flat_scene, hidden=replace(flat_scene.hidden, yaw=np.pi))
    assert picture_image(flat_scene).max() == pytest.approx(1.0, abs=1e-12)
    assert picture_image(turned).max() == 0.0


# --- area averages


def warped_grid(texels, scale, seed):
    """Corners of slightly irregular footprints, ``scale`` texels wide, past every edge."""
    draw = np.random.default_rng(seed)
    count = int((texels + 4) / scale) + 2
    g, h = np.meshgrid(*[np.arange(count) * scale - 2.0] * 2)
    x = 0.98 * g - 0.15 * h + 0.05 * scale * draw.random(g.shape)
    y = 0.1 * g + h + 0.05 * scale * draw.random(g.shape)
    return x, y


@pytest.mark.parametrize("scale", [0.3, 1.0, 3.7])
@pytest.mark.parametrize("mirrored", [False, True])
def test_area_average_of_a_brute_force_sum(scale, mirrored):
    picture = np.random.default_rng(0).random((6, 6))
    x, y = warped_grid(6, scale, seed=1)
    if mirrored:
        x = 6 - x
    average = area_average(picture, x, y)
    n = 200
    u, v = np.meshgrid(*[(np.arange(n) + 0.5) / n] * 2)
    draw = np.random.default_rng(2)
    for i, j in draw.integers(0, x.shape[0] - 1, (25, 2)):
        corners = [(c[i, j], c[i, j + 1], c[i + 1, j], c[i + 1, j + 1]) for c in (x, y)]
        p, q = (
            (1 - v) * ((1 - u) * c[0] + u * c[1]) + v * ((1 - u) * c[2] + u * c[3]) for c in corners
        )
        pu, qu = ((1 - v) * (c[1] - c[0]) + v * (c[3] - c[2]) for c in corners)
        pv, qv = ((1 - u) * (c[2] - c[0]) + u * (c[3] - c[1]) for c in corners)
        weight = np.abs(pu * qv - pv * qu)
        inside = (p >= 0) & (p < 6) & (q >= 0) & (q < 6)
        values = np.zeros(p.shape)
        values[inside] = picture[q[inside].astype(int), p[inside].astype(int)]
        # the brute force misplaces the texels' borders by up to half of its 1/200
        assert average[i, j] == pytest.approx((values * weight).sum() / weight.sum(), abs=2e-3)


def test_footprints_without_area_see_the_texel_at_their_centre():
    picture = np.random.default_rng(3).random((4, 6))
    # edge-on footprints of 1.1 texels, one row of them inside the picture and one beside it
    x, y = np.meshgrid(0.1 + 1.1 * np.arange(6), [2.3, 2.3, 2.3 + 1e3, 2.3 + 1e3])
    average = area_average(picture, x, y)
    centres = (0.1 + 1.1 * (np.arange(5) + 0.5)).astype(int)
    np.testing.assert_array_equal(average[0], picture[2, centres])
    np.testing.assert_array_equal(average[2], 0.0)


@pytest.mark.parametrize("scale", [0.2, 1.3, 5.0])
def test_area_average_keeps_all_light(scale):
    picture = np.random.default_rng(3).random((9, 9))
    x, y = warped_grid(9, scale, seed=4)
    # extend to cover the picture wholly
    assert x.min() < -1
    average = area_average(picture, x, y)
    area = 0.5 * np.abs(
        (x[1:, 1:] - x[:-1, :-1]) * (y[1:, :-1] - y[:-1, 1:])
        - (x[1:, :-1] - x[:-1, 1:]) * (y[1:, 1:] - y[:-1, :-1])
    )
    # every texel is covered once: rounding only
    assert (average * area).sum() == pytest.approx(picture.sum(), rel=1e-12)


def test_folded_and_undefined_footprints():
    picture = np.ones((4, 4))
    column = np.array([[1.0, 2.0, np.nan], [2.0, 1.0, 3.0]])
    row = np.array([[1.0, 1.0, 1.0], [2.0, 2.0, 2.0]])
    assert area_average(picture, column, row).tolist() == [[1.0, 0.0]]


# --- edges of the wall


def test_wall_edge_fades_like_the_footprint_of_the_lens(flat_scene):
    """Against rays through a dense grid over the lens, toward the point in focus."""
    scene = replace(flat_scene, wall=FlatWall(size=(0.16, 0.5)))
    camera = scene.camera
    x, y = pixel_centres(camera)
    rays = chief_rays(scene, x, y)
    visible = wall_visibility(scene, rays)
    partial = (visible > 0.02) & (visible < 0.98) & (abs(rays.points[..., 1]) < 0.2)
    assert partial.sum() > 20
    steps = (np.arange(400) + 0.5) / 200 - 1
    u, v = np.meshgrid(steps, steps)
    inside = u**2 + v**2 < 1
    lens = np.array(camera.position) + camera.stop_diameter / 2 * (
        u[inside][:, None] * camera.frame[0] + v[inside][:, None] * camera.frame[1]
    )
    for i, j in np.argwhere(partial)[::7]:
        along = scene.focus_distance / rays.cos_axis[i, j]
        focus = np.array(camera.position) + along * rays.directions[i, j]
        part = lens[:, 2] / (lens[:, 2] - focus[2])
        wall_x = lens[:, 0] + part * (focus[0] - lens[:, 0])
        share = (abs(wall_x) < 0.08).mean()
        # grid of 400 over the lens, and the footprint taken as affine: (stop/distance)^2
        assert visible[i, j] == pytest.approx(share, abs=3e-3)


def test_adjoint_of_footprints_is_their_transpose():
    random = np.random.default_rng(0)
    row, column = np.meshgrid(np.linspace(-3, 12, 9), np.linspace(2, 17, 8), indexing="ij")
    bent = (column + random.uniform(-0.6, 0.6, row.shape), row + 0.3 * column)
    bent[0][3, 3] += 5.0  # folds its footprints
    bent[1][0, 0] = np.nan
    footprints = Footprints((10, 14), *bent)
    picture, values = random.random((10, 14)), random.standard_normal((8, 7))
    left = np.vdot(footprints.average(picture), values)
    assert np.vdot(picture, footprints.adjoint(values)) == pytest.approx(left, rel=1e-12)
