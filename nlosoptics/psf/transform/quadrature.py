"""Sum over polar or cell nodes, as many as an error allows, by a non-uniform FFT."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ..._vectors import Array
from ..aperture.quadrature_nodes import frozen
from ..wave.detilted import Residual
from ..window import error_bounds
from ..window.window import Window
from . import nufft

#: Semi-axis sums of the ellipses on which `growth` bounds a wave.
RHO = 1 + np.geomspace(0.02, 20.0, 48)
LOG = np.log(RHO)
#: Error of nodes that is at the level of rounding.
NEGLIGIBLE = 1e-15
#: Largest error of nodes that is wanted: coarser nodes save no time.
MOST = 1e-2
#: Airy units about the rays within which an image may be as bright as its peak.
BRIGHT = 2.0


def node_counts(residual: Residual, window: Window, own: Array | None = None) -> tuple[int, ...]:
    """Return the shape of the nodes for which the quadrature has converged to rounding error.

    ``own`` is the result of `growth`, if it is known.
    """
    own = growth(residual) if own is None else own
    farthest = math.hypot(*window.reach_from(residual.shift))
    counts = _counts(residual, own, [farthest], [NEGLIGIBLE])
    shape = residual.wavefront.u.shape
    return *shape[:-2], *np.maximum(counts, shape[-2:]).tolist()


class Coarse(NamedTuple):
    """Nodes and accuracies of a transform that is only as accurate as wanted.

    Attributes
    ----------
    counts : tuple of int
        Shape of the nodes.
    growth : ndarray, (2, n)
        Along both coordinates, result of `growth`.
    core : float
        Error of their sum where the image is bright, relative to the ideal peak of the field.
    epsilon : float
        Requested error of the transform, relative in the rms sense.
    """

    counts: tuple[int, ...]
    growth: Array
    core: float
    epsilon: float

    def field_errors(self, residual: Residual, distance: Array) -> Array:
        """Bound the field's error by the nodes at distances, m, from the tilt's image point."""
        rings = np.linspace(0.0, float(distance.max()), 17)
        digits = np.multiply(self.counts[-2:], residual.series.orders)[:, None, None]
        largest = _image_growth(residual, rings) + self.growth[:, None]
        error = np.exp(np.min(largest - digits * LOG, axis=2)).sum(axis=0)
        return np.asarray(error[np.minimum(np.searchsorted(rings, distance), rings.size - 1)])


def growth(residual: Residual) -> Array:
    """Return the logarithm of the error of nodes without image point and count.

    With n Gauss-Legendre nodes for s = -1 to 1, the error of the mean of an analytic function is at
    most ``(32/15) M rho^(-2n)/(1 - rho^(-2))`` for every ellipse with the foci -1 and 1 and
    semi-axes of sum rho in which its modulus is below M [1]_. For the phase ``sum A_k P_k(s)``, ln
    M is at most ``sum A_k (rho^k - rho^(-k))/2``; the amplitude and the Jacobian, of degree 1, are
    factors.

    On a disc or ring, s is linear in r^2. The mean over the angle is a function of r^2, and
    a degree k of s becomes 2 k, or 2 k + 1 with the factor r of odd orders, for rho^2 in place of
    rho. With n angles the error is at most ``2 M rho^(-n)/(1 - rho^(-n))`` for M in the strip of
    complex angles up to i ln(rho), where an order m grows as a degree m does above [2]_.

    Returns
    -------
    ndarray, (2, n)
        ln (M/(1 - rho^(-2))) with its factors along both coordinates, for each of `RHO`. n nodes
        lower it by ``series.orders`` n ln(rho).

    References
    ----------
    .. [1] Trefethen, Approximation Theory and Approximation Practice (2013), theorem 19.3.
    .. [2] Trefethen and Weideman, SIAM Review 56 (2014) 385, theorem 3.1.
    """
    log = np.log(32 / 15 * RHO / (1 - RHO**-2.0)) + np.zeros((2, 1))
    for axis, terms in enumerate(residual.series.bounds()):
        log[axis] += residual.wavenumber * np.sum(terms[:, None] * _rates(len(terms)), axis=0)
    if not residual.is_uniform:
        mean = residual.amplitude_sum / float(np.sum(residual.wavefront.weights))
        for axis, terms in enumerate(residual.amplitude_series.bounds()):
            powers = np.exp(_logs(len(terms)))
            log[axis] += np.log(np.sum(terms[:, None] / mean * powers, axis=0))
    return log


@lru_cache(maxsize=16)
def _rates(n: int) -> Array:
    """Return ``(rho^k - rho^(-k))/2`` for k < n and each of `RHO`, (n, len(RHO))."""
    return frozen(np.sinh(_logs(n)))


def _logs(n: int) -> Array:
    """Return ``k ln(rho)`` for k < n and each of `RHO`, up to a bound that no sum needs."""
    return np.asarray(np.minimum(np.arange(n)[:, None] * LOG, 300.0))


def predicted_peak(residual: Residual) -> float:
    """Predict the largest intensity from the rms aberration and the rays, 1 at the ideal peak."""
    rms = residual.heights.rms * residual.wavenumber
    rays, unit = residual.rays, residual.airy_unit
    side = max(rays.reach / 10, 1.25 * unit)
    densest = rays.densest(side) / side**2
    return min(max(math.exp(-(rms**2)), densest * 4 / math.pi * unit**2), 1.0)


def _image_growth(residual: Residual, distance: Array) -> Array:
    """Return what image points at distances (m,), m, add to `growth`, (2, m, n)."""
    slope = residual.wavenumber * distance / abs(residual.wavefront.image_distance)
    phase = np.outer(residual.series.sides, slope)
    return np.asarray(np.multiply.outer(phase, _rates(2)[1]))


def coarse(
    residual: Residual, window: Window, tol: float, growth: Array, sure: bool = False
) -> Coarse:
    """Return the nodes for an intensity error of about half of ``tol``.

    Where the image is dark, an error of the field matters less. With ``sure``, it may be as bright
    as its peak at the window's edge.
    """
    peak = predicted_peak(residual)
    dark = math.sqrt(peak)
    if not sure:
        reach = min(window.shape) * window.pitch / 2 - math.hypot(*residual.shift)
        beyond = np.asarray(max(reach - residual.rays.reach, 0.0)) / residual.airy_unit
        # Straight edges of a rim make spikes, with a field above that of a clear disc.
        dark = min(3 * float(error_bounds.tail(beyond)), dark)
    core = min(tol * math.sqrt(peak) / 8, MOST)
    # the square of the error is a hundredth of tol, or less
    edge = max(min(tol * peak / (8 * dark), math.sqrt(tol * peak) / 10, MOST), core)
    farthest = math.hypot(*window.reach_from(residual.shift))
    bright = min(residual.rays.reach + BRIGHT * residual.airy_unit, farthest)
    counts = _counts(residual, growth, [bright, farthest], [core / 2, edge / 2])
    epsilon = min(max(tol / 4, nufft.BEST), nufft.COARSEST)
    return Coarse((*residual.aberration.shape[:-2], *counts), growth, core, epsilon)


def _counts(
    residual: Residual, growth: Array, distances: list[float], errors: list[float]
) -> tuple[int, int]:
    """Return the nodes along both coordinates for errors of at most ``errors`` at distances, m."""
    largest = _image_growth(residual, np.array(distances)) + growth[:, None]
    largest -= np.log(errors)[:, None]
    digits = np.min(largest / LOG, axis=2).max(axis=1)
    counts = np.ceil(digits / residual.series.orders).astype(int)
    return residual.series.least_nodes(*counts.tolist())


def nodes(residual: Residual, window: Window, counts: tuple[int, ...]) -> nufft.Nodes:
    """Return nodes of a polar or cells wave of the shape ``counts``, for a sum to a window."""
    nufft.check_memory(counts, window)
    u, v, areas = residual.wavefront.nodes(*counts)
    path, amplitude = np.zeros_like(u), np.ones_like(u)
    if not residual.is_plane:
        path = residual.series.at_nodes(*counts)
    if not residual.is_uniform:
        amplitude = residual.amplitude_series.at_nodes(*counts)
    return nufft.Nodes(u, v, path, amplitude, areas)
