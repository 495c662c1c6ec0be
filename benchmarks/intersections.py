"""Rays on walls and meshes: seconds and error, against raw embreex and trimesh's own ray API.

python benchmarks/intersections.py [--rays 1000000] [--triangles 81920 1310720] [--json FILE]

Walls are timed on NUMBA_NUM_THREADS threads, a plain Newton loop on one; embreex on two threads.
Errors are of the distance, relative: of walls against the surface at the hit over the cosine, of
meshes against the plane of the triangle found, in extended precision.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import trimesh
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numba import njit

from nlosoptics import raytrace
from nlosoptics.scene import ConcaveWall, FlatWall, HeightMapWall, SumWall, WavyWall


def best(work, repeats=4):
    """Least seconds of several calls, and the last result."""
    seconds = math.inf
    for _ in range(repeats):
        start = time.perf_counter()
        result = work()
        seconds = min(seconds, time.perf_counter() - start)
    return seconds, result


@njit(cache=True)
def plain_newton(a, kx, ky, phase, origins, directions, distance):
    """Newton's method from the mean plane for a wave, without any bracket."""
    for i in range(distance.size):
        ox, oy, oz = origins[i]
        dx, dy, dz = directions[i]
        t = -oz / dz
        for _ in range(20):
            angle = kx * (ox + t * dx) + ky * (oy + t * dy) + phase
            slope = dz + a * (kx * dx + ky * dy) * math.sin(angle)
            step = (oz + t * dz - a * math.cos(angle)) / slope
            t -= step
            if abs(step) < 1e-15 * t:
                break
        distance[i] = t


def wall_rows(count, draw):
    """One row a kind of wall, and the plain Newton loop for the wavy one."""
    origins = draw.uniform((-1, -1, 0.6), (1, 1, 1.4), (count, 3))
    directions = draw.uniform((-0.4, -0.4, 0), (0.4, 0.4, 0), (count, 3)) - origins
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    wavy = WavyWall(0.01, 0.2, 0.3, direction=0.4)
    walls = {
        "flat": FlatWall(),
        "sphere": ConcaveWall(4.0),
        "cylinder": ConcaveWall(4.0, shape="cylinder"),
        "wavy": wavy,
        "sum of two waves": SumWall(wavy, WavyWall(0.004, 0.13, direction=1.0)),
        "height map": HeightMapWall.random(
            height_rms=1e-3, correlation_length=0.05, size=1.2, pitch=5e-3
        ),
    }
    for name, wall in walls.items():
        seconds, hits = best(lambda wall=wall: raytrace.intersect(wall, origins, directions))
        x, y, z = hits.points[hits.hit].T
        gap = np.abs(z - wall.height(x, y)) * hits.normals[hits.hit][:, 2]
        cosine = np.abs((hits.normals * directions).sum(axis=1)[hits.hit])
        yield name, "nlosoptics", seconds, float((gap / cosine / hits.distance[hits.hit]).max())
    distance = np.empty(count)
    row = wavy._terms()[0][0, 1:5]
    seconds, _ = best(lambda: plain_newton(*row, origins, directions, distance))
    exact = raytrace.intersect(wavy, origins, directions).distance
    yield "wavy", "plain Newton", seconds, float(np.abs(distance / exact - 1).max())


def facet_error(mesh, triangle, origins, directions, distance):
    """Largest relative error of distances to the planes of triangles."""
    a, b, c = np.moveaxis(np.asarray(mesh.triangles, np.longdouble)[triangle], 1, 0)
    normal = np.cross(b - a, c - a)
    exact = (normal * (a - origins)).sum(axis=1) / (normal * directions).sum(axis=1)
    return float(np.abs(distance / exact - 1).max())


def mesh_rows(triangles, count, draw):
    """A closed mesh with random rays from within."""
    subdivisions = max(0, round(math.log(triangles / 20, 4)))
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions)
    name = f"mesh {len(mesh.faces)}"
    origins = draw.uniform(-0.3, 0.3, (count, 3))
    directions = draw.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    seconds, _ = best(lambda: raytrace.intersect_mesh(mesh, origins[:1], directions[:1]), 1)
    yield name, "nlosoptics, built", seconds, math.nan
    seconds, hits = best(lambda: raytrace.intersect_mesh(mesh, origins, directions))
    some = slice(0, 20_000)
    rays = origins[some], directions[some]
    error = facet_error(mesh, hits.triangle[some], *rays, hits.distance[some])
    yield name, "nlosoptics", seconds, error

    scene = EmbreeScene()
    TriangleMesh(scene, mesh.triangles.astype(np.float32))
    o, d = origins.astype(np.float32), directions.astype(np.float32)
    scene.run(o[:1], d[:1])
    halves = [slice(0, count // 2), slice(count // 2, count)]
    with ThreadPoolExecutor(2) as pool:
        seconds, _ = best(lambda: list(pool.map(lambda part: scene.run(o[part], d[part]), halves)))
    answer = scene.run(o[some], d[some], output=True)
    # what it says of distance is float32; a leak has none
    error = facet_error(mesh, np.maximum(answer["primID"], 0), *rays, answer["tfar"])
    yield name, "embreex, 2 threads", seconds, error

    few = slice(0, count // 5)
    seconds, _ = best(lambda: mesh.ray.intersects_first(origins[few], directions[few]), 2)
    yield name, "trimesh, triangle only", 5 * seconds, math.nan
    where = mesh.ray.intersects_location
    seconds, _ = best(lambda: where(origins[few], directions[few], multiple_hits=False), 2)
    yield name, "trimesh, location", 5 * seconds, math.nan


def main():
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rays", type=int, default=1_000_000)
    parser.add_argument("--triangles", type=int, nargs="+", default=[81_920, 1_310_720])
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    draw, rows = np.random.default_rng(0), []
    print(f"{'surface':18s} {'by':24s} {'seconds':>9s} {'Mray/s':>8s} {'error':>9s}")
    parts = [wall_rows(options.rays, draw)]
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
