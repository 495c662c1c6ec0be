"""Intensity integrated over square pixels.

An intensity is band-limited to 1/(lambda N). Its samples at a pitch finer than lambda N/2 determine
it completely, and the mean over a pixel is a weighted sum of them. The weights are the integral of
a windowed sinc over the pixel. Their spectrum equals the pixel's sinc up to the band limit and
vanishes where the sampled spectrum repeats. Only a few samples around the pixel are needed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..._checks import fits_memory
from ..._vectors import Array
from ..aperture.quadrature_nodes import gauss_legendre
from .window import Window

#: Kaiser parameter; the filter's error is about exp(-24) = 4e-11.
BETA = 24.0


@dataclass(frozen=True, eq=False)
class PixelRule:
    """Weights that turn fine intensity samples into pixel means.

    Parameters
    ----------
    factor : int
        Fine samples per pixel side.
    margin : int
        Additional samples on either side of the window.
    taps : ndarray, (factor + 2 margin,)
        Weights, sum 1.
    """

    factor: int
    margin: int
    taps: Array

    def window(self, pitch: float, shape: tuple[int, int]) -> Window:
        """Return the window of fine samples for a centred window of pixels.

        ``pitch`` is the pixel side, m, and ``shape`` the number of pixels (ny, nx).
        """
        ny, nx = shape
        fine = pitch / self.factor
        back = ((self.factor - 1) / 2 + self.margin) * fine
        return Window(
            fine,
            (ny * self.factor + 2 * self.margin, nx * self.factor + 2 * self.margin),
            (-(nx // 2) * pitch - back, -(ny // 2) * pitch - back),
        )

    def mean(self, fine: Array) -> Array:
        """Return pixel means (rows, n) along the last axis of (rows, n factor + 2 margin)."""
        down, along = fine.strides
        # sliding_window_view would take longer than the sums of a few rows
        runs = np.lib.stride_tricks.as_strided(
            fine,
            (len(fine), self.count(fine.shape[1]), self.taps.size),
            (down, self.factor * along, along),
        )
        # einsum does not call BLAS, so results are bit-identical for any thread count.
        return np.asarray(np.einsum("rpt,t->rp", runs, self.taps))

    def mean_down(self, fine: Array) -> Array:
        """Return pixel means along the first axis of samples (n factor + 2 margin, columns)."""
        return self.mean(np.ascontiguousarray(fine.T)).T

    def count(self, samples: int) -> int:
        """Return the number of pixels that a number of fine samples gives."""
        return (samples - 2 * self.margin) // self.factor


def pixel_rule(pitch: float, nyquist_pitch: float, n: int) -> PixelRule:
    """Return the weights for a row of ``n`` pixels of side ``pitch``, m.

    Finer samples allow a shorter filter. The factor with the fewest samples in total is chosen, at
    a pitch of at most ``nyquist_pitch``/1.05.
    """
    lowest = max(1, math.ceil(1.05 * pitch / nyquist_pitch))
    what = f"a pixel {pitch / nyquist_pitch:.3g} times as wide as Nyquist's samples"
    fits_memory(what, 64.0 * lowest, "use a smaller pixel pitch")
    # The best factor is at most sqrt(16 lowest/n) above the lowest.
    factors = range(lowest, lowest + 8 * math.isqrt(lowest) + 8)
    factor = min(factors, key=lambda s: n * s + 2 * _margin(pitch / s, nyquist_pitch))
    margin = _margin(pitch / factor, nyquist_pitch)
    return PixelRule(factor, margin, _taps(factor, margin))


def _margin(fine: float, nyquist_pitch: float) -> int:
    """Half length, in samples, of a Kaiser window that fits between the band and its repeat."""
    gap = 0.5 - fine / (2 * nyquist_pitch)  # half the gap, cycles per sample
    return math.ceil(math.hypot(BETA, math.pi) / (2 * math.pi * gap))


def _taps(factor: int, margin: int) -> Array:
    """Weight of each sample: integral of sinc times a Kaiser window over the pixel."""
    fraction, weights = gauss_legendre(16)
    # Antiderivative at t = 0.5, 1.5, ... margin - 0.5, margin samples; it is odd about 0.
    edges = np.append(np.arange(margin) + 0.5, float(margin))
    starts = np.append(0.0, edges[:-1])
    t = starts[:, None] + np.diff(np.append(0.0, edges))[:, None] * fraction
    kaiser = np.i0(BETA * np.sqrt(np.maximum(1 - (t / margin) ** 2, 0.0)))
    areas = np.sum(np.sinc(t) * kaiser * weights, axis=1) * np.diff(np.append(0.0, edges))
    primitive = np.cumsum(areas)
    primitive /= 2 * primitive[-1]
    ends = np.arange(factor + 2 * margin, dtype=np.float64) - margin + 0.5

    def at(position: Array) -> Array:
        """Antiderivative at half-integer positions."""
        index = np.minimum(np.abs(position) - 0.5, margin).astype(np.int64)
        return np.asarray(np.sign(position) * primitive[index])

    return (at(ends) - at(ends - factor)) / factor
