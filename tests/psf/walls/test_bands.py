"""Light of several wavelengths: closed forms of the axis and of Gaussian lines."""

from __future__ import annotations

import math

import numpy as np
import pytest
from pytest import approx
from scipy.special import j1

from nlosoptics import psf
from nlosoptics.errors import SceneError

CENTRE, RADIUS, DISTANCE = 632.8e-9, 5e-3, 0.1


def wave(coefficients=None):
    return psf.Wavefront.from_zernike(
        coefficients or {1: 0.0},
        wavelength=CENTRE,
        pupil_radius=RADIUS,
        image_distance=DISTANCE,
    )


def airy(r, wavelength):
    """Energy per area of a round pupil, whole plane 1."""
    v = 2 * math.pi * RADIUS * r / (wavelength * DISTANCE)
    shape = np.where(v > 0, 2 * j1(v) / np.where(v > 0, v, 1.0), 1.0) ** 2
    return shape * math.pi * (RADIUS / (wavelength * DISTANCE)) ** 2


def test_lines_add_their_airy_patterns():
    lines, weights = np.array([500e-9, 600e-9, 700e-9]), np.array([1.0, 3.0, 2.0])
    found = psf.band_point_spread(wave(), lines, weights, tol=1e-6, shape=101, model="scalar")
    r = np.hypot(*np.meshgrid(found.x, found.y))
    exact = sum(w / 6 * airy(r, line) for w, line in zip(weights, lines, strict=True))
    # tol of every line's peak
    assert found.intensity == approx(exact * found.pitch**2, abs=1e-6 * found.intensity.max())
    assert found.wavelength == approx((500 + 1800 + 1400) / 6 * 1e-9)
    assert found.error_estimate <= 1e-6


def test_path_errors_are_metres_for_every_line():
    """Defocus of a quarter wave at one line is half a wave at half the wavelength: sinc^2."""
    waves = 0.25
    rms = waves * CENTRE / (2 * math.sqrt(3))
    found = psf.band_point_spread(
        wave({4: rms}), [CENTRE, CENTRE / 2], normalisation="ideal-peak", tol=1e-8, shape=65
    )
    exact = (np.sinc(waves) ** 2 + np.sinc(2 * waves) ** 2) / 2
    assert found.intensity[32, 32] == approx(exact, abs=1e-8)


def test_gaussian_line_has_its_moments():
    fwhm = 30e-9
    lines, weights = psf.gaussian_band(CENTRE, fwhm, count=6)
    sigma = fwhm / math.sqrt(8 * math.log(2))
    assert weights.sum() == approx(1.0, rel=1e-14)
    assert weights @ lines == approx(CENTRE, rel=1e-14)
    assert weights @ (lines - CENTRE) ** 2 == approx(sigma**2, rel=1e-12)
    assert weights @ (lines - CENTRE) ** 4 == approx(3 * sigma**4, rel=1e-12)


def test_more_lines_change_a_smooth_band_little():
    few, many = (
        psf.band_point_spread(
            wave({4: 100e-9, 8: 50e-9}),
            *psf.gaussian_band(CENTRE, 20e-9, count=n),
            tol=1e-9,
            shape=65,
            pitch=1e-6,
        ).intensity
        for n in (4, 8)
    )
    # the error of four Gauss-Hermite nodes is of the order (spread/wavelength)^8
    assert few == approx(many, abs=1e-6 * many.max())


def test_one_line_is_the_point_spread():
    one = psf.band_point_spread(wave({4: 80e-9}), CENTRE, pitch=1e-6, shape=65, tol=1e-6)
    same = psf.point_spread(wave({4: 80e-9}), pitch=1e-6, shape=65, tol=1e-6)
    assert (one.intensity == same.intensity).all()
    assert psf.band_point_spread(wave(), [5e-7, 6e-7]).shape[0] >= 256


@pytest.mark.parametrize(
    ("lines", "weights", "message"),
    [
        ([], None, "give both of shape"),
        ([5e-7, 6e-7], [1.0], "give both of shape"),
        ([5e-7, 6e-7], [1.0, -1.0], "weights"),
        ([5e-7, 6e-7], [0.0, 0.0], "weights"),
        ([5e-7, math.nan], None, "wavelength"),
    ],
)
def test_bad_lines_are_refused(lines, weights, message):
    with pytest.raises(SceneError, match=message):
        psf.band_point_spread(wave(), lines, weights)


def test_bad_band_is_refused():
    with pytest.raises(SceneError, match="bandwidth"):
        psf.gaussian_band(CENTRE, CENTRE)
    with pytest.raises(SceneError, match="take fewer"):
        psf.gaussian_band(CENTRE, CENTRE / 3, count=64)
