"""Virtual light on the relay wall: which wavenumbers it has, and a capture's response to each.

The virtual pulse is ``K(t) = exp(2 pi i t/wl_mean - t^2/(2 wl_sigma^2))``, t in m of optical path
(Liu et al., Nature 572, 620 (2019)). What it leaves on the wall is ``(H * K)(t)``, the sum over
bins of ``H_j K(t - t_j)`` with t_j the bins' middles. Here K is a sum of few plane waves

    K(t) ~ sum_k w_k exp(i k t),  w_k = (dk/2 pi) sqrt(2 pi) wl_sigma exp(-wl_sigma^2 (k - k0)^2/2),

k over all multiples of dk within a band about ``k0 = 2 pi/wl_mean``. The sum has the period
2 pi/dk, made so long that no time asked for sees the next period, and the band so wide, that its
error stays below ``tol`` of K's peak.
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

#: Bytes of transformed time that are held at once.
BLOCK = 2**25
#: Bins that a pulse's standard deviation has at least.
SHORTEST = 0.25


@dataclass(frozen=True, eq=False)
class Band:
    """The plane waves that make the virtual pulse, and the bins that they act on.

    Parameters
    ----------
    numbers : ndarray
        (n,), multiples of ``step`` that are kept.
    step : float
        Between wavenumbers, rad/m of optical path.
    weights : ndarray
        (n,), w_k.
    bins : slice
        Those whose light reaches any time that is asked for.
    n_times : int
        Bins of one period, what is beyond ``bins`` being 0.
    """

    numbers: NDArray[np.int64]
    step: float
    weights: Array
    bins: slice
    n_times: int

    @property
    def wavenumbers(self) -> Array:
        """(n,), rad/m of optical path."""
        return self.step * self.numbers

    def part(self, kept: slice) -> Band:
        """The band with some of its waves."""
        return Band(self.numbers[kept], self.step, self.weights[kept], self.bins, self.n_times)


def pulse_band(
    capture: TransientCapture,
    wl_mean: float,
    wl_sigma: float,
    times: tuple[float, float],
    tol: float,
) -> Band:
    """Wavenumbers that stand for the pulse at all times within an interval.

    Parameters
    ----------
    capture : TransientCapture
        Its bins.
    wl_mean, wl_sigma : float
        m of optical path.
    times : (float, float)
        First and last time at which the filtered response is wanted, m.
    tol : float
        Of the pulse's peak.

    Returns
    -------
    Band

    Raises
    ------
    SamplingError
        If no bin's light reaches these times, or the pulse is shorter than a quarter of a bin.
    MemoryLimitError
        If the pulse is so long that one response does not fit.
    """
    import ducc0
    from scipy.special import erfcinv

    if wl_sigma < SHORTEST * capture.delta_t:
        raise SamplingError(
            f"wl_sigma = {wl_sigma:.4g} m, limit {SHORTEST * capture.delta_t:.4g} m, "
            f"{SHORTEST:g} bins, in which it would be lost; take a longer pulse, or finer bins"
        )
    # half of tol for what the band leaves out, a quarter each for late and for repeated light
    half_band = math.sqrt(2.0) * float(erfcinv(0.5 * tol)) / wl_sigma
    reach = wl_sigma * math.sqrt(2.0 * math.log(4.0 / tol))
    width, edges = capture.delta_t, capture.edges
    first = max(0, math.floor((times[0] - reach - edges[0]) / width))
    last = min(capture.n_bins, math.ceil((times[1] + reach - edges[0]) / width))
    if last <= first:
        raise SamplingError(
            f"the volume is seen at paths of {times[0]:.4g} to {times[1]:.4g} m, and the capture "
            f"holds {edges[0]:.4g} to {edges[-1]:.4g} m; give another volume, or check t_start"
        )
    period = max(times[1] - edges[first], edges[last] - times[0]) + reach
    fits_memory(
        f"a pulse of wl_sigma = {wl_sigma:.4g} m",
        32.0 * period / width,
        "take a shorter one",
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
    """A capture's weighted response to each wave of a band, outer legs taken away by phase.

    Parameters
    ----------
    capture : TransientCapture
    band : Band
    columns : ndarray of int
        (m,), which of the capture's pairs, counted along ``H.reshape(n_bins, -1)``.
    legs : ndarray
        (m,), path that the times hold beside the hidden one, m.
    dtype : {"float64", "float32"}

    Returns
    -------
    ndarray
        (n, m) complex: ``w_k sum_j H_j exp(-i k (t_j - legs))``.
    """
    import ducc0

    flat = capture.H.reshape(capture.n_bins, -1)[band.bins]
    kind = np.complex64 if dtype == "float32" else np.complex128
    out = np.empty((len(band.numbers), len(columns)), dtype=kind)
    # rfft holds half of the circle of frequencies; the other half is its conjugate
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
    """Slices of at most ``size`` that cover ``count``."""
    for start in range(0, count, size):
        yield slice(start, min(start + size, count))
