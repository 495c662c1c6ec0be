"""Time-resolved light and its images."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
import trimesh

from .. import transient
from ..scene import Lambert

_DELTA, _BINS = 0.01, 320  # m of path
_POINT = np.array([0.11, -0.23, 0.72])


def _plate(side: float, centre: tuple[float, float, float]) -> trimesh.Trimesh:
    """Return a square that faces the wall."""
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * side / 2 + centre
    return trimesh.Trimesh(corners, [[0, 2, 1], [0, 3, 2]], process=False)


def light_of_a_patch() -> tuple[float, float]:
    """Light of a small patch, relative, in its bin: z^4/(pi^2 r1^4 r2^4)."""
    side, at = 1e-3, (0.4, 0.2, 0.8)
    laser, sensor = np.array([0.1, -0.2, 0.0]), np.array([0.3, 0.4, 0.0])
    scan = transient.Scan(
        laser_points=laser,
        sensor_points=sensor,
        wall_albedo=0.5,
        t_start=0.5,
        delta_t=0.1,
        n_bins=30,
    )
    capture = transient.render([(_plate(side, at), Lambert(0.7))], scan, max_bounces=3)
    r1, r2 = (np.linalg.norm(p - at) for p in (laser, sensor))
    expected = np.zeros(30)
    expected[int((r1 + r2 - 0.5) / 0.1)] = 0.35 * side**2 * 0.8**4 / (np.pi**2 * r1**4 * r2**4)
    return abs(capture.H.ravel() - expected).max() / expected.max(), 1e-4


def light_of_a_plane() -> tuple[float, float]:
    """Light of a wide plane over time, relative: [(2z/t0)^6 - (2z/t1)^6]/(3 pi z^2)."""
    z, at = 0.8, (0.2, 0.1, 0.0)
    scan = transient.Scan(laser_points=at, sensor_points=at, t_start=1.5, delta_t=0.05, n_bins=50)
    plane = _plate(60.0, (0.0, 0.0, z))
    capture = transient.render([(plane, Lambert(1.0))], scan, max_bounces=3, tol=1e-5)
    t = np.maximum(capture.edges, 2 * z)
    expected = ((2 * z / t[:-1]) ** 6 - (2 * z / t[1:]) ** 6) / (3 * math.pi * z**2)
    return abs(capture.H.ravel() - expected).sum() / expected.sum(), 2e-5


def _seen(image: transient.VolumeImage) -> float:
    """Return how far from `_POINT` the light's middle is, m."""
    light = image.intensity * (image.intensity > 0.5 * image.intensity.max())
    axes = np.meshgrid(image.volume.z, image.volume.y, image.volume.x, indexing="ij")
    z, y, x = ((light * axis).sum() / light.sum() for axis in axes)
    return float(np.linalg.norm(np.array([x, y, z]) - _POINT))


def _pulses(
    laser_points: np.ndarray, sensor_points: np.ndarray, pairing: Literal["all", "confocal"]
) -> transient.TransientCapture:
    """Return the light of a point, as pulses of 2 cm of path."""
    to, back = (np.linalg.norm(p - _POINT, axis=-1) for p in (laser_points, sensor_points))
    t = _DELTA * (np.arange(_BINS)[:, None, None] + 0.5)
    light = np.exp(-0.5 * ((t - to - back) / 0.02) ** 2) / (to * back) ** 2
    return transient.TransientCapture(
        H=light,
        laser_points=laser_points,
        sensor_points=sensor_points,
        delta_t=_DELTA,
        pairing=pairing,
    )


def _volume() -> transient.Volume:
    return transient.Volume.box(_POINT + np.array([0.002, -0.001, 0.002]), np.full(3, 0.15), 0.006)


def confocal_images() -> tuple[float, float]:
    """Point by f-k migration and the light-cone transform, m: it is where it was put."""
    grid = transient.wall_grid(1.0, 32)
    capture = _pulses(grid, grid, "confocal")
    methods = (transient.fk_migration, transient.lct)
    return max(_seen(method(capture, _volume())) for method in methods), 0.002


def phasor_field() -> tuple[float, float]:
    """Point by the phasor field of a single laser, m: it is where it was put."""
    capture = _pulses(np.zeros(3), transient.wall_grid(1.0, 32), "all")
    return _seen(transient.phasor_image(capture, _volume(), wl_mean=0.08)), 0.002
