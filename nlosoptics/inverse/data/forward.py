"""Image model in torch, with the grid and transfer function of `imaging.ForwardModel`."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from ...errors import SamplingError, SceneError
from ...imaging.forward_model import ForwardModel


class TorchForwardModel(nn.Module):
    """Differentiable image model in torch: convolution with a point spread function (PSF).

    It is the torch version of `imaging.ForwardModel`, and the PSF may vary over the object. Calling
    the model maps objects (..., H, W) to images (..., H, W), in the model's precision, which is
    double unless ``.to(torch.float32)`` changes it. ``adjoint`` applies the transpose.

    Parameters
    ----------
    model : ForwardModel
        Model in numpy, with a single PSF or a `psf.PointSpreadField` (PSFs over the object). FFT
        grid, transfer functions and weights are taken from this model.

    Raises
    ------
    SceneError
        If ``model`` is not a `ForwardModel`, or a picture is not a tensor.
    SamplingError
        If a picture does not have the shape of the model.

    See Also
    --------
    nlosoptics.imaging.ForwardModel : Convolution with one PSF or a field.
    PupilPSF : Differentiable PSF of a wave.

    Examples
    --------
    >>> import numpy as np
    >>> import torch
    >>> from nlosoptics.imaging import ForwardModel
    >>> from nlosoptics.inverse import TorchForwardModel
    >>> model = TorchForwardModel(ForwardModel(np.full((3, 3), 1 / 9), shape=(8, 8)))
    >>> tuple(model(torch.ones(5, 8, 8)).shape)
    (5, 8, 8)
    """

    _transfer: Tensor
    weights: Tensor

    def __init__(self, model: ForwardModel) -> None:
        super().__init__()
        if not isinstance(model, ForwardModel):
            raise SceneError(
                f"model of type {type(model).__name__} is not an imaging.ForwardModel; build one "
                "from a point spread"
            )
        self.shape, self.grid = model.shape, model.grid
        transfer = torch.from_numpy(model.transfer.reshape(-1, *model.transfer.shape[-2:]).copy())
        weights = torch.ones(1, 1, 1) if model.weights is None else model.weights.copy()
        # Stored as pairs of reals: Module.to(dtype) would drop the imaginary part.
        self.register_buffer("_transfer", torch.view_as_real(transfer))
        self.register_buffer("weights", torch.as_tensor(weights, dtype=torch.float64))

    @property
    def transfer(self) -> Tensor:
        """Transfer functions: ``rfft2`` of K fixed PSFs on the FFT grid, complex.

        Their shape is (K, rows, columns//2 + 1). If the PSF varies over the object, it is a
        weighted sum of K fixed PSFs (modes), otherwise K is 1.
        """
        return torch.view_as_complex(self._transfer)

    def forward(self, object_image: Tensor) -> Tensor:
        """Compute the image (..., H, W) of an object (..., H, W)."""
        self._check("object_image", object_image)
        parts = torch.fft.rfft2(object_image.unsqueeze(-3) * self.weights, s=self.grid)
        return self._frame((parts * self.transfer).sum(dim=-3))

    def adjoint(self, image: Tensor) -> Tensor:
        """Apply the transpose of `forward`: correlate an image (..., H, W) with the PSF."""
        self._check("image", image)
        spectrum = torch.fft.rfft2(image, s=self.grid).unsqueeze(-3)
        return (self._frame(spectrum * self.transfer.conj()) * self.weights).sum(dim=-3)

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

    def _frame(self, spectrum: Tensor) -> Tensor:
        picture: Tensor = torch.fft.irfft2(spectrum, s=self.grid)
        return picture[..., : self.shape[0], : self.shape[1]]
