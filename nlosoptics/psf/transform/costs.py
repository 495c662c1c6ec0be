"""Predicted run times of the transforms on one core, s.

The constants are fits to runs on one core of a two-core virtual machine. Predictions hold within a
factor of about three. They order the transforms and prevent runs of excessive length.
"""

from __future__ import annotations

import math

from ..wave.detilted import Residual
from ..window.window import Window
from . import quadrature
from .antialiased_fft import Grid

#: Overhead of any transform, s: calls, checks, small arrays and the wave's regime.
CALL = 1.2e-3


def airy(window: Window) -> float:
    """Predict the seconds of the closed form, one Bessel function per point."""
    return CALL + 3e-8 * _points(window)


def sum_over_nodes(n_nodes: float, window: Window) -> float:
    """Predict the seconds of a non-uniform transform of ``n_nodes`` to a window."""
    return CALL + 1.4e-7 * n_nodes + 3e-8 * _points(window)


def coarse_sum(coarse: quadrature.Coarse, window: Window) -> float:
    """Predict the seconds of ``fft`` for a wave on rings or cells."""
    digits = -math.log10(coarse.epsilon)
    return 6e-4 + (3e-8 + 1e-9 * digits**2) * math.prod(coarse.counts) + 1.2e-8 * _points(window)


def soft_padded(window: Window, grid: Grid) -> float:
    """Predict the seconds of a polynomial wave on a softened grid by padded FFTs."""
    size = round(grid.period / window.pitch)
    columns = min(size, 2 * grid.centre) + window.shape[1]
    return CALL + 3e-8 * grid.radius**2 + 5e-10 * size * columns * math.log2(size)


def map_sums(n: int, window: Window) -> float:
    """Predict the seconds of the chirp transform of a grid of ``n`` x ``n`` cells to any pitch."""
    ny, nx = window.shape
    return CALL + 3.6e-8 * n * n + 1.8e-8 * (n * (n + nx) + nx * (n + ny))


def scattered_sum(residual: Residual, window: Window) -> float:
    """Predict the seconds of ``nufft`` for scattered nodes, including its error estimate."""
    v = math.pi * math.hypot(*window.reach_from(residual.shift)) / residual.airy_unit
    v += residual.wavenumber * residual.rays.slope * residual.wavefront.pupil_radius
    nodes = (0.29 * v + 19) * (v + 12 * math.cbrt(v) + 24)
    return (
        sum_over_nodes(float(len(residual.wavefront.u)), window)
        + sum_over_nodes(nodes, window)
        + 1.3e-6 * nodes
    )


def map_bytes(n: int, window: Window) -> float:
    """Predict the peak memory of `map_sums`, bytes, including that of preparing the wave."""
    ny, nx = map(float, window.shape)
    return max(48.0 * n * (n + max(ny, nx)) + 24.0 * ny * nx, 140.0 * n**2)


def rays(count: float) -> float:
    """Predict the seconds of ``geometric``: two passes, the second for the error estimate."""
    return 3e-3 + 4e-7 * count


def scattered(cells: float, nodes: float, points: float, pixels: float) -> float:
    """Predict the seconds of `rough.scattered_light` from its counts of cells to pixels."""
    return 9e-3 + 7e-7 * cells + 6.2e-7 * nodes + 2.4e-7 * points + 5e-7 * pixels


def _points(window: Window) -> float:
    """Return the number of points of a window, as a float that cannot overflow."""
    return float(window.shape[0]) * window.shape[1]
