"""Autocorrelations of the parts into which a Gaussian filter splits random heights.

The filter passes ``exp(-(pi cutoff f)^2)`` of the power at the spatial frequency f. In lags it is
the convolution with ``exp(-(r/cutoff)^2)/(pi cutoff^2)``, whose integrand changes no sign.
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

#: Cutoffs beyond which the filter's kernel, exp(-49), is nothing.
KERNEL: Final = 7.0
#: Gauss nodes a panel; panels are at most a cutoff wide.
NODES: Final = 12
#: Step of the table in cutoffs; its quintics then err by 1e-9 of the variance.
STEP: Final = 0.05
#: Share of the variance that each part must hold to be told from what the table errs by.
LEAST: Final = 1e-6


@dataclass(frozen=True)
class GaussianRemainder:
    """What the filter holds back of ``exp(-r^2/length^2)``, 1 at lag 0, without cancellation.

    Parameters
    ----------
    length, cutoff : float
        m.
    """

    length: float
    cutoff: float

    @property
    def passed(self) -> float:
        """Share of the variance that the filter passes."""
        return (self.length / math.hypot(self.length, self.cutoff)) ** 2

    @property
    def held(self) -> float:
        """Share of the variance that stays."""
        return (self.cutoff / math.hypot(self.length, self.cutoff)) ** 2

    @property
    def end(self) -> float:
        """Lag beyond which C is 0, to 1e-300, m."""
        return 27 * math.hypot(self.length, self.cutoff)

    def __call__(self, r: Array) -> Array:
        """C at lags of any shape, m."""
        x = np.square(np.asarray(r) / self.length)
        fall = 1 + np.expm1(-self.held * x) / self.held
        return np.asarray(np.exp(-self.passed * x) * fall)

    def structure(self, r: Array) -> Array:
        """``1 - C``."""
        x = np.square(np.asarray(r) / self.length)
        gain = np.exp(-self.passed * x) * np.expm1(-self.held * x) / self.held
        return np.asarray(-np.expm1(-self.passed * x) - gain)


@dataclass(frozen=True, eq=False)
class Smoothed:
    """What the filter passes of any C, 1 at lag 0; 0 beyond ``end``.

    Parameters
    ----------
    spline : callable
        Covariance over lags from 0 to ``end``, in units of the whole variance.
    passed : float
        Its value at 0.
    end : float
        m.
    """

    spline: Correlation
    passed: float
    end: float

    def covariance(self, r: Array) -> Array:
        """``passed * C``."""
        r = np.asarray(r, dtype=np.float64)
        return np.where(r < self.end, self.spline(np.minimum(r, self.end)), 0.0)

    def __call__(self, r: Array) -> Array:
        """C at lags of any shape, m."""
        return self.covariance(r) / self.passed


@dataclass(frozen=True, eq=False)
class Remainder:
    """What the filter holds back of any C, 1 at lag 0: both parts add up to C by construction."""

    whole: Correlation
    long: Smoothed

    @property
    def end(self) -> float:
        """Lag beyond which C is 0, m."""
        return self.long.end

    def __call__(self, r: Array) -> Array:
        """C at lags of any shape, m."""
        return (self.whole(r) - self.long.covariance(r)) / (1 - self.long.passed)


def smoothed(
    whole: Correlation, length: float, end: float, cutoff: float, lags: Array | None = None
) -> Smoothed:
    """Filter an autocorrelation.

    Parameters
    ----------
    whole : callable
        C.
    length : float
        Scale on which C falls, m.
    end : float
        Lag beyond which C is 0, m.
    cutoff : float
        m.
    lags : ndarray, optional
        Of a measured C, m, where its cubics meet.

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
            f"be {LEAST:g} to 1 - {LEAST:g} for an autocorrelation other than 'gaussian'; use a "
            "cutoff nearer to the correlation length, 0 or infinity"
        )
    from scipy.interpolate import make_interp_spline  # half a second to load

    return Smoothed(make_interp_spline(at, values, k=5), passed, far)


def fall_length(correlation: Correlation, scale: float) -> float:
    """Smallest lag at which C comes to 1/e, m, searched about a scale."""
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
    """Lags of the table: even where the filter rounds C off, wider where C alone has a shape."""
    step = STEP * cutoff
    even = far if measured or cutoff > length else min(8 * cutoff, far)
    lags = [np.arange(0.0, even, step)]
    r, rest = float(lags[0][-1]), []
    while r < far:
        r += min(step * max(1.0, r / (8 * cutoff)), max(step, STEP * length))
        rest.append(r)
    return np.concatenate([lags[0], rest])


def _near(lags: Array, cutoff: float) -> list[Array]:
    """Runs of lags within four cutoffs of each other."""
    runs = np.floor(lags / (4 * cutoff))
    return list(np.split(lags, np.nonzero(np.diff(runs))[0] + 1))


def _filtered(whole: Correlation, r: Array, breaks: Array, end: float, cutoff: float) -> Array:
    """Covariance at neighbouring lags: ``2/c^2 int C t I0(2 r t/c^2) exp(-(r^2 + t^2)/c^2) dt``."""
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
