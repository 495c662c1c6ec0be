"""Shadow geometry piece by piece: areas, cuts of polygons, projections and regions of a segment."""

from __future__ import annotations

import numpy as np
import pytest
from pytest import approx

from nlosoptics.transient.rendering import _visibility_kernels as kernels

ROW = np.array([0.3, -0.2, 0.9, 0.7, 0.1, 0.2, -0.1, 0.8, -0.3])  # a corner and two sides
POINT = np.array([0.1, 0.4, -0.3])


def polygon(count: int, seed: int) -> np.ndarray:
    """A convex polygon, counter-clockwise, away from the origin."""
    turn = np.sort(np.random.default_rng(seed).uniform(0, 2 * np.pi, count))
    return np.column_stack([0.8 + 0.3 * np.cos(turn), -0.5 + 0.2 * np.sin(turn)])


def twice_area(corners: np.ndarray) -> float:
    x, y = corners.T
    return float(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1)))


def flat(corners: np.ndarray) -> np.ndarray:
    cell = np.zeros(2 * kernels.CORNERS)
    cell[: corners.size] = corners.ravel()
    return cell


@pytest.mark.parametrize("count", [3, 4, 9])
def test_area_is_that_of_the_shoelace_formula(count: int) -> None:
    corners = polygon(count, seed=count)
    assert kernels._area(corners, count) == approx(twice_area(corners), rel=1e-12)


def test_frame_gives_normal_and_coordinates() -> None:
    a, b = ROW[3:6], ROW[6:]
    n, to_u, to_v = kernels.frame(ROW)
    assert n == approx(np.cross(a, b))
    assert (np.dot(to_u, a), np.dot(to_u, b), np.dot(to_u, n)) == approx((1, 0, 0), abs=1e-15)
    assert (np.dot(to_v, a), np.dot(to_v, b), np.dot(to_v, n)) == approx((0, 1, 0), abs=1e-15)


def test_equal_corners_in_a_row_are_one() -> None:
    corners = np.array([[0, 0], [0, 0], [1, 0], [1, 1], [1, 1 + 1e-14], [0, 1e-14]], dtype=float)
    assert kernels._distinct(corners, 6) == 3
    assert corners[:3] == approx(np.array([[0, 0], [1, 0], [1, 1]]), abs=1e-13)
    apart = np.array([[0, 0], [1, 0], [0, 1], [-0.5, 0.5]], dtype=float)
    assert kernels._distinct(apart.copy(), 4) == 4


@pytest.mark.parametrize("seed", range(6))
def test_a_line_parts_a_polygon_into_both_sides(seed: int) -> None:
    corners = polygon(7, seed)
    middle = corners.mean(axis=0)
    draw = np.random.default_rng(seed)
    away = draw.normal(size=2)
    line = np.array([*(middle - away), *(middle + away)])
    cells, sizes = np.zeros((8, 2 * kernels.CORNERS)), np.zeros(8, dtype=np.int64)
    cells[0], sizes[0] = flat(corners), 7
    sides = (np.empty((2 * kernels.CORNERS, 2)), np.empty((2 * kernels.CORNERS, 2)))
    assert kernels._cut(cells, sizes, 1, line, sides) == 2
    parts = [cells[k, : 2 * sizes[k]].reshape(-1, 2) for k in range(2)]
    areas = [twice_area(part) for part in parts]
    assert min(areas) > 0
    assert sum(areas) == approx(twice_area(corners), rel=1e-12)
    for part, sign in zip(parts, (1, -1), strict=True):
        side = away[0] * (part[:, 1] - middle[1]) - away[1] * (part[:, 0] - middle[0])
        assert (sign * side >= -1e-12).all()
    # a segment beside the polygon, or one that only reaches its edge, parts nothing
    for line in (
        np.array([*(middle + 5.0), *(middle + 6.0)]),
        np.array([*(2 * corners[0] - middle), *corners[0]]),
    ):
        assert kernels._cut(cells, sizes, 2, line, sides) == 2


def test_no_polygon_has_more_corners_than_fit() -> None:
    count = kernels.CORNERS + 1
    corners = polygon(count, seed=1)
    cells, sizes = np.zeros((3, 2 * kernels.CORNERS)), np.zeros(3, dtype=np.int64)
    assert kernels._put(cells, sizes, 0, 1, corners, count) == 2
    assert sizes[:2].tolist() == [kernels.CORNERS, 3]
    parts = [cells[k, : 2 * sizes[k]].reshape(-1, 2) for k in range(2)]
    assert sum(map(twice_area, parts)) == approx(twice_area(corners), rel=1e-12)
    assert min(map(twice_area, parts)) > 0
    assert kernels._put(cells, sizes, 2, 2, corners, 5) == 3
    assert kernels._put(cells, sizes, 0, 2, corners, 5) == 2
    assert kernels._put(cells, sizes, 2, 2, corners, count) == kernels.OVERFLOW
    assert kernels._put(cells, sizes, 3, 3, corners, 5) == kernels.OVERFLOW


