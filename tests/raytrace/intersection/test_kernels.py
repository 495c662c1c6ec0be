"""Kernels of intersections with walls and triangles, with random rays, on record."""

import math

import numpy as np
import pytest
import trimesh

from nlosoptics.raytrace.intersection import _block_kernels as blocks
from nlosoptics.raytrace.intersection import _triangle_kernels as triangles
from nlosoptics.raytrace.intersection import _wall_kernels as kernels
from nlosoptics.raytrace.intersection.intersections import compiled_wall
from nlosoptics.raytrace.intersection.triangles import NO_LIMIT, Facets
from nlosoptics.scene import ConcaveWall, ConvexWall, FacetWall, HeightMapWall, SumWall, WavyWall

MAP = HeightMapWall(2e-3 * np.random.default_rng(1).normal(size=(31, 41)), 0.03)
WAVE = WavyWall(0.02, 0.3, 0.5, direction=0.6, size=(1.2, 0.8))
WALLS = {
    "wave": WAVE,
    "waves": SumWall(WavyWall(0.03, 0.15, direction=0.4), WavyWall(0.005, 0.2, direction=2.0)),
    "bowl": ConcaveWall(0.8, size=(1.2, 0.9)),
    "dish": ConcaveWall(1.7, size=(1.1, 0.9)),
    "ball": ConvexWall(0.8, size=(1.0, 1.1)),
    "trough": ConcaveWall(0.6, shape="cylinder", axis="x", size=(1.3, 1.0)),
    "pillar": ConvexWall(0.6, shape="cylinder", axis="y", size=(1.1, 1.5)),
    "nearly flat": ConvexWall(1e-3, size=(1e-3, 1.5e-3)),
    "wave on a bowl": SumWall(WavyWall(0.01, 0.5, 0.2), ConcaveWall(0.9), size=(1.2, 1.1)),
    "wave on a ball": SumWall(WavyWall(0.01, 0.5, 0.2), ConvexWall(0.5)),
    "wave on a pillar": SumWall(
        WavyWall(0.01, 0.5), ConvexWall(0.6, shape="cylinder", axis="y"), size=(1.0, 2.0)
    ),
    "map": MAP,
    "map on a trough": SumWall(MAP, ConcaveWall(2.0, shape="cylinder")),
    "facets": FacetWall(0.05, 0.2, seed=2, size=(1.2, 0.9)),
    "facets on a wave": SumWall(FacetWall(0.05, 0.1, seed=2), WAVE),
}


def rays(count, seed):
    """Steep and grazing rays from above, within and behind the wall, some along an axis."""
    draw = np.random.default_rng(seed)
    targets = draw.uniform((-0.6, -0.5, -0.03), (0.6, 0.5, 0.03), (count, 3))
    directions = draw.normal(size=(count, 3)) * (1.0, 1.0, 0.7)
    directions[:, 2] *= np.where(draw.random(count) < 0.8, -np.sign(directions[:, 2]), 1.0)
    directions[::7, 0] = directions[::11, 1] = directions[9::50, 2] = 0.0
    directions[5::50] = (0.0, 0.0, -1.0)
    directions[6::50] = (0.0, 0.0, 1.0)
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    away = draw.choice((-0.4, 0.0, 0.01, 0.3, 2.0, 90.0, 1e6), count)
    return targets - away[:, None] * directions, directions, away


@pytest.mark.parametrize("name", WALLS)
def test_rays_one_by_one(name, on_record):
    compiled = compiled_wall(WALLS[name], math.inf)
    terms, tables, bounds, box, slab, rim = compiled
    found = []
    for o, d, away in zip(*rays(300, 3), strict=True):
        hit = kernels.wall_hit(*compiled, tuple(o), tuple(d))
        hit += (hit[0] - away,)
        if bounds is not None:
            limits = kernels.search(terms, bounds, box, slab, rim, tuple(o), tuple(d))
            hit += (*limits, limits[0] - away)
            if "facets" not in name:
                hit += kernels.newton_hit(terms, tables, slab, tuple(o), tuple(d), *limits[:4])
                hit += kernels.marched_hit(terms, tables, slab, tuple(o), tuple(d), *limits)
        found.append(hit)
    on_record([*np.array(found, dtype=float).T.copy()], 1e-8)


