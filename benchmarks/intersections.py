"""Rays on walls and meshes: seconds and error, against raw embreex and trimesh's own ray API.

python benchmarks/intersections.py [--rays 1000000] [--triangles 1280 ... 2000000] [--json FILE]
python benchmarks/intersections.py --growth     seconds against triangles and rays, with exponents
python benchmarks/intersections.py --leaks      of a closed mesh: random rays and aimed ones

All run on NUMBA_NUM_THREADS threads, but a plain Newton loop on one. With NUMBA_NUM_THREADS=1,
seconds are those of the processor, so that other load counts little, and the throughput is compared
with the least that is asked of it. Errors are of the distance, relative: of walls against the
surface at the hit over the cosine, of meshes against the plane of the triangle found, in extended
precision.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np
import trimesh
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numba import njit

from nlosoptics import raytrace
from nlosoptics.raytrace.intersection.meshes import threads
from nlosoptics.scene import (
    ConcaveWall,
    ConvexWall,
    FlatWall,
    HeightMapWall,
    MeshWall,
    SumWall,
    WavyWall,
)

THREADS = threads()
SIZES = [1_280, 5_120, 81_920, 2_000_000]  # triangles of meshes
CLOCK = time.process_time if THREADS == 1 else time.perf_counter
# Least throughput on one thread, relative to the other method for the same surface.
ASKED = {
    "sum of 2 waves": 1.5,
    "sum of 8 waves": 1.5,
    "mesh wall": 1.5,
    "mesh 1280": 0.8,
    "mesh 5120": 0.8,
}


def best(work, repeats=4):
    """Least seconds of several calls, and the last result."""
    seconds = math.inf
    for _ in range(repeats):
        start = CLOCK()
        result = work()
        seconds = min(seconds, CLOCK() - start)
    return seconds, result


def alternately(*works, repeats=7):
    """Least seconds of each work, taken in turns, so that each meets the same other load."""
    seconds = [math.inf] * len(works)
    for _ in range(repeats):
        for i, work in enumerate(works):
            seconds[i] = min(seconds[i], best(work, 1)[0])
    return seconds


def compare(name, ours, theirs, method):
    """Print our throughput relative to that of another method, and what is asked of it."""
    asked = ASKED.get(name)
    goal = f", asked {asked}" if asked and THREADS == 1 else ""
    print(f"{name}: {theirs / ours:.2f} times the throughput of {method}{goal}")


@njit(cache=True)
def plain_newton(waves, origins, directions, distance):
    """Newton's method from the mean plane for a sum of waves, without any bracket."""
    for i in range(distance.size):
        ox, oy, oz = origins[i]
        dx, dy, dz = directions[i]
        t = -oz / dz
        for _ in range(20):
            f, slope = oz + t * dz, dz
            for j in range(waves.shape[0]):
                a, kx, ky, phase = waves[j]
                angle = kx * (ox + t * dx) + ky * (oy + t * dy) + phase
                f -= a * math.cos(angle)
                slope += a * (kx * dx + ky * dy) * math.sin(angle)
            step = f / slope
            t -= step
            if abs(step) < 1e-15 * t:
                break
        distance[i] = t


def rays_from_above(count, draw):
    """Unit rays from the room to the middle of a wall."""
    origins = draw.uniform((-1, -1, 0.6), (1, 1, 1.4), (count, 3))
    directions = draw.uniform((-0.4, -0.4, 0), (0.4, 0.4, 0), (count, 3)) - origins
    return origins, directions / np.linalg.norm(directions, axis=1, keepdims=True)


