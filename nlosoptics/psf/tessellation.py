"""Areas of the plane that belong to scattered points: Voronoi cells, whole and within a disc."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

FAR: Final = 12.0  # disc radii, where a ring of further points closes the outermost cells
RING: Final = 64


def cell_areas(sites: Array, radius: float) -> tuple[Array, Array, NDArray[np.int64]]:
    """Areas of Voronoi cells, their areas within a disc, and which cells are neighbours.

    Parameters
    ----------
    sites : ndarray, (n, 2)
        m, within 3 radii of the origin.
    radius : float
        Of the disc about the origin, m.

    Returns
    -------
    whole : ndarray, (n,)
        m^2; the outermost cells end half way to a ring of 12 radii.
    within : ndarray, (n,)
        m^2; they add up to the disc's area. A site that coincides with another has 0 of both.
    neighbours : ndarray of int, (m, 2)
        Pairs of sites whose cells share an edge.
    """
    from scipy.spatial import Voronoi

    n = len(sites)
    angle = 2 * np.pi * (np.arange(RING) + 0.5) / RING
    ring = FAR * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    points = np.concatenate([sites / radius, ring])
    diagram = Voronoi(points)
    pairs = np.asarray(diagram.ridge_points, dtype=np.int64)
    corners = np.asarray(diagram.ridge_vertices, dtype=np.int64)
    closed = (corners >= 0).all(axis=1)
    pairs, corners = pairs[closed], corners[closed]
    start, end = diagram.vertices[corners[:, 0]], diagram.vertices[corners[:, 1]]
    whole, within = np.zeros(n + RING), np.zeros(n + RING)
    for side in (0, 1):
        owner = pairs[:, side]
        a, b = start - points[owner], end - points[owner]
        cross = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
        turn = np.sign(cross)
        whole += np.bincount(owner, np.abs(cross) / 2, minlength=n + RING)
        within += np.bincount(owner, turn * _sectors(start, end), minlength=n + RING)
    inner = (pairs < n).all(axis=1)
    scale = radius**2
    return whole[:n] * scale, np.maximum(within[:n], 0.0) * scale, pairs[inner]


def _sectors(a: Array, b: Array) -> Array:
    """Signed area of the triangle from the origin to a and b, (n, 2), within the unit disc."""
    d = b - a
    square = np.sum(d * d, axis=1)
    along = -np.sum(a * d, axis=1)
    # |a + t d| = 1
    root = along**2 - square * (np.sum(a * a, axis=1) - 1)
    crosses = (root > 0) & (square > 0)
    half = np.sqrt(np.where(crosses, root, 0.0))
    safe = np.where(square > 0, square, 1.0)
    enter, leave = ((along + s * half) / safe for s in (-1, 1))
    crosses &= (enter < 1) & (leave > 0)
    enter, leave = np.clip(enter, 0, 1), np.clip(leave, 0, 1)
    p, q = a + enter[:, None] * d, a + leave[:, None] * d
    cut = _angle(a, p) / 2 + _cross(p, q) / 2 + _angle(q, b) / 2
    return np.where(crosses, cut, _angle(a, b) / 2)


def _cross(a: Array, b: Array) -> Array:
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def _angle(a: Array, b: Array) -> Array:
    """Signed angle from a to b, rad."""
    return np.asarray(np.arctan2(_cross(a, b), np.sum(a * b, axis=1)))
