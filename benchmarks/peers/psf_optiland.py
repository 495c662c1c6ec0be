"""Point spreads by Optiland: images as .npy files, seconds as JSON on stdout.

Started by psf_peers.py in the peers' interpreter. Optiland's point spreads trace a lens and take no
wave. Here the lens is a perfect thin one at F/1000, whose traced path differences are below 1e-7
waves; the stated sum is then written in their place, and pupil and image are made anew as the
constructors make them, with the trace and the polynomials kept. A phase surface in the lens would
give the wave as well, but the reference sphere follows the chief ray, which bends with tilt and
coma: the image lies off the samples.

Its best here: the matrix transform to a chosen pitch, whose matrices it does not keep; the FFT
where the pitch is a whole fraction of its grid and the grid is held in memory; the sum of spherical
waves in a window that it can fill. The pupil is the samples inside the rim, none weighted by area.
Path differences count backwards, so the wave is given with the other sign.
"""

from __future__ import annotations

import os

os.environ["NUMBA_NUM_THREADS"] = "1"

import numpy as np
from optiland.optic import Optic
from optiland.psf import FFTPSF, MMDFTPSF, HuygensPSF
from optiland.zernike import ZernikeNoll
from psf_common import answer

WAVELENGTH = 0.6328  # um
FOCUS, DIAMETER = 10000.0, 10.0  # mm
AXIS = (0, 0)
MOST = 5120  # samples a side of a grid that is transformed
SLIGHTLY = 1 - 1e-12  # a window that fills the period exactly may not exceed it by rounding
NOTE = (
    "Optiland takes no wave: the stated one is written in place of a perfect lens's. By a phase "
    "surface its images lie about the chief ray, off the samples where there is tilt or coma"
)


def lens():
    """A perfect thin lens at the stop, its object at infinity."""
    optic = Optic()
    optic.surfaces.add(index=0, thickness=np.inf)
    optic.surfaces.add(index=1, surface_type="paraxial", f=FOCUS, thickness=FOCUS, is_stop=True)
    optic.surfaces.add(index=2)
    optic.set_aperture("EPD", DIAMETER)
    optic.fields.set_type("angle")
    optic.fields.add(y=0)
    optic.wavelengths.add(value=WAVELENGTH, is_primary=True)
    return optic


def writer(spread, case, orders):
    """Function that writes the stated sum into the traced wave, of which it takes the nodes."""
    data = spread.data[(AXIS, WAVELENGTH)]
    x, y = spread.distribution.x, spread.distribution.y
    r, phi = np.hypot(x, y), np.arctan2(y, x)
    term = ZernikeNoll().get_term
    modes = np.array([term(1.0, n, m, r, phi) for n, m in orders])
    waves, none = np.array(case["waves"]), np.zeros_like(x)

    def write():
        data.opd = -np.tensordot(waves, modes, 1) if orders else none

    return write


def matrix(case, orders, n):
    optic = lens()
    # one image sample at first: the trace alone
    spread = MMDFTPSF(optic, AXIS, WAVELENGTH, num_rays=n + 1, image_size=1, pixel_pitch=1.0)
    number = spread._get_working_FNO()
    spread.image_size = case["size"]
    spread.pixel_pitch = case["pitch"] * WAVELENGTH * number * SLIGHTLY
    write = writer(spread, case, orders)

    def image():
        write()
        spread.pupil = spread._generate_pupil()
        return spread._compute_psf()

    return image


def fourier(case, orders, n):
    spread = FFTPSF(lens(), AXIS, WAVELENGTH, num_rays=n + 1, grid_size=n + 1)
    spread.grid_size = grid_side(case, n)
    write = writer(spread, case, orders)
    first = spread.grid_size // 2 - case["size"] // 2
    window = slice(first, first + case["size"])

    def image():
        write()
        spread.pupils = spread._generate_pupils()
        return spread._compute_psf()[window, window]

    return image


def huygens(case, orders, n):
    spread = HuygensPSF(lens(), AXIS, WAVELENGTH, num_rays=n + 1, image_size=1, pixel_pitch=1e-3)
    size = case["size"]
    # its samples lie from edge to edge of the extent: one more, and the last is left out
    spread.image_size = size + 1
    unit = 1e-3 * WAVELENGTH * FOCUS / DIAMETER  # mm
    spread.pixel_pitch = case["pitch"] * unit * size / (size + 1)
    write = writer(spread, case, orders)

    def image():
        write()
        return spread._compute_psf()[:size, :size]

    return image


def grid_side(case, n):
    """Side of the grid that has the case's pitch."""
    return round(n / case["pitch"])


def within_period(case, samples):
    """Samples whose images repeat beyond the window only, which it asks for; of a clear disc."""
    return [n for n in samples if n / case["pitch"] >= case["size"] and not case["pupil"]]


def on_grids(case, samples):
    return [n for n in within_period(case, samples) if n < grid_side(case, n) <= MOST]


def few(case, samples):
    """Samples of a direct sum, in windows that it can fill."""
    return [64] if case["size"] <= 256 and not case["pupil"] else []


if __name__ == "__main__":
    answer(
        "Optiland",
        {
            "MMDFTPSF": (matrix, within_period),
            "FFTPSF": (fourier, on_grids),
            "HuygensPSF": (huygens, few),
        },
        NOTE,
    )
