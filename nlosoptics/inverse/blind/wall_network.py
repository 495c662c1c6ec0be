"""Small network that proposes waves for one image: a mixture of Gaussians over coefficients."""

from __future__ import annotations

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
PARTS = 16


class Mixture(NamedTuple):
    """Gaussians over the coefficients of B images, waves rms.

    ``weights`` (B, PARTS): logarithms of the weights, of which the exponentials add up to 1.
    ``means``, ``deviations`` (B, PARTS, M): means and standard deviations of the coefficients of
    `MODES`.
    """

    weights: Tensor
    means: Tensor
    deviations: Tensor


class WallNetwork(nn.Module):
    """Network of convolutions and attention from images to `Mixture`; 2.5 million weights."""

    def __init__(self) -> None:
        super().__init__()
        side = SIDE // 4
        self.layers = nn.Sequential(
            nn.PixelUnshuffle(2),
            nn.Conv2d(16, 64, 3, padding=1),
            _Residual(64),
            _Residual(64),
            nn.Conv2d(64, 128, 3, stride=2, padding=1),
            _Places(128, side),
            _Residual(128),
            _Residual(128),
            _Residual(128),
            nn.Conv2d(128, 192, 3, stride=2, padding=1),
            _Attention(192, 6),
            _Attention(192, 6),
            nn.GroupNorm(8, 192),
            nn.SiLU(),
            nn.Conv2d(192, 64, 3, stride=2, padding=1),
            nn.Flatten(),
            nn.Linear(64 * (side // 4) ** 2, 256),
            nn.SiLU(),
            nn.Linear(256, PARTS * (2 * len(MODES) + 1)),
        )

    def forward(self, images: Tensor, noise: Tensor) -> Mixture:
        """Return the mixtures of images (B, SIDE, SIDE) with a dark background.

        ``noise`` (B,) is the standard deviation of their noise, in the images' unit.
        """
        found = self.layers(channels(images, noise)).float().unflatten(1, (PARTS, -1))
        weights, means, spreads = found.split([1, len(MODES), len(MODES)], dim=2)
        deviations = 0.01 + (spreads - 2.0).clamp(max=1.0).exp()
        return Mixture(weights[..., 0].log_softmax(dim=1), means, deviations)


def channels(images: Tensor, noise: Tensor) -> Tensor:
    """Return what the network sees, (B, 4, SIDE, SIDE).

    The image; the logarithm of its spectrum's power over the noise; the transform of that, which
    separates object and point spread; and the image with an even spectrum.
    """
    bright = images.amax(dim=(1, 2), keepdim=True).clamp(min=1e-12)
    scaled, level = images / bright, noise.view(-1, 1, 1) / bright
    spectrum = torch.fft.fft2(scaled * _taper().to(images.device))
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
    """Return a window (SIDE, SIDE) that falls to 0 over 4 pixels at the edges."""
    rise = np.sin(0.5 * np.pi * np.minimum(1.0, (np.arange(SIDE // 2) + 0.5) / 4)) ** 2
    window = np.concatenate([rise, rise[::-1]])
    return torch.from_numpy(np.outer(window, window).astype(np.float32))


class _Residual(nn.Module):
    """Two 3 x 3 convolutions, whose result is added to what they are given."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            nn.GroupNorm(8, width),
            nn.SiLU(),
            nn.Conv2d(width, width, 3, padding=1),
            nn.GroupNorm(8, width),
            nn.SiLU(),
            nn.Conv2d(width, width, 3, padding=1),
        )

    def forward(self, given: Tensor) -> Tensor:
        added: Tensor = self.layers(given)
        return given + added


class _Places(nn.Module):
    """Trained values of each place, since frequencies and lags differ in what they tell."""

    def __init__(self, width: int, side: int) -> None:
        super().__init__()
        self.values = nn.Parameter(torch.zeros(width, side, side))

    def forward(self, given: Tensor) -> Tensor:
        return given + self.values


class _Attention(nn.Module):
    """Attention among all places, then two layers on each place."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.before, self.between = nn.LayerNorm(width), nn.LayerNorm(width)
        self.three, self.mixed = nn.Linear(width, 3 * width), nn.Linear(width, width)
        self.layer = nn.Sequential(
            nn.Linear(width, 2 * width), nn.SiLU(), nn.Linear(2 * width, width)
        )

    def forward(self, given: Tensor) -> Tensor:
        places = given.flatten(2).transpose(1, 2)
        three = self.three(self.before(places)).unflatten(2, (3, self.heads, -1))
        query, key, value = three.permute(2, 0, 3, 1, 4)
        seen = nn.functional.scaled_dot_product_attention(query, key, value)
        places = places + self.mixed(seen.transpose(1, 2).flatten(2))
        places = places + self.layer(self.between(places))
        found: Tensor = places.transpose(1, 2).unflatten(2, given.shape[2:])
        return found
