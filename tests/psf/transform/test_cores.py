"""Pixels far wider than diffraction: fine samples near the rays and a tail beyond."""

from __future__ import annotations

import math

import numpy as np
import pytest
from pytest import approx

from nlosoptics import psf
from nlosoptics.psf.transform.wide_pixels import (
    binned,
    detilted_wide_spread,
    inner_parts,
    tail_pixels,
)
from nlosoptics.psf.wave.detilted import split

WAVELENGTH, UNIT = 632.8e-9, 2 * 632.8e-9  # lambda N
SYSTEM = {"wavelength": WAVELENGTH, "pupil_radius": 12.5e-3, "image_distance": 50e-3}


def wave_of(waves):
    return psf.Wavefront.from_zernike({j: w * WAVELENGTH for j, w in waves.items()}, **SYSTEM)


@pytest.mark.parametrize("half", [0.2, 0.5, 1.3, 2.5])
def test_light_beyond_a_square_adds_up(half):
    found = tail_pixels((801, 801), ((half, half), (half, half)))
    assert found.sum() == approx(1 - half / 400.5, rel=1e-12)
    assert np.all(found >= 0)
    assert np.abs(found - found.T).max() < 1e-15
    assert np.abs(found - found[::-1]).max() < 1e-15
    # the mean of 1/r^3 over a pixel far out, to second order
    r = math.hypot(30, 40)
    exact = half / (4 * math.sqrt(2)) / r**3 * (1 + 3 / 8 / r**2)
    assert found[430, 440] == approx(exact, rel=1e-5)


@pytest.mark.parametrize("tol", [1e-2, 1e-3, 1e-4])
@pytest.mark.parametrize(
    "waves",
    [{}, {2: 0.3, 3: -0.2}, {4: 0.2, 8: 0.1}, {4: 2.0}, {5: 1.0, 11: 0.7}],
    ids=["flat", "tilt", "mild", "defocus", "mix"],
)
def test_estimate_bounds_the_error(waves, tol):
    options = {"pitch": 41.3 * UNIT, "shape": (5, 7)}
    wave = wave_of(waves)
    exact = psf.point_spread(
        wave, tol=1e-6, pixel_integrated=True, **options, model="scalar"
    ).intensity
    found = detilted_wide_spread(split(wave), tol=tol, **options)
    error = np.abs(found.intensity - exact).max() / exact.max()
    assert error <= found.error_estimate + 1e-6
    assert found.error_estimate <= tol
    assert found.enclosed_energy == approx(exact.sum(), abs=tol)
    assert found.regime.pixel == approx(41.3)
    if tol == 1e-3 and 4 not in waves and 5 not in waves:
        assert found.method.endswith("+ tail")


@pytest.mark.parametrize(("pixel", "tol"), [(306.0, 3e-5), (41.3, 1e-4)])
def test_parts_of_wide_pixels_add_up_to_the_tolerance(pixel, tol):
    """Otherwise all samples of these pixels would be computed after the fine ones."""
    residual = split(wave_of({5: 0.2}))
    n, parts, fine = inner_parts(residual, pixel * UNIT, (9, 9), tol)
    assert fine * min(n, parts) < 0.75 * tol
    assert detilted_wide_spread(residual, pixel * UNIT, (9, 9), tol).method == "fft + tail"


@pytest.mark.parametrize(("pixel", "tol"), [(6.27, 7e-7), (16.9, 1.5e-6)])
def test_one_fft_is_fine_enough_for_the_mean_over_a_wide_pixel(pixel, tol):
    options = {"pitch": pixel * UNIT, "shape": 31, "tol": tol, "pixel_integrated": True}
    found = psf.point_spread(wave_of({4: 0.01}), **options, model="scalar")
    assert found.reason.startswith("fft is the cheapest")
    assert "ran first" not in found.reason


def test_narrow_pixels_and_grids_go_the_usual_way():
    wave = wave_of({4: 0.1})
    options = {"pitch": 3 * UNIT, "shape": (9, 9)}
    usual = psf.point_spread(wave, tol=1e-3, pixel_integrated=True, **options, model="scalar")
    found = detilted_wide_spread(split(wave), tol=1e-3, **options)
    assert np.array_equal(found.intensity, usual.intensity)
    grid = psf.Wavefront.from_zernike({}, **SYSTEM, nodes="grid", samples=512)
    found = detilted_wide_spread(split(grid), tol=1e-2, pitch=20 * UNIT, shape=(5, 5))
    assert "tail" not in found.method


@pytest.mark.parametrize("shape", [(1, 1), (2, 3), (5, 4), (12, 9)])
@pytest.mark.parametrize(("n", "parts"), [(9, 3), (11, 3), (15, 5), (21, 3), (7, 9)])
def test_fine_samples_are_summed_about_their_middle(n, parts, shape):
    """Sample by sample, in windows that are narrower and wider than the samples."""
    fine = np.random.default_rng(n).random((n, n))
    expected = np.zeros(shape)
    middle = [size // 2 for size in shape]
    for i, j in np.ndindex(n, n):
        row, column = (
            m + math.floor((k - n // 2 + parts // 2) / parts)
            for m, k in zip(middle, (i, j), strict=True)
        )
        if 0 <= row < shape[0] and 0 <= column < shape[1]:
            expected[row, column] += fine[i, j]
    assert binned(fine, parts, shape) == approx(expected, rel=1e-12)
