"""Autocorrelations of the parts into which a Gaussian filter splits random heights.

The filter passes the fraction ``exp(-(pi cutoff f)^2)`` of the power at the spatial frequency f.
In terms of lags it is the convolution with the positive kernel
``exp(-(r/cutoff)^2)/(pi cutoff^2)``.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ...errors import SceneError
from ..aperture.quadrature_nodes import gauss_legendre

Array = NDArray[np.float64]
Correlation = Callable[[Array], Array]

#: Radius of the filter's kernel, in cutoffs; beyond it the kernel is below exp(-49).
KERNEL: Final = 7.0
#: Gauss nodes per panel; panels are at most one cutoff wide.
NODES: Final = 12
#: Step of the table, in cutoffs; its quintic splines then have an error of 1e-9 of the variance.
STEP: Final = 0.05
#: Least fraction of the variance in each part, well above the error of the table.
LEAST: Final = 1e-6


@dataclass(frozen=True)
class GaussianRemainder:
    """Autocorrelation of the short waves of a Gaussian one, without cancellation.

    Parameters
    ----------
    length : float
        Correlation length of the whole, ``exp(-r^2/length^2)``, m.
    cutoff : float
        Cutoff of the filter, m.
    """

    length: float
    cutoff: float

    @property
    def passed(self) -> float:
        """Fraction of the variance that the filter passes."""
        return (self.length / math.hypot(self.length, self.cutoff)) ** 2

    @property
    def held(self) -> float:
        """Fraction of the variance that the filter rejects, that of the short waves."""
        return (self.cutoff / math.hypot(self.length, self.cutoff)) ** 2

    @property
    def end(self) -> float:
        """Lag beyond which C is 0, to 1e-300, m."""
        return 27 * math.hypot(self.length, self.cutoff)

    def __call__(self, r: Array) -> Array:
        """Return C, 1 at lag 0, at lags of any shape, m."""
        x = np.square(np.asarray(r) / self.length)
        fall = 1 + np.expm1(-self.held * x) / self.held
        return np.asarray(np.exp(-self.passed * x) * fall)

    def structure(self, r: Array) -> Array:
        """Return ``1 - C`` at lags of any shape, m."""
        x = np.square(np.asarray(r) / self.length)
        gain = np.exp(-self.passed * x) * np.expm1(-self.held * x) / self.held
        return np.asarray(-np.expm1(-self.passed * x) - gain)


@dataclass(frozen=True, eq=False)
class Smoothed:
    """Autocorrelation of the long waves of any C.

    Parameters
    ----------
    spline : callable
        Covariance at lags from 0 to ``end``, in units of the total variance.
    passed : float
        Covariance at lag 0: fraction of the variance that the filter passes.
    end : float
        Lag beyond which the covariance is 0, m.
    """

    spline: Correlation
    passed: float
    end: float

    def covariance(self, r: Array) -> Array:
        """Return ``passed * C`` at lags of any shape, m."""
        r = np.asarray(r, dtype=np.float64)
        return np.where(r < self.end, self.spline(np.minimum(r, self.end)), 0.0)

    def __call__(self, r: Array) -> Array:
        """Return C, 1 at lag 0, at lags of any shape, m."""
        return self.covariance(r) / self.passed


@dataclass(frozen=True, eq=False)
class Remainder:
    """Autocorrelation of the short waves of any C, as the difference of the whole and long waves.

    Parameters
    ----------
    whole : callable
        Autocorrelation of the whole.
    long : Smoothed
        That of the long waves.
    """

    whole: Correlation
    long: Smoothed

    @property
    def end(self) -> float:
        """Lag beyond which C is 0, m."""
        return self.long.end

    def __call__(self, r: Array) -> Array:
        """Return C, 1 at lag 0, at lags of any shape, m."""
        return (self.whole(r) - self.long.covariance(r)) / (1 - self.long.passed)


def smoothed(
    whole: Correlation, length: float, end: float, cutoff: float, lags: Array | None = None
) -> Smoothed:
    """Return the autocorrelation of the long waves, by filtering that of the whole.

    Parameters
    ----------
    whole : callable
        Autocorrelation C of the whole, a function of lags, m.
    length : float
        Scale of the decay of C, m.
    end : float
        Lag beyond which C is 0, m.
    cutoff : float
        Cutoff of the filter, m.
    lags : ndarray, (n,), optional
        Lags of a measured C, m, at which its interpolating cubics meet.

    Returns
    -------
    Smoothed

    Raises
    ------
    SceneError
        If a part would hold less than 1e-6 of the variance.
    """
    breaks = np.append(np.arange(0.0, 40.0, 0.5), np.geomspace(40.0, 1e3, 65)) * length
    if lags is not None:
        breaks = lags
    far = end + KERNEL * cutoff
    at = _table_lags(length, far, cutoff, measured=lags is not None)
    values = np.concatenate([_filtered(whole, r, breaks, end, cutoff) for r in _near(at, cutoff)])
    passed = float(values[0])
    if not LEAST < passed < 1 - LEAST:
        raise SceneError(
            f"cutoff = {cutoff:.3g} m leaves {passed:.3g} of the variance to the long waves, must "
            f"be {LEAST:g} to 1 - {LEAST:g} if autocorrelation is not 'gaussian'; use a cutoff "
            "nearer to the correlation length, 0 or infinity"
        )
    from scipy.interpolate import make_interp_spline  # half a second to load

    return Smoothed(make_interp_spline(at, values, k=5), passed, far)


def fall_length(correlation: Correlation, scale: float) -> float:
    """Return the smallest lag, m, at which C falls to 1/e, searched around ``scale``, m."""
    lags = scale * np.geomspace(1e-4, 1e4, 801)
    below = int(np.argmax(correlation(lags) <= math.exp(-1)))
    low, high = float(lags[max(below - 1, 0)]), float(lags[below])
    for _ in range(50):
        middle = (low + high) / 2
        if float(correlation(np.asarray(middle))) <= math.exp(-1):
            high = middle
        else:
            low = middle
    return high


def _table_lags(length: float, far: float, cutoff: float, *, measured: bool) -> Array:
    """Return the lags of the table: equidistant at short lags, with growing steps beyond.

    The step grows only where C varies more slowly than the filter's kernel.
    """
    step = STEP * cutoff
    even = far if measured or cutoff > length else min(8 * cutoff, far)
    lags = [np.arange(0.0, even, step)]
    r, rest = float(lags[0][-1]), []
    while r < far:
        r += min(step * max(1.0, r / (8 * cutoff)), max(step, STEP * length))
        rest.append(r)
    return np.concatenate([lags[0], rest])


def _near(lags: Array, cutoff: float) -> list[Array]:
    """Split lags into runs of at most four cutoffs, which share their quadrature nodes."""
    runs = np.floor(lags / (4 * cutoff))
    return list(np.split(lags, np.nonzero(np.diff(runs))[0] + 1))


def _filtered(whole: Correlation, r: Array, breaks: Array, end: float, cutoff: float) -> Array:
    """Return the filtered covariance at neighbouring lags ``r`` by Gauss quadrature.

    ``2/c^2 int C(t) t I0(2 r t/c^2) exp(-(r^2 + t^2)/c^2) dt`` with the cutoff c. Panels end at
    ``breaks``.
    """
    from scipy.special import i0e

    low, high = max(r[0] - KERNEL * cutoff, 0.0), min(r[-1] + KERNEL * cutoff, end)
    if high <= low:
        return np.zeros_like(r)
    even = np.linspace(low, high, math.ceil((high - low) / cutoff) + 1)
    edges = np.unique(np.append(even, breaks[(breaks > low) & (breaks < high)]))
    fraction, weights = gauss_legendre(NODES)
    t = (edges[:-1, None] + np.diff(edges)[:, None] * fraction).ravel()
    weight = (np.diff(edges)[:, None] * weights).ravel() * whole(t) * t * (2 / cutoff**2)
    kernel = np.exp(-(((r[:, None] - t) / cutoff) ** 2)) * i0e(2 * r[:, None] * t / cutoff**2)
    return np.asarray(np.einsum("rt,t->r", kernel, weight))
