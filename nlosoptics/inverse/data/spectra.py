"""Power spectra of images at the frequencies of their frame, and what optics pass of them.

Half spectra, (H, W//2 + 1), as ``rfft2`` of an image (H, W) returns them.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from .forward import AnyModel, half_spectrum_weights, torch_model

# Largest power of an object's image, relative to the noise, at a frequency that counts as beyond
# the optics.
_NOTHING_PASSED = 0.05


def frame_transfer(model: AnyModel) -> Tensor:
    """Return the transfer function at the frequencies of the frame, complex128.

    A padded model holds it for a larger grid. For a field it is that of the mean point spread.
    """
    twin = torch_model(model, torch.device("cpu"), torch.float64)
    kernel = torch.fft.irfft2(twin.mean_transfer, s=twin.grid)
    for axis, (side, length) in enumerate(zip(twin.grid, twin.shape, strict=True)):
        # Offsets of at least the frame's length are negative ones, see `padded_transfer`.
        offsets = torch.arange(side)
        offsets = torch.where(offsets < length, offsets, offsets - side) % length
        shape = list(kernel.shape)
        shape[axis] = length
        kernel = torch.zeros(shape, dtype=kernel.dtype).index_add_(axis, offsets, kernel)
    transfer: Tensor = torch.fft.rfft2(kernel)
    return transfer


def half_weights(shape: tuple[int, ...]) -> Tensor:
    """Return how often each frequency of a half spectrum counts; the mean does not count."""
    rows, columns = shape
    twice = half_spectrum_weights(columns).repeat(rows, 1)
    twice[0, 0] = 0.0
    return twice


def power(image: Tensor) -> Tensor:
    """Return the power of each frequency of an image; for white noise its variance, on average."""
    spectrum: Tensor = torch.fft.rfft2(image)
    return spectrum.abs().square() / image.numel()


def periodic_power(image: Tensor) -> Tensor:
    """Return the `power` of an image without the jumps between opposite edges of its frame.

    The smooth image whose second differences cancel those of the jumps is subtracted (Moisan,
    J. Math. Imaging Vis. 39 (2011) 161).
    """
    rows, columns = image.shape
    jumps = torch.zeros_like(image)
    jumps[0] += image[-1] - image[0]
    jumps[-1] += image[0] - image[-1]
    jumps[:, 0] += image[:, -1] - image[:, 0]
    jumps[:, -1] += image[:, 0] - image[:, -1]
    y, x = _angles(rows, columns)
    curvature = 2.0 * (torch.cos(y) + torch.cos(x)) - 4.0
    curvature[0, 0] = 1.0
    smooth = torch.fft.rfft2(jumps) / curvature
    smooth[0, 0] = 0.0
    rest: Tensor = torch.fft.rfft2(image) - smooth
    return rest.abs().square() / image.numel()


def object_power(shape: tuple[int, ...]) -> Tensor:
    """Return the power spectrum 1/(f^2 + f_0^2) of an object, f_0 one cycle per frame; mean 0."""
    y, x = _angles(*shape)
    spectrum = 1.0 / (y**2 + x**2 + (2.0 * math.pi / max(shape)) ** 2)
    spectrum[0, 0] = 0.0
    return spectrum


def expected_signal(
    image_power: Tensor, passed: Tensor, variance: float, shape: tuple[int, ...]
) -> Tensor:
    """Return the power of the image of an object with spectrum `object_power`.

    Parameters
    ----------
    image_power : Tensor, (H, W//2 + 1)
        Power of the image, from `periodic_power`. Its excess over the noise is the object's.
    passed : Tensor, (H, W//2 + 1)
        Squared modulus of the transfer function.
    variance : float
        Variance of the noise, image units squared.
    shape : (int, int)
        Rows H and columns W of the image.
    """
    twice = half_weights(shape)
    signal = passed * object_power(shape)
    excess = float((twice * (image_power - variance)).sum())
    return signal * (max(excess, 0.0) / float((twice * signal).sum().clamp_min(1e-300)))


def beyond_optics(signal: Tensor, variance: float) -> Tensor:
    """Return the mask of frequencies at which the `expected_signal` is far below the noise."""
    return signal < _NOTHING_PASSED * variance


def _angles(rows: int, columns: int) -> tuple[Tensor, Tensor]:
    """Return the angular frequencies of a half spectrum, radians per pixel, as column and row."""
    y = 2.0 * math.pi * torch.fft.fftfreq(rows, dtype=torch.float64)[:, None]
    x = 2.0 * math.pi * torch.fft.rfftfreq(columns, dtype=torch.float64)[None]
    return y, x
