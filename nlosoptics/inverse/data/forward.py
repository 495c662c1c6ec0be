"""Image model in torch, with the grid and transfer function of `imaging.ForwardModel`."""

from __future__ import annotations

from copy import deepcopy
from typing import Any, Self

import numpy as np
import torch
from torch import Tensor, nn

from ...errors import SamplingError, SceneError
from ...imaging.forward_model import ForwardModel


class TorchForwardModel(nn.Module):
    """Differentiable image model in torch: convolution with a point spread function (PSF).

    It is the torch version of `imaging.ForwardModel`, and the PSF may vary over the object. Calling
    the model maps objects (..., H, W) to images (..., H, W). The method ``adjoint`` applies the
    transpose. Build the model by `from_numpy`, which also sets device and precision.

    Parameters
    ----------
    model : ForwardModel
        Model in numpy, with a single PSF or a `psf.PointSpreadField` (PSFs over the object). FFT
        grid, boundary, transfer functions and weights are taken from this model.

    See Also
    --------
    nlosoptics.imaging.ForwardModel : Convolution with one PSF or a field.
    PupilPSF : Differentiable PSF of a wave.
    """

    _transfer: Tensor
    weights: Tensor | None

    def __init__(self, model: ForwardModel) -> None:
        super().__init__()
        self.shape = model.shape
        self.grid = model.grid
        self.boundary = model.boundary
        # Stored as pairs of reals: Module.to(dtype) would drop the imaginary part.
        pairs = torch.view_as_real(torch.from_numpy(model.transfer.copy()))
        self.register_buffer("_transfer", pairs)
        weights = None if model.weights is None else torch.from_numpy(model.weights.copy())
        self.register_buffer("weights", weights)

    @classmethod
    def from_numpy(
        cls,
        model: ForwardModel,
        device: torch.device | str = "cpu",
        dtype: torch.dtype = torch.float32,
    ) -> Self:
        """Convert an image model in numpy to torch.

        Parameters
        ----------
        model : ForwardModel
            Model in numpy.
        device : torch.device or str
            Device of the tensors.
        dtype : torch.dtype
            Precision, ``torch.float32`` or ``torch.float64``.

        Returns
        -------
        TorchForwardModel
            Model with the same transfer functions as tensors on the device.

        Raises
        ------
        SamplingError
            If ``dtype`` is not one of these two.
        SceneError
            If ``model`` is not a `ForwardModel`.

        Examples
        --------
        >>> import numpy as np
        >>> import torch
        >>> from nlosoptics.imaging import ForwardModel
        >>> from nlosoptics.inverse import TorchForwardModel
        >>> model = TorchForwardModel.from_numpy(ForwardModel(np.full((3, 3), 1 / 9), shape=(8, 8)))
        >>> tuple(model(torch.ones(5, 8, 8)).shape)
        (5, 8, 8)
        """
        if not isinstance(model, ForwardModel):
            raise SceneError(
                f"model of type {type(model).__name__} is not an imaging.ForwardModel; build one "
                "from a point spread"
            )
        if dtype not in (torch.float32, torch.float64):
            raise SamplingError(
                f"dtype = {dtype} is not supported by the transform; "
                "use torch.float32 or torch.float64"
            )
        return cls(model).to(device=device, dtype=dtype)

    @property
    def transfer(self) -> Tensor:
        """Transfer function: ``rfft2`` of the PSF on the FFT grid, complex, (rows, columns//2 + 1).

        If the PSF varies over the object, it is a weighted sum of K fixed PSFs (modes), and the
        shape is (K, rows, columns//2 + 1).
        """
        return torch.view_as_complex(self._transfer)

    def to_numpy_model(self) -> ForwardModel:
        """Return the model as a `ForwardModel` in numpy, in double precision."""
        transfer = self.transfer.detach().cpu().to(torch.complex128).numpy()
        kernel = np.fft.fftshift(np.fft.irfft2(transfer, s=self.grid), axes=(-2, -1))
        weights = None if self.weights is None else self.weights.detach().cpu().double().numpy()
        model = ForwardModel.__new__(ForwardModel)
        fields: dict[str, Any] = {"shape": self.shape, "boundary": self.boundary, "grid": self.grid}
        fields |= {"pitch": None, "kernel": kernel, "weights": weights, "transfer": transfer}
        for name, value in fields.items():
            object.__setattr__(model, name, value)
        return model

    def forward(self, object_image: Tensor) -> Tensor:
        """Compute the image (..., H, W) of an object (..., H, W)."""
        self._check("object_image", object_image)
        if self.weights is None:
            return self._frame(self._spectrum(object_image) * self.transfer)
        parts = self._spectrum(object_image.unsqueeze(-3) * self.weights)
        return self._frame((parts * self.transfer).sum(dim=-3))

    def adjoint(self, image: Tensor) -> Tensor:
        """Apply the transpose of `forward`: correlate an image (..., H, W) with the PSF."""
        self._check("image", image)
        spectrum = self._spectrum(image)
        if self.weights is None:
            return self._frame(spectrum * self.transfer.conj())
        parts = self._frame(spectrum.unsqueeze(-3) * self.transfer.conj())
        return (parts * self.weights).sum(dim=-3)

    def _check(self, name: str, picture: Tensor) -> None:
        if not isinstance(picture, Tensor):
            raise SceneError(
                f"{name} of type {type(picture).__name__} is not a tensor; give "
                "torch.from_numpy(picture)"
            )
        if tuple(picture.shape[-2:]) != self.shape:
            raise SamplingError(
                f"{name} has shape {tuple(picture.shape)}, must end in {self.shape}; "
                "resample it or build the model for that shape"
            )

    def _spectrum(self, picture: Tensor) -> Tensor:
        spectrum: Tensor = torch.fft.rfft2(picture, s=self.grid)
        return spectrum

    def _frame(self, spectrum: Tensor) -> Tensor:
        rows, columns = self.shape
        picture: Tensor = torch.fft.irfft2(spectrum, s=self.grid)
        return picture[..., :rows, :columns]


def torch_model(
    model: ForwardModel | TorchForwardModel, device: torch.device, dtype: torch.dtype
) -> TorchForwardModel:
    """Return a torch model on a device in a precision; the given model is not changed."""
    if isinstance(model, TorchForwardModel):
        if model._transfer.device == device and model._transfer.dtype == dtype:
            return model
        return deepcopy(model).to(device=device, dtype=dtype)
    return TorchForwardModel.from_numpy(model, device, dtype)
