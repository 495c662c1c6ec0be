"""Batches of point spreads, on record."""

import numpy as np
import pytest

from nlosoptics import psf

from ...records import attempt


@pytest.mark.parametrize("integrated", [False, True])
@pytest.mark.parametrize("obscuration", [0.0, 0.4])
@pytest.mark.parametrize("waves", [0.1, 2.0])
def test_a_batch(waves, obscuration, integrated, on_record):
    system = {"wavelength": 6e-7, "pupil_radius": 4e-3, "image_distance": 0.06}
    wave = psf.Wavefront.from_zernike({6: 2e-7}, obscuration=obscuration, **system)
    rng = np.random.default_rng(5)
    modes = np.stack([psf.zernike(j, wave.u / 4e-3, wave.v / 4e-3) for j in (4, 5, 7, 11)])
    bend = np.tensordot(rng.normal(size=(3, 4)) * waves * 6e-7 / 4, modes, 1)
    unit = 6e-7 * wave.f_number
    asked = {"pitch": 0.37 * unit, "shape": (22, 17), "pixel_integrated": integrated}
    asked |= {"normalisation": "ideal-peak"}
    on_record([attempt(psf.point_spreads, wave, bend, tol=tol, **asked) for tol in (1e-2, 1e-5)])
