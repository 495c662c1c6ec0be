"""Grids of polynomial waves with softened rims."""

import numpy as np
import pytest

from nlosoptics import psf
from nlosoptics.psf.transform import antialiased_fft, antialiased_pupil
from nlosoptics.psf.wave.detilted import split
from nlosoptics.psf.window import antialiased_disc
from nlosoptics.psf.window.window import Window

WAVELENGTH, RADIUS = 632.8e-9, 12.5e-3
SYSTEM = {"wavelength": WAVELENGTH, "pupil_radius": RADIUS, "image_distance": 50e-3}
MIX = {4: 0.0859, 5: 0.0429, 6: 0.0859, 7: 0.0515, 8: 0.0859, 11: 0.0429}  # 1 wave


def zernike_wave(waves, **changes):
    coefficients = {j: w * WAVELENGTH for j, w in waves.items()}
    return psf.Wavefront.from_zernike(coefficients, **{**SYSTEM, **changes})


@pytest.mark.parametrize("obscuration", [0.0, 0.4])
def test_polynomial_is_the_wave_on_both_sides_of_the_rim(obscuration):
    waves = {4: 1.0, 5: -0.3, 7: 0.5, 8: 0.2, 9: 0.1, 11: -0.4, 14: 0.3, 16: 0.2, 21: 0.1}
    wave = zernike_wave(waves, obscuration=obscuration)
    residual = split(wave)
    found = antialiased_pupil.soft_wave(residual, 1e-9)
    powers = found.aberration
    assert found.misfit < 1e-11
    assert found.amplitude.size == 0
    u, v = np.random.default_rng(2).uniform(-1.1, 1.1, (2, 200))
    found = np.polynomial.polynomial.polyval2d(u, v, powers)
    rho, theta = np.hypot(u, v), np.arctan2(v, u)
    expected = sum(w * WAVELENGTH * psf.zernike(j, rho, theta) for j, w in waves.items())
    # an annulus has a tilt of its own; rounding grows with the fifth power beyond the rim
    plane = np.stack([np.ones_like(u), u, v])
    left = found - expected
    left -= np.linalg.lstsq(plane.T, left, rcond=None)[0] @ plane
    assert np.abs(left).max() < 1e-11 * WAVELENGTH


@pytest.mark.parametrize("radius", [6.0, 23.0, 70.5])
@pytest.mark.parametrize(("reach", "wider"), [(10, 17), (17, 25)])
def test_rims_cut_short_err_by_what_is_said(radius, reach, wider):
    residual = split(zernike_wave(MIX))
    found = antialiased_pupil.soft_wave(residual, 1e-9)
    window = Window.centred(residual.airy_unit / 4, (int(2 * radius),) * 2)
    fields = []
    for cells in (reach, wider):
        grid = antialiased_fft.Grid(2 * radius * residual.airy_unit, radius, cells)
        fields.append(np.sqrt(antialiased_fft.image(residual, found, window, grid, None)))
    error = np.abs(fields[0] - fields[1]).max()
    # within a hundred times: a bound that says nothing would pass too
    assert (
        0.01 * antialiased_disc.cut(radius, reach)
        < error
        <= antialiased_disc.cut(radius, reach) + 1e-13
    )
