"""Intensity integrated over pixels."""

import numpy as np
import pytest
from pytest import approx
from scipy.integrate import dblquad
from scipy.special import j1

from nlosoptics import psf
from nlosoptics.psf.window.pixels import pixel_rule

WAVELENGTH = 632.8e-9
SYSTEM = {"wavelength": WAVELENGTH, "pupil_radius": 12.5e-3, "image_distance": 50e-3}
UNIT = WAVELENGTH * 2


def density(y, x):
    """Airy disc's energy per area, lengths in lambda N."""
    v = np.pi * np.hypot(x, y)
    return np.pi / 4 * (1.0 if v < 1e-9 else (2 * j1(v) / v) ** 2)


@pytest.mark.parametrize("method", ["airy", "quadrature", "fft"])
@pytest.mark.parametrize("side", [0.1, 0.5, 1.3])
def test_pixels_of_an_airy_disc(method, side):
    wave = psf.Wavefront.from_zernike({}, **SYSTEM)
    spread = psf.point_spread(
        wave, method=method, tol=1e-11, pitch=side * UNIT, shape=(9, 12), pixel_integrated=True
    )
    peak = spread.intensity.max()
    for row, column in ((4, 6), (4, 7), (5, 4), (0, 0), (8, 11)):
        x, y = (column - 6) * side, (row - 4) * side
        box = (x - side / 2, x + side / 2, y - side / 2, y + side / 2)
        exact = dblquad(density, *box, epsabs=1e-13, epsrel=1e-12)[0]
        # the filter's 4e-11, see pixels.BETA
        assert spread.intensity[row, column] == approx(exact, abs=6e-11 * peak)


@pytest.mark.parametrize("side", [10.0, 100.0])
def test_wide_pixels_hold_the_encircled_energy(side):
    wave = psf.Wavefront.from_zernike({}, **SYSTEM)
    spread = psf.point_spread(wave, pitch=side * UNIT, shape=5, pixel_integrated=True)
    within = psf.encircled_energy(wave, side / 2 * UNIT)
    beyond = psf.encircled_energy(wave, side / np.sqrt(2) * UNIT)
    assert within < spread.intensity[2, 2] < beyond
    # symmetric to the rounding of the sum, the tails of the rim's estimate aside
    assert spread.intensity == approx(spread.intensity.T, abs=spread.error_estimate)


@pytest.mark.parametrize("method", ["quadrature", "fft"])
def test_pixels_add_up(method):
    wave = psf.Wavefront.from_zernike({2: 4e-7, 8: 3e-7, 5: 2e-7}, **SYSTEM)
    kwargs = {"method": method, "pixel_integrated": True}
    coarse = psf.point_spread(wave, pitch=3 * UNIT, shape=21, **kwargs)
    fine = psf.point_spread(wave, pitch=UNIT, shape=63, **kwargs)
    summed = fine.intensity.reshape(21, 3, 21, 3).sum(axis=(1, 3))
    # the estimate of fft, the filter's 4e-11 of quadrature
    tolerance = coarse.error_estimate + fine.error_estimate
    assert coarse.intensity == approx(summed, abs=tolerance * coarse.intensity.max())
    assert coarse.enclosed_energy == approx(coarse.intensity.sum(), rel=1e-12)


def test_grid_wave_on_pixels():
    kwargs = {"pitch": 2.3 * UNIT, "shape": 21, "pixel_integrated": True, "tol": 0.05}
    polar = psf.point_spread(psf.Wavefront.from_zernike({8: 4e-7}, **SYSTEM), **kwargs)
    wave = psf.Wavefront.from_zernike({8: 4e-7}, nodes="grid", samples=256, **SYSTEM)
    grid = psf.point_spread(wave, **kwargs)
    assert grid.method == "mdft"
    worst = np.abs(grid.intensity - polar.intensity).max() / polar.intensity.max()
    assert worst < grid.error_estimate
    # the rim cut into cells of 1/256 of the pupil, and its repeats
    assert worst < 1e-3


@pytest.mark.thorough
@pytest.mark.parametrize("waves", [{4: 6.0}, {6: 8.0, 8: 3.0}, {11: 6.0}])
def test_estimates_bound_the_error_on_pixels(waves):
    wave = psf.Wavefront.from_zernike({j: w * WAVELENGTH for j, w in waves.items()}, **SYSTEM)
    kwargs = {"pitch": 72e-6, "pixel_integrated": True}
    exact = psf.point_spread(wave, method="quadrature", **kwargs)
    spread = psf.point_spread(wave, method="fft", **kwargs)
    worst = np.abs(spread.intensity - exact.intensity).max() / exact.intensity.max()
    assert worst < spread.error_estimate < 1e-3


def test_mean_over_pixels_is_the_ideal_peak_scale():
    wave = psf.Wavefront.from_zernike({}, **SYSTEM)
    kwargs = {"pitch": UNIT / 2, "shape": 9, "pixel_integrated": True}
    peak = psf.point_spread(wave, normalisation="ideal-peak", **kwargs, model="scalar")
    energy = psf.point_spread(wave, **kwargs, model="scalar")
    # energy = mean x density at the ideal peak x area
    assert energy.intensity == approx(peak.intensity * np.pi / 4 / 4, rel=1e-12)


@pytest.mark.parametrize("side", [0.05, 0.4, 3.0, 57.0])
def test_filter_is_one_below_the_band_limit_and_null_at_repeats(side):
    # side in units of Nyquist's pitch; a cosine of frequency f keeps sinc(f side)
    rule = pixel_rule(side, 1.0, 16)
    place = (np.arange(rule.taps.size) - (rule.taps.size - 1) / 2) * side / rule.factor
    for frequency in (0.0, 0.1, 0.33, 0.5):
        kept = np.sum(rule.taps * np.cos(2 * np.pi * frequency * place))
        assert kept == approx(np.sinc(frequency * side), abs=1e-10)
