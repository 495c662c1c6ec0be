"""Gridding: interpolation between even samples of a band-limited function.

The kernel is ``exp(beta (sqrt(1 - (2 u/taps)^2) - 1))``, with u in samples; the spectrum of the
samples is divided by the kernel's Fourier transform beforehand (Barnett, Magland, af Klinteberg,
SIAM J. Sci. Comput. 41, C479 (2019)).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]

#: Steps of the kernel's table per sample.
PER_TAP = 2048


@dataclass(frozen=True)
class Gridding:
    """Kernel of width ``taps`` samples; sampling is finer than needed by ``oversampling``."""

    taps: int
    oversampling: float

    @property
    def beta(self) -> float:
        """Shape of the kernel, by the rule of Barnett et al."""
        return 0.976 * math.pi * self.taps * (1.0 - 0.5 / self.oversampling)

    def kernel(self, u: Array) -> Array:
        """Return the kernel at distances ``u`` in samples; 0 beyond half of ``taps``."""
        inside = np.clip(1.0 - (2.0 * u / self.taps) ** 2, 0.0, None)
        return np.asarray(np.where(inside > 0.0, np.exp(self.beta * (np.sqrt(inside) - 1.0)), 0.0))

    @property
    def table(self) -> Array:
        """Kernel from -taps/2 to taps/2 in steps of 1/PER_TAP, and one further value."""
        return _table(self)

    def correction(self, frequencies: Array) -> Array:
        """Return the inverse of the kernel's Fourier transform; ``frequencies`` per sample."""
        nodes, weights = np.polynomial.legendre.leggauss(64)
        u, w = 0.25 * self.taps * (nodes + 1.0), 0.5 * self.taps * weights
        waves = np.cos(2.0 * math.pi * frequencies[:, None] * u)
        return np.asarray(1.0 / (waves @ (w * self.kernel(u))))


@lru_cache(maxsize=8)
def _table(gridding: Gridding) -> Array:
    steps = np.arange(gridding.taps * PER_TAP + 2) / PER_TAP
    table = gridding.kernel(steps - 0.5 * gridding.taps)
    table.flags.writeable = False
    return table