def wall_rows(count, draw):
    """One row a kind of wall, and one of the plain Newton loop for waves."""
    origins, directions = rays_from_above(count, draw)
    wavy = WavyWall(0.01, 0.2, 0.3, direction=0.4)
    eight = [WavyWall(4e-3 / (1 + i), 0.2 / (1 + i / 2), i, direction=2.4 * i) for i in range(8)]
    walls = {
        "flat": FlatWall(),
        "sphere": ConcaveWall(4.0),
        "cylinder": ConcaveWall(4.0, shape="cylinder"),
        "wavy": wavy,
        "sum of 2 waves": SumWall(wavy, WavyWall(0.004, 0.13, direction=1.0)),
        "sum of 8 waves": SumWall(*eight),
        "wave on a sphere": SumWall(wavy, ConcaveWall(4.0), size=2.0),
        "height map": HeightMapWall.random(
            height_rms=1e-3, correlation_length=0.05, size=1.2, pitch=5e-3
        ),
    }
    for name, wall in walls.items():
        raytrace.intersect(wall, origins[:1], directions[:1])
        seconds, hits = best(lambda wall=wall: raytrace.intersect(wall, origins, directions))
        yield name, "nlosoptics", seconds, height_error(wall, hits, directions)
        if "wav" not in name or "sphere" in name:
            continue
        distance, waves = np.empty(count), np.ascontiguousarray(wall.compiled()[0][:, 1:5])
        plain_newton(waves, origins[:1], directions[:1], distance[:1])
        ours, theirs = alternately(
            partial(raytrace.intersect, wall, origins, directions),
            partial(plain_newton, waves, origins, directions, distance),
            repeats=4,
        )
        error = np.abs(distance / hits.distance - 1).max()
        yield name, "plain Newton", theirs, float(error)
        compare(name, ours, theirs, "plain Newton")


def height_error(wall, hits, directions):
    """Largest relative error of distances, from the height of the hits above the wall."""
    x, y, z = hits.points[hits.hit].T
    gap = np.abs(z - wall.height(x, y)) * hits.normals[hits.hit][:, 2]
    cosine = np.abs((hits.normals * directions).sum(axis=1)[hits.hit])
    return float((gap / cosine / hits.distance[hits.hit]).max())


def mesh_wall_rows(count, draw, nodes=203):
    """A wall of some 80,000 triangles as a smooth surface, and the triangles themselves."""
    x, y = (v.ravel() for v in np.meshgrid(*2 * [np.linspace(-0.6, 0.6, nodes)]))
    vertices = np.stack([x, y, ConvexWall(4.0, size=1.2).height(x, y)], axis=1)
    number = np.arange(nodes * nodes).reshape(nodes, nodes)
    a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]
    faces = [np.stack(corners, axis=-1).reshape(-1, 3) for corners in ((a, b, d), (a, d, c))]
    wall = MeshWall(trimesh.Trimesh(vertices, np.concatenate(faces), process=False))
    name, rays = "mesh wall", rays_from_above(count, draw)
    hits = raytrace.intersect(wall, *rays)
    with ThreadPoolExecutor(THREADS) as pool:
        _, raw = raw_embreex(wall.triangles, *rays, pool)
        ours, theirs = alternately(partial(raytrace.intersect, wall, *rays), raw)
    yield name, "nlosoptics", ours, height_error(wall, hits, rays[1])
    yield name, "embreex, its triangles", theirs, math.nan
    compare(name, ours, theirs, f"embreex on its {len(wall.triangles.faces)} triangles")


def facet_error(mesh, triangle, origins, directions, distance):
    """Largest relative error of distances to the planes of triangles."""
    a, b, c = np.moveaxis(np.asarray(mesh.triangles, np.longdouble)[triangle], 1, 0)
    normal = np.cross(b - a, c - a)
    exact = (normal * (a - origins)).sum(axis=1) / (normal * directions).sum(axis=1)
    return float(np.abs(distance / exact - 1).max())


