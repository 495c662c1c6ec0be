"""Image models: their shapes, mean transfer functions, and wider point spreads."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import scipy  # its parts are loaded on first use
from numpy.typing import NDArray

from ..._checks import counted
from ...errors import SamplingError, SceneError
from ...imaging.forward_model import ForwardModel


def model_shape(model: Any) -> tuple[int, int]:
    """Return the shape (H, W) of an image model; raise for any other object."""
    if not isinstance(model, ForwardModel):
        raise SceneError(
            f"model of type {type(model).__name__} is not an image model; "
            "give an imaging.ForwardModel(point_spread, shape=image.shape)"
        )
    return model.shape


def one_kernel_shape(model: Any) -> tuple[int, int]:
    """Return the shape (H, W) of a model; raise if its point spread varies over the field."""
    shape = model_shape(model)
    if model.weights is not None:
        raise SamplingError(
            "the model's point spread varies over the field "
            f"({counted(len(model.weights), 'mode')}), but this solver needs a single one; "
            "give a model of one PointSpread"
        )
    return shape


def mean_transfer(model: ForwardModel) -> NDArray[np.complex128]:
    """Return the ``rfft2`` of a model's kernel averaged over the frame, on the model's grid.

    It is a single transfer function, (rows, columns//2 + 1), also for a field of point spreads.
    """
    if model.weights is None:
        return model.transfer
    return np.tensordot(model.weights.mean((-2, -1)), model.transfer, 1)


def widened(model: ForwardModel, factor: float = math.sqrt(2.0)) -> ForwardModel:
    """Return the image model of a point spread that is ``factor`` > 1 times as wide.

    The kernel is interpolated linearly on the model's grid. The mean transfer function keeps its
    largest modulus.
    """
    kernel = np.fft.fftshift(scipy.fft.irfft2(model.transfer, model.grid), axes=(-2, -1))
    for axis in (-2, -1):
        middle = kernel.shape[axis] // 2
        at = middle + (np.arange(kernel.shape[axis]) - middle) / factor
        low = at.astype(np.intp)
        part = (at - low).reshape(-1, *(1,) * (-1 - axis))
        lower, upper = (np.take(kernel, low + step, axis) for step in (0, 1))
        kernel = (1.0 - part) * lower + part * upper
    twin = ForwardModel.__new__(ForwardModel)
    transfer = scipy.fft.rfft2(np.fft.ifftshift(kernel, axes=(-2, -1)))
    for name, value in {**vars(model), "kernel": kernel, "transfer": transfer}.items():
        object.__setattr__(twin, name, value)
    scale = abs(mean_transfer(model)).max() / abs(mean_transfer(twin)).max()
    kernel *= scale
    transfer *= scale
    return twin
