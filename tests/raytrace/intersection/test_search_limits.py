"""Limits within which hits are searched, against dense samples, and rays that blocks settle."""

import math

import numpy as np
import pytest

from nlosoptics import raytrace
from nlosoptics.raytrace.intersection import _block_kernels, _wall_kernels
from nlosoptics.raytrace.intersection._block_kernels import BLOCK, ROWS
from nlosoptics.raytrace.intersection.intersections import compiled_wall
from nlosoptics.scene import ConcaveWall, ConvexWall, HeightMapWall, SumWall, WavyWall

WAVES = (WavyWall(0.02, 0.3, 0.5, direction=0.6), WavyWall(0.005, 0.2, direction=2.0))
MAP = HeightMapWall(2e-3 * np.random.default_rng(1).normal(size=(41, 41)), 0.03)
WALLS = {
    "one wave": SumWall(WAVES[0], WavyWall(1e-9, 1.0), size=(1.2, 0.8)),
    "waves": SumWall(*WAVES),
    "wave on a bowl": SumWall(WavyWall(1e-6, 0.5), ConcaveWall(0.7), size=(1.2, 1.1)),
    "wave on a ball": SumWall(WavyWall(1e-6, 0.5), ConvexWall(0.5)),
    "wave on a trough": SumWall(
        WavyWall(1e-6, 0.5), ConcaveWall(0.6, shape="cylinder", axis="x"), size=(1.3, 2.0)
    ),
    "wave on a pillar": SumWall(WavyWall(1e-6, 0.5), ConvexWall(0.6, shape="cylinder", axis="y")),
    "height map": MAP,
}


def rays(count, seed):
    """Rays towards the wall from around it, some along an axis or level."""
    draw = np.random.default_rng(seed)
    targets = draw.uniform((-0.5, -0.4, -0.02), (0.5, 0.4, 0.02), (count, 3))
    directions = draw.normal(size=(count, 3))
    directions[::7, 0] = 0.0
    directions[::11, 1] = 0.0
    directions[5::50] = (0.0, 0.0, -1.0)
    directions[9::50, 2] = 0.0
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    return targets - 2.0 * directions, directions


def limits(wall, o, d):
    """Return low, high and the curvature bound of one ray's search, and the wall as compiled."""
    terms, _, bounds, box, slab, rim = compiled_wall(wall, math.inf)
    low, high, bound, _, _ = _wall_kernels.search(terms, bounds, box, slab, rim, tuple(o), tuple(d))
    return low, high, bound, box, slab, rim


@pytest.mark.parametrize("name", WALLS)
def test_search_is_where_the_ray_is_over_the_wall_and_within_its_heights(name):
    found = 0
    for o, d in zip(*rays(150, seed=2), strict=True):
        low, high, _, box, slab, rim = limits(WALLS[name], o, d)
        t = np.linspace(0.0, 4.0, 4001)
        x, y, z = o[:, None] + t * d[:, None]
        inside = (np.abs(x) <= box[0]) & (np.abs(y) <= box[1]) & (np.hypot(x, y) <= rim)
        inside &= (slab[0] <= z) & (z <= slab[1])
        if not inside.any():  # shorter than a step, or empty
            assert high - low < 1e-3 or low > 4.0
            continue
        found += 1
        assert abs(low - t[inside][0]) <= 1e-3
        assert abs(min(high, 4.0) - t[inside][-1]) <= 1e-3
    assert found > 50


@pytest.mark.parametrize("name", WALLS)
def test_curvature_along_a_ray_is_bounded_and_the_bound_is_nearly_reached(name):
    wall, step, reached = WALLS[name], 1e-4, []
    for o, d in zip(*rays(150, seed=3), strict=True):
        low, high, bound, *_ = limits(wall, o, d)
        if not high - low > 10 * step or high == math.inf:
            continue
        t = np.linspace(low + step, high - step, 500)
        height = [wall.height(o[0] + s * d[0], o[1] + s * d[1]) for s in (t - step, t, t + step)]
        bend = np.abs(height[0] - 2 * height[1] + height[2]).max() / step**2
        # finite differences: rounding of heights and their fourth derivative
        assert bend <= bound * 1.01 + 1e-4
        reached.append(bend / bound if bound > 1e-3 else 0.0)
    assert len(reached) > 50
    assert max(reached) > (0.1 if name == "height map" else 0.9)


def settled(wall, origins, directions):
    """Return which rays a block settles, and their distances, m."""
    terms, tables, bounds, box, slab, _ = compiled_wall(wall, math.inf)
    found, distance = [], []
    for start in range(0, len(origins), BLOCK):
        w, state = np.zeros(ROWS * BLOCK), np.zeros(BLOCK, dtype=np.int64)
        rows = w.reshape(ROWS, BLOCK)
        rows[:3] = origins[start : start + BLOCK].T
        rows[3:6] = directions[start : start + BLOCK].T
        _block_kernels.block_hits(terms, tables, bounds, box, slab, w, state)
        found.append(state >= 0)
        distance.append(rows[_block_kernels.T // BLOCK].copy())
    return np.concatenate(found), np.concatenate(distance)


@pytest.mark.parametrize("wall", [WAVES[0], SumWall(*WAVES), MAP], ids=["wave", "waves", "map"])
@pytest.mark.parametrize("height", [0.03, 0.5, 5.0])
def test_blocks_settle_steep_rays_by_themselves(wall, height):
    """Only few rays are left to the search one by one, whose result is the same but slow."""
    draw = np.random.default_rng(4)
    targets = np.column_stack([draw.uniform(-0.4, 0.4, (640, 2)), np.zeros(640)])
    directions = np.column_stack([draw.uniform(-0.3, 0.3, (640, 2)), -np.ones(640)])
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    origins = targets + height / directions[:, 2:] * directions
    known, distance = settled(wall, origins, directions)
    assert known.mean() > 0.97
    hits = raytrace.intersect(wall, origins, directions)
    assert np.abs(distance - hits.distance)[known].max() < 1e-12
