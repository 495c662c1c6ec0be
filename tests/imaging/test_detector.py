"""Camera noise: means, variances, speckle, saturation and the converter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import special

from nlosoptics.imaging.detector import (
    full_reading,
    noise_variance,
    read_out,
    speckles_per_pixel,
)
from nlosoptics.scene import Camera

SIDE = 256
COUNT = SIDE**2
CAMERA = Camera(
    position=(0, 0, 1), aim=(0, 0, 0), focal_length=0.05, stop_diameter=0.025,
    pixels=(8 * SIDE, 8 * SIDE), binning=8, read_noise=3.6, full_well=70e3, bit_depth=16,
)  # fmt: skip


@pytest.mark.parametrize("light", [0.0, 3.0, 50.0, 4e4])
@pytest.mark.parametrize("freedom", [None, 90.0])
def test_mean_and_variance_are_the_expected_ones(light, freedom):
    dark = 2.5
    frame = np.full((SIDE, SIDE), light)
    electrons, saturated = read_out(CAMERA, frame, dark, freedom=freedom, seed=1)
    step = 70e3 / 2**16
    variance = light + dark + 64 * (3.6**2 + step**2 / 12)
    if freedom is not None:
        variance += light**2 / freedom
    assert noise_variance(CAMERA, frame, dark, freedom)[0, 0] == pytest.approx(variance, rel=1e-14)
    # five standard errors
    assert electrons.mean() == pytest.approx(light + dark, abs=5 * np.sqrt(variance / COUNT))
    assert electrons.var() == pytest.approx(variance, rel=5 * np.sqrt(2.2 / COUNT))
    assert saturated == 0.0


def test_binning_sums_the_noise_of_native_pixels():
    single = replace(CAMERA, binning=1, pixels=(SIDE, SIDE))
    frame = np.full((SIDE, SIDE), 10.0)
    for camera, native in ((single, 1), (CAMERA, 64)):
        step = camera.full_well / 2**16
        expected = 10.0 + native * (3.6**2 + step**2 / 12)
        electrons, _ = read_out(camera, frame, 0.0, seed=2)
        # five standard errors
        assert electrons.var() == pytest.approx(expected, rel=5 * np.sqrt(2 / COUNT))


def test_speckle_contrast_is_that_of_its_freedom():
    """Bright light: the contrast is that of the gamma variates, 1/sqrt(freedom)."""
    quiet = replace(CAMERA, read_noise=0.0, full_well=1e9, bit_depth=32)
    light = np.full((SIDE, SIDE), 1e8)
    for freedom in (2.0, 90.0):
        electrons, _ = read_out(quiet, light, 0.0, freedom=freedom, seed=3)
        contrast = electrons.std() / electrons.mean()
        # five standard errors of a gamma variate's deviation (kurtosis 6/freedom)
        error = np.sqrt((2 + 6 / freedom) / COUNT) / 2
        assert contrast == pytest.approx(freedom**-0.5, rel=5 * error)


@pytest.mark.parametrize(("pixel", "f_number"), [(1e-7, 2.0), (1e-6, 2.0), (9e-6, 8.0), (9e-6, 2)])
def test_speckles_per_pixel_against_the_double_integral(pixel, f_number):
    wavelength = 632.8e-9
    nodes, weights = np.polynomial.legendre.leggauss(400)
    u, w = (nodes + 1) / 2, weights / 2
    gx, gy = np.meshgrid(u, u)
    v = np.pi * pixel / (wavelength * f_number) * np.hypot(gx, gy)
    coherence = (2 * special.j1(v) / v) ** 2
    mean = 4 * np.einsum("i,j,ij", w, w, (1 - gx) * (1 - gy) * coherence)
    # rounding of the 400 x 400 nodes
    assert speckles_per_pixel(pixel, wavelength, f_number) == pytest.approx(1 / mean, rel=1e-10)


def test_speckles_per_pixel_limits():
    wavelength, f_number = 632.8e-9, 2.0
    assert speckles_per_pixel(1e-10, wavelength, f_number) == pytest.approx(1.0, abs=1e-7)
    # a wide pixel holds its area over that of a speckle, 4 (wavelength F)^2/pi, Goodman sec. 4.4;
    # the edge adds a part of order wavelength F/pixel
    pixel = 1e-3
    many = np.pi / 4 * (pixel / (wavelength * f_number)) ** 2
    assert speckles_per_pixel(pixel, wavelength, f_number) == pytest.approx(many, rel=5e-3)
    # wider than the number of intervals that follow every oscillation
    many = np.pi / 4 * (1.0 / (wavelength * f_number)) ** 2
    assert speckles_per_pixel(1.0, wavelength, f_number) == pytest.approx(many, rel=1e-3)
    # a lens at F/2 focused at 2 m, 9 um pixels
    assert speckles_per_pixel(9e-6, wavelength, 2.05) == pytest.approx(45, abs=0.5)


def test_coarse_converter_rounds():
    camera = replace(CAMERA, binning=1, pixels=(SIDE, SIDE), bit_depth=4, read_noise=0.0)
    step = 70e3 / 16
    electrons, _ = read_out(camera, np.full((SIDE, SIDE), 3.2 * step), 0.0, seed=5)
    assert set(np.unique(electrons / step)) == {3.0}


def test_full_pixels_are_clipped_and_counted():
    camera = replace(CAMERA, read_noise=0.0)
    frame = np.zeros((SIDE, SIDE))
    frame[: SIDE // 4] = 2 * 64 * 70e3
    electrons, saturated = read_out(camera, frame, 0.0, seed=6)
    assert saturated == 0.25
    step = 70e3 / 2**16
    # the highest code of 64 native pixels, one step below full each
    assert electrons.max() == pytest.approx(64 * (2**16 - 1) * step, rel=1e-12)
    assert electrons[: SIDE // 4].min() > 0.999 * 64 * 70e3


def test_seed_decides_every_bit():
    frame = np.full((32, 32), 20.0)
    first, again, other = (read_out(CAMERA, frame, 1.0, freedom=50.0, seed=s)[0] for s in (7, 7, 8))
    np.testing.assert_array_equal(first, again)
    assert (first != other).mean() > 0.9


@pytest.mark.parametrize("mean", [1e14, 1e16, 1e17])
def test_any_brightness_is_counted(mean):
    """Beyond the largest whole numbers too: a well that holds them scatters as Poisson's."""
    camera = bright_camera(full_well=4 * mean, bit_depth=32, read_noise=0.0)
    light = np.full((60, 60), mean)
    electrons, saturated = read_out(camera, light, 0.0, seed=3)
    step = camera.full_well / 2**camera.bit_depth
    variance = mean + step**2 / 12
    # 3600 draws: the mean scatters by 1/60 of a deviation, the variance by 2.4 %; 4 of each
    assert abs(electrons.mean() - mean) < 4 / 60 * np.sqrt(variance)
    assert electrons.var() == pytest.approx(variance, rel=0.1)
    assert saturated == 0.0


