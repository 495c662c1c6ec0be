"""Small network that proposes waves for one image: a mixture of Gaussians over coefficients."""

from __future__ import annotations

import math
from functools import cache
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from ...psf.wave.zernikes import zernike_order

#: Noll indices of the proposed coefficients, n = 2..5.
MODES = tuple(range(4, 22))
#: Pixels of the network's image along each side, at Nyquist's pitch.
SIDE = 64
#: Number of Gaussians.
PARTS = 4
_FOLD = 4  # pixels along each side that become channels of one node
_TAPER = 4  # pixels at each edge over which the image falls to 0
#: Least standard deviation of a proposed coefficient, waves.
_LEAST = 0.01
_MOST_LOG = 1.0


class Mixture(NamedTuple):
    """Gaussians over the coefficients of B images, waves rms.

    Parameters
    ----------
    weights : Tensor, (B, PARTS)
        Logarithms of the weights, of which the exponentials add up to 1.
    means, deviations : Tensor, (B, PARTS, M)
        Means and standard deviations of the coefficients of `MODES`.
    """

    weights: Tensor
    means: Tensor
    deviations: Tensor

    def log_likelihood(self, coefficients: Tensor) -> Tensor:
        """Return the logarithm of the density (B,) of coefficients (B, M) or of their twin.

        A wave W(x) and its twin -W(-x) have the same point spread, so that an image cannot tell
        which of them made it.
        """
        pair = torch.stack([coefficients, coefficients * twin_signs()], dim=1)[:, :, None]
        offset = (pair - self.means[:, None]) / self.deviations[:, None]
        each = -0.5 * offset.square() - self.deviations.log()[:, None]
        density = each.sum(dim=3) + self.weights[:, None]
        return density.flatten(1).logsumexp(dim=1) - math.log(2.0)


class WallNetwork(nn.Module):
    """Convolutional network from images to `Mixture`; about 1.1 million weights."""

    def __init__(self) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            nn.PixelUnshuffle(_FOLD),
            _convolution(4 * _FOLD**2, 64),
            _convolution(64, 96, stride=2),
            _convolution(96, 96),
            _convolution(96, 128, stride=2),
            _convolution(128, 128),
            nn.Flatten(),
            nn.Linear(128 * (SIDE // (4 * _FOLD)) ** 2, 256),
            nn.SiLU(),
            nn.Linear(256, PARTS * (2 * len(MODES) + 1)),
        )

    def forward(self, images: Tensor, noise: Tensor) -> Mixture:
        """Return the mixtures of images (B, SIDE, SIDE) with a dark background.

        ``noise`` (B,) is the standard deviation of their noise, in the images' unit.
        """
        found = self.layers(channels(images, noise)).unflatten(1, (PARTS, -1))
        weights, means, spreads = found.split([1, len(MODES), len(MODES)], dim=2)
        deviations = _LEAST + (spreads - 2.0).clamp(max=_MOST_LOG).exp()
        return Mixture(weights[..., 0].log_softmax(dim=1), means, deviations)


def channels(images: Tensor, noise: Tensor) -> Tensor:
    """Return what the network sees, (B, 4, SIDE, SIDE).

    The image; the logarithm of its spectrum's power over the noise; the transform of that, which
    separates object and point spread; and the image with an even spectrum.
    """
    bright = images.amax(dim=(1, 2), keepdim=True).clamp(min=1e-12)
    scaled, level = images / bright, noise.view(-1, 1, 1) / bright
    spectrum = torch.fft.fft2(scaled * _taper())
    size = spectrum.real.square() + spectrum.imag.square()
    power = size / (level * SIDE).square()
    logarithm = torch.log1p(power)
    lags = torch.fft.ifft2(logarithm).real
    lags[:, 0, 0] = 0.0
    even = torch.fft.ifft2(spectrum * (power / ((1.0 + power) * size.sqrt().clamp(min=1e-9)))).real
    centred = torch.fft.fftshift(torch.stack([logarithm / 4.0 - 0.5, 16.0 * lags], 1), (2, 3))
    return torch.cat([4.0 * scaled[:, None] - 0.5, centred, 40.0 * even[:, None]], dim=1)


@cache
def twin_signs() -> Tensor:
    """Return the signs (M,) that convert a wave to its twin, -1 for even radial orders."""
    return torch.tensor([-1.0 if zernike_order(mode)[0] % 2 == 0 else 1.0 for mode in MODES])


@cache
def _taper() -> Tensor:
    """Return a window (SIDE, SIDE) that falls to 0 at the edges."""
    rise = np.sin(0.5 * np.pi * np.minimum(1.0, (np.arange(SIDE // 2) + 0.5) / _TAPER)) ** 2
    window = np.concatenate([rise, rise[::-1]])
    return torch.from_numpy(np.outer(window, window).astype(np.float32))


def _convolution(given: int, made: int, stride: int = 1) -> nn.Sequential:
    """Return a 3 x 3 convolution with normalisation."""
    return nn.Sequential(nn.Conv2d(given, made, 3, stride, 1), nn.GroupNorm(8, made), nn.SiLU())