@pytest.mark.parametrize("name", ["wave", "waves", "map"])
def test_rays_of_a_block(name, on_record):
    """Steep ones, of which the block settles nearly all, and any."""
    terms, tables, bounds, box, slab, _ = compiled_wall(WALLS[name], math.inf)
    draw, found = np.random.default_rng(4), []
    for slope in (0.2, 0.6, 2.0):
        w = np.zeros(blocks.ROWS * blocks.BLOCK)
        rows, state = w.reshape(blocks.ROWS, -1), np.zeros(blocks.BLOCK, dtype=np.int64)
        targets = draw.uniform((-0.65, -0.5, 0.0), (0.65, 0.5, 0.0), (blocks.BLOCK, 3))
        along = np.column_stack([draw.normal(0, slope, (blocks.BLOCK, 2)), -np.ones(blocks.BLOCK)])
        along[::13, 2] *= -1.0
        along /= np.linalg.norm(along, axis=1)[:, None]
        rows[:3] = (targets - draw.choice((0.03, 0.4, 2.0), (blocks.BLOCK, 1)) * along).T
        rows[3:6] = along.T
        blocks.block_hits(terms, tables, bounds, box, slab, w, state)
        distance, slopes = rows[blocks.T // blocks.BLOCK], rows[blocks.HX // blocks.BLOCK :][:2]
        found.append([state, np.where(state >= 0, [distance, *slopes], 0.0)])
    on_record(found, 1e-8)


def mesh(coarse):
    """A lump of unequal triangles, or a box with corners at multiples of 1/8."""
    if coarse:
        return trimesh.creation.box((1.0, 0.5, 0.25)).subdivide()
    found = trimesh.creation.icosphere(subdivisions=2, radius=0.4)
    found.vertices *= 1.0 + 0.2 * np.random.default_rng(2).normal(size=(len(found.vertices), 1))
    found.vertices[:, 0] *= 1.3
    return found


def triangle_rays(coarse, count=300):
    draw = np.random.default_rng(8)
    if coarse:  # through corners, along edges and in planes
        origins = draw.integers(-8, 9, (count, 3)) / 8.0
        directions = np.eye(3)[draw.integers(0, 3, count)] * draw.choice((-1.0, 1.0), (count, 1))
        directions[::3] = draw.integers(-4, 5, (len(directions[::3]), 3)) / 4.0
        directions[~directions.any(axis=1)] = (0.0, 0.0, 1.0)
        return origins, directions
    origins, aims = draw.uniform(-0.8, 0.8, (2, count, 3))
    return origins, 0.6 * aims - origins


@pytest.mark.parametrize("coarse", [False, True])
def test_triangles_one_by_one(coarse, on_record):
    facets, (origins, directions) = Facets(mesh(coarse)), triangle_rays(coarse)
    count = len(origins)
    shapes, found = (facets.rows, facets.edges, facets.names), []
    index = np.arange(count, dtype=np.int32)
    for nearest, farthest in ((0.0, NO_LIMIT), (0.25, np.tile([0.3, 0.5, 0.9], count // 3))):
        hits = np.full(count, np.nan), *np.full((2, count, 3), np.nan)
        hits += (np.full(count, -1, dtype=np.int32),)
        triangles.search(
            *(*shapes, facets.boxes, origins, directions, index, nearest, farthest, hits)
        )
        units, counts = np.zeros((count, 3)), np.zeros(count, dtype=np.int64)
        rows = triangles.search_all(
            *(*shapes[:2], facets.boxes, origins, directions, nearest, units, counts)
        )
        found.append([hits, units, counts, rows[:, ::2].copy(), 1e14 * rows[:, 1]])
    on_record(found, 1e-8)


@pytest.mark.parametrize("fresh", [False, True])
@pytest.mark.parametrize("sorting", [False, True])
@pytest.mark.parametrize("coarse", [False, True])
def test_rays_for_embree(coarse, sorting, fresh, on_record):
    """Prepared and sorted rays, and what is kept of right, wrong and missing triangles."""
    facets, (origins, directions) = Facets(mesh(coarse)), triangle_rays(coarse)
    count, draw = len(origins), np.random.default_rng(3)
    origins = origins + 0.4 * np.sign(origins)
    loose, prepared = np.zeros((2, count, 8), dtype=np.float32)
    bins = np.zeros(count if sorting else 0, dtype=np.int32)
    hits = np.full(count, -7.0), *np.full((2, count, 3), -7.0), np.full(count, -7, dtype=np.int32)
    kept = triangles.enter(
        *(origins, directions, facets.limits, facets.centre, facets.reach, 0.01 * facets.reach),
        *(loose, bins, prepared, hits, fresh),
    )
    found = [kept, prepared[:kept].copy(), *(one.copy() for one in hits)]
    moved = np.zeros((kept, 6), dtype=np.float32)
    triangles.aside(prepared[:kept], 0.03, 0.7, moved)
    numbers = prepared[:kept].view(np.int32)[:, triangles.INDEX].copy()
    index = np.arange(count, dtype=np.int32)
    nearest = tuple(one.copy() for one in hits)
    nearest[3][:] = -1
    triangles.search(
        *(facets.rows, facets.edges, facets.names, facets.boxes, origins, directions, index),
        *(0.0, NO_LIMIT, nearest),
    )
    place = np.zeros(int(facets.names.max()) + 1, dtype=np.int32)
    place[facets.names] = np.arange(len(facets.names))
    ids = np.where(nearest[3][numbers] >= 0, place[nearest[3][numbers]], -1).astype(np.int32)
    ids[::6] = draw.integers(-1, len(facets.names), len(ids[::6]))
    far = np.tile([0.5, 0.8, 3.0], count // 3) if fresh else NO_LIMIT
    left = triangles.place(
        *(facets.rows, facets.edges, facets.names, origins, directions, prepared[:kept], ids),
        *(0.02, 0.3, far, hits, fresh),
    )
    on_record([found, moved, numbers, left, ids[:left], prepared[:left], hits], 1e-6)
