"""Least-squares objects under a field of point spreads, where one spectrum does not divide."""

from __future__ import annotations

import torch
from torch import Tensor

from .measurements import total
from .torch_model import TorchForwardModel

# Each solve starts at the last one's object, which moves little: the residual falls by this much,
# or as far as single precision lets it.
_FALL = 0.1
_MOST_STEPS = 6


class FieldStep:
    """Objects x that minimise ``p |A x - a|^2 + x' R x - 2 x' b``, one after another.

    A is a field's convolution over the whole FFT grid, R diagonal in Fourier space. Outside the
    frame, where the object is nothing in the end, weights are their means.

    Parameters
    ----------
    model : TorchForwardModel
        With weights, float64.
    response : float
        What the transfer functions are divided by.
    dtype : torch.dtype
    """

    def __init__(self, model: TorchForwardModel, response: float, dtype: torch.dtype) -> None:
        weights = model.weights
        if weights is None:
            raise ValueError("a model of one point spread needs no field step")
        self._grid = model.grid
        rows, columns = model.shape
        means = weights.mean(dim=(-2, -1), keepdim=True)
        extended = means.expand(-1, *model.grid).clone()
        extended[:, :rows, :columns] = weights
        self._weights = extended.to(dtype)
        complex_dtype = torch.complex64 if dtype == torch.float32 else torch.complex128
        self._transfer = (model.transfer / response).to(complex_dtype)
        self._free = torch.zeros(model.grid, dtype=dtype, device=weights.device)
        self._image = torch.zeros_like(self._free)

    def solve(
        self, image: Tensor, pull: Tensor, penalty: float, rest: Tensor, inverse: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Object and its image.

        Parameters
        ----------
        image, pull : Tensor
            a and b, on the grid.
        penalty : float
            p.
        rest, inverse : Tensor
            Half spectra of R, and of the preconditioner, which is positive.
        """
        free, seen = self._free.clone(), self._image.clone()
        residual = penalty * self._adjoint(image - seen) + pull - self._filtered(free, rest)
        step = self._filtered(residual, inverse)
        direction, product = step, total(residual * step)
        goal = _FALL**2 * product
        for _ in range(_MOST_STEPS):
            if product <= goal or product == 0.0:
                break
            moved = self._forward(direction)
            turned = penalty * self._adjoint(moved) + self._filtered(direction, rest)
            length = product / total(direction * turned)
            free += length * direction
            seen += length * moved
            residual = residual - length * turned
            step = self._filtered(residual, inverse)
            last, product = product, total(residual * step)
            direction = step + (product / last) * direction
        self._free, self._image = free, seen
        return free, seen

    def _forward(self, picture: Tensor) -> Tensor:
        parts = torch.fft.rfft2(self._weights * picture) * self._transfer
        image: Tensor = torch.fft.irfft2(parts.sum(dim=0), s=self._grid)
        return image

    def _adjoint(self, image: Tensor) -> Tensor:
        spectra = torch.fft.rfft2(image) * self._transfer.conj()
        parts: Tensor = torch.fft.irfft2(spectra, s=self._grid) * self._weights
        return parts.sum(dim=0)

    def _filtered(self, picture: Tensor, response: Tensor) -> Tensor:
        filtered: Tensor = torch.fft.irfft2(torch.fft.rfft2(picture) * response, s=self._grid)
        return filtered
