"""Values of capture files: checks and axis conventions common to all layouts."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._checks import real, vector
from ...errors import SamplingError, SceneError

Array = NDArray[Any]
#: Arguments of `TransientCapture`, as far as a file states them; spatial axes of ``H``, points and
#: normals run in the file's direction until `upright` has turned them.
Values = dict[str, Any]


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
    if variables.get(key) is None:
        raise SceneError(f"{key} is missing, the file is incomplete; copy or write it again")
    values = np.asarray(variables[key])
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


def triple(variables: Mapping[str, Any], key: str) -> Any:
    """Return three numbers of a file as a vector, or None if they are absent."""
    if variables.get(key) is None or np.size(variables[key]) == 0:
        return None
    return vector(key, array(variables, key, 0, 1, 2, 3).ravel())


def upright(values: Values) -> Values:
    """Transpose and flip grids to rising [y, x], judged from the coordinates of their points."""
    paired, lasers = values["pairing"] == "confocal", values["laser_points"]
    first = {"laser": 1, "sensor": 1 if paired or lasers is None else lasers.ndim}
    for name, axis in first.items():
        points = values[f"{name}_points"]
        if points is None or points.ndim != 3:
            continue
        down, across = points[-1, 0] - points[0, 0], points[0, -1] - points[0, 0]
        swap = abs(down[0]) > abs(down[1]) or abs(across[1]) > abs(across[0])
        if swap:
            down, across = across, down
        turned = {f"{name}_points": 0, f"{name}_normals": 0}
        if name == "sensor" or not paired:
            turned["H"] = axis
        for key, at in turned.items():
            if values[key] is not None:
                bins = values[key].swapaxes(at, at + 1) if swap else values[key]
                bins = np.flip(bins, at) if down[1] < 0.0 else bins
                values[key] = np.flip(bins, at + 1) if across[0] < 0.0 else bins
    return values
