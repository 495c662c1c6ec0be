"""Checked arrays, from arrays or tensors, and sums in double precision."""

from __future__ import annotations

import math
import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import SamplingError, SceneError

#: Standard normal quantile at 3/4: median of abs(x) over sigma.
MEDIAN_OVER_SIGMA = 0.6744897501960817


def is_tensor(value: Any) -> bool:
    """Return whether a value is a torch tensor."""
    torch = sys.modules.get("torch")  # without torch there are no tensors
    return torch is not None and isinstance(value, torch.Tensor)


def as_numpy(values: Any) -> NDArray[Any]:
    """Return values as a numpy array; a tensor on the processor is not copied."""
    if is_tensor(values):
        values = values.detach().cpu().numpy()
    return np.asarray(values)


def real_array(name: str, value: Any) -> NDArray[np.float64]:
    """Return an array, a tensor or nested sequences as a float64 array.

    ``name``: name of the argument in error messages. ``value``: real numbers.
    """
    try:
        values = as_numpy(value)
        if np.iscomplexobj(values):
            raise TypeError
        return values.astype(np.float64, copy=False)
    except (TypeError, ValueError):
        raise SceneError(
            f"{name} of type {type(value).__name__} is not an array of real numbers; "
            "give an array or a tensor"
        ) from None


def shape_of(name: str, value: Any) -> tuple[int, ...]:
    """Return the shape of a number, an array, a tensor or nested sequences.

    ``name``: name of the argument in error messages. ``value``: value to examine.
    """
    try:
        return tuple(np.shape(value))
    except ValueError:
        raise SceneError(
            f"{name} of type {type(value).__name__} has rows that differ in shape; "
            "give an array or a tensor"
        ) from None


def check_shape(
    name: str,
    values: Any,
    shape: tuple[int, ...],
    rest: str = "like the model; resample it or build the model for that shape",
) -> None:
    """Raise a `SamplingError` if an array or a tensor does not have a shape.

    ``rest`` ends the message: what has this shape, and what to do.
    """
    if tuple(values.shape) != tuple(shape):
        raise SamplingError(
            f"{name} has shape {tuple(values.shape)}, must be {tuple(shape)} {rest}"
        )


def check_finite(
    name: str, values: NDArray[Any], remedy: str, ignored: NDArray[np.bool_] | bool = False
) -> None:
    """Raise a `SceneError` if values that are not ``ignored`` are NaN or infinite."""
    n_bad = int(np.count_nonzero(~(np.isfinite(values) | ignored)))
    if n_bad:
        raise SceneError(
            f"{name} has {n_bad} of {values.size} values that are not finite; {remedy}"
        )


def total(values: NDArray[Any]) -> float:
    """Return the sum of an image in double precision."""
    return float(values.sum(-1, dtype=np.float64).sum())


def norm(values: NDArray[Any]) -> float:
    """Return the root of the sum of squares of an image, in double precision."""
    return math.sqrt(total(values * values))


def half_spectrum_weights(columns: int) -> NDArray[np.float64]:
    """Return how often each column of an ``rfft2`` counts in the whole spectrum: once or twice.

    The ``rfft2`` of an image with ``columns`` columns holds one of each two conjugate columns. Its
    first column and, if ``columns`` is even, its last one have no conjugate and count once.
    """
    weights = np.full(columns // 2 + 1, 2.0)
    weights[0] = 1.0
    if columns % 2 == 0:
        weights[-1] = 1.0
    return weights
