"""Fourier transforms of real images by ducc0, without scipy.fft, whose import takes 0.1 s."""

from __future__ import annotations

from typing import Any

import ducc0.fft
import numpy as np
from numpy.typing import NDArray

Images = NDArray[Any]


def fast_length(least: int) -> int:
    """Return the shortest fast length of a real transform of at least ``least`` samples."""
    return int(ducc0.fft.good_size(least, True))


def rfft2(images: Images, grid: tuple[int, ...] | None = None, out: Images | None = None) -> Images:
    """Return the half spectra (..., rows, columns//2 + 1) of images (..., rows, columns).

    The images are continued with zeros to a ``grid`` (rows, columns), if one is given.
    """
    if grid is not None and images.shape[-2:] != tuple(grid):
        rows, columns = images.shape[-2:]
        framed = np.zeros((*images.shape[:-2], *grid), dtype=images.dtype)
        framed[..., :rows, :columns] = images
        images = framed
    return np.asarray(ducc0.fft.r2c(images, axes=(-2, -1), out=out))


def irfft2(spectra: Images, columns: int, out: Images | None = None) -> Images:
    """Return the images (..., rows, columns) of half spectra (..., rows, columns//2 + 1).

    Spectra may be real: those of images that are even.
    """
    if np.isrealobj(spectra):
        spectra = spectra + 0j
    return np.asarray(
        ducc0.fft.c2r(spectra, axes=(-2, -1), lastsize=columns, forward=False, inorm=2, out=out)
    )


def cosines2(image: Images) -> Images:
    """Return the orthonormal cosine transform (rows, columns) of an image."""
    return np.asarray(ducc0.fft.dct(image, 2, axes=(0, 1), inorm=1))
