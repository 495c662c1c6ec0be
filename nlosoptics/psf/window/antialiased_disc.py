"""A disc sampled on a grid without the errors of a jagged edge.

Sampling a disc folds the far diffraction of its rim back onto the image (aliasing). Here the disc
is first convolved with a kernel. The kernel's spectrum is 1 up to some distance from the rays'
landing point and 0 where the image repeats, so that neither the image nor its repeats disturb each
other. It is an error-function step at half the image period P; the convolved disc differs from the
disc only within a few cells of the rim.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.polynomial import Chebyshev

from ..._vectors import Array
from ..aperture.quadrature_nodes import gauss_legendre

#: Width of the step in units of P. At distance s the spectrum is 1 for s < 0.2 P and 0 for
#: s > 0.8 P, to 1e-7.
STEP = 0.08
#: Cells on either side of the rim after which the kernel, exp(-(pi STEP t)^2), is cut; 1e-8 there.
REACH = 17
#: Shorter reach, in cells, for uses that accept the larger error given by `cut`.
SHORT_REACH = 10


def leak(s: Array) -> Array:
    """Return the error of the kernel's spectrum at distances ``s``, in image periods.

    It is the loss of the image at s, and equally what is left of its repeat at the distance 1 - s.
    """
    from scipy.special import erfc  # here, since a plan of a flat wall needs none of scipy

    return np.asarray(erfc((0.5 - s) / STEP) / 2)


def cut(radius: float, reach: int) -> float:
    """Return a bound of the image's field error by the kernel's end at ``reach`` cells.

    ``reach`` is `REACH` or `SHORT_REACH`. The error is relative to the peak, for a disc of
    ``radius`` cells. Errors measured within half a period of the image are at most half the bound.
    """
    if reach == SHORT_REACH:
        return 4e-5 / radius
    return 1e-12 * max(1.0, 30 / radius) ** 4


class SoftDisc:
    """Disc of height 1 after convolution, as a function of radius; all lengths in cells.

    It is the Hankel transform of ``radius J1(2 pi radius q)/q`` times the kernel's spectrum. Near
    the rim a Chebyshev series evaluates it; elsewhere it is 0 or 1.
    """

    def __init__(self, radius: float, reach: int = REACH) -> None:
        self.radius = radius
        self.low, self.high = max(radius - reach, 0.0), radius + reach
        # The profile has no frequency above 1 per cell, so three nodes per cell resolve it.
        degree, span = math.ceil(3 * (self.high - self.low)) + 19, [self.low, self.high]
        self.rim = Chebyshev.interpolate(lambda r: _hankel(r, radius), degree, span)

    def __call__(self, r: Array) -> Array:
        """Return the values at radii ``r``, in cells."""
        value = np.where(r < self.radius, 1.0, 0.0)
        near = (r >= self.low) & (r < self.high)
        value[near] = self.rim(r[near])
        return value


def _hankel(r: Array, radius: float) -> Array:
    """Profile of the convolved disc at radii ``r`` by quadrature over its spectrum."""
    from scipy.special import j0, j1

    top = 0.5 + 6 * STEP  # beyond this frequency the spectrum is below 1e-17
    turns = top * (2 * radius + REACH)  # of the product of both Bessel functions
    # n nodes resolve 2 n/pi turns; 8 % more and 60 for the spectrum's step leave 1e-14
    fraction, weights = gauss_legendre(math.ceil(1.7 * turns) + 60)
    q = top * fraction
    spectrum = leak(1 - q) * j1(2 * math.pi * radius * q) * weights * top
    parts = np.array_split(r, math.ceil(r.size * q.size / 2**16))
    waves = [j0(2 * math.pi * part[:, None] * q) for part in parts]
    return 2 * math.pi * radius * np.concatenate([wave @ spectrum for wave in waves])
