"""Predicted run times on one core, s, that several modules use.

The constants are fits to runs on one core of a two-core virtual machine. Predictions hold within a
factor of about three. They order the transforms and prevent runs of excessive length.
"""

from __future__ import annotations

import math

from ..window.window import Window

#: Overhead of any transform, s: calls, checks, small arrays and the wave's regime.
CALL = 1.2e-3


def sum_over_nodes(n_nodes: float, window: Window) -> float:
    """Predict the seconds of a non-uniform transform of ``n_nodes`` to a window."""
    return CALL + 1.4e-7 * n_nodes + 3e-8 * math.prod(window.shape)


def map_sums(n: int, window: Window) -> float:
    """Predict the seconds of the chirp transform of a grid of ``n`` x ``n`` cells to any pitch."""
    ny, nx = window.shape
    return CALL + 3.6e-8 * n * n + 1.8e-8 * (n * (n + nx) + nx * (n + ny))


def map_bytes(n: int, window: Window) -> float:
    """Predict the peak memory of `map_sums`, bytes, including that of preparing the wave."""
    ny, nx = map(float, window.shape)
    return max(48.0 * n * (n + max(ny, nx)) + 24.0 * ny * nx, 140.0 * n**2)


def scattered(cells: float, nodes: float, points: float, pixels: float) -> float:
    """Predict the seconds of `Scattering` from its counts of cells to pixels."""
    return 9e-3 + 7e-7 * cells + 6.2e-7 * nodes + 2.4e-7 * points + 5e-7 * pixels
