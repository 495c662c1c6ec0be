"""Kernels of shadows and of three bounces, each alone, on record.

The kernels are plain Python here, see `plain_kernels`. The triangles are at random places, some
share sides, and some cross each other.
"""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from nlosoptics.scene import Lambert, OrenNayar, SpecularMicrofacet, SumMaterial
from nlosoptics.transient.rendering.surfaces import neighbours

from ...plain_kernels import TIGHT, plain

shadows = plain("transient.rendering._visibility_kernels")
bounces = plain("transient.rendering._three_bounce_kernels")
POINTS = np.array([[-0.3, 0.2, 0.0], [0.4, -0.1, 0.0], [0.05, 0.6, 0.0]])
START, DELTA = 1.3, 0.17
ABOVE = np.array([0.0, 0.0, 0.6])


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


MESH, CLEAR = scene()
ROWS = MESH[0]


def chains(outlined):
    """The lines of each triangle, in their order."""
    heads, links, lines, (faces, _) = outlined
    found = []
    for head in heads:
        chain = []
        while head >= 0:
            chain.append(lines[head].copy())
            head = links[head]
        found.append(np.array(chain).reshape(-1, 4))
    return [faces, *found]


def test_crossings_and_outlines(on_record):
    found = [MESH[3:], CLEAR, [shadows.frame(row) for row in ROWS]]
    small = np.empty(12, np.int64), np.empty(2, np.int64), np.empty((2, 4))
    work = np.empty(12, bool), np.empty((4, 4))
    for p in [*POINTS, np.array([0.1, 0.05, 0.85])]:
        found.append(chains(shadows.outline(MESH, p, shadows.outline_room(MESH))))
        found.append(chains(shadows.outline(MESH, p, (*small, work))))
    on_record(found, TIGHT)


def test_regions_and_shadows_of_segments(on_record):
    draw = np.random.default_rng(3)
    found, ends = [], []
    planes, line = np.zeros((4, 4)), np.zeros(4)
    for _ in range(25):
        p, a, b = draw.uniform(-0.5, 0.5, (3, 3)) + ABOVE
        found.append([shadows._sector(tuple(p), tuple(a), tuple(b), planes), planes.copy()])
        boxes = draw.uniform(-0.6, 0.6, (60, 2, 3)) + ABOVE
        boxes = np.sort(boxes, axis=1).reshape(60, 6)
        boxes[::2, 3:] = boxes[::2, :3] + 0.2
        outside = [shadows._box_outside(box, planes, slack) for box in boxes for slack in (0, 0.1)]
        aside = [shadows._aside(row, planes, slack) for row in ROWS for slack in (0, 0.1)]
        apart = [
            shadows._apart(row, box, slack) for row in ROWS for box in boxes for slack in (0, 0.1)
        ]
        found.append([np.array(outside), np.array(aside), np.array(apart)])
        casts = []
        for row in ROWS:
            line[:] = -7.0
            casts.append([shadows._cast(tuple(a), tuple(b), row, tuple(p), 1e-12, line), *line])
        found.append(np.array(casts))
    # one end in the triangle's plane, both, and one at the height of the point
    o, one, other = ROWS[0, :3], ROWS[0, 3:6], ROWS[0, 6:]
    up = np.cross(one, other)
    p = o + 0.2 * one + 2 * up
    for first, last in itertools.permutations((-1.0, 0.0, 0.9, 2.0, 2.7), 2):
        a, b = o + one + first * up, o + 0.3 * other + last * up
        line[:] = -7.0
        ends.append([shadows._cast(tuple(a), tuple(b), ROWS[0], tuple(p), 1e-12, line), *line])
    assert not shadows._sector((0, 0, 0), (0.1, 0.2, 0.3), (0.2, 0.4, 0.6), planes)
    on_record([found, np.array(ends)], TIGHT)


def polygon(count, seed, *, wide=0.4):
    turn = np.sort(np.random.default_rng(seed).uniform(0, 2 * np.pi, count))
    return np.column_stack([0.4 + wide * np.cos(turn), 0.3 + 0.3 * np.sin(turn)])


