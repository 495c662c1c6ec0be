"""Kernels of pictures, of photon counts and of random paths, each alone, on record.

The kernels are plain Python here, see `plain_kernels`. No two sizes are equal and no number is
round, so that an exchange of any two of them is seen.
"""

from __future__ import annotations

import numpy as np
import pytest

from nlosoptics.scene import Lambert, OrenNayar, SpecularMicrofacet, SumMaterial

from ..plain_kernels import TIGHT, after, complexes, numbers, plain

phasor = plain("transient.imaging._phasor_kernels")
migration = plain("transient.imaging._migration_kernels")
detector = plain("transient.capture._detector_kernels")
bounces = plain("transient.rendering._bounce_kernels")
sight = plain("transient.rendering._sight_kernels")
SAMPLER = (np.uint64(77), np.zeros((1, 0, 32), np.uint32), np.zeros((1, 0), np.uint32))


@pytest.mark.parametrize("falls", [True, False], ids=["falls", "stays"])
def test_sums_of_waves(falls, on_record):
    voxels, near, turns = numbers(3, 3), numbers(4, 3, low=2.0, high=3.0), complexes(2, 7)
    found = []
    for legs in (phasor.ALONE, phasor.ALL, phasor.PAIRED):
        far = numbers(5 if legs == phasor.ALL else 4, 3, low=-4.0, high=-3.0)
        spectrum = complexes(5 if legs == phasor.ALL else 1, 4, 7)
        given = (voxels, near, far, legs, falls, 1.9, 0.37, spectrum, turns)
        found.append(after(phasor.direct_sum, *given, np.zeros((2, 3), complex)))
    axes = numbers(3, low=0.2), numbers(4, low=0.2), numbers(2, low=0.2)
    for ways in (1, 2):
        out = np.zeros((5, 2, 4, 3), complex)
        found.append(after(phasor.fill_kernels, *axes, ways, falls, 1.9, 0.37, out))
    fields, total = complexes(5, 2, 4, 3), complexes(2, 2, 4, 3)
    for far in (numbers(1, 3, low=2.0, high=3.0), np.empty((0, 3))):
        given = (fields, *axes, far, falls, 1.9, 0.37, complexes(2, 5), total.copy())
        found.append(after(phasor.add_waves, *given))
    for count in range(1, 10):
        field = complexes(count)
        found.append(after(phasor.add_path, 2.3, 0.7, 1.9, 0.37, complexes(count, seed=3), field))
    on_record(found, TIGHT)


def test_products_of_waves(on_record):
    spectra, row = complexes(2, 4, 6), np.zeros(6, complex)
    half, whole = complexes(2, 3, 3, 4), complexes(2, 3, 4, 6)
    found = []
    for kernels in (half, whole):
        found.append(after(phasor.multiply_row, spectra[0, 1], kernels[0, 0, 1], row.copy()))
        for shape in ((4, 6), (2, 3), (1, 6)):
            product = complexes(*shape)
            found += [
                after(phasor.add_product, spectra[0], kernels[0, 0], row.copy(), product),
                after(phasor.multiply_waves, spectra, kernels, complexes(2, 3, *shape)),
                after(phasor.sum_waves, spectra, kernels, complexes(3, *shape)),
            ]
    on_record(found, TIGHT)


def test_migration(on_record):
    lateral = np.array([[0.0, 1.7, 9.1], [2.3, 400.0, 90.0]])
    found = []
    for n_waves, n in ((9, 6), (6, 8)):
        spectrum = complexes(2, 3, 40)
        given = (spectrum, lateral, 1.3, 0.05, 13, 0.21, 0.37, numbers(26), 4, 6, n_waves)
        found.append(after(migration.stolt, *given, np.ones((2, 3, n), complex)))
    lasers, sensors = numbers(3, 3, low=-1.0, high=0.0), numbers(4, 3, low=-1.0, high=0.0)
    sensors[2] = lasers[1]
    which = np.array([0, 1, 2, 1, 0]), np.array([3, 2, 0, 1, 1])
    axes = numbers(3), numbers(2), numbers(4, low=0.3)
    for power in (-2, 0, 1, 2):
        given = (numbers(5, 9, low=0.0), lasers, sensors, *which, numbers(5, low=0.0), *axes)
        out, seen = np.zeros((2, 3, 4)), np.zeros((2, 3, 4), bool)
        found.append(after(migration.backproject, *given, 1.9, 0.23, power, out, seen))
    on_record(found, TIGHT)


