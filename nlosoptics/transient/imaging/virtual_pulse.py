"""Virtual pulse on the relay wall: its wavenumbers, and a capture's response to each of them.

The virtual pulse is ``K(t) = exp(2 pi i t/wl_mean - t^2/(2 wl_sigma^2))``, with t in m of optical
path (Liu et al., Nature 572, 620 (2019)). The resulting field on the wall is ``(H * K)(t)``, the
sum over bins of ``H_j K(t - t_j)`` with t_j the centres of the bins. K is approximated by a few
harmonic waves,

    K(t) ~ sum_k w_k exp(i k t),  w_k = (dk/2 pi) sqrt(2 pi) wl_sigma exp(-wl_sigma^2 (k - k0)^2/2),

where k are the multiples of dk within a band about ``k0 = 2 pi/wl_mean``. The sum has the period
2 pi/dk. Period and bandwidth are large enough that the error at all requested times stays below
``tol`` times the peak of K.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..._checks import fits_memory
from ...errors import SamplingError
from ..capture.capture import TransientCapture

Array = NDArray[np.floating]
ComplexArray = NDArray[np.complexfloating]

#: Bytes of transformed time series that are held at a time.
BLOCK = 2**25


@dataclass(frozen=True, eq=False)
class Band:
    """Harmonic waves that make up the virtual pulse, and the bins that they act on."""

    numbers: NDArray[np.int64]  # (n,) int64: wavenumbers in multiples of ``step``
    step: float  # Spacing of wavenumbers, rad/m of optical path
    weights: Array  # (n,): weights w_k of the harmonic waves
    bins: slice  # Bins that contribute to any requested time
    n_times: int  # Number of bins in one period; those beyond ``bins`` are 0

    @property
    def wavenumbers(self) -> Array:
        """Wavenumbers (n,), rad/m of optical path."""
        return self.step * self.numbers

    def part(self, kept: slice) -> Band:
        """Return a band with only the waves in a slice."""
        return Band(self.numbers[kept], self.step, self.weights[kept], self.bins, self.n_times)


def pulse_band(
    capture: TransientCapture,
    wl_mean: float,
    wl_sigma: float,
    times: tuple[float, float],
    tol: float,
) -> Band:
    """Choose the wavenumbers that represent the pulse at all times within an interval."""
    import ducc0
    from scipy.special import erfcinv

    if wl_sigma < 0.25 * capture.delta_t:
        raise SamplingError(
            f"wl_sigma = {wl_sigma:.4g} m, limit {0.25 * capture.delta_t:.4g} m "
            f"(a quarter of a bin), is too short for the bins; give a longer pulse, or finer bins"
        )
    # error budget: half of tol for the limited band, a quarter each for omitted bins and for the
    # periodic repetition
    half_band = math.sqrt(2.0) * float(erfcinv(0.5 * tol)) / wl_sigma
    reach = wl_sigma * math.sqrt(2.0 * math.log(4.0 / tol))
    width, edges = capture.delta_t, capture.edges
    first = max(0, math.floor((times[0] - reach - edges[0]) / width))
    last = min(capture.n_bins, math.ceil((times[1] + reach - edges[0]) / width))
    if last <= first:
        raise SamplingError(
            f"the volume has paths of {times[0]:.4g} to {times[1]:.4g} m, outside the capture's "
            f"{edges[0]:.4g} to {edges[-1]:.4g} m; give another volume, or check t_start"
        )
    period = max(times[1] - edges[first], edges[last] - times[0]) + reach
    fits_memory(
        f"a pulse of wl_sigma = {wl_sigma:.4g} m",
        32.0 * period / width,
        "give a shorter one",
    )
    n_times = int(ducc0.fft.good_size(math.ceil(period / width), True))
    step = 2.0 * math.pi / (n_times * width)
    centre = 2.0 * math.pi / wl_mean
    numbers = np.arange(
        math.floor((centre - half_band) / step), math.ceil((centre + half_band) / step) + 1
    )
    weights = step * wl_sigma / math.sqrt(2.0 * math.pi)
    weights = weights * np.exp(-0.5 * (wl_sigma * (step * numbers - centre)) ** 2)
    return Band(numbers, step, weights, slice(first, last), n_times)


def responses(
    capture: TransientCapture, band: Band, columns: NDArray[np.intp], legs: Array, dtype: str
) -> ComplexArray:
    """Return a capture's weighted response to each wave of a band, with known legs subtracted.

    Returns (n, m) complex: ``w_k sum_j H_j exp(-i k (t_j - legs))``.
    """
    import ducc0

    flat = capture.H.reshape(capture.n_bins, -1)[band.bins]
    kind = np.complex64 if dtype == "float32" else np.complex128
    out = np.empty((len(band.numbers), len(columns)), dtype=kind)
    # the real transform returns half of the frequencies; the others are complex conjugates
    turned = np.mod(band.numbers, band.n_times)
    mirrored = turned > band.n_times // 2
    rows = np.where(mirrored, band.n_times - turned, turned)
    middle = capture.t_start + (band.bins.start + 0.5) * capture.delta_t
    waves = band.wavenumbers
    turns = band.weights * np.exp(-1j * waves * middle)
    for block in blocks(len(columns), max(1, BLOCK // (8 * band.n_times))):
        padded = np.zeros((band.n_times, block.stop - block.start), dtype=dtype)
        padded[: flat.shape[0]] = flat[:, columns[block]]
        light = ducc0.fft.r2c(padded, axes=(0,), nthreads=1)[rows]
        light[mirrored] = light[mirrored].conj()
        out[:, block] = light * turns[:, None]
        if legs[block].any():
            out[:, block] *= np.exp(1j * np.outer(waves, legs[block]))
    return out


def blocks(count: int, size: int) -> Iterator[slice]:
    """Yield slices of at most ``size`` elements that cover ``count`` elements."""
    for start in range(0, count, size):
        yield slice(start, min(start + size, count))
