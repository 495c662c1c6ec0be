"""Phase statistics of a rough wall in pupil coordinates."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..._vectors import Array
from ..wave.wavefront import Wavefront
from .roughness import Roughness


@dataclass(frozen=True, eq=False)
class RoughView:
    """Statistics of a rough wall, with the geometry by which the exit pupil sees it.

    It computes how roughness divides the light into a sharp core and a scattered halo.
    """

    #: Time of the transfer function at one separation, s, beyond that of its sum.
    term_seconds: ClassVar[float] = 0.0

    roughness: Roughness  # Statistics of the wall's heights
    # (2, 2); Matrix M: two pupil points at the distance (vector) d see wall points at the
    # distance M d.
    footprint: Array
    rayleigh_parameter: float  # Rms phase s that the heights add to the wave, rad
    # (2, 2); Distance over which wall ripples diffract on their way to the pupil, m, see
    # `WallView`. None if it is not known; the mean over walls does not need it.
    effective_distance: Array | None = None

    def lags(self, du: Array, dv: Array) -> Array:
        """Return the distances on the wall, m, for distances (du, dv) in the pupil, m."""
        m = self.footprint
        along, across = (m[i, 0] * du + m[i, 1] * dv for i in (0, 1))
        return np.asarray(np.hypot(along, across))

    @property
    def length(self) -> float:
        """Distance along the wall over which the heights change (correlation length), m."""
        return self.roughness.correlation_length

    @property
    def has_tails(self) -> bool:
        """Whether the halo falls more slowly than a Gaussian, away from its centre."""
        return bool(self.roughness.autocorrelation != "gaussian")

    @property
    def coherent_fraction(self) -> float:
        """Fraction of the energy in the coherent core, ``exp(-s^2)``."""
        return math.exp(-(self.rayleigh_parameter**2))

    @property
    def scattered_fraction(self) -> float:
        """Fraction of the energy in the halo, ``1 - exp(-s^2)``."""
        return -math.expm1(-(self.rayleigh_parameter**2))

    def scattered_transfer(self, du: Array, dv: Array) -> Array:
        """Return the factor on the optical transfer function that yields the halo, 0 to 1.

        ``du`` and ``dv`` are the components of distances between pupil points, m.
        """
        return self.diffuse_transfer(self.lags(du, dv))

    def diffuse_transfer(self, lag: Array) -> Array:
        """Return `scattered_transfer` at distances between wall points, m, of any shape.

        It is ``exp(-s^2 [1 - C(lag)]) - exp(-s^2)``, with the autocorrelation C of the heights.
        """
        square = self.rayleigh_parameter**2
        if square < 1:
            # expm1 avoids the cancellation of two numbers near 1
            return np.asarray(
                math.exp(-square) * np.expm1(square * self.roughness.correlation(lag))
            )
        return np.exp(-square * self.roughness.structure(lag)) - math.exp(-square)

    def last_lag(self, cut: float) -> float:
        """Return the distance on the wall, m, beyond which `diffuse_transfer` is negligible.

        ``cut`` is the negligible value relative to that at lag 0, above 0 and below 1.
        """
        square = self.rayleigh_parameter**2
        if square > 500:  # exp would overflow
            level = 1 + math.log(cut) / square
        else:
            level = math.log1p(cut * math.expm1(square)) / square if square > 0 else cut
        return self.roughness.reach(level)

    def halo(self, wave: Wavefront) -> float:
        """Return the radius of the halo in the image, m: three standard deviations of a Gaussian.

        The Gaussian is the one whose transfer function falls to 1/e at the same distance. The halo
        of a wall with an exponential autocorrelation extends farther.
        """
        if self.rayleigh_parameter == 0:
            return 0.0
        lag = min(self.last_lag(math.exp(-1)), 1e3 * self.length)
        step = lag / float(np.linalg.norm(self.footprint, 2))
        return 3 * math.sqrt(2) * wave.wavelength * abs(wave.image_distance) / (2 * math.pi * step)
