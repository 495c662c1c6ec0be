"""An image in a unit of its own, and what is left of it once an object's light is taken out."""

from __future__ import annotations

import torch
from torch import Tensor

from .measurement import Measurement

_LEAST_CONTRAST = 0.1


class ScaledImage:
    """An image in single precision, with gain and background at their least-squares values.

    Parameters
    ----------
    data : Measurement
    unit : float
        Image units that become 1.

    Attributes
    ----------
    image : Tensor
        (H, W) float32, without the background that alone explains it best.
    unit : float
    """

    def __init__(self, data: Measurement, unit: float) -> None:
        self.unit = unit
        self._per_counted = data.data.numel() / data.counted
        self._weights = None if data.weights is None else data.weights.float()
        self._shape: Tensor | None = None
        level = data.background(data.background_strength(data.data))
        if data.fit_background:
            shape = data.background_shape
            self._shape = torch.ones_like(data.data) if shape is None else shape
            self._shape = self._shape.float()
            self._norm = (self.weighted(self._shape) * self._shape).sum()
        self.image = ((data.data - level) / unit).float()
        self._power = self.weighted(self.image * self.image).sum()

    def misfit(self, seen: Tensor) -> tuple[Tensor, Tensor]:
        """Gain at which ``seen`` explains the image best, and the residual (H, W); differentiable.

        Light is never negative: if the fitted gain is negative or tiny, it is clamped to a tenth of
        the image contrast, to keep a useful gradient.
        """
        seen = self._without_background(seen)
        norm = self.weighted(seen * seen).sum().clamp_min(torch.finfo(seen.dtype).tiny)
        least = _LEAST_CONTRAST * (self._power / norm.detach()).sqrt()
        gain = (self.weighted(seen * self.image).sum() / norm).clamp_min(least)
        return gain, self.image - gain * seen

    def weighted(self, values: Tensor) -> Tensor:
        """Values times the pixel weights, whose mean is 1."""
        return values if self._weights is None else values * self._weights

    def mean_square(self, residual: Tensor) -> Tensor:
        """Weighted mean square of a residual over the pixels that count."""
        mean: Tensor = self.weighted(residual * residual).mean() * self._per_counted
        return mean

    def _without_background(self, values: Tensor) -> Tensor:
        if self._shape is None:
            return values
        strength = (self.weighted(self._shape) * values).sum() / self._norm
        return values - strength * self._shape


def total_variation(picture: Tensor, smooth: Tensor | float) -> Tensor:
    """Isotropic total variation of a picture (..., H, W) within its frame.

    Gradients under ``smooth`` count quadratically: the root's own slope at 0 is infinite.
    """
    down = torch.diff(picture, dim=-2)[..., :, :-1]
    along = torch.diff(picture, dim=-1)[..., :-1, :]
    square = down * down + along * along
    return ((square + smooth * smooth).sqrt() - smooth).sum(dim=(-2, -1))
