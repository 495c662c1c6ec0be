"""Values read from a capture file: checks and axis conventions common to all layouts."""

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
    """Values read from a capture file; None where the file does not state a value.

    Axes of ``H`` are (n_bins, *laser axes, *sensor axes) as in `TransientCapture`, but spatial
    axes still run in the file's direction. ``needs`` maps each argument of `load_capture` that the
    user must give to the reason. ``doubt`` is an assumption in reading the file that nothing in
    it proves, or empty. The user confirms it with the argument ``format``, or makes it unnecessary
    by giving all arguments named in ``instead``.
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
    """Return one number of a file, or None if it is absent or empty."""
    value = variables.get(key)
    if value is None or np.size(value) == 0:
        return None
    if np.size(value) != 1:
        raise SceneError(f"{key} has {np.size(value)} values, must be one number; correct the file")
    return real(key, np.asarray(value).reshape(())[()])


def array(variables: Mapping[str, Any], key: str, *ndims: int) -> Array:
    """Return an array of real numbers as stored; its number of axes must be among ``ndims``."""
    value = variables.get(key)
    if value is None:
        raise SceneError(f"{key} is missing, the file is incomplete; copy or write it again")
    values = np.asarray(value)
    if values.dtype.kind not in "biuf":
        raise SceneError(
            f"{key} holds {values.dtype} values, must be real numbers; correct the file"
        )
    if values.ndim not in ndims:
        wanted = " or ".join(map(str, ndims))
        raise SamplingError(
            f"{key} has shape {values.shape}, must have {wanted} dimensions; correct the file"
        )
    return values


def bins(values: Array) -> Array:
    """Return bins as float32 or float64; integers become float64."""
    if values.dtype in (np.float32, np.float64):
        return values
    fits_memory("H", 8.0 * values.size, "free memory, or load a part of the file")
    return values.astype(np.float64)


def triple(variables: Mapping[str, Any], key: str) -> Any:
    """Return three numbers of a file as a vector, or None if they are absent."""
    value = variables.get(key)
    if value is None or np.size(value) == 0:
        return None
    return vector(key, array(variables, key, 0, 1, 2, 3).ravel())


def upright(found: Found) -> Found:
    """Transpose and flip grids to rising [y, x], judged from the coordinates of their points."""
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
    """Return whether points (a, b, 3) must be transposed, then flipped along rows and columns."""
    last = points[-1, 0] - points[0, 0], points[0, -1] - points[0, 0]
    down, across = last
    swap = abs(down[0]) > abs(down[1]) or abs(across[1]) > abs(across[0])
    if swap:
        down, across = across, down
    return bool(swap), bool(down[1] < 0.0), bool(across[0] < 0.0)


def turned(values: Array, turn: tuple[bool, bool, bool], axis: int) -> Array:
    """Return an array with axes ``axis`` and ``axis`` + 1 transposed and flipped by `_turn`."""
    swap, rows, columns = turn
    if swap:
        values = values.swapaxes(axis, axis + 1)
    if rows:
        values = np.flip(values, axis)
    return np.flip(values, axis + 1) if columns else values