def test_a_flood_of_light_fills_every_well():
    camera = bright_camera(full_well=1e4, bit_depth=12, read_noise=0.0)
    electrons, saturated = read_out(camera, np.full((8, 8), 1e30), 0.0, seed=1)
    assert saturated == 1.0
    assert (electrons == camera.full_well * (1 - 2.0**-camera.bit_depth)).all()


def bright_camera(**changes):
    return Camera(
        position=(0, 0, 1),
        aim=(0, 0, 0),
        focal_length=0.05,
        stop_diameter=0.01,
        binning=1,
        **changes,
    )


@pytest.mark.parametrize(
    ("changes", "level"),
    [
        ({"read_noise": 0.0, "bit_depth": 4}, 9.0 * (1000.0 - 1000.0 / 16)),
        ({"read_noise": 50.0, "bit_depth": 16}, 9.0 * 1000.0 - 3.0 * 3.0 * 50.0),
        ({"read_noise": 2000.0, "bit_depth": 16}, 9.0 * 500.0),
    ],
)
def test_full_reading_is_below_the_full_well_by_the_readout_noise(changes, level):
    camera = replace(CAMERA, binning=3, pixels=(96, 96), full_well=1000.0, **changes)
    assert full_reading(camera) == pytest.approx(level, rel=1e-6)
