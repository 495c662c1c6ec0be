"""Hidden triangles as they stand in each other's light: neighbours, and where they cross."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .hidden_surfaces import HiddenSurfaces

Array = NDArray[np.float64]
Index = NDArray[np.int64]
#: Triangles, tree of boxes, extent in m, neighbours, and where the lines begin that cross each.
Mesh = tuple[Array, Array, float, Index, Index, Array]


def occluders(surfaces: HiddenSurfaces) -> tuple[Mesh, Index]:
    """What `_shadow_kernels.see` asks, and the number of each of its triangles in the mesh."""
    from ..raytrace.triangles import Facets
    from ._shadow_kernels import crossings

    facets = Facets(surfaces.mesh)
    names = facets.names.astype(np.int64)
    corners = surfaces.corners[names]
    reach = float(np.abs(corners).max())
    begins, lines = np.zeros(len(names) + 1, dtype=np.int64), np.empty((0, 4))
    crossings(facets.rows, facets.boxes, reach, begins, lines)
    begins = np.cumsum(begins)
    if begins[-1]:
        lines = np.empty((begins[-1], 4))
        crossings(facets.rows, facets.boxes, reach, begins, lines)
    return (facets.rows, facets.boxes, reach, neighbours(corners), begins, lines), names


def neighbours(corners: Array) -> Index:
    """Of each side of each triangle the triangle beyond it, as `_shadow_kernels` numbers them.

    Parameters
    ----------
    corners : ndarray
        (n, 3, 3), m; corners that are equal are one.

    Returns
    -------
    ndarray of int64
        (n, 3), of the sides from each corner to the next.
    """
    from ._shadow_kernels import ALONE, FLIPPED

    # with 0.0, lest -0.0 be another number
    _, points = np.unique(corners.reshape(-1, 3) + 0.0, axis=0, return_inverse=True)
    points = points.reshape(-1, 3)
    first, last = points.ravel(), np.roll(points, -1, axis=1).ravel()
    sides = np.stack([np.minimum(first, last), np.maximum(first, last)], axis=1)
    _, side, count = np.unique(sides, axis=0, return_inverse=True, return_counts=True)
    order = np.argsort(side.reshape(-1), kind="stable")
    pairs = order[count[side.reshape(-1)[order]] == 2].reshape(-1, 2)
    found = np.full(first.size, ALONE, dtype=np.int64)
    around = first[pairs[:, 0]] != first[pairs[:, 1]]  # each goes along it the other way
    for here, there in (pairs.T, pairs.T[::-1]):
        found[here] = np.where(around, there // 3, FLIPPED - there // 3)
    return found.reshape(-1, 3)
