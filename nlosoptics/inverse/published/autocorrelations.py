"""Autocorrelation and spectrum of an object, from its image via a wall with a speckle-like PSF."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage

from ...errors import SamplingError, SceneError
from ...imaging.forward_model import ForwardModel
from ..data.arrays import real_array
from ..data.models import squared
from ..data.noisy_image import NoisyImage

Array = NDArray[np.float64]


class SpectrumModulus(NamedTuple):
    """Estimated modulus of the object's spectrum, the input of phase retrieval.

    ``modulus`` (g_y, g_x//2 + 1): modulus of the object's ``rfft2``, float64, any scale. The grid
    is at least 1.5 times as wide as the object's autocorrelation. ``grid`` (int, int): rows and
    columns (g_y, g_x) of the grid. ``object_size`` (int, int): rows and columns of the rectangle
    that contains the object.
    """

    modulus: Array
    grid: tuple[int, int]
    object_size: tuple[int, int]


def image_lags(data: NoisyImage, model: ForwardModel | None) -> Array:
    """Return the autocorrelation of an image minus its mean, with the zero lag at the centre.

    Both sides are odd. Without a model each lag is the mean over all pairs of valid pixels. With a
    model the power spectrum is divided by that of the point spread, where this exceeds the noise.
    """
    counts = (data.weights > 0.0).astype(np.float64)
    # excluded pixels hold the weighted mean of the others
    clean = counts * (data.data - np.average(data.data, weights=counts))
    if model is None:
        grid = tuple(int(fft.next_fast_len(2 * n, real=True)) for n in clean.shape)
        pairs = fft.irfft2(squared(fft.rfft2(counts, s=grid)), s=grid)
        lags = fft.irfft2(squared(fft.rfft2(clean, s=grid)), s=grid) / np.maximum(pairs, 1.0)
    else:
        grid, passed = model.grid, squared(model.transfer)
        power, noise = squared(fft.rfft2(clean, s=grid)), data.noise_power()
        # Wiener filter of the power; the image's mean power gives the signal-to-noise ratio
        floor = noise / max(power.mean() - noise, 1e-12 * power.mean()) * passed.mean()
        lags = fft.irfft2(np.maximum(power - noise, 0.0) * passed / (passed**2 + floor**2), s=grid)
    reach = [min((n - 1) // 2, (g - 1) // 2) for n, g in zip(clean.shape, grid, strict=True)]
    # from FFT order to the zero lag at the centre
    return np.asarray(lags[np.ix_(*(np.arange(-r, r + 1) for r in reach))])


def spectrum_modulus(lags: Array, object_size: tuple[int, int] | None) -> SpectrumModulus:
    """Estimate the modulus of the object's spectrum from an autocorrelation with background.

    ``lags`` (odd, odd) have the zero lag at the centre, which is not used itself. ``object_size``
    is the object's rows and columns; None: half the extent of the lags above the background. A
    `SamplingError` is raised if no lags exceed it, or the object's lags do not fit the array.
    """
    if min(lags.shape) < 3:
        raise SamplingError(
            f"the image holds {lags.shape[0]} x {lags.shape[1]} lags, limit 3 x 3; give one of at "
            "least 3 x 3 pixels"
        )
    centre = tuple(n // 2 for n in lags.shape)
    lags = lags.copy()
    # The zero lag contains the noise variance, or nothing, so its neighbours replace it.
    neighbours = [(centre[0] + i, centre[1] + j) for i, j in ((0, 1), (0, -1), (1, 0), (-1, 0))]
    lags[centre] = np.mean([lags[place] for place in neighbours])
    if object_size is None:
        object_size = _object_size(lags)
    half = [n - 1 for n in object_size]
    if any(h > c for h, c in zip(half, centre, strict=True)):
        raise SamplingError(
            f"an object of {object_size[0]} x {object_size[1]} pixels has lags up to "
            f"{half[0]} x {half[1]}, beyond the {centre[0]} x {centre[1]} that there are; "
            "give a smaller object_size, or an image at least twice as wide as the object"
        )
    rows, columns = (slice(c - h, c + h + 1) for c, h in zip(centre, half, strict=True))
    window = lags[rows, columns]
    border = np.concatenate((window[0], window[-1], window[:, 0], window[:, -1]))
    window = window - np.median(border)
    grid = tuple(int(fft.next_fast_len(3 * h + 1, real=True)) for h in half)
    wrapped = np.zeros(grid)
    offsets = [np.arange(-h, h + 1) for h in half]
    wrapped[np.ix_(*offsets)] = window
    power = fft.rfft2(wrapped).real
    if not power.max() > 0.0:
        raise SamplingError(
            "the lags hold no positive power within the object's extent; "
            "give object_size, or an autocorrelation that falls from its centre"
        )
    modulus = np.sqrt(np.maximum(power / power.max(), 0.0))
    return SpectrumModulus(modulus=modulus, grid=(grid[0], grid[1]), object_size=object_size)


def checked_lags(autocorrelation: Any) -> Array:
    """Return an autocorrelation as an array made symmetric about its centre; raise if invalid."""
    lags = real_array("autocorrelation", autocorrelation)
    if lags.ndim != 2 or min(lags.shape) < 5 or not all(n % 2 for n in lags.shape):
        raise SamplingError(
            f"autocorrelation has shape {lags.shape}, must be (odd, odd) with the zero lag at the "
            "centre, at least 5 x 5; cut one row or column off an even array"
        )
    if not np.isfinite(lags).all():
        raise SceneError(
            f"autocorrelation has {np.count_nonzero(~np.isfinite(lags))} of {lags.size} values "
            "that are not finite; mend them first"
        )
    if np.ptp(lags) == 0.0:
        raise SceneError(
            f"autocorrelation is {lags.flat[0]:g} everywhere; give one that falls from its centre"
        )
    return 0.5 * (lags + lags[::-1, ::-1])


def _object_size(lags: Array) -> tuple[int, int]:
    """Estimate the object's size: half the extent of the lags above the background, plus margin.

    The outer 15 % of the lags determine background and noise. At large lags few pairs of bright
    pixels contribute, so that noise hides the edge; hence the margin.
    """
    smooth = ndimage.uniform_filter(lags, 3)
    axes = [np.abs(np.arange(n) - n // 2) / (n // 2) for n in lags.shape]
    far = np.maximum(axes[0][:, None], axes[1]) > 0.85
    level = np.median(smooth[far])
    spread = 1.4826 * np.median(np.abs(smooth[far] - level))
    labels, _ = ndimage.label(smooth > level + 3.0 * spread)
    name = labels[lags.shape[0] // 2, lags.shape[1] // 2]
    if name == 0:
        raise SamplingError(
            "no lags stand out of the background around the centre, so that the autocorrelation "
            "shows no object; use an image with more light, or give object_size"
        )
    found = ndimage.find_objects(labels)[name - 1]
    sizes = [
        min(math.ceil(1.4 * (s.stop - s.start) / 2) + 1, (n + 1) // 2)
        for s, n in zip(found, lags.shape, strict=True)
    ]
    return sizes[0], sizes[1]
