"""Tilts of wall facets as slopes of the wave in the pupil."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...errors import SamplingError, SceneError
from ...scene import Scene
from .wall_view import _optics, _zoom

Array = NDArray[np.float64]


def pupil_slopes(scene: Scene, slopes: ArrayLike, positions: ArrayLike, nodes: ArrayLike) -> Array:
    """Compute the slopes of the wave in the exit pupil that tilted facets of the wall cause.

    A facet is a small flat part of the wall. The mean wall is the wall without its facets' tilts.

    Parameters
    ----------
    scene : Scene
        Scene with the camera, the hidden object and the mean wall.
    slopes : array_like, (ny, nx, 2)
        Slopes s1 and s2 of each facet relative to the mean wall. The normal of a facet is parallel
        to ``n - s1 t1 - s2 t2``, with n the normal of the mean wall, t1 its tangent along x and
        t2 = n x t1.
    positions : array_like, (ny, nx, 3)
        Centres of the facets in world coordinates, m, on a square lattice; y increases from
        row to row, x along a row.
    nodes : array_like, (n, 2)
        Points (u, v) of the exit pupil, m.

    Returns
    -------
    ndarray, (n, 2)
        Slopes dW/du and dW/dv that the facets add to the aberration W, rad, to first order in the
        facets' slopes.

    Raises
    ------
    SamplingError
        If a pupil point sees a wall point where there is no facet.
    CausticError
        If the aberration of the mean wall has no single value.
    SceneError
        If an array has the wrong shape or is not finite.

    See Also
    --------
    wavefront_from_slopes : Wave from slopes, by least squares.
    scene_point_spread : Pupil function and PSF of a scene with a rough wall.

    Notes
    -----
    A pupil point p sees the wall point M p, with the matrix
    ``M = [P_i/d1 + P_o/d2 - (cos_i + cos_o) K]^-1 E/d2``. Facet slopes ``g = (s1, s2)`` change the
    slopes of the wave by ``-(cos_i + cos_o) M^T g``. The symbols are:

    - i and o: the rays from the wall point to the object (i) and to the lens (o), of lengths d1 and
      d2; cos_i and cos_o are the cosines of their angles to the wall's normal,
    - P_i and P_o: the matrix ``1 - e e^T`` for the ray i or o, with e the component of the ray's
      unit vector in the wall's tangent plane,
    - K: second derivatives of the mean wall, positive if the wall is concave to the room,
    - E: 2 x 2 matrix of scalar products. The u and v axes are projected onto the plane that is
      perpendicular to the ray o; row 1 has their products with t1, row 2 those with t2.
    """
    table, x, y = _lattice(slopes, positions)
    points = np.asarray(nodes, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 2 or not np.isfinite(points).all():
        raise SceneError(f"nodes have shape {points.shape}; give (n, 2) finite u and v in m")
    zoom = _zoom(scene)
    seen = _optics(scene, points / zoom)
    columns, rows = (_cell_index(axis, seen.points[:, k]) for k, axis in enumerate((x, y)))
    outside = (columns < 0) | (columns >= len(x)) | (rows < 0) | (rows >= len(y))
    if outside.any():
        i = int(np.argmax(outside))
        raise SamplingError(
            f"pupil node {i} sees the wall at x = {seen.points[i, 0]:.6g} m, y = "
            f"{seen.points[i, 1]:.6g} m, beyond the cells (x from {x[0]:.6g} to {x[-1]:.6g} m, y "
            f"from {y[0]:.6g} to {y[-1]:.6g} m); give facets on the whole patch that the pupil sees"
        )
    tilt = table[rows, columns]
    found = -seen.cosines[:, None] * np.einsum("nba,nb->na", seen.footprint, tilt)
    return np.asarray(found / zoom)


def _lattice(slopes: ArrayLike, positions: ArrayLike) -> tuple[Array, Array, Array]:
    """Check facets and return their slopes (ny, nx, 2) and the cells' x (nx,) and y (ny,), m."""
    table, places = np.asarray(slopes, np.float64), np.asarray(positions, np.float64)
    if table.ndim != 3 or table.shape[2] != 2 or places.shape != (*table.shape[:2], 3):
        raise SceneError(
            f"slopes have shape {table.shape} and positions {places.shape}; give (ny, nx, 2) and "
            "(ny, nx, 3)"
        )
    if min(table.shape[:2]) < 2:
        raise SceneError(f"slopes have shape {table.shape}; give two cells or more per axis")
    if not (np.isfinite(table).all() and np.isfinite(places).all()):
        raise SceneError("slopes or positions hold NaN or infinity; give finite facets")
    x, y = places[0, :, 0], places[:, 0, 1]
    for axis, found in ((x, places[..., 0]), (y[:, None], places[..., 1])):
        step = (axis.ravel()[-1] - axis.ravel()[0]) / (axis.size - 1)
        even = axis.ravel()[0] + step * np.arange(axis.size)
        error = max(float(np.abs(found - axis).max()), float(np.abs(axis.ravel() - even).max()))
        if not (step > 0 and error <= 1e-6 * step):
            raise SceneError(
                f"positions are {error:.3g} m off a lattice of {step:.3g} m; give the centres of "
                "square cells, rows along y"
            )
    return table, x, y


def _cell_index(centres: Array, at: Array) -> NDArray[np.int64]:
    """Index of the cell that contains each coordinate; out of range for coordinates outside."""
    step = (centres[-1] - centres[0]) / (len(centres) - 1)
    return np.asarray(np.floor((at - centres[0]) / step + 0.5), dtype=np.int64)
