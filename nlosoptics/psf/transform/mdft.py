"""Discrete Fourier transform of a pupil grid to any pitch and window (chirp-z transform).

With Bluestein's identity ``j l = (j^2 + l^2 - (l - j)^2)/2`` the transform becomes a convolution
with a chirp, computed by three FFTs for any image pitch (Rabiner, Schafer & Rader 1969).
"""

from __future__ import annotations

import math

import ducc0
import numpy as np

from ..._vectors import Array, ComplexArray
from ..wave.detilted import Residual
from ..window.grids import Pass, PupilGrid, intensity
from ..window.pixels import PixelRule
from ..window.window import Window


def intensity_in(
    residual: Residual, grid: PupilGrid, window: Window, rule: PixelRule | None
) -> Array:
    """Compute the image intensity (ny, nx) in a window, 1 at the ideal peak.

    It is averaged over pixels if ``rule`` is given.
    """
    wave = residual.wavefront
    n = grid.values.shape[0]
    # Phase in turns per pupil sample and metre of image, with the sign of the image distance.
    rate = grid.pitch / (wave.wavelength * wave.image_distance)
    passes = [
        chirp_pass(
            n,
            grid.centre,
            count,
            rate * window.pitch,
            rate * (first + (count // 2) * window.pitch - shift),
        )
        for first, count, shift in zip(
            window.first, window.shape[::-1], residual.shift, strict=True
        )
    ]
    return intensity(grid.values, passes[0], passes[1], window.shape, rule)


def chirp_pass(n: int, centre: int, count: int, step: float, offset: float) -> Pass:
    """Return a function that maps rows g to ``sum_j g_j exp(-2 pi i j (offset + l step))``.

    The result is up to a phase factor per sample l. j counts from ``centre``, l from ``count//2``.
    """
    size = int(ducc0.fft.good_size(n + count - 1))
    j = np.arange(n) - centre
    before = np.exp(-2j * math.pi * (offset * j + step / 2 * j**2))
    lag = np.arange(1 - n, count)
    chirp = np.zeros(size, dtype=np.complex128)
    chirp[lag] = np.exp(1j * math.pi * step * (lag + centre - count // 2) ** 2)
    kernel = ducc0.fft.c2c(chirp, nthreads=1) / size

    def transform(rows: ComplexArray) -> ComplexArray:
        padded = np.zeros((rows.shape[0], size), dtype=np.complex128)
        padded[:, :n] = rows * before
        ducc0.fft.c2c(padded, axes=(1,), out=padded, nthreads=1)
        padded *= kernel
        ducc0.fft.c2c(padded, axes=(1,), forward=False, out=padded, nthreads=1)
        return padded[:, :count]

    return transform
