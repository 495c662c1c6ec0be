"""Spectrally accurate sum over polar or cell nodes, by a non-uniform fast Fourier transform."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from ..wave.detilted import Residual
from ..window.window import Window
from . import nufft

if TYPE_CHECKING:
    from ..wave.cell_series import CellSpectrum

Array = NDArray[np.float64]
#: Semi-axis sums of the ellipses on which `Coarse` bounds a wave.
RHO = 1 + np.geomspace(0.02, 20.0, 48)
#: Error of nodes, and phase of a series term, rad, that are at the level of rounding.
NEGLIGIBLE = 1e-15
#: Largest error of nodes that is wanted: coarser nodes save no time.
MOST = 1e-2
#: Airy units about the rays within which an image may be as bright as its peak.
BRIGHT = 2.0


def node_counts(residual: Residual, window: Window) -> tuple[int, ...]:
    """Return the shape of the nodes for which the quadrature has converged to rounding error.

    With v the largest phase change across the radius, ``0.29 v + 7`` Gauss-Legendre radii and
    ``v + 12 v^(1/3)`` angles integrate exp(i v rho cos) to 3e-15. The degrees of the aberration's
    own series are added; terms below `NEGLIGIBLE` are ignored. For cells the bound of
    `growth` is at most `NEGLIGIBLE`.
    """
    wave = residual.wavefront
    r_max = math.hypot(*window.reach_from(residual.shift))
    if wave.layout == "cells":
        counts = _cell_counts(residual, growth(residual), [r_max], [NEGLIGIBLE])
        return len(wave.u), *np.maximum(counts, wave.u.shape[1:]).tolist()
    slope = r_max / abs(wave.image_distance) + residual.rays.slope
    v = residual.wavenumber * slope * wave.pupil_radius
    degree_r, degree_theta = residual.degrees(NEGLIGIBLE / residual.wavenumber)
    if not residual.is_uniform:
        more_r, more_theta = residual.amplitude_series.degrees(NEGLIGIBLE)
        degree_r, degree_theta = degree_r + more_r, degree_theta + more_theta
    n_r, n_theta = wave.u.shape
    return (
        max(n_r, math.ceil(0.29 * v + 7 + degree_r)),
        max(n_theta, math.ceil(v + 12 * v ** (1 / 3) + degree_theta)),
    )


class Coarse(NamedTuple):
    """Nodes of cells and accuracies of a transform that is only as accurate as wanted.

    Attributes
    ----------
    counts : (int, int, int)
        Shape of the nodes.
    growth : ndarray, (2, n)
        Along both sides of a patch, result of `growth`.
    core : float
        Error of their sum where the image is bright, relative to the ideal peak of the field.
    epsilon : float
        Requested error of the transform, relative in the rms sense.
    """

    counts: tuple[int, int, int]
    growth: Array
    core: float
    epsilon: float

    def field_errors(self, residual: Residual, distance: Array) -> Array:
        """Bound the field's error by the nodes at distances, m, from the tilt's image point."""
        rings = np.linspace(0.0, float(distance.max()), 17)
        count = np.array(self.counts[1:])[:, None, None]
        largest = _image_growth(residual, rings) + self.growth[:, None]
        error = np.exp(np.min(largest - 2 * count * np.log(RHO), axis=2)).sum(axis=0)
        return np.asarray(error[np.minimum(np.searchsorted(rings, distance), rings.size - 1)])


def growth(residual: Residual) -> Array:
    """Return the logarithm of the error of Gauss-Legendre nodes without image point and count.

    With n nodes along a side, s = -1 to 1, the error of the mean of an analytic function is at most
    ``(32/15) M rho^(-2n)/(1 - rho^(-2))`` for every ellipse with the foci -1 and 1 and semi-axes of
    sum rho in which its modulus is below M [1]_. For the phase ``sum A_k P_k(s)``, ln M is at most
    ``sum A_k (rho^k - rho^(-k))/2``; the amplitude and the Jacobian, of degree 1, are factors.

    Returns
    -------
    ndarray, (2, n)
        ln (M/(1 - rho^(-2))) with its factors along both sides of a patch, for each of `RHO`.

    References
    ----------
    .. [1] Trefethen, Approximation Theory and Approximation Practice (2013), theorem 19.3.
    """
    found = np.log(32 / 15 * RHO / (1 - RHO**-2.0)) + np.zeros((2, 1))
    phase = cast("CellSpectrum", residual.series)
    for axis in (0, 1):
        terms = residual.wavenumber * phase.sizes.sum(axis=1 - axis)[1:, None]
        degree = np.arange(1.0, len(terms) + 1)[:, None]
        found[axis] += np.sum(terms * (RHO**degree - RHO**-degree) / 2, axis=0)
        if not residual.is_uniform:
            amplitude = cast("CellSpectrum", residual.amplitude_series)
            terms = amplitude.sizes.sum(axis=1 - axis)[:, None]
            degree = np.arange(len(terms))[:, None]
            mean = residual.amplitude_sum / residual.aperture.area
            found[axis] += np.log(np.sum(terms / mean * RHO**degree, axis=0))
    return found


def _image_growth(residual: Residual, distance: Array) -> Array:
    """Return what image points at distances (m,), m, add to `growth`, (2, m, n)."""
    slope = residual.wavenumber * distance / abs(residual.wavefront.image_distance)
    sides = np.array(residual.aperture.patch_size)
    return np.asarray(np.multiply.outer(np.outer(sides, slope / 2), (RHO - 1 / RHO) / 2))


def coarse(residual: Residual, window: Window, tol: float, peak: float, dark: float) -> Coarse:
    """Return the nodes of cells for an intensity error of about half of ``tol``.

    ``peak`` is the predicted largest intensity, and ``dark`` the predicted modulus of the field at
    the window's edge: where the image is dark, an error of the field matters less.
    """
    peak = min(peak, 1.0)
    core = min(tol * math.sqrt(peak) / 8, MOST)
    # the square of the error is a sixteenth of tol, or less
    edge = max(min(tol * peak / (8 * dark), math.sqrt(tol * peak) / 4, MOST), core)
    farthest = math.hypot(*window.reach_from(residual.shift))
    bright = min(residual.rays.reach + BRIGHT * residual.airy_unit, farthest)
    own = growth(residual)
    counts = _cell_counts(residual, own, [bright, farthest], [core / 2, edge / 2])
    epsilon = min(max(tol / 4, nufft.BEST), nufft.COARSEST)
    return Coarse((len(residual.aberration), *counts), own, core, epsilon)


def _cell_counts(
    residual: Residual, growth: Array, distances: list[float], errors: list[float]
) -> tuple[int, int]:
    """Return the nodes along s and t for errors of at most ``errors`` at image distances, m."""
    largest = _image_growth(residual, np.array(distances)) + growth[:, None]
    largest -= np.log(errors)[:, None]
    along_s, along_t = np.ceil(np.min(largest / (2 * np.log(RHO)), axis=2).max(axis=1))
    return int(along_s), int(along_t)


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
