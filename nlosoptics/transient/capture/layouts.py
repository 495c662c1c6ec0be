"""Values of a capture file, before they are a capture: checks and axes common to all layouts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._checks import fits_memory, real, vector
from ...errors import SamplingError, SceneError

Array = NDArray[Any]

LIGHT = 299792458.0  # m/s


@dataclass(kw_only=True)
class Found:
    """Values of a capture file, None where it does not say; space as it lies in the file.

    ``H`` is (n_bins, *laser axes, *sensor axes) as in `TransientCapture`. ``needs`` has, by
    argument of `load_capture`, why it must be given; ``doubt`` what ``format`` settles, and so do
    the arguments ``instead``.
    """

    layout: str
    H: Array
    sensor_points: Any = None  # (..., 3), m, as are the next three
    laser_points: Any = None
    sensor_normals: Any = None
    laser_normals: Any = None
    sensor_origin: Any = None
    laser_origin: Any = None
    delta_t: float | None = None
    t_start: float | None = None
    pairing: Any = None
    outer_legs: bool | None = None
    quantity: str = "unknown"
    by_bounce: dict[int, Array] = field(default_factory=dict)
    standard_error: Array | None = None
    details: dict[str, Any] = field(default_factory=dict)
    needs: dict[str, str] = field(default_factory=dict)
    doubt: str = ""
    instead: tuple[str, ...] = ()


def number(variables: Mapping[str, Any], key: str) -> float | None:
    """One number of a file; None where it is absent or empty."""
    value = variables.get(key)
    if value is None or np.size(value) == 0:
        return None
    if np.size(value) != 1:
        raise SceneError(f"{key} has {np.size(value)} values, must be one number")
    return real(key, np.asarray(value).reshape(())[()])


def array(variables: Mapping[str, Any], key: str, *ndims: int) -> Array:
    """An array of real numbers of a file, as stored, of one of ``ndims`` dimensions."""
    value = variables.get(key)
    if value is None:
        raise SceneError(f"{key} is missing; the file is not whole")
    values = np.asarray(value)
    if values.dtype.kind not in "biuf":
        raise SceneError(f"{key} holds {values.dtype} values, must be real numbers")
    if values.ndim not in ndims:
        wanted = " or ".join(map(str, ndims))
        raise SamplingError(f"{key} has shape {values.shape}, must have {wanted} dimensions")
    return values


def bins(values: Array) -> Array:
    """Bins in single or double precision; whole numbers become double."""
    if values.dtype in (np.float32, np.float64):
        return values
    fits_memory("H", 8.0 * values.size, "free memory, or load a part of the file")
    return values.astype(np.float64)


def triple(variables: Mapping[str, Any], key: str) -> Any:
    """Three numbers of a file; None where they are absent."""
    value = variables.get(key)
    if value is None or np.size(value) == 0:
        return None
    return vector(key, array(variables, key, 0, 1, 2, 3).ravel())


def upright(found: Found) -> Found:
    """Turn grids by their points to [y, x] that rise, of a layout that may lay them any way."""
    paired = found.pairing == "confocal"
    shapes = [] if found.laser_points is None else [found.laser_points.ndim - 1]
    lasers = 0 if paired or not shapes else shapes[0]
    for name, first in (("laser", 1), ("sensor", 1 + lasers)):
        points = getattr(found, f"{name}_points")
        if points is None or points.ndim != 3:
            continue
        turn = _turn(points)
        for key in (f"{name}_points", f"{name}_normals"):
            if getattr(found, key) is not None:
                setattr(found, key, turned(getattr(found, key), turn, 0))
        if name == "sensor" or not paired:
            found.H = turned(found.H, turn, first)
    return found


def _turn(points: Array) -> tuple[bool, bool, bool]:
    """Whether (ny or nx, ..., 3) points need a transposition, then flips of rows and columns."""
    last = points[-1, 0] - points[0, 0], points[0, -1] - points[0, 0]
    down, across = last
    swap = abs(down[0]) > abs(down[1]) or abs(across[1]) > abs(across[0])
    if swap:
        down, across = across, down
    return bool(swap), bool(down[1] < 0.0), bool(across[0] < 0.0)


def turned(values: Array, turn: tuple[bool, bool, bool], axis: int) -> Array:
    """Transpose and flip two axes of an array, from ``axis`` on."""
    swap, rows, columns = turn
    if swap:
        values = values.swapaxes(axis, axis + 1)
    if rows:
        values = np.flip(values, axis)
    return np.flip(values, axis + 1) if columns else values
