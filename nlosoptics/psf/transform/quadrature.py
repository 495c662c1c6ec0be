"""Spectrally accurate sum over polar or cell nodes, by a non-uniform fast Fourier transform."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..._checks import fits_memory
from ..wave.detilted import Residual
from ..window.window import Window
from . import nufft

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
#: Range of the accuracies of `coarse_counts`.
LEAST, MOST = 1e-12, 1e-2
#: Bound of the field's error over the accuracy of the nodes.
SAFETY = 4.0
#: Airy units about the rays within which an image may be as bright as its peak.
BRIGHT = 2.0


def node_counts(residual: Residual, window: Window, threshold: float = 1e-15) -> tuple[int, ...]:
    """Return the shape of the nodes for which the quadrature has converged to rounding error.

    With v the largest phase change across the radius, ``0.29 v + 7`` Gauss-Legendre radii and
    ``v + 12 v^(1/3)`` angles integrate exp(i v rho cos) to 3e-15. The degrees of the aberration's
    own series are added; terms below ``threshold``, rad, are ignored. For cells see `cell_counts`.
    """
    wave = residual.wavefront
    r_max = math.hypot(*window.reach_from(residual.shift))
    slope = r_max / abs(wave.image_distance) + residual.rays.slope
    if wave.layout == "cells":
        return cell_counts(residual, slope, threshold)
    v = residual.wavenumber * slope * wave.pupil_radius
    degree_r, degree_theta = residual.degrees(threshold / residual.wavenumber)
    if not residual.is_uniform:
        more_r, more_theta = residual.amplitude_series.degrees(threshold)
        degree_r, degree_theta = degree_r + more_r, degree_theta + more_theta
    n_r, n_theta = wave.u.shape
    return (
        max(n_r, math.ceil(0.29 * v + 7 + degree_r)),
        max(n_theta, math.ceil(v + 12 * v ** (1 / 3) + degree_theta)),
    )


def cell_counts(residual: Residual, slope: float, threshold: float) -> tuple[int, int, int]:
    """Return the shape of the nodes of cells for which the quadrature has converged.

    With v the phase along the longest line of any patch, ``v/4 + 3.1 v^(1/3) + 6`` Gauss-Legendre
    nodes integrate exp(i v s) to 1e-15. Half the degree of the aberration's series is added.

    Parameters
    ----------
    residual : Residual
        Wave on cells.
    slope : float
        Largest slope dW/du of the whole phase, that of the image points included, rad.
    threshold : float
        Phase below which terms of the series are ignored, rad.

    Returns
    -------
    (int, int, int)
        Patches, and nodes along both sides of each.
    """
    n_patches = len(residual.aberration)
    degrees = residual.degrees(threshold / residual.wavenumber)
    if not residual.is_uniform:
        more = residual.amplitude_series.degrees(threshold)
        degrees = degrees[0] + more[0], degrees[1] + more[1]
    counts = [
        max(own, math.ceil(v / 4 + 3.1 * v ** (1 / 3) + 6 + degree / 2))
        for own, degree, v in zip(
            residual.wavefront.u.shape[1:],
            degrees,
            (residual.wavenumber * slope * size for size in residual.aperture.patch_size),
            strict=True,
        )
    ]
    return n_patches, counts[0], counts[1]


class Coarse(NamedTuple):
    """Nodes of cells and accuracies of a transform that is only as accurate as wanted.

    Attributes
    ----------
    counts : (int, int, int)
        Shape of the nodes.
    degrees : (int, int)
        Degrees of the aberration along both sides of a patch that matter at this accuracy.
    core : float
        Error of their sum where the image is bright, relative to the ideal peak of the field.
    edge : float
        Error at the farthest point of the window, at least ``core``.
    epsilon : float
        Requested error of the transform, relative in the rms sense.
    """

    counts: tuple[int, int, int]
    degrees: tuple[int, int]
    core: float
    edge: float
    epsilon: float

    def field_errors(self, residual: Residual, distance: Array) -> Array:
        """Bound the field's error by the nodes at distances, m, from the tilt's image point.

        Measured errors reach 0.6 of it. It is not claimed to be below that of the core, so that the
        law of `coarse_counts` is not extrapolated.
        """
        k, digits = residual.wavenumber, np.full(distance.shape, np.inf)
        slope = residual.rays.slope + distance / abs(residual.wavefront.image_distance)
        for size, count, degree in zip(
            residual.aperture.patch_size, self.counts[1:], self.degrees, strict=True
        ):
            v = np.maximum(k * slope * size, 1e-3)
            spare = np.maximum(count - degree / 2 - v / 4, 0.0)
            digits = np.minimum(digits, (spare / (0.67 * np.cbrt(v))) ** 1.5)
        return np.asarray(SAFETY * np.maximum(10.0**-digits, self.core))


def coarse_counts(
    residual: Residual, distance: float, accuracy: float, degrees: tuple[int, int]
) -> tuple[int, int, int]:
    """Return the shape of the nodes of cells whose sum has a given accuracy, 1e-12 to 0.1.

    It is the error of the field relative to its ideal peak, up to a ``distance``, m, from the
    tilt's image point. With L = -log10(accuracy) and v as in `cell_counts`,
    ``v/4 + 0.67 L^(2/3) v^(1/3)`` nodes integrate exp(i v s) to that accuracy: an error falls as
    an Airy function once there are more than v/4. Half of ``degrees``, those of the aberration, is
    added. The counts may be below those of the wavefront's own nodes.
    """
    slope = distance / abs(residual.wavefront.image_distance) + residual.rays.slope
    digits = -math.log10(accuracy)
    counts = [
        math.ceil(v / 4 + 0.67 * digits ** (2 / 3) * v ** (1 / 3) + degree / 2)
        for degree, v in zip(
            degrees,
            (residual.wavenumber * slope * size for size in residual.aperture.patch_size),
            strict=True,
        )
    ]
    return len(residual.aberration), counts[0], counts[1]


def coarse(residual: Residual, window: Window, tol: float, peak: float, dark: float) -> Coarse:
    """Return the nodes of cells for an intensity error of a sixth to a third of ``tol``.

    ``peak`` is the predicted largest intensity, and ``dark`` the predicted modulus of the field at
    the window's edge: where the image is dark, an error of the field matters less. Terms of the
    aberration below core^(1/4) rad are ignored; they change a small error only.
    """
    peak = min(peak, 1.0)
    core = min(max(tol * math.sqrt(peak) / 48, LEAST), MOST)
    # the square of the error is a sixteenth of tol, or less
    edge = min(tol * peak / (24 * dark), math.sqrt(tol * peak) / (4 * SAFETY), MOST)
    edge = max(edge, core)
    epsilon = min(max(tol / 8, nufft.BEST), nufft.COARSEST)
    small = core**0.25
    degrees = residual.degrees(small / residual.wavenumber)
    if not residual.is_uniform:
        more = residual.amplitude_series.degrees(small)
        degrees = degrees[0] + more[0], degrees[1] + more[1]
    farthest = math.hypot(*window.reach_from(residual.shift))
    bright = min(residual.rays.reach + BRIGHT * residual.airy_unit, farthest)
    wanted = (
        coarse_counts(residual, *place, degrees) for place in ((bright, core), (farthest, edge))
    )
    n_patches, *counts = map(max, zip(*wanted, strict=True))
    return Coarse((n_patches, counts[0], counts[1]), degrees, core, edge, epsilon)


def epsilon(residual: Residual, window: Window, tol: float) -> float:
    """Return the relative accuracy to request of the transform: the best one if it is cheap."""
    return nufft.epsilon(math.prod(node_counts(residual, window)), window, tol)


def n_bytes(residual: Residual, window: Window) -> float:
    """Return the peak memory of `field`, bytes."""
    return nufft.n_bytes(math.prod(node_counts(residual, window)), window)


def field(
    residual: Residual,
    window: Window,
    epsilon: float = nufft.BEST,
    counts: tuple[int, ...] | None = None,
) -> ComplexArray:
    """Return the image field (ny, nx), 1 at the reference point without aberration.

    ``sum A w exp(ikW) exp(-2 pi i x.p/(lambda d))``, with the tilt applied as a shift of x.
    ``epsilon`` is the requested error of the transform, relative in the rms sense; ``counts`` is
    the shape of the nodes, by default that of `node_counts`.
    """
    counts = counts or node_counts(residual, window)
    fits_memory(
        f"quadrature over {' x '.join(map(str, counts))} nodes to {window.shape[0]} x "
        f"{window.shape[1]} points",
        n_bytes(residual, window),
        "use a smaller shape, or method='fft'",
    )
    return nufft.image_field(residual, *pupil_nodes(residual, counts), window, epsilon)


def pupil_nodes(residual: Residual, counts: tuple[int, ...]) -> tuple[Array, Array, Array, Array]:
    """Return u, v, the residual aberration, all m, and the weights, of sum 1, on nodes.

    ``counts`` is the shape of the nodes; the weights include the amplitude.
    """
    u, v, weights = residual.wavefront.nodes(*counts)
    path = np.zeros_like(u)
    if np.any(residual.aberration):
        path = residual.series.at_nodes(*counts)
    if residual.is_uniform:
        return u, v, path, weights / weights.sum()
    amplitude = residual.amplitude_series.at_nodes(*counts)
    return u, v, path, amplitude * weights / residual.amplitude_sum
