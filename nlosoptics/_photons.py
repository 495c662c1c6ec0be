"""Photon rates of light of a given power."""

from __future__ import annotations

from ._checks import in_range, positive


def photon_rate(power: float, wavelength: float) -> float:
    """Return the photons per second, P lambda/(h c), of a power (W) at a vacuum wavelength (m)."""
    positive("wavelength", wavelength, unit="m")
    hc = 6.62607015e-34 * 299_792_458.0  # J m, exact by definition of the SI
    return in_range("power", power, 0.0, unit="W") * wavelength / hc
