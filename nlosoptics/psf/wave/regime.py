"""Sampling regime of a wave: aberration in waves, slopes, sampling, pixel size."""

from __future__ import annotations

import math
from dataclasses import dataclass

from .detilted import Residual


@dataclass(frozen=True, kw_only=True)
class Regime:
    """Numbers that decide by which method the PSF of a wave can be computed accurately.

    The residual aberration is the aberration without piston and tilt. An Airy unit is lambda N,
    with the wavelength lambda and the F-number N.

    Parameters
    ----------
    peak_to_valley, rms : float
        Residual aberration over the lit part of the pupil, wavelengths: largest minus smallest
        value, and root mean square weighted by the amplitude.
    slope : float
        Largest gradient of the residual aberration, rad.
    reach : float
        Largest distance along x or y from the centre at which rays of the residual wave meet the
        image plane, Airy units.
    slope_per_sample : float or None
        Largest change of the residual aberration between neighbouring sample points of the pupil,
        wavelengths; for irregular points, over their mean spacing. None for the layouts "polar" and
        "cells" of a `Wavefront`, whose samples are interpolated by smooth functions.
    pixel : float
        Distance between image samples, or pixel side, Airy units.
    fresnel_number : float
        Fresnel number of the pupil, ``a^2/(lambda |d|)``, with the pupil radius a and the image
        distance d.
    rayleigh_parameter : float
        Rms phase s that a rough wall adds to the wave, rad; 0 for a smooth wall.

    See Also
    --------
    point_spread : PSF of a given wave.
    """

    peak_to_valley: float
    rms: float
    slope: float
    reach: float
    slope_per_sample: float | None
    pixel: float
    fresnel_number: float
    rayleigh_parameter: float = 0.0

    @property
    def coherent_fraction(self) -> float:
        """Fraction of the energy reflected in the same way as by a smooth wall: ``exp(-s^2)``."""
        return math.exp(-(self.rayleigh_parameter**2))


def regime(residual: Residual, pitch: float, *, rayleigh_parameter: float = 0.0) -> Regime:
    """Return the regime of a wave for image samples or pixels of a pitch.

    Parameters
    ----------
    residual : Residual
        Wave without its piston and tilt.
    pitch : float
        Image pitch, m.
    rayleigh_parameter : float
        Rms phase after reflection at a rough wall, rad.
    """
    wave = residual.wavefront
    rays = residual.rays
    low, high, _, rms = residual.heights
    per_sample = None
    if not residual.has_series:
        per_sample = rays.slope * residual.spacing / wave.wavelength
    return Regime(
        peak_to_valley=(high - low) / wave.wavelength,
        rms=rms / wave.wavelength,
        slope=rays.slope,
        reach=rays.reach / residual.airy_unit,
        slope_per_sample=per_sample,
        pixel=pitch / residual.airy_unit,
        fresnel_number=wave.pupil_radius**2 / (wave.wavelength * abs(wave.image_distance)),
        rayleigh_parameter=rayleigh_parameter,
    )