def test_lines_over_polygons(on_record):
    draw = np.random.default_rng(5)
    found, crossed = [], []
    for number in range(60):
        count = 3 + number % 7
        corners = polygon(count, number)
        line = draw.uniform(-0.3, 1.1, 4)
        if number % 5 == 0:  # from a corner, or through two
            line[:2] = corners[1]
        if number % 10 == 0:
            line[2:] = corners[2 + number % 20 // 10 - count]
        cells, sizes = np.full((3, 2 * shadows.CORNERS), -1.0), np.zeros(3, dtype=np.int64)
        cells[0, : 2 * count], sizes[0] = corners.ravel(), count
        sides = np.zeros((32, 2)), np.zeros((32, 2))
        crossed += [shadows._enters(line), shadows._crosses(cells[0], count, line)]
        found.append([shadows._part(cells, sizes, 0, 1, line, sides), cells, sizes])
        full = cells[:1].copy(), np.array([count])
        found.append([shadows._cut(*full, 1, line, sides), shadows._area(corners, count)])
        repeated = np.repeat(corners, 1 + (np.arange(count) + number) % 3 // 2, axis=0)
        repeated = np.roll(repeated, 1, axis=0)
        found.append([shadows._distinct(repeated, len(repeated)), repeated])
    corners = polygon(17, 9)
    for room, at, count in ((3, 0, 1), (3, 1, 2), (3, 2, 2), (3, 2, 3), (2, 0, 2), (4, 0, 3)):
        cells, sizes = np.zeros((room, 2 * shadows.CORNERS)), np.zeros(room, dtype=np.int64)
        for size in (17, 16, 5):
            found.append(
                [shadows._put(cells, sizes, at, count, corners, size), cells.copy(), sizes.copy()]
            )
    on_record([np.array(crossed), found], TIGHT)


@pytest.mark.parametrize("number", range(3))
def test_what_a_point_sees(number, on_record):
    p, found = POINTS[number], []
    outlined = shadows.outline(MESH, p, shadows.outline_room(MESH))
    room = shadows.shadow_room()
    polygons, sizes = np.zeros((60, 2 * shadows.CORNERS)), np.zeros(60, dtype=np.int64)
    for t in range(12):
        bounces._whole(polygons, sizes)
        count = shadows.see(MESH, t, p, outlined, polygons, sizes, 1, room)
        seen = [polygons[k, : 2 * sizes[k]].copy() for k in range(max(count, 0))]
        found.append([count, seen, bounces._is_whole(polygons[0], sizes[0])])
    # too little room
    small = tuple(one[:2] for one in room[:4])
    for t in range(12):
        bounces._whole(polygons, sizes)
        found.append(shadows.see(MESH, t, p, outlined, polygons, sizes, 1, (*small, room[4])))
    on_record(found, TIGHT)


def test_light_over_the_bins(on_record):
    draw = np.random.default_rng(7)
    found = []
    for width in (0.02, 0.3, 1.7):
        for number in range(30):
            paths = draw.uniform(1.2, 1.2 + 0.04 * (number + 1), 3)
            if number % 6 == 0:
                paths[1] = paths[number % 4 // 2 * 2]
            bins = np.zeros(7)
            with np.errstate(divide="ignore", invalid="ignore"):
                bounces.spread(*paths, *draw.uniform(0.2, 1.0, 3), 0.7, 1.31, width, bins)
            found.append(bins)
    edges = [
        bounces._bin(t, 1.3, 0.25, 5) for t in (1.0, 1.29, 1.3, 1.4, 1.55, 1.8, 2.29, 2.3, 9.0)
    ]
    on_record([np.array(found), edges], TIGHT)


GLOSS = SumMaterial(Lambert(0.4), SpecularMicrofacet(0.2, 0.35))
PAINTS = [Lambert(0.7), GLOSS, OrenNayar(0.8, 0.4)]


def world():
    tables = [paint.lobe_table() for paint in PAINTS]
    starts, which = np.cumsum([0, *map(len, tables)]), np.arange(12) % 3
    sharp = np.array([1.0, 0.35 * 2**0.5, 1.0])[which]
    return np.concatenate(tables), np.stack([starts[which], starts[which + 1]], axis=1), sharp


@pytest.mark.parametrize("limit", [np.inf, 3e-2, 3e-3])
def test_parts_of_a_triangle(limit, on_record):
    lobes, spans, _ = world()
    stack = np.zeros((bounces.DEEPEST + 4, bounces.COLUMNS))
    draw = np.random.default_rng(8)
    found = []
    for number in range(4):
        corners = draw.uniform(-0.5, 0.5, (3, 3)) + ABOVE
        if number == 3:
            corners = corners * 0.3 + 0.2 * ABOVE
        heights = draw.uniform(0.05, 0.5, 2)
        piece = np.array([*corners.ravel(), draw.uniform(0.1, 0.5), *heights, number])
        pair = (*POINTS[0, :2], *POINTS[1, :2], *heights)
        begin, end = spans[number]
        found += [bounces._node(*corners[0], pair, lobes, begin, end)]
        for sharp in (1.0, 0.4, 0.2):
            bins = np.zeros(9)
            asked = (lobes, begin, end, sharp, limit, START, DELTA, bins, stack)
            found += [bounces._piece(piece, pair, *asked), bins]
    on_record(found, TIGHT)


@pytest.mark.parametrize("told", [True, False], ids=["known", "unknown"])
def test_pairs_of_points(told, on_record):
    known = np.full((3, 12), bounces.PART, dtype=np.int8)
    ends = np.zeros((3, 13), dtype=np.int32)
    kept, sizes = np.empty((0, 2 * shadows.CORNERS)), np.empty(0, dtype=np.int64)
    if told:
        bounces.sights(MESH, CLEAR, POINTS, known, ends, kept, sizes)
        counts = ends.copy()
        ends = np.cumsum(ends.ravel(), dtype=np.int32).reshape(ends.shape)
        kept, sizes = (
            np.zeros((ends[-1, -1], 2 * shadows.CORNERS)),
            np.zeros(ends[-1, -1], np.int64),
        )
        bounces.sights(MESH, CLEAR, POINTS, known, ends, kept, sizes)
        polygons = [one[: 2 * size] for one, size in zip(kept, sizes, strict=True)]
        seen = [known, counts, polygons]
    else:
        seen = []
    first, second = np.array([0, 1, 2, 0, 1]), np.array([1, 1, 0, 2, 2])
    turned = np.array([False, False, True, True, False]) & told
    out, report = np.ones((5, 9)), np.ones((5, bounces.REPORT))
    bounces.three_bounces(
        *(MESH, CLEAR, world(), POINTS[first], POINTS[second], turned, first),
        *((known, ends, kept, sizes, told), START - 0.1 * np.arange(5.0), DELTA, 0.2, 900),
        *(np.array([0, 2, 5]), out, report),
    )
    on_record([seen, out, report], TIGHT)


def test_sights_of_a_solid(on_record):
    """Where nothing is on the side of the point, no shadow is cut out."""
    rows = ROWS[:4]
    boxes = np.array([[-1.0, -1.0, 0.0, 1.0, 1.0, 2.0]])
    mates = neighbours(hidden()[:4])
    mesh = rows, boxes, MESH[2], mates, np.zeros(5, np.int64), np.empty((0, 4))
    clear = shadows.clear_sides(rows, MESH[2])
    assert clear.any(axis=1).all()
    found = [clear]
    for sides in (clear, ~clear, np.zeros((4, 2), bool)):
        known, ends = np.full((3, 4), bounces.PART, dtype=np.int8), np.zeros((3, 5), np.int32)
        bounces.sights(mesh, sides, POINTS, known, ends, np.empty((0, 32)), np.empty(0, np.int64))
        found += [known, ends]
    on_record(found, TIGHT)


def test_passes_end(on_record):
    """A pass that needs too many parts is given up, and the last whole one is kept."""
    p, q = POINTS[:2]
    both = [shadows.outline(MESH, one, shadows.outline_room(MESH)) for one in (p, q)]
    known = np.full(12, bounces.PART, np.int8), np.zeros(13, np.int32), None, None
    room = np.zeros((400, 32)), np.zeros(400, np.int64), shadows.shadow_room()
    pieces, count = bounces._seen(MESH, CLEAR, p, q, both, known, False, room, np.empty((3, 13)))
    stack, found = np.zeros((bounces.DEEPEST + 4, bounces.COLUMNS)), [pieces[:count]]
    for most, tol in ((10, 0.1), (40, 0.1), (300, 0.05), (4000, 0.3), (4000, 0.02)):
        bins, report = np.zeros(9), np.full(bounces.REPORT, -1.0)
        given = (pieces, count, p, q, world(), tol, most, START, DELTA, bins)
        bounces._pair(*given, np.zeros(9), stack, report)
        found.append([bins, report])
    report = np.full(bounces.REPORT, -1.0)
    bounces._pair(pieces, 0, p, q, world(), 0.1, 9, START, DELTA, bins, np.zeros(9), stack, report)
    found.append(report)
    lights, hidden_peaks = [0.0, 1e-9, 0.3], []
    for light, tilt, turn, sharp, limit in itertools.product(
        lights, (0.1, 0.9, 1.56), (0.05, 0.4), (0.02, 0.2), (np.inf, 1e-3, 1e-7)
    ):
        hidden_peaks.append(bounces._may_hide(light, tilt, turn, sharp, limit))
    on_record([found, np.array(hidden_peaks)], TIGHT)


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
