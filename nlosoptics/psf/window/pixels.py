"""Intensity integrated over square pixels.

An intensity is band-limited to 1/(lambda N), so its samples at a pitch finer than lambda N/2 hold
it whole, and the mean over a pixel is a weighted sum of them. The weights are the integral, over
the pixel, of a windowed sinc: a filter that equals the pixel's sinc up to the band limit, falls to
nothing where the sampled spectrum repeats, and needs only a few samples around the pixel.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..._checks import fits_memory
from ..aperture.quadrature_nodes import gauss_legendre
from .window import Window

Array = NDArray[np.float64]

#: Kaiser parameter; the filter errs by about exp(-24) = 4e-11.
BETA = 24.0


@dataclass(frozen=True, eq=False)
class PixelRule:
    """Weights that turn fine samples into pixel means.

    Parameters
    ----------
    factor : int
        Fine samples per pixel side.
    margin : int
        Further samples on either side of the window.
    taps : ndarray
        (factor + 2 margin,), sum 1.
    """

    factor: int
    margin: int
    taps: Array

    def window(self, pitch: float, shape: tuple[int, int]) -> Window:
        """Fine samples for a centred window of pixels."""
        ny, nx = shape
        fine = pitch / self.factor
        back = ((self.factor - 1) / 2 + self.margin) * fine
        return Window(
            fine,
            (ny * self.factor + 2 * self.margin, nx * self.factor + 2 * self.margin),
            (-(nx // 2) * pitch - back, -(ny // 2) * pitch - back),
        )

    def mean(self, fine: Array) -> Array:
        """Pixel means along the last axis of (rows, n factor + 2 margin)."""
        runs = np.lib.stride_tricks.sliding_window_view(fine, self.taps.size, axis=1)
        # einsum without BLAS: the same bits for any thread count.
        return np.asarray(np.einsum("rpt,t->rp", runs[:, :: self.factor], self.taps))

    def mean_down(self, fine: Array) -> Array:
        """The same along the first axis of (n factor + 2 margin, columns)."""
        return self.mean(np.ascontiguousarray(fine.T)).T

    def count(self, samples: int) -> int:
        """Pixels that so many fine samples make."""
        return (samples - 2 * self.margin) // self.factor


def pixel_rule(pitch: float, nyquist_pitch: float, n: int) -> PixelRule:
    """Weights for pixels of side ``pitch``, ``n`` of them across.

    Finer samples let the filter fall off faster; the factor is the one with the fewest samples in
    all, at least 1.05 times Nyquist's.
    """
    lowest = max(1, math.ceil(1.05 * pitch / nyquist_pitch))
    what = f"a pixel {pitch / nyquist_pitch:.3g} times as wide as Nyquist's samples"
    fits_memory(what, 64.0 * lowest, "use a smaller pixel pitch")
    # the fewest samples are at most sqrt(16 lowest/n) beyond the lowest factor
    factors = range(lowest, lowest + 8 * math.isqrt(lowest) + 8)
    factor = min(factors, key=lambda s: n * s + 2 * _margin(pitch / s, nyquist_pitch))
    margin = _margin(pitch / factor, nyquist_pitch)
    return PixelRule(factor, margin, _taps(factor, margin))


def _margin(fine: float, nyquist_pitch: float) -> int:
    """Samples over which a Kaiser window of `BETA` fits the gap from the band to its repeat."""
    gap = 0.5 - fine / (2 * nyquist_pitch)  # half of it, in cycles per sample
    return math.ceil(math.hypot(BETA, math.pi) / (2 * math.pi * gap))


def _taps(factor: int, margin: int) -> Array:
    """Integral of sinc(t) times a Kaiser window over the pixel, sample by sample."""
    fraction, weights = gauss_legendre(16)
    # Primitive at t = 0.5, 1.5, ... margin - 0.5, margin (in samples), odd about 0.
    edges = np.append(np.arange(margin) + 0.5, float(margin))
    starts = np.append(0.0, edges[:-1])
    t = starts[:, None] + np.diff(np.append(0.0, edges))[:, None] * fraction
    kaiser = np.i0(BETA * np.sqrt(np.maximum(1 - (t / margin) ** 2, 0.0)))
    areas = np.sum(np.sinc(t) * kaiser * weights, axis=1) * np.diff(np.append(0.0, edges))
    primitive = np.cumsum(areas)
    primitive /= 2 * primitive[-1]
    ends = np.arange(factor + 2 * margin, dtype=np.float64) - margin + 0.5

    def at(position: Array) -> Array:
        index = np.minimum(np.abs(position) - 0.5, margin).astype(np.int64)
        return np.asarray(np.sign(position) * primitive[index])

    return (at(ends) - at(ends - factor)) / factor
