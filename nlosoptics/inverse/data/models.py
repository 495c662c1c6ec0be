"""Image models of either library: their shapes, mean transfer functions and images."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import scipy  # its parts are loaded on first use

from ..._checks import counted
from ...errors import SamplingError, SceneError
from ...imaging.forward_model import ForwardModel
from .arrays import Values, as_double, is_tensor, library

if TYPE_CHECKING:
    from .forward import TorchForwardModel

#: Image model in numpy or torch.
AnyModel: TypeAlias = "ForwardModel | TorchForwardModel"


def model_shape(model: Any) -> tuple[int, int]:
    """Return the shape (H, W) of a numpy or torch image model; raise for any other object."""
    # a torch model is recognised by its conversion, since its class needs torch
    if not isinstance(model, ForwardModel) and not hasattr(model, "to_numpy_model"):
        raise SceneError(
            f"model of type {type(model).__name__} is not an image model; "
            "give an imaging.ForwardModel or an inverse.TorchForwardModel"
        )
    shape: tuple[int, int] = model.shape
    return shape


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


def numpy_model(model: AnyModel) -> ForwardModel:
    """Return the image model in numpy; the given model is not changed."""
    return model if isinstance(model, ForwardModel) else model.to_numpy_model()


def model_like(model: AnyModel, values: Values) -> AnyModel:
    """Return the image model in double precision, in the library and on the device of an array."""
    if not is_tensor(values):
        return numpy_model(model)
    from .forward import torch_model

    return torch_model(model, values.device, library(values).float64)


def image_of(model: AnyModel, level: Values) -> Values:
    """Return the image (H, W) of an object (H, W), in double precision."""
    own, level = model_like(model, level), as_double(level)
    return own.forward(level)


def mean_transfer(model: AnyModel) -> Values:
    """Return the ``rfft2`` of a model's kernel averaged over the frame, on the model's grid.

    It is a single transfer function, (rows, columns//2 + 1), also for a field of point spreads.
    """
    if model.weights is None:
        return model.transfer
    shares = model.weights.mean((-2, -1))
    return (shares[:, None, None] * model.transfer).sum(0)


def widened(model: AnyModel, factor: float = math.sqrt(2.0)) -> ForwardModel:
    """Return the image model, in numpy, of a point spread that is ``factor`` > 1 times as wide.

    The kernel is interpolated linearly on the model's grid. The mean transfer function keeps its
    largest modulus.
    """
    own = numpy_model(model)
    kernel = np.fft.fftshift(scipy.fft.irfft2(own.transfer, own.grid), axes=(-2, -1))
    for axis in (-2, -1):
        middle = kernel.shape[axis] // 2
        at = middle + (np.arange(kernel.shape[axis]) - middle) / factor
        low = at.astype(np.intp)
        part = (at - low).reshape(-1, *(1,) * (-1 - axis))
        lower, upper = (np.take(kernel, low + step, axis) for step in (0, 1))
        kernel = (1.0 - part) * lower + part * upper
    twin = ForwardModel.__new__(ForwardModel)
    transfer = scipy.fft.rfft2(np.fft.ifftshift(kernel, axes=(-2, -1)))
    for name, value in {**vars(own), "kernel": kernel, "transfer": transfer}.items():
        object.__setattr__(twin, name, value)
    scale = abs(mean_transfer(own)).max() / abs(mean_transfer(twin)).max()
    kernel *= scale
    transfer *= scale
    return twin