def test_counts(on_record):
    means = np.concatenate([[-1.0, 0.0, 9.999, 10.0], np.geomspace(0.05, 3e4, 120)])
    found = []
    for seed in (3, 2**40 + 5, 2**63):
        found.append(after(detector.poisson, means, np.uint64(seed), np.full(means.size, -9.0)))
    on_record([*found, detector._few(900.0, np.uint64(3), np.uint64(1))], TIGHT)


def tree(rows):
    """The boxes over rows of triangles, four to a leaf, level by level."""
    corners = np.stack([rows[:, :3], rows[:, :3] + rows[:, 3:6], rows[:, :3] + rows[:, 6:]], 1)
    leaves = [corners[i : i + 4].reshape(-1, 3) for i in range(0, len(rows), 4)]
    assert len(leaves) & (len(leaves) - 1) == 0
    levels = [leaves]
    while len(levels[0]) > 1:
        low = levels[0]
        levels.insert(0, [np.concatenate(low[i : i + 2]) for i in range(0, len(low), 2)])
    return np.array([[*p.min(axis=0), *p.max(axis=0)] for level in levels for p in level])


def triangles(count, *, size=0.3):
    """Corner and two sides of triangles above the wall."""
    at = numbers(count, 3) * [1.0, 1.0, 0.4] + [0.0, 0.0, 0.9]
    return np.hstack([at, size * numbers(count, 6, seed=1)])


