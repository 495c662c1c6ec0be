"""The image model in torch: same grid, same transfer function."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Self

import numpy as np
import torch
from torch import Tensor, nn

from ..errors import SamplingError, SceneError
from ..imaging.forward_model import ForwardModel, one_kernel


class TorchForwardModel(nn.Module):
    """Convolution with a point spread function on batches of tensors, differentiable.

    Build it by `from_numpy`; it shares grid, boundary and transfer function with that model.
    """

    _transfer: Tensor

    def __init__(self, model: ForwardModel) -> None:
        super().__init__()
        self.shape = model.shape
        self.grid = model.grid
        self.boundary = model.boundary
        # Stored as pairs of reals: Module.to(dtype) would drop the imaginary part.
        pairs = torch.view_as_real(torch.from_numpy(model.transfer.copy()))
        self.register_buffer("_transfer", pairs)

    @classmethod
    def from_numpy(
        cls,
        model: ForwardModel,
        device: torch.device | str = "cpu",
        dtype: torch.dtype = torch.float32,
    ) -> Self:
        """Torch twin of a numpy model.

        Parameters
        ----------
        model : ForwardModel
        device : torch.device or str
        dtype : torch.dtype
            ``torch.float32`` or ``torch.float64``.

        Returns
        -------
        TorchForwardModel

        Raises
        ------
        SamplingError
            If ``dtype`` is another, or the model's point spread varies over the field.
        """
        if dtype not in (torch.float32, torch.float64):
            raise SamplingError(
                f"dtype = {dtype} is not supported by the transform; "
                "use torch.float32 or torch.float64"
            )
        return cls(one_kernel(model)).to(device=device, dtype=dtype)

    @property
    def transfer(self) -> Tensor:
        """``rfft2`` of the kernel on ``grid``, complex."""
        return torch.view_as_complex(self._transfer)

    def forward(self, object_image: Tensor) -> Tensor:
        """Image (..., H, W) of an object (..., H, W)."""
        return self._filter("object_image", object_image, self.transfer)

    def adjoint(self, image: Tensor) -> Tensor:
        """Transpose of `forward`: correlation of an image (..., H, W) with the kernel."""
        return self._filter("image", image, self.transfer.conj())

    def _filter(self, name: str, picture: Tensor, transfer: Tensor) -> Tensor:
        if tuple(picture.shape[-2:]) != self.shape:
            raise SamplingError(
                f"{name} has shape {tuple(picture.shape)}, must end in {self.shape}; "
                "resample it or build the model for that shape"
            )
        rows, columns = self.shape
        spectrum = torch.fft.rfft2(picture, s=self.grid) * transfer
        result: Tensor = torch.fft.irfft2(spectrum, s=self.grid)
        return result[..., :rows, :columns]


def torch_model(
    model: ForwardModel | TorchForwardModel, device: torch.device, dtype: torch.dtype
) -> TorchForwardModel:
    """Either kind of model, at a device and a precision, without changing the one given."""
    if isinstance(model, TorchForwardModel):
        if model._transfer.device == device and model._transfer.dtype == dtype:
            return model
        twin = TorchForwardModel.__new__(TorchForwardModel)
        nn.Module.__init__(twin)
        twin.shape, twin.grid, twin.boundary = model.shape, model.grid, model.boundary
        twin.register_buffer("_transfer", model._transfer.to(device=device, dtype=dtype))
        return twin
    return TorchForwardModel.from_numpy(model, device, dtype)


class FieldOperator:
    """A numpy model whose point spread varies over the field, on tensors, in double precision.

    Parameters
    ----------
    model : ForwardModel
        Of a field.
    device : torch.device

    Attributes
    ----------
    shape, grid : (int, int)
    transfer : Tensor
        Of the point spread averaged over the frame: what a preconditioner needs.
    """

    def __init__(self, model: ForwardModel, device: torch.device) -> None:
        assert model.weights is not None
        self.shape, self.grid = model.shape, model.grid
        mean = np.tensordot(model.weights.mean(axis=(1, 2)), model.transfer, axes=1)
        self.transfer = torch.from_numpy(mean).to(device)
        self._model = model

    def __call__(self, object_image: Tensor) -> Tensor:
        """Image (H, W) of an object (H, W)."""
        return self._on_tensors(self._model.forward, object_image)

    def adjoint(self, image: Tensor) -> Tensor:
        """Transpose of the call."""
        return self._on_tensors(self._model.adjoint, image)

    def _on_tensors(self, operator: Callable[[Any], Any], values: Tensor) -> Tensor:
        return torch.from_numpy(operator(values.cpu().numpy())).to(values.device, values.dtype)


def operator(
    model: ForwardModel | TorchForwardModel, device: torch.device, dtype: torch.dtype
) -> TorchForwardModel | FieldOperator:
    """Either kind of model on tensors, fields of point spreads as well."""
    if isinstance(model, ForwardModel) and model.weights is not None:
        return FieldOperator(model, device)
    return torch_model(model, device, dtype)


def model_shape(model: Any) -> tuple[int, int]:
    """Frame of either kind of model, or the error that says that it is none."""
    if not isinstance(model, (ForwardModel, TorchForwardModel)):
        raise SceneError(
            f"model of type {type(model).__name__} is not an image model; "
            "give an imaging.ForwardModel or an inverse.TorchForwardModel"
        )
    return model.shape


def one_kernel_shape(model: Any) -> tuple[int, int]:
    """Frame of either kind of model, or the error that its point spread varies over the field."""
    shape = model_shape(model)
    if isinstance(model, ForwardModel):
        one_kernel(model)
    return shape
