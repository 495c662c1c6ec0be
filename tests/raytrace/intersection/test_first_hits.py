"""First hits by Newton's method against a march that cannot pass a crossing.

`python -m tests.raytrace.intersection.test_first_hits 1000000` compares a million rays per wall.
"""

from __future__ import annotations

import math
import sys

import numpy as np
import pytest
from numba import njit

from nlosoptics import raytrace
from nlosoptics.raytrace import Hits
from nlosoptics.raytrace.intersection import _wall_kernels
from nlosoptics.raytrace.intersection.intersections import search_bounds
from nlosoptics.scene import ConcaveWall, ConvexWall, HeightMapWall, MeshWall, SumWall, WavyWall

pytestmark = pytest.mark.thorough  # they compile kernels that few scenes need


HIT, OUTSIDE, UNRESOLVED = Hits.HIT, Hits.OUTSIDE, Hits.UNRESOLVED

RANDOM = np.random.default_rng(1)
WALLS = {
    "shallow waves": SumWall(WavyWall(0.01, 0.2, 0.3), WavyWall(0.004, 0.13, direction=1.0)),
    "deep waves": SumWall(
        WavyWall(0.03, 0.15, direction=0.4), WavyWall(0.01, 0.06, 1.0, direction=1.1), size=1.2
    ),
    "one deep wave": WavyWall(0.05, 0.2, direction=0.3, size=1.2),
    "nine waves": SumWall(
        *[WavyWall(3e-3 / (1 + i), 0.15 / (1 + i), i, direction=2.4 * i) for i in range(9)],
        size=1.2,
    ),
    "smooth height map": HeightMapWall.random(
        height_rms=1e-3, correlation_length=0.05, size=1.2, pitch=5e-3
    ),
    "rough height map": HeightMapWall(8e-3 * RANDOM.normal(size=(61, 61)), 0.02),
    "mesh": MeshWall(ConvexWall(2.0, size=1.2).to_mesh(max_sag_error=1e-4)),
    "wave on a sphere": SumWall(WavyWall(0.01, 0.1), ConcaveWall(4.0), size=1.2),
    "height map on a cylinder": SumWall(
        HeightMapWall(8e-3 * RANDOM.normal(size=(61, 61)), 0.02), ConvexWall(5.0, shape="cylinder")
    ),
}


def rays(count, seed):
    """Steep and grazing rays, from above, from the side, from within the waves and from behind."""
    draw = np.random.default_rng(seed)
    targets = np.column_stack([draw.uniform(-0.7, 0.7, (count, 2)), draw.normal(0, 0.02, count)])
    turn = draw.uniform(0, 2 * math.pi, count)
    # cosines with the mean normal from 1 to 0.001, some of them upward
    cosine = 10 ** draw.uniform(-3, 0, count) * np.where(draw.uniform(size=count) < 0.05, -1, 1)
    sine = np.sqrt(1 - cosine**2)
    directions = np.stack([sine * np.cos(turn), sine * np.sin(turn), -cosine], axis=1)
    away = 10 ** draw.uniform(-2, 0.7, count)
    return targets - away[:, None] * directions, directions


@njit
def march(terms, tables, bounds, box, slab, rim, o, d, distance, status):
    """Fill distance (n,) and status (n,) by the march alone."""
    for i in range(distance.size):
        start, unit = (o[i, 0], o[i, 1], o[i, 2]), _wall_kernels._unit((d[i, 0], d[i, 1], d[i, 2]))
        low, high, bound, scale, missed = _wall_kernels.search(
            terms, bounds, box, slab, rim, start, unit
        )
        distance[i], status[i] = math.nan, missed
        if low <= high:
            distance[i], status[i] = _wall_kernels.marched_hit(
                terms, tables, slab, start, unit, low, high, bound, scale, missed
            )


def differences(wall, origins, directions):
    """Return the number of rays with another hit, those at an edge, and the largest error, m.

    The error is of the height above the wall, which is what either method computes: that of the
    distance is larger for a grazing ray.
    """
    hits = raytrace.intersect(wall, origins, directions)
    terms, tables = wall.compiled()
    distance, status = np.empty(len(origins)), np.empty(len(origins), dtype=np.int8)
    march(terms, tables, *search_bounds(wall, terms, tables), origins, directions, distance, status)
    both = (hits.status == HIT) & (status == HIT)
    units = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    cosine = np.abs((hits.normals * units).sum(axis=1))
    error = np.abs(hits.distance - distance)[both] * cosine[both]
    # the march gives up where it takes too many steps
    other = (hits.status != status) & (status != UNRESOLVED)
    reach = np.inf if wall.size is None else np.array(wall.size) / 2
    met = np.where(hits.hit, hits.distance, distance)
    ends = np.abs((origins + met[:, None] * units)[:, :2])
    edge = other & (np.abs(ends - reach) < 1e-12).any(axis=1)
    wrong = int((other & ~edge).sum()) + int((error > 1e-12).sum())
    return wrong, int(edge.sum()), float(error.max(initial=0.0))


@pytest.mark.parametrize("wall", WALLS.values(), ids=WALLS)
def test_first_hits_are_those_of_the_march(wall):
    origins, directions = rays(20_000, seed=0)
    wrong, edge, error = differences(wall, origins, directions)
    assert wrong == 0
    assert edge <= 1
    # roundings of coordinates of up to 5 m
    assert error < 1e-14
    status = raytrace.intersect(wall, origins, directions).status
    assert (status == HIT).sum() > 3000
    assert wall.size is None or (status == OUTSIDE).sum() > 500


if __name__ == "__main__":
    total = 0
    for name, wall in WALLS.items():
        found = differences(wall, *rays(int(sys.argv[1]), seed=1))
        total += int(sys.argv[1])
        wrong, edge, error = found
        sys.stdout.write(f"{name:26s} {wrong} wrong, {edge} at an edge, error {error:.1e} m\n")
    sys.stdout.write(f"{total} rays\n")
