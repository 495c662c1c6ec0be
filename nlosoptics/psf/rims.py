"""A disc on a grid without the error of its jagged edge.

Sampling a disc folds the far diffraction of its rim back onto the image. Convolved first with a
kernel whose spectrum is 1 up to a distance from the rays' landing point and 0 where the image
repeats, the disc is sampled without either. The kernel's spectrum is an error-function step at half
the image period P, so the convolved disc differs from the disc only within a few cells of the rim.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray
from scipy.special import erfc, j0, j1

from .nodes import gauss_legendre

Array = NDArray[np.float64]

#: Width of the step in units of P; 1 at s < 0.2 P and 0 at s > 0.8 P to 1e-7.
STEP = 0.08
#: Cells on either side of the rim: the kernel falls as exp(-(pi STEP t)^2), 1e-8 here.
REACH = 17


def leak(s: Array) -> Array:
    """What the kernel's spectrum lacks at a distance ``s``, in periods, or keeps at 1 - s."""
    return np.asarray(erfc((0.5 - s) / STEP) / 2)


def soft_disc(r: Array, radius: float) -> Array:
    """Convolved unit disc at radii ``r``, all in cells.

    Hankel transform of ``radius J1(2 pi radius q)/q`` times the kernel's spectrum; near the rim by
    a Chebyshev series of it, elsewhere 0 or 1.
    """
    value = np.where(r < radius, 1.0, 0.0)
    low, high = max(radius - REACH, 0.0), radius + REACH
    near = (r > low) & (r < high)
    # The profile has no frequency above 0.9 per cell: three nodes a cell resolve it.
    n = math.ceil(3 * (high - low)) + 20
    nodes = np.cos(math.pi * (np.arange(n) + 0.5) / n)
    profile = _hankel((low + high) / 2 + (high - low) / 2 * nodes, radius)
    series = np.empty(n)
    for k in range(n):
        series[k] = 2 / n * np.sum(profile * np.cos(k * math.pi * (np.arange(n) + 0.5) / n))
    series[0] /= 2
    value[near] = chebyshev.chebval((2 * r[near] - low - high) / (high - low), series)
    return value


def _hankel(r: Array, radius: float) -> Array:
    top = 0.5 + 6 * STEP  # the spectrum is below 1e-17 beyond
    turns = top * (2 * radius + REACH)
    fraction, weights = gauss_legendre(math.ceil(4 * turns) + 60)
    q = top * fraction
    spectrum = erfc((q - 0.5) / STEP) / 2 * j1(2 * math.pi * radius * q) * weights * top
    total = np.empty_like(r)
    for i, at in enumerate(r):
        total[i] = 2 * math.pi * radius * np.sum(spectrum * j0(2 * math.pi * at * q))
    return total