@pytest.mark.parametrize("count", [5, 24, 25, 62])
def test_what_blocks_a_sight(count, on_record):
    leaves = 1 << (-(-count // 4) - 1).bit_length()
    count = max(count, 4 * leaves - 3)
    rows = triangles(count)
    boxes = tree(rows)
    draw = np.random.default_rng(count)
    ends = draw.uniform(-1.0, 1.0, (150, 2, 3)) * [1, 1, 0.6] + [0, 0, 0.8]
    ends[::7, 1, 0] = ends[::7, 0, 0]  # across an axis
    found = [sight.blocked(rows, boxes, tuple(p), tuple(q - p)) for p, q in ends]
    # connections that begin or end on a triangle, inside it, on a side, at a corner or beyond
    for share in (
        (0.3, 0.4),
        (0.5, 0.5),
        (1.0, 0.0),
        (0.0, 1.0),
        (0.0, 0.6),
        (0.5, 0.51),
        (-0.01, 0.5),
    ):
        at = rows[0, :3] + share[0] * rows[0, 3:6] + share[1] * rows[0, 6:]
        for scale in (0.5, 1.0 - 1e-8, 1.0 - 1e-10, 1.0, 1.0 + 1e-8, 2.0):
            p = np.array([0.1, 0.2, -0.05])
            found.append(sight.blocked(rows[:1], boxes, tuple(p), tuple((at - p) / scale)))
    on_record([np.array(found), sum(found)])


PAINTS = [
    Lambert(0.7),
    SumMaterial(Lambert(0.4), SpecularMicrofacet(0.2, 0.35)),
    OrenNayar(0.8, 0.4),
]


def world(*, asked=True):
    rows = triangles(9, size=0.5)
    tables = [paint.lobe_table() for paint in PAINTS]
    starts = np.cumsum([0, *map(len, tables)])
    which = np.array([0, 1, 2, 1, 0, 2, 1, 0, 1])
    normals = np.cross(rows[:, 3:6], rows[:, 6:])
    areas = np.sqrt((normals**2).sum(axis=1)) / 2
    shares = np.insert(np.cumsum(areas[:7]), 0, 0.0)  # the last two are the wall's
    return bounces.Surfaces(
        lobes=np.concatenate(tables),
        spans=np.stack([starts[which], starts[which + 1]], axis=1),
        triangles=rows,
        normals=normals / (2 * areas[:, None]),
        sides=np.array([1, -1, 0, 0, 1, -1, 0, 0, 1]),
        shares=shares / shares[-1],
        area=float(shares[-1]),
        rows=rows[:7],
        boxes=np.empty((1, 6)),
        asked=asked,
    )


SENSORS = np.array([[-0.5, 0.4, 0.0], [0.3, -0.2, 0.0], [0.1, 0.7, 0.0]])


def vertices(surfaces, count=12, *, seed=0):
    """Vertices on the surfaces, every fifth without one, with directions back along the path."""
    draw = np.random.default_rng([count, seed])
    found = np.zeros((count, bounces.VERTEX))
    for i in range(count):
        t = draw.integers(9)
        row, share = surfaces.triangles[t], draw.dirichlet((1.0, 1.0, 1.0))
        found[i, :3] = row[:3] + share[0] * row[3:6] + share[1] * row[6:]
        back = draw.normal(size=3)
        back /= np.linalg.norm(back)
        side = np.sign(back @ surfaces.normals[t])
        found[i, 3:6], found[i, 6:9] = side * surfaces.normals[t], back
        found[i, 9:] = draw.uniform(0.2, 2.0), draw.uniform(0.5, 1.5), t if i % 5 != 3 else -1
    found[4, bounces.WEIGHT] = 0.0
    return found


@pytest.mark.parametrize("aimed", [0.0, 0.4, 1.0])
def test_first_vertices_and_legs(aimed, on_record):
    surfaces, n = world(), 14
    origins, directions, hit = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros(n, np.int64)
    found = [after(bounces.look, surfaces, SAMPLER, aimed, SENSORS, 5, origins, directions, hit)]
    given = vertices(surfaces, n)
    views = numbers(n, bounces.VIEWS, 3)
    views /= np.linalg.norm(views, axis=2, keepdims=True)
    for seen in (views, np.empty((0, bounces.VIEWS, 3))):
        arrays = np.zeros((n, bounces.LEAVE)), np.zeros((n, 3)), np.zeros((n, 3))
        asked = (surfaces, SAMPLER, 5, 4, aimed, seen, given)
        found.append(after(bounces.leave, *asked, *arrays))
    on_record(found, TIGHT)


def test_arrivals(on_record):
    surfaces, n = world(), 16
    old, leaving = vertices(surfaces, n), numbers(n, bounces.LEAVE, low=0.2)
    directions = numbers(n, 3)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    distance = numbers(n, low=0.3)
    hit = np.arange(n) % 10 - 1
    leaving[::2, bounces.REACH] = -1.0
    leaving[1::4, bounces.REACH] = distance[1::4] * (1 + 0.9e-6)
    leaving[3::4, bounces.REACH] = distance[3::4] * (1 - 1.2e-6)
    leaving[5, bounces.SENT], distance[7] = 0.0, 0.0
    leaving[2, bounces.DENSITY] = 0.0
    found = []
    for aimed in (0.0, 0.4, 1.0):
        new = np.full((n, bounces.VERTEX), 3.3)
        given = (surfaces, aimed, old, leaving, directions, distance, hit)
        found.append(after(bounces.arrive, *given, new))
    on_record(found, TIGHT)


@pytest.mark.parametrize("asked", [True, False], ids=["shadows", "none"])
def test_connections_and_bins(asked, on_record):
    surfaces = world(asked=asked)
    given = vertices(surfaces, 12)
    laser = np.array([0.2, -0.3, 0.0])
    factor, away = np.zeros((3, 12)), np.zeros((3, 12))
    views = np.zeros((12, bounces.VIEWS, 3))
    found = [
        after(bounces.connect, surfaces, laser, given, np.zeros(12), np.zeros(12)),
        after(bounces.seen_from, surfaces, SENSORS, given, factor, away),
        after(bounces.view, SAMPLER, SENSORS, factor, given, views),
        after(bounces.view, SAMPLER, SENSORS, numbers(3, 12, low=0.1), given, views + 1.0),
    ]
    spread = np.array([0, 2, 3, 3, 7, 8, 11, 12, 14, 17, 19, 20, 23])
    first = numbers(23, 3)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    weights = numbers(2, 3, 23, low=-0.2), numbers(2, 3, 23, low=0.2, high=2.0)
    rows = np.array([[1, 2], [0, 0], [1, 1], [0, 2]])
    totals = numbers(3, 4, 11), numbers(3, 4, 11, seed=1)
    table = factor + 0.1 * (np.arange(12) % 3), away + 0.3
    paths = (given, spread, first)
    walked = (surfaces, paths, rows, 0.9 + numbers(4, high=0.5), 6.3, table, SENSORS, weights)
    found.append(after(bounces.gather_pairs, *walked, *totals))
    on_record(found, TIGHT)
