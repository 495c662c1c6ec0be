"""Points on the relay wall: grids, checks, and the pairing of laser and sensor points."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..._checks import is_single, one_of, positive, real, whole
from ...errors import SamplingError, SceneError

Array = NDArray[np.floating]

#: Largest deviation of points from an even grid, as a fraction of its pitch.
UNEVEN = 1e-3


def wall_grid(side: float, count: int, *, centre: tuple[float, float] = (0.0, 0.0)) -> Array:
    """Return the points of a square grid on the wall z = 0, at the centres of its cells.

    Parameters
    ----------
    side : float
        Side of the square, m.
    count : int
        Number of cells along each side.
    centre : (float, float)
        Centre (x, y) of the square, m.

    Returns
    -------
    ndarray
        Points (count, count, 3), ordered [y, x] with row 0 at the lowest y, world frame, m.

    Raises
    ------
    SceneError
        If a value is not finite or out of range.

    See Also
    --------
    render : Simulated capture of hidden meshes.
    TransientCapture : Time-resolved capture.

    Examples
    --------
    >>> from nlosoptics.transient import wall_grid
    >>> points = wall_grid(side=2.0, count=4)
    >>> points.shape
    (4, 4, 3)
    >>> print(points[0, :, 0])
    [-0.75 -0.25  0.25  0.75]
    """
    side, count = positive("side", side, unit="m"), whole("count", count)
    if is_single(centre) or not hasattr(centre, "__len__") or len(centre) != 2:
        raise SceneError(f"centre = {centre!r} is not a point on the wall; give (x, y) in m")
    x, y = (real("centre", value) for value in centre)
    along = (np.arange(count) + 0.5) * (side / count) - 0.5 * side
    points = np.zeros((count, count, 3))
    points[..., 0] = along + x
    points[..., 1] = along[:, None] + y
    return points


def real_array(name: str, values: Any, *, ndmin: int = 0) -> NDArray[np.float64]:
    """Return a float64 copy of an array of real numbers, which need not be finite."""
    try:
        array = np.array(values, ndmin=ndmin)
    except ValueError:  # rows of several lengths
        raise SamplingError(
            f"{name} have rows of several lengths; give rows of equal length"
        ) from None
    # the type of an empty list says nothing
    if array.dtype.kind not in "iuf" and array.size:
        raise SceneError(f"{name} of type {array.dtype} are not real numbers; give floats in m")
    return array.astype(np.float64, copy=False)


def checked_points(name: str, values: ArrayLike) -> NDArray[np.float64]:
    """Return a float64 copy of finite points (..., 3)."""
    points = real_array(name, values)
    if points.ndim == 0 or points.shape[-1] != 3 or points.size == 0:
        raise SamplingError(
            f"{name} have shape {points.shape}, must be (..., 3); give x, y and z in m"
        )
    if not np.isfinite(points).all():
        raise SceneError(f"{name} have values that are not finite; give finite numbers in m")
    return points


def points_on_wall(name: str, values: ArrayLike) -> NDArray[np.float64]:
    """Return a float64 copy of finite points (..., 3) that lie in the plane z = 0."""
    points = checked_points(name, values)
    off = float(np.abs(points[..., 2]).max())
    if off > 1e-9:
        raise SceneError(
            f"{name} are up to {off:g} m off the wall z = 0, limit 1e-09 m; move them onto it"
        )
    points[..., 2] = 0.0
    return points


def pair_shape(
    pairing: Any, laser_shape: tuple[int, ...], sensor_shape: tuple[int, ...]
) -> tuple[int, ...]:
    """Return the shape of a capture behind its time axis."""
    if one_of("pairing", pairing, ("all", "confocal")) == "all":
        return laser_shape + sensor_shape
    if laser_shape != sensor_shape:
        raise SamplingError(
            f"laser points {laser_shape} and sensor points {sensor_shape} are not pairs, their "
            "shapes must be equal; give one laser point per sensor point, or pairing='all'"
        )
    return sensor_shape


def even_axes(points: Array) -> tuple[Array, Array, float]:
    """Fit an even grid with axes x (nx,) and y (ny,) to points (ny, nx, 3).

    This also removes the rounding of single-precision coordinates.

    Returns x and y, m, and the largest deviation of the points from that grid along x or y, as a
    fraction of its pitch.
    """
    first, last = points[0, 0], points[-1, -1]
    x = np.linspace(first[0], last[0], points.shape[1])
    y = np.linspace(first[1], last[1], points.shape[0])
    off = float(np.abs(points[..., :2] - np.stack(np.meshgrid(x, y), axis=-1)).max())
    steps = [abs(axis[1] - axis[0]) for axis in (x, y) if len(axis) > 1]
    pitch = float(min(steps, default=1.0))
    return x, y, off / pitch if pitch > 0.0 else math.inf


def point_steps(points: Array) -> list[Array]:
    """Return the distances of neighbouring points along each axis of a grid with several, m."""
    return [
        np.linalg.norm(np.diff(points, axis=axis), axis=-1).ravel()
        for axis in range(points.ndim - 1)
        if points.shape[axis] > 1
    ]