def closed_mesh(triangles):
    """An icosphere of so many triangles if there is one, else a bumpy sphere of rings."""
    subdivisions = max(0, round(math.log(triangles / 20, 4)))
    if abs(20 * 4**subdivisions / triangles - 1) < 0.05:
        return trimesh.creation.icosphere(subdivisions=subdivisions)
    rings = round(math.sqrt(triangles / 4))
    around = 2 * rings  # vertices of a ring
    polar = np.linspace(0, math.pi, rings + 2)[1:-1, None]
    azimuth = 2 * math.pi * np.arange(around) / around
    x, y = np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth)
    z = np.cos(polar) + 0 * azimuth
    vertices = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    vertices = np.concatenate([vertices, [[0, 0, 1], [0, 0, -1]]])
    number = np.arange(rings * around).reshape(rings, around)
    a, b = number[:-1], np.roll(number, -1, axis=1)[:-1]
    c, d = number[1:], np.roll(number, -1, axis=1)[1:]
    north, south = np.full(around, len(vertices) - 2), np.full(around, len(vertices) - 1)
    last = number[-1]
    faces = [(a, c, d), (a, d, b), (north, a[0], b[0]), (south, np.roll(last, -1), last)]
    faces = np.concatenate([np.stack(corners, axis=-1).reshape(-1, 3) for corners in faces])
    x, y, z = vertices.T
    radius = 1 + 0.05 * np.sin(3 * x) * np.cos(4 * y) * np.sin(5 * z + 1)
    return trimesh.Trimesh(vertices * radius[:, None], faces, process=False)


def rays_within(count, draw):
    """Origins near the middle of a mesh, directions all around."""
    origins = draw.uniform(-0.3, 0.3, (count, 3))
    directions = draw.normal(size=(count, 3))
    return origins, directions / np.linalg.norm(directions, axis=1, keepdims=True)


