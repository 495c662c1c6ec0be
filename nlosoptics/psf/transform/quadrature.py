"""Spectrally accurate sum over polar or cell nodes, by a non-uniform fast Fourier transform."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..._checks import fits_memory
from ..wave.detilted import Residual
from ..window.window import Window
from . import nufft

ComplexArray = NDArray[np.complex128]


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


def epsilon(residual: Residual, window: Window, tol: float) -> float:
    """Return the relative accuracy to request of the transform: the best one if it is cheap."""
    return nufft.epsilon(math.prod(node_counts(residual, window)), window, tol)


def n_bytes(residual: Residual, window: Window) -> float:
    """Return the peak memory of `field`, bytes."""
    return nufft.n_bytes(math.prod(node_counts(residual, window)), window)


def field(residual: Residual, window: Window, epsilon: float = nufft.BEST) -> ComplexArray:
    """Return the image field (ny, nx), 1 at the reference point without aberration.

    ``sum A w exp(ikW) exp(-2 pi i x.p/(lambda d))``, with the tilt applied as a shift of x.
    ``epsilon`` is the requested error of the transform, relative in the rms sense.
    """
    wave = residual.wavefront
    counts = node_counts(residual, window)
    fits_memory(
        f"quadrature over {' x '.join(map(str, counts))} nodes to {window.shape[0]} x "
        f"{window.shape[1]} points",
        n_bytes(residual, window),
        "use a smaller shape, or method='fft'",
    )
    u, v, weights = wave.nodes(*counts)
    path = np.zeros_like(u)
    if np.any(residual.aberration):
        path = residual.series.at_nodes(*counts)
    if residual.is_uniform:
        size = weights / weights.sum()
    else:
        size = residual.amplitude_series.at_nodes(*counts) * weights / residual.amplitude_sum
    return nufft.image_field(residual, u, v, path, size, window, epsilon)
