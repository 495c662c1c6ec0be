"""Three bounces by brute force: middles of a fine grid of triangles, in numpy alone."""

from __future__ import annotations

import numpy as np

from nlosoptics import raytrace


def middles(corners, n):
    """Centroids (n^2, 3) of the n^2 equal parts of a triangle, and the area of each."""
    i, j = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    up, down = i + j < n, i + j < n - 1
    u = np.concatenate([i[up] + 1 / 3, i[down] + 2 / 3]) / n
    v = np.concatenate([j[up] + 1 / 3, j[down] + 2 / 3]) / n
    o, a, b = corners[0], corners[1] - corners[0], corners[2] - corners[0]
    area = 0.5 * np.linalg.norm(np.cross(a, b)) / n**2
    return o + u[:, None] * a + v[:, None] * b, area


def brute_force(surfaces, laser, sensor, edges, n, *, shadows=None, wall_normal=(0, 0, 1)):
    """G over bins; ``shadows`` is the mesh that may stand in between."""
    laser, sensor = np.asarray(laser, float), np.asarray(sensor, float)
    total = np.zeros(len(edges) - 1)
    for mesh, material in surfaces:
        for corners in np.asarray(mesh.vertices)[mesh.faces]:
            x, area = middles(corners, n)
            normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
            normal /= np.linalg.norm(normal)
            to_l, to_c = laser - x, sensor - x
            r1, r2 = np.linalg.norm(to_l, axis=1), np.linalg.norm(to_c, axis=1)
            to_l, to_c = to_l / r1[:, None], to_c / r2[:, None]
            mu_1, mu_2 = to_l @ normal, to_c @ normal
            facing = np.where(mu_1 > 0.0, 1.0, -1.0)[:, None] * normal
            # the cosines at the wall are those of the way back
            value = (
                (to_l @ wall_normal)
                * (to_c @ wall_normal)
                * np.abs(mu_1 * mu_2)
                / (r1 * r2) ** 2
                / np.pi
            )
            value *= material.evaluate(to_l, to_c, facing) * area
            value[mu_1 * mu_2 <= 0.0] = 0.0
            if shadows is not None:
                value[raytrace.occluded(shadows, x, np.broadcast_to(laser, x.shape))] = 0.0
                value[raytrace.occluded(shadows, x, np.broadcast_to(sensor, x.shape))] = 0.0
            total += np.histogram(r1 + r2, bins=edges, weights=value)[0]
    return total
