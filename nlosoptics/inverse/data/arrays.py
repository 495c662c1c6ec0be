"""Arithmetic on numpy arrays and torch tensors alike, without importing torch for arrays.

Checked images, tests and total variation run in numpy; the other solvers, and data on a GPU, in
torch. Both libraries share most names, so that functions here take either.
"""

from __future__ import annotations

import math
import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from ...errors import SamplingError, SceneError

#: numpy array or torch tensor.
Values = Any
#: Standard normal quantile at 3/4: median of abs(x) over sigma.
MEDIAN_OVER_SIGMA = 0.6744897501960817


def is_tensor(value: Any) -> bool:
    """Return whether a value is a torch tensor."""
    torch = sys.modules.get("torch")  # without torch there are no tensors
    return torch is not None and isinstance(value, torch.Tensor)


def library(values: Values) -> Any:
    """Return the module, ``numpy`` or ``torch``, that made an array."""
    return sys.modules["torch"] if is_tensor(values) else np


def as_numpy(values: Values) -> NDArray[Any]:
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
    values: Values,
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


def as_double(values: Values) -> Values:
    """Return values in double precision."""
    return values.double() if is_tensor(values) else values.astype(np.float64, copy=False)


def like(values: Values, prototype: Values) -> Values:
    """Return values in the library and precision, and on the device, of another array."""
    if is_tensor(prototype):
        return library(prototype).as_tensor(values).to(prototype)
    return as_numpy(values).astype(prototype.dtype)


def total(values: Values) -> float:
    """Return the sum of an image in double precision.

    Rows are summed first, so that the result has the same bits for any number of threads.
    """
    return float(values.sum(-1, dtype=library(values).float64).sum())


def weighted(values: Values, weights: Values | None) -> Values:
    """Return values times the pixel weights; None for weights of 1."""
    return values if weights is None else values * weights


def norm(values: Values) -> float:
    """Return the root of the sum of squares of an image, in double precision."""
    return math.sqrt(total(values * values))


def rfft2(values: Values) -> Values:
    """Return the half spectra (..., rows, columns//2 + 1) of images (..., rows, columns)."""
    return library(values).fft.rfft2(values) if is_tensor(values) else fft.rfft2(values)


def irfft2(spectra: Values, columns: int) -> Values:
    """Return the images (..., rows, columns) of half spectra (..., rows, columns//2 + 1)."""
    transforms = library(spectra).fft if is_tensor(spectra) else fft
    return transforms.irfft2(spectra, s=(spectra.shape[-2], columns))


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
