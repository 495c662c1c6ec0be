"""Points of the relay wall: grids of them, their checks, and how lasers and sensors pair."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..._checks import is_single, one_of, positive, real, whole
from ...errors import SamplingError, SceneError

Array = NDArray[np.floating]

#: Share of its pitch by which points may lie off an even grid.
UNEVEN = 1e-3


def wall_grid(side: float, count: int, *, centre: tuple[float, float] = (0.0, 0.0)) -> Array:
    """Middles of the cells of a square grid on the wall z = 0.

    Parameters
    ----------
    side : float
        Of the square, m.
    count : int
        Cells along each side.
    centre : (float, float)
        m.

    Returns
    -------
    ndarray
        (count, count, 3), [y, x], m.

    Raises
    ------
    SceneError
        If a value is not finite or out of range.
    """
    side, count = positive("side", side, unit="m"), whole("count", count)
    if is_single(centre) or len(centre) != 2:
        raise SceneError(f"centre = {centre!r} is no place on the wall; give (x, y) in m")
    x, y = (real("centre", value) for value in centre)
    along = (np.arange(count) + 0.5) * (side / count) - 0.5 * side
    points = np.zeros((count, count, 3))
    points[..., 0] = along + x
    points[..., 1] = along[:, None] + y
    return points


def real_array(name: str, values: Any, *, ndmin: int = 0) -> NDArray[np.float64]:
    """A copy of real numbers in double precision; they need not be finite."""
    try:
        array = np.array(values, ndmin=ndmin)
    except ValueError:  # rows of several lengths
        raise SamplingError(f"{name} have rows of several lengths; give them all one") from None
    # an empty list has no type of its own
    if array.dtype.kind not in "iuf" and array.size:
        raise SceneError(f"{name} of type {array.dtype} are no real numbers; give floats in m")
    return array.astype(np.float64, copy=False)


def checked_points(name: str, values: ArrayLike) -> NDArray[np.float64]:
    """A copy of finite points (..., 3)."""
    points = real_array(name, values)
    if points.ndim == 0 or points.shape[-1] != 3 or points.size == 0:
        raise SamplingError(f"{name} have shape {points.shape}, must be (..., 3), m")
    if not np.isfinite(points).all():
        raise SceneError(f"{name} have values that are not finite")
    return points


def points_on_wall(name: str, values: ArrayLike) -> NDArray[np.float64]:
    """A copy of finite points (..., 3) in the plane z = 0."""
    points = checked_points(name, values)
    off = float(np.abs(points[..., 2]).max())
    if off > 1e-9:
        raise SceneError(f"{name} are up to {off:g} m off the wall z = 0; put them on it")
    points[..., 2] = 0.0
    return points


def pair_shape(
    pairing: Any, laser_shape: tuple[int, ...], sensor_shape: tuple[int, ...]
) -> tuple[int, ...]:
    """Axes of the pairs of laser and sensor points, behind the bins.

    Raises
    ------
    SceneError
        If ``pairing`` is neither "all" nor "confocal".
    SamplingError
        If confocal points are not as many of both.
    """
    if one_of("pairing", pairing, ("all", "confocal")) == "all":
        return laser_shape + sensor_shape
    if laser_shape != sensor_shape:
        raise SamplingError(
            f"laser points {laser_shape} and sensor points {sensor_shape} are not pairs; give as "
            "many of both, or pairing='all'"
        )
    return sensor_shape


def even_axes(points: Array) -> tuple[Array, Array, float]:
    """Axes x (nx,) and y (ny,) of the even grid nearest to points (ny, nx, 3).

    Coordinates of single precision are as uneven as they are rounded, and become even here.

    Returns
    -------
    tuple
        x, y, m, and by how much the points are off that grid along x or y, as a share of its pitch.
    """
    first, last = points[0, 0], points[-1, -1]
    x = np.linspace(first[0], last[0], points.shape[1])
    y = np.linspace(first[1], last[1], points.shape[0])
    off = float(np.abs(points[..., :2] - np.stack(np.meshgrid(x, y), axis=-1)).max())
    steps = [abs(axis[1] - axis[0]) for axis in (x, y) if len(axis) > 1]
    pitch = float(min(steps, default=1.0))
    return x, y, off / pitch if pitch > 0.0 else math.inf
