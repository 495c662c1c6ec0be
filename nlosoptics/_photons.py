"""Photon rates of light of a given power."""

from __future__ import annotations

from ._checks import in_range, positive


def photon_rate(power: float, wavelength: float) -> float:
    """Photon rate of a beam, P lambda/(h c).

    Parameters
    ----------
    power : float
        Power, W.
    wavelength : float
        Vacuum wavelength, m.

    Returns
    -------
    float
        Photons per second, 1/s.
    """
    positive("wavelength", wavelength, unit="m")
    hc = 6.62607015e-34 * 299_792_458.0  # J m, exact by definition of the SI
    return in_range("power", power, 0.0, unit="W") * wavelength / hc
