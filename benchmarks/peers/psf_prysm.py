"""Point spreads by prysm: images as .npy files, seconds as JSON on stdout.

Started by psf_peers.py in the peers' interpreter. Its best here: the antialiased `truecircle`,
the modes kept, and each of its transforms to a chosen pitch, the matrix triple product with its
matrices kept and the chirp; `airydisk` without aberration. prysm's samples are those of a pupil
that fills the array; lengths in lambda N and pupil radii.
"""

from __future__ import annotations

import numpy as np
from prysm.coordinates import cart_to_polar, make_xy_grid
from prysm.fttools import czt, mdft
from prysm.geometry import truecircle
from prysm.polynomials import sum_of_2d_modes, zernike_nm_sequence
from prysm.psf import airydisk
from psf_common import answer, grids, once, transmission


def transformed(transform):
    def build(case, orders, n):
        mdft.clear()
        czt.clear()
        x, y = make_xy_grid(n, diameter=2)
        rho, theta = cart_to_polar(x, y)
        if case["pupil"]:
            aperture = transmission(case["pupil"], x[0], y[:, 0])
        else:
            aperture = truecircle(1, rho)
        modes = np.array(list(zernike_nm_sequence(orders, rho, theta, norm=True)))
        waves = np.array(case["waves"])
        q, size = 1 / case["pitch"], case["size"]

        def image():
            if orders:
                pupil = aperture * np.exp(2j * np.pi * sum_of_2d_modes(modes, waves))
            else:
                pupil = aperture.astype(np.complex128)
            field = transform(pupil, q, size)
            return field.real**2 + field.imag**2

        return image

    return build


def closed(case, orders, n):
    x = (np.arange(case["size"]) - case["size"] // 2) * case["pitch"]

    def image():
        return airydisk(np.hypot(x[:, None], x), 1.0, 1.0)

    return image


if __name__ == "__main__":
    answer(
        "prysm",
        {
            "mdft": (transformed(mdft.dft2), grids),
            "czt": (transformed(czt.czt2), grids),
            "airydisk": (closed, once),
        },
    )
