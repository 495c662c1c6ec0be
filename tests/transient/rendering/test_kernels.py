"""Kernels of shadows and of three bounces, each alone, on record.

The kernels are plain Python here, see `plain_kernels`. The triangles are at random places, some
share sides, and some cross each other.
"""

from __future__ import annotations

import numpy as np

from nlosoptics.transient.rendering.surfaces import neighbours

from ...plain_kernels import plain

shadows = plain("transient.rendering._visibility_kernels")
bounces = plain("transient.rendering._three_bounce_kernels")


def hidden():
    """Corners (12, 3, 3) of a closed tetrahedron, a sheet of three, and triangles across them."""
    draw = np.random.default_rng(11)
    a, b, c, d = draw.uniform(-0.4, 0.4, (4, 3)) * [1, 1, 0.5] + [0.1, 0.0, 0.9]
    e, f, g = draw.uniform(-0.6, 0.6, (3, 3)) * [1, 1, 0.3] + [-0.1, 0.1, 0.6]
    solid = [[a, b, c], [a, d, b], [b, d, c], [c, d, a]]
    sheet = [[e, f, g], [f, e, d], [g, e, a]]  # the last is oriented the other way
    others = draw.uniform(-0.5, 0.5, (5, 3, 3)) * [1, 1, 0.4] + [0.0, 0.0, 0.8]
    return np.array([*solid, *sheet, *others])


def scene():
    """Data of the triangles as `surfaces.occluders` gives them, and which sides are clear."""
    corners = hidden()
    o, sides = corners[:, 0], corners[:, 1:] - corners[:, :1]
    rows = np.hstack([o, sides[:, 0], sides[:, 1]])
    parts = [corners[i : i + 4].reshape(-1, 3) for i in range(0, 12, 4)]
    parts.append(np.array([[0.7, 0.7, 0.7], [0.71, 0.72, 0.73]]))  # a leaf without a triangle
    nodes = [np.concatenate(parts), np.concatenate(parts[:2]), np.concatenate(parts[2:]), *parts]
    boxes = np.array([[*one.min(axis=0), *one.max(axis=0)] for one in nodes])
    reach = float(np.abs(corners).max())
    ends, cuts = np.zeros(13, dtype=np.int64), np.empty((0, 4))
    shadows.crossings(rows, boxes, reach, ends, cuts)
    ends = np.cumsum(ends)
    cuts = np.zeros((ends[-1], 4))
    shadows.crossings(rows, boxes, reach, ends, cuts)
    mesh = rows, boxes, reach, neighbours(corners), ends, cuts
    return mesh, shadows.clear_sides(rows, reach)


def test_sides_are_clear_up_to_rounding():
    """Above and below a triangle's plane: by the heights of all corners, a little apart from 0."""
    apart = shadows.ROUNDING * 2.5
    flat = np.array([[0.3, -0.2, 0.9], [1.1, 0.1, 0.9], [0.4, 0.7, 0.9]])  # normal +z
    for shift, wanted in (
        (0.0, [True, True]),
        (0.9 * apart, [True, True]),
        (-0.9 * apart, [True, True]),
        (1.1 * apart, [False, True]),
        (-1.1 * apart, [True, False]),
    ):
        other = flat[[0, 2, 1]] + [0.9, 0.0, 0.0]  # normal -z, at another height
        other[1, 2] += shift
        rows = np.array([[*c[0], *(c[1] - c[0]), *(c[2] - c[0])] for c in (flat, other)])
        assert shadows.clear_sides(rows, 2.5)[0].tolist() == wanted, shift
        assert shadows.clear_sides(rows[:1], 2.5).tolist() == [[True, True]]
    draw = np.random.default_rng(6)
    corners = draw.uniform(-0.3, 0.3, (7, 3, 3)) + draw.uniform(-1.0, 1.0, (7, 1, 3))
    rows = np.concatenate([corners[:, 0], corners[:, 1] - corners[:, 0]], axis=1)
    rows = np.concatenate([rows, corners[:, 2] - corners[:, 0]], axis=1)
    for count in (2, 3, 7):
        across = np.cross(rows[:count, 3:6], rows[:count, 6:])
        lines = corners[None, :count] - corners[:count, None, :1]
        heights = np.einsum("tk,tmck->tmc", across, lines)
        wanted = np.stack([heights.max(axis=(1, 2)) < 1e-9, heights.min(axis=(1, 2)) > -1e-9], -1)
        assert np.array_equal(shadows.clear_sides(rows[:count], 1.0), wanted)
        assert count == 7 or wanted.any()
