"""Phase statistics of a rough wall in pupil coordinates."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from ..wave.wavefront import Wavefront
from .roughness import Roughness

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class RoughView:
    """Roughness, with the geometry that maps pupil points to wall points.

    Parameters
    ----------
    roughness : Roughness
        Statistics of the heights.
    footprint : ndarray, (2, 2)
        Matrix M from a separation in the exit pupil to the separation on the wall.
    rayleigh_parameter : float
        s, rad: rms phase due to the heights.
    effective_distance : ndarray (2, 2) or None
        Matrix d_eff of `WallView`, m; not needed for the mean.
    """

    #: Time of the transfer function at one separation, s, beyond that of its sum.
    term_seconds: ClassVar[float] = 0.0

    roughness: Roughness
    footprint: Array
    rayleigh_parameter: float
    effective_distance: Array | None = None

    def of(self, part: Roughness) -> RoughView:
        """Return the view of a part of the heights, such as from `Roughness.split`."""
        whole = self.roughness.height_rms
        share = part.height_rms / whole if whole > 0 else 0.0
        return replace(self, roughness=part, rayleigh_parameter=share * self.rayleigh_parameter)

    def lags(self, du: Array, dv: Array) -> Array:
        """Return the separation on the wall, m, for separations (du, dv) in the pupil, m."""
        m = self.footprint
        along, across = (m[i, 0] * du + m[i, 1] * dv for i in (0, 1))
        return np.asarray(np.hypot(along, across))

    @property
    def length(self) -> float:
        """Scale on which the heights change along the wall, m."""
        return self.roughness.correlation_length

    @property
    def has_tails(self) -> bool:
        """Whether the halo falls more slowly than a Gaussian."""
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
        """Return the scattered part of the transfer function.

        ``du`` and ``dv``, of any shape, are separations in the exit pupil, m.
        """
        return self.diffuse_transfer(self.lags(du, dv))

    def diffuse_transfer(self, lag: Array) -> Array:
        """Return the scattered part of the transfer function, ``exp(-s^2 [1 - C]) - exp(-s^2)``.

        ``lag`` holds separations on the wall, m, of any shape.
        """
        square = self.rayleigh_parameter**2
        if square < 1:
            # expm1 avoids the cancellation of two numbers near 1
            return np.asarray(
                math.exp(-square) * np.expm1(square * self.roughness.correlation(lag))
            )
        return np.exp(-square * self.roughness.structure(lag)) - math.exp(-square)

    def last_lag(self, cut: float) -> float:
        """Return the lag, m, beyond which `diffuse_transfer` is below ``cut`` times that at 0."""
        square = self.rayleigh_parameter**2
        if square > 500:  # exp would overflow
            level = 1 + math.log(cut) / square
        else:
            level = math.log1p(cut * math.expm1(square)) / square if square > 0 else cut
        return self.roughness.reach(level)

    def halo(self, wave: Wavefront) -> float:
        """Return the radius of the halo in the image, m: about 3 standard deviations.

        The standard deviation is that of a Gaussian with the same 1/e lag of `diffuse_transfer`.
        The halo of an exponential C has wider tails.
        """
        if self.rayleigh_parameter == 0:
            return 0.0
        lag = min(self.last_lag(math.exp(-1)), 1e3 * self.length)
        step = lag / float(np.linalg.norm(self.footprint, 2))
        return 3 * math.sqrt(2) * wave.wavelength * abs(wave.image_distance) / (2 * math.pi * step)
