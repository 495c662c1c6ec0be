"""Image in scaled units, and its residual for a given object at the best gain and background."""

from __future__ import annotations

import torch
from torch import Tensor

from .noisy_image import NoisyImage

_LEAST_CONTRAST = 0.1
# Gradient below which total variation is smoothed, relative to the range of objects from 0 to 1.
_SMOOTH = 1e-3


class ScaledImage:
    """Image in single precision; gain and background are set by least squares.

    ``data``: image and noise. ``unit``: value of the image that becomes 1.

    ``image`` (H, W): image in this unit, float32, minus the background that best fits it alone.
    ``unit``: value of the image that became 1.
    """

    def __init__(self, data: NoisyImage, unit: float) -> None:
        self.unit = unit
        self._per_counted = data.data.numel() / data.counted
        self._weights = None if data.weights is None else data.weights.float()
        self._shape: Tensor | None = None
        if data.fit_background:
            self._shape = (torch.ones_like(data.data) * data.background(1.0)).float()
            self._norm = (self.weighted(self._shape) * self._shape).sum()
        self.image = (data.without_background() / unit).float()
        self._power = self.weighted(self.image * self.image).sum()

    def misfit(self, seen: Tensor) -> tuple[Tensor, Tensor]:
        """Return the best gain of a modelled image ``seen`` (H, W), and the residual (H, W).

        Both are differentiable. If the fitted gain is negative or tiny, it is clamped to a tenth of
        the image contrast, to keep a useful gradient.
        """
        seen = self._without_background(seen)
        norm = self.weighted(seen * seen).sum().clamp_min(torch.finfo(seen.dtype).tiny)
        least = _LEAST_CONTRAST * (self._power / norm.detach()).sqrt()
        gain = (self.weighted(seen * self.image).sum() / norm).clamp_min(least)
        return gain, self.image - gain * seen

    def weighted(self, values: Tensor) -> Tensor:
        """Return values (H, W) times the pixel weights, which have mean 1."""
        return values if self._weights is None else values * self._weights

    def mean_square(self, residual: Tensor) -> Tensor:
        """Return the weighted mean square of a residual (H, W), without excluded pixels."""
        mean: Tensor = self.weighted(residual * residual).mean() * self._per_counted
        return mean

    def _without_background(self, values: Tensor) -> Tensor:
        if self._shape is None:
            return values
        strength = (self.weighted(self._shape) * values).sum() / self._norm
        return values - strength * self._shape


def total_variation(picture: Tensor) -> Tensor:
    """Return the isotropic total variation of an object (..., H, W), without its borders.

    Gradients below 1e-3 enter quadratically, since the square root has an infinite slope at 0.
    """
    down = torch.diff(picture, dim=-2)[..., :, :-1]
    along = torch.diff(picture, dim=-1)[..., :-1, :]
    square = down * down + along * along
    return ((square + _SMOOTH * _SMOOTH).sqrt() - _SMOOTH).sum(dim=(-2, -1))