@pytest.mark.parametrize(
    ("line", "enters"),
    [
        ((-0.5, 0.3, 1.5, 0.3), True),
        ((0.2, 0.2, 0.3, 0.4), True),
        ((0.1, -0.5, 0.1, 0.2), True),
        ((0.9, 0.9, 0.1, 0.1), True),
        ((-0.5, 0.3, -0.1, 0.3), False),
        ((0.2, -0.1, 0.8, -0.2), False),
        ((0.8, 0.4, 0.4, 0.9), False),
        ((-0.3, 0.2, 0.2, -0.3), False),
        ((0.0, 0.0, 1.0, 0.0), False),  # along a side
        ((-1.0, 1.0, 0.0, 0.0), False),  # up to a corner
    ],
)
def test_a_segment_enters_the_triangle_or_passes_it(line: tuple, enters: bool) -> None:
    assert kernels._enters(np.array(line)) == enters


def regions(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    planes = np.empty((4, 4))
    assert kernels._sector(tuple(POINT), tuple(a), tuple(b), planes)
    return planes


def test_a_segment_hides_what_is_behind_it() -> None:
    """Points of the plane through point and segment are inside if their ray meets the segment."""
    draw = np.random.default_rng(2)
    for _ in range(20):
        a, b = draw.normal(size=(2, 3))
        planes = regions(a, b)
        assert np.linalg.norm(planes[:, :3], axis=1) == approx(np.ones(4))
        s, t = draw.uniform(-0.5, 1.5), draw.uniform(0.2, 2.0)
        x = POINT + t * (a + s * (b - a) - POINT)
        heights = planes[:, :3] @ x - planes[:, 3]
        assert heights[0] == approx(0.0, abs=1e-12)
        assert (heights[1:] > 0).all() == (0 < s < 1 and t > 1)
    a = np.array([0.7, 0.1, 0.4])
    assert not kernels._sector(tuple(POINT), tuple(a), tuple(a), np.empty((4, 4)))


def test_boxes_and_triangles_outside_the_region_are_left_out() -> None:
    """None that holds a hidden point is left out; most of those far from the plane are."""
    draw = np.random.default_rng(3)
    out = {"triangle": 0, "box": 0}
    for _ in range(300):
        a, b = draw.normal(size=(2, 3))
        planes = regions(a, b)
        corners = draw.normal(size=3) + draw.normal(0, 0.5, (3, 3))
        row = np.concatenate([corners[0], corners[1] - corners[0], corners[2] - corners[0]])
        box = np.concatenate([corners.min(axis=0), corners.max(axis=0)])
        ends = planes[:, :3] @ corners.T - planes[:, 3:]
        beside = bool((ends.max(axis=1) < 0).any() or ends[0].min() > 0)
        assert kernels._aside(row, planes, 1e-12) == beside
        cube = np.array(np.meshgrid(*zip(box[:3], box[3:], strict=True))).reshape(3, -1)
        ends = planes[:, :3] @ cube - planes[:, 3:]
        beside_box = bool((ends.max(axis=1) < 0).any() or ends[0].min() > 0)
        assert kernels._box_outside(box, planes, 1e-12) == beside_box
        out["triangle"] += beside
        out["box"] += beside_box
    assert 50 < out["box"] < out["triangle"] < 280


def test_shadows_are_central_projections() -> None:
    """Of segments between the plane and the point, whole or cut at the plane."""
    o, a_side, b_side = ROW.reshape(3, 3)
    normal = np.cross(a_side, b_side)
    draw = np.random.default_rng(4)
    kinds = {"whole": 0, "cut": 0, "none": 0}
    for _ in range(200):
        ends = POINT + draw.uniform(0.2, 2.0, (2, 1)) * (
            o + draw.uniform(0, 1, (2, 2)) @ np.array([a_side, b_side]) - POINT
        )
        side = (ends - o) @ normal / ((POINT - o) @ normal)
        line = np.empty(4)
        cast = kernels._cast(tuple(ends[0]), tuple(ends[1]), ROW, POINT, 1e-12, line)
        if (side <= 0).all():
            kinds["none"] += 1
            assert not cast
            continue
        assert cast
        kinds["cut" if (side < 0).any() else "whole"] += 1
        for k in range(2):
            # an end behind the plane is moved along the segment into the plane
            share = side[k] / (side[k] - side[1 - k]) if side[k] < 0 else 0.0
            x = ends[k] + share * (ends[1 - k] - ends[k])
            height = (x - o) @ normal / ((POINT - o) @ normal)
            x = POINT + (x - POINT) / (1 - height)
            found = o + line[2 * k] * a_side + line[2 * k + 1] * b_side
            assert found == approx(x, abs=1e-10)
    assert min(kinds.values()) > 20
    # beyond the point, seen from the plane, a segment casts no shadow
    beyond = POINT + 0.5 * (POINT - o), POINT + 0.7 * (POINT - o - a_side)
    assert not kernels._cast(tuple(beyond[0]), tuple(beyond[1]), ROW, POINT, 1e-12, np.empty(4))
