"""Point spreads by POPPY: images as .npy files, seconds as JSON on stdout.

Started by psf_peers.py in the peers' interpreter. Its best here: the gray-pixel aperture, which
knows the area of the cells that the rim cuts, modes kept, and the matrix transform called by
itself, without the bookkeeping of an optical system; `airy_2d` without aberration. The modes are
taken from `R`, since `zernike` is 0 in cells whose middle is beyond the rim. POPPY's transform has
the other sign in its exponent, so the wave is given with the other sign too.
"""

from __future__ import annotations

import astropy.units as u
import numpy as np
import poppy
from poppy.matrixDFT import matrix_dft
from poppy.misc import airy_2d
from poppy.zernike import R
from psf_common import answer, grids, once, transmission


def mode(n, m, rho, theta):
    """Noll's Zernike polynomial."""
    value = np.sqrt((n + 1) * (2 if m else 1)) * R(n, abs(m), rho)
    return value * np.cos(m * theta) if m >= 0 else value * np.sin(-m * theta)


def matrix(case, orders, n):
    wave = poppy.Wavefront(npix=n, diam=2 * u.m, wavelength=1e-6)
    aperture = poppy.CircularAperture(radius=1 * u.m, gray_pixel=True).get_transmission(wave)
    axis = (np.arange(n) - (n - 1) / 2) * 2 / n
    if case["pupil"]:
        aperture = transmission(case["pupil"], axis, axis)
    rho, theta = np.hypot(axis, axis[:, None]), np.arctan2(axis[:, None], axis)
    modes = np.array([mode(*order, rho, theta) for order in orders])
    waves, size = np.array(case["waves"]), case["size"]

    def image():
        pupil = aperture.astype(np.complex128)
        if orders:
            pupil = aperture * np.exp(-2j * np.pi * np.tensordot(waves, modes, 1))
        field = matrix_dft(pupil, size * case["pitch"], size, centering="FFTSTYLE")
        return field.real**2 + field.imag**2

    return image


def closed(case, orders, n):
    size = case["size"]
    arcsec = np.degrees(case["pitch"]) * 3600  # a diameter and a wavelength of 1 m

    def image():
        return airy_2d(1.0, 1.0, (size, size), arcsec, center=(size // 2, size // 2))

    return image


if __name__ == "__main__":
    answer("POPPY", {"matrix": (matrix, grids), "airy_2d": (closed, once)})
