"""First hits of random rays on random walls and meshes, on record."""

import numpy as np
import pytest
import trimesh

from nlosoptics import raytrace

from ...records import attempt
from ...runs.random_scenes import random_case


def rays(count, height):
    rng = np.random.default_rng(7)
    origins = rng.uniform(-0.6, 0.6, (count, 3)) + np.array([0, 0, height])
    aims = rng.uniform(-0.8, 0.8, (count, 3)) * (1, 1, 0.05)
    away = aims - origins
    away[::9] *= -1
    return origins, away / np.linalg.norm(away, axis=1)[:, None]


@pytest.mark.parametrize("number", range(20))
def test_a_wall(number, on_record):
    wall = random_case(number, wild=number % 2 == 1).scene.wall
    on_record([attempt(raytrace.intersect, wall, *rays(300, h)) for h in (1.0, 0.02)])


@pytest.mark.parametrize("divisions", [0, 1, 3])
def test_a_mesh(divisions, on_record):
    mesh = trimesh.creation.icosphere(divisions, 0.5)
    mesh.vertices[:, 0] *= 1.3
    origins, along = rays(300, 0.9)
    on_record(
        [
            raytrace.intersect_mesh(mesh, origins, along),
            raytrace.intersect_mesh(mesh, origins, along, min_distance=0.7),
            raytrace.all_hits(mesh, origins, along, min_distance=0.1),
            raytrace.occluded(mesh, origins, origins + 0.9 * along),
        ]
    )
