"""Exact sum over polar pupil nodes, by a non-uniform fast Fourier transform."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from .._checks import fits_memory
from . import nufft
from .nodes import polar_nodes
from .residuals import Residual
from .windows import Window

ComplexArray = NDArray[np.complex128]


def node_counts(residual: Residual, window: Window, threshold: float = 1e-15) -> tuple[int, int]:
    """Radii and angles at which the rule has converged to rounding.

    With v the largest phase slope across the radius, ``0.29 v + 7`` Gauss-Legendre radii and
    ``v + 12 v^(1/3)`` angles integrate exp(i v rho cos) to 3e-15; the degree of the aberration's
    own series is added, as far as its terms pass the ``threshold``, rad.
    """
    wave = residual.wavefront
    r_max = math.hypot(*window.reach_from(residual.shift))
    v = math.pi * r_max / residual.airy_unit
    v += residual.wavenumber * residual.rays.slope * wave.pupil_radius
    degree_r, degree_theta = residual.series.degrees(threshold / residual.wavenumber)
    if not residual.is_uniform:
        more_r, more_theta = residual.amplitude_series.degrees(threshold)
        degree_r, degree_theta = degree_r + more_r, degree_theta + more_theta
    n_r, n_theta = wave.u.shape
    return (
        max(n_r, math.ceil(0.29 * v + 7 + degree_r)),
        max(n_theta, math.ceil(v + 12 * v ** (1 / 3) + degree_theta)),
    )


def epsilon(residual: Residual, window: Window, tol: float) -> float:
    """Relative accuracy to ask of the transform: all digits where they cost little."""
    n_r, n_theta = node_counts(residual, window)
    return nufft.epsilon(n_r * n_theta, window, tol)


def n_bytes(residual: Residual, window: Window) -> float:
    """Peak memory of `field`."""
    n_r, n_theta = node_counts(residual, window)
    return nufft.n_bytes(n_r * n_theta, window)


def field(residual: Residual, window: Window, epsilon: float = nufft.BEST) -> ComplexArray:
    """Image field, 1 at the axis without aberration.

    ``sum A w exp(ikW) exp(-2 pi i x.p/(lambda d))``, the tilt's part of W taken as a shift of x;
    ``epsilon`` is the error of the transform, rms relative to the field's.
    """
    wave = residual.wavefront
    n_r, n_theta = node_counts(residual, window)
    fits_memory(
        f"quadrature over {n_r} x {n_theta} nodes to {window.shape[0]} x {window.shape[1]} points",
        n_bytes(residual, window),
        "use a smaller shape, or method='fft'",
    )
    u, v, weights = polar_nodes(wave.pupil_radius, n_r, n_theta, wave.obscuration)
    path = np.zeros_like(u)
    if np.any(residual.aberration):
        path = residual.series.at_nodes(n_r, n_theta)
    if residual.is_uniform:
        size = weights / weights.sum()
    else:
        size = residual.amplitude_series.at_nodes(n_r, n_theta) * weights / residual.amplitude_sum
    return nufft.image_field(residual, u, v, path, size, window, epsilon)