def raw_embreex(mesh, origins, directions, pool):
    """A scene, and a call that asks it for triangles only, in float32, on all threads."""
    scene = EmbreeScene()
    TriangleMesh(scene, mesh.triangles.astype(np.float32))
    o, d = origins.astype(np.float32), directions.astype(np.float32)
    scene.run(o[:1], d[:1])
    if THREADS == 1:
        return scene, lambda: scene.run(o, d)
    ends = [len(o) * k // THREADS for k in range(THREADS + 1)]
    parts = [slice(*pair) for pair in itertools.pairwise(ends)]
    return scene, lambda: list(pool.map(lambda part: scene.run(o[part], d[part]), parts))


def mesh_rows(triangles, count, draw):
    """A closed mesh with random rays from within."""
    mesh = closed_mesh(triangles)
    name = f"mesh {len(mesh.faces)}"
    origins, directions = rays_within(count, draw)
    seconds, _ = best(lambda: raytrace.intersect_mesh(mesh, origins[:1], directions[:1]), 1)
    yield name, "nlosoptics, built", seconds, math.nan
    hits = raytrace.intersect_mesh(mesh, origins, directions)
    some = slice(0, 20_000)
    rays = origins[some], directions[some]
    error = facet_error(mesh, hits.triangle[some], *rays, hits.distance[some])
    with ThreadPoolExecutor(THREADS) as pool:
        scene, raw = raw_embreex(mesh, origins, directions, pool)
        ours, theirs = alternately(lambda: raytrace.intersect_mesh(mesh, origins, directions), raw)
    yield name, "nlosoptics", ours, error
    o, d = (v.astype(np.float32) for v in rays)
    answer = scene.run(o, d, output=True)
    # what it says of distance is float32; a leak has none
    error = facet_error(mesh, np.maximum(answer["primID"], 0), *rays, answer["tfar"])
    yield name, "embreex", theirs, error
    compare(name, ours, theirs, "embreex")

    few = slice(0, count // 5)
    seconds, _ = best(lambda: mesh.ray.intersects_first(origins[few], directions[few]), 2)
    yield name, "trimesh, triangle only", 5 * seconds, math.nan
    where = mesh.ray.intersects_location
    seconds, _ = best(lambda: where(origins[few], directions[few], multiple_hits=False), 2)
    yield name, "trimesh, location", 5 * seconds, math.nan


def growth(draw, rays=1_000_000):
    """Seconds against triangles and against rays, and the exponents of a fitted power."""
    report = {}
    sizes = [1_280, 5_120, 20_480, 81_920, 327_680, 1_310_720]
    counts = [10_000, 30_000, 100_000, 300_000, 1_000_000, 4_000_000]
    cases = {"triangles": [(n, rays) for n in sizes], "rays": [(81_920, n) for n in counts]}
    for grown, pairs in cases.items():
        found = []
        print(f"{grown:>12s} {'nlosoptics s':>13s} {'embreex s':>13s} {'ratio':>6s}")
        for triangles, count in pairs:
            mesh = closed_mesh(triangles)
            origins, directions = rays_within(count, draw)
            raytrace.intersect_mesh(mesh, origins[:1], directions[:1])
            with ThreadPoolExecutor(THREADS) as pool:
                _, raw = raw_embreex(mesh, origins, directions, pool)
                ours = partial(raytrace.intersect_mesh, mesh, origins, directions)
                found.append(alternately(ours, raw))
            a, b = found[-1]
            n = triangles if grown == "triangles" else count
            print(f"{n:12d} {a:13.5f} {b:13.5f} {b / a:6.2f}")
        amounts = [pair[0] if grown == "triangles" else pair[1] for pair in pairs]
        exponents = np.polyfit(np.log(amounts), np.log(found), 1)[0]
        print(f"{'exponent':>12s} {exponents[0]:13.3f} {exponents[1]:13.3f}")
        report[grown] = {
            "amounts": amounts,
            "nlosoptics_seconds": [pair[0] for pair in found],
            "embreex_seconds": [pair[1] for pair in found],
            "exponents": {"nlosoptics": float(exponents[0]), "embreex": float(exponents[1])},
        }
    return report


def leaks(draw, triangles=81_920, rays=10_000_000):
    """Rays from within a closed mesh that get out: at random, and aimed at vertices and edges."""
    mesh, found = closed_mesh(triangles), {}
    vertices, edges = np.asarray(mesh.vertices), np.asarray(mesh.edges_unique)
    for kind, total in (("random", rays), ("vertices", rays // 5), ("edges", rays // 5)):
        out = 0
        for start in range(0, total, 1_000_000):
            count = min(1_000_000, total - start)
            origins, directions = rays_within(count, draw)
            if kind == "vertices":
                directions = vertices[draw.integers(len(vertices), size=count)] - origins
            elif kind == "edges":
                ends = vertices[edges[draw.integers(len(edges), size=count)]]
                share = draw.uniform(size=(count, 1))
                directions = ends[:, 0] + share * (ends[:, 1] - ends[:, 0]) - origins
            out += int((~raytrace.intersect_mesh(mesh, origins, directions).hit).sum())
        print(f"{kind:10s} {total:9d} rays, {out} leaks")
        found[kind] = {"rays": total, "leaks": out, "triangles": len(mesh.faces)}
    return found


def main():
    """Print the table, or what an option asks for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rays", type=int, default=1_000_000)
    parser.add_argument("--triangles", type=int, nargs="+", default=SIZES)
    parser.add_argument("--growth", action="store_true", help="only the growth of the cost")
    parser.add_argument("--leaks", action="store_true", help="only the leaks of a closed mesh")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    draw, rows = np.random.default_rng(0), []
    if options.growth or options.leaks:
        report = {"growth": growth(draw, options.rays)} if options.growth else {}
        report |= {"leaks": leaks(draw)} if options.leaks else {}
        if options.json:
            options.json.write_text(json.dumps(report, indent=1) + "\n")
        return
    print(f"Threads: {THREADS}")
    print(f"{'surface':18s} {'by':24s} {'seconds':>9s} {'Mray/s':>8s} {'error':>9s}")
    parts = [wall_rows(options.rays, draw), mesh_wall_rows(options.rays, draw)]
    parts += [mesh_rows(triangles, options.rays, draw) for triangles in options.triangles]
    for part in parts:
        for surface, by, seconds, error in part:
            rays = 1 if by.endswith("built") else options.rays
            print(f"{surface:18s} {by:24s} {seconds:9.4f} {rays / seconds / 1e6:8.2f} {error:9.1e}")
            rows.append(
                {
                    "surface": surface,
                    "by": by,
                    "rays": rays,
                    "seconds": seconds,
                    "relative_error": None if math.isnan(error) else error,
                }
            )
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
