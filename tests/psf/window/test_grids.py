"""Pupil functions on grids: waves as polynomials and by their series."""

import numpy as np
import pytest

from nlosoptics.psf import Wavefront
from nlosoptics.psf.wave.detilted import split
from nlosoptics.psf.window import grids

SYSTEM = {"wavelength": 500e-9, "pupil_radius": 5e-3, "image_distance": 0.1}


@pytest.mark.parametrize("obscuration", [0.0, 0.3])
@pytest.mark.parametrize("uneven", [False, True])
def test_polynomials_and_series_give_the_same_grid(monkeypatch, obscuration, uneven):
    amplitude = (lambda u, v: 1 - 0.1 * u / 5e-3 + 0.05 * (v / 5e-3) ** 2) if uneven else None
    wave = Wavefront.from_zernike(
        {4: 80e-9, 7: 60e-9, 11: 40e-9}, **SYSTEM, obscuration=obscuration
    )
    if uneven:
        wave = Wavefront(
            **SYSTEM,
            obscuration=obscuration,
            layout="polar",
            u=wave.u,
            v=wave.v,
            weights=wave.weights,
            aberration=wave.aberration,
            amplitude=amplitude(wave.u, wave.v),
        )
    residual = split(wave)
    assert grids._polynomials(residual, 1e-16) is not None
    found = grids.pupil_grid_from_polar(residual, 1e-4)
    monkeypatch.setattr(grids, "_polynomials", lambda *_: None)
    expected = grids.pupil_grid_from_polar(residual, 1e-4)
    # the series is evaluated to 1e-8 rad
    assert np.abs(found.values - expected.values).max() < 2e-8 * np.abs(expected.values).max()


def test_a_wave_of_high_degree_has_no_polynomial():
    residual = split(Wavefront.from_zernike({92: 20e-9}, **SYSTEM))  # degree 13
    assert grids._polynomials(residual, 1e-16) is None
