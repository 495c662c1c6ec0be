"""Occluders in the cone of light from an object point by the wall to the lens."""

from __future__ import annotations

import math

import numpy as np

from ..._vectors import Array
from ...errors import SceneError
from ...raytrace import occluded
from ...scene import Scene
from .aiming import aim, point_of, pupil_points


def check_cone(scene: Scene, object_point: Array | None = None) -> bool:
    """Return whether the occluders hide an object point from the whole lens.

    Points are in the world frame, m. Raises `SceneError` if only a part of the lens is hidden.
    """
    rings, spokes = 6, 24  # of the sample rays over the lens, including its rim
    radii = scene.camera.stop_diameter / 2 * np.arange(1, rings + 1)[:, None] / rings
    angles = 2 * math.pi * np.arange(spokes) / spokes
    nodes = np.stack([radii * np.cos(angles), radii * np.sin(angles)], axis=-1).reshape(-1, 2)
    nodes = np.concatenate([np.zeros((1, 2)), nodes])
    axis = scene.camera.axis
    point = point_of(scene, object_point)
    lens = pupil_points(np.array(scene.camera.position), axis, nodes)
    rays = aim(scene.wall, point, lens, axis)
    return hides(scene, point, rays.points, lens)


def hides(scene: Scene, object_point: Array, on_wall: Array, on_lens: Array) -> bool:
    """Return whether the occluders block every path from a point by the wall to the lens.

    ``on_wall`` and ``on_lens`` (n, 3), m, are the points where the paths meet wall and lens. Paths
    that miss the wall are ignored. Raises `SceneError` if only some paths are blocked.
    """
    scene.check_black_occluders()
    mesh = scene.occluding_mesh
    if mesh is None:
        return False
    kept = scene.wall.contains(on_wall[:, 0], on_wall[:, 1])
    on_wall, on_lens = on_wall[kept], on_lens[kept]
    cut = occluded(mesh, object_point, on_wall) | occluded(mesh, on_wall, on_lens)
    if cut.any() and not cut.all():
        point = tuple(round(float(c), 6) for c in object_point)
        raise SceneError(
            f"scene.occluders cut {100 * cut.mean():.2g} % of the cone of light from the object "
            f"point {point} m by the wall to the lens, limit 0 or 100 %: a point spread needs the "
            "whole pupil; move the occluder, or make camera.stop_diameter smaller"
        )
    return bool(cut.size) and bool(cut.all())
