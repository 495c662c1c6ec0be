"""Centroid, spot radius, ensquared energy, phase transfer and peak of a point spread."""

from __future__ import annotations

import math

import numpy as np
import pytest
from pytest import approx
from scipy.special import sici

from nlosoptics import psf
from nlosoptics.errors import SamplingError, SceneError

WAVELENGTH, RADIUS, DISTANCE = 632.8e-9, 5e-3, 0.1
UNIT = WAVELENGTH * DISTANCE / (2 * RADIUS)


def wave(coefficients, **options):
    """A polar wave of Noll coefficients in waves rms."""
    return psf.Wavefront.from_zernike(
        {k: c * WAVELENGTH for k, c in coefficients.items()},
        wavelength=WAVELENGTH,
        pupil_radius=RADIUS,
        image_distance=DISTANCE,
        **options,
    )


@pytest.mark.parametrize("nodes", ["polar", "grid"])
def test_centroid_is_where_the_tilt_leads(nodes):
    """Noll 2 is 2 rho cos: a tilt of 2c/a moves the spot by d 2c/a; defocus moves nothing."""
    at = psf.centroid(wave({2: 0.7, 4: 0.3}, nodes=nodes))
    expected = DISTANCE * 2 * 0.7 * WAVELENGTH / RADIUS
    # a grid's slopes at the rim are one-sided
    assert at == approx((expected, 0.0), abs=(1e-12 if nodes == "polar" else 2e-3) * expected)


def test_centroid_of_coma_is_the_mean_slope():
    """Noll 8, sqrt(8)(3 rho^3 - 2 rho) cos: mean slope sqrt(8)(6 <rho^2> - 2)/a = sqrt(8)/a."""
    x, y = psf.centroid(wave({8: 0.2}))
    assert x == approx(DISTANCE * math.sqrt(8) * 0.2 * WAVELENGTH / RADIUS, rel=1e-9)
    assert y == approx(0.0, abs=1e-15)
    spread = psf.point_spread(wave({8: 0.2}), shape=1001, pitch=UNIT / 4)
    # tails leave the window evenly on both sides but for 1e-2 of the shift
    assert psf.centroid(spread)[0] == approx(x, rel=2e-2)


def test_spot_radius_of_defocus():
    """Noll 4, sqrt(3)(2 rho^2 - 1): rays at 4 sqrt(3) c rho d/a, rms 4 sqrt(3/2) c d/a."""
    exact = 4 * math.sqrt(1.5) * 0.9 * WAVELENGTH * DISTANCE / RADIUS
    assert psf.spot_radius(wave({4: 0.9})) == approx(exact, rel=1e-9)
    # a tilt moves it and leaves it as it is
    assert psf.spot_radius(wave({3: 5.0, 4: 0.9})) == approx(exact, rel=1e-9)


def test_ensquared_energy_of_a_square_pupil():
    """sinc^2 along both axes: (2/pi)(Si(2v) - sin^2(v)/v) within half a side of v = pi h/u."""
    n = 128
    pitch = 2 * RADIUS / n
    amplitude = np.zeros((2 * n, 2 * n))
    amplitude[n // 2 : n // 2 + n, n // 2 : n // 2 + n] = 1.0
    square = psf.Wavefront.from_map(
        np.zeros_like(amplitude),
        amplitude,
        wavelength=WAVELENGTH,
        pupil_pitch=pitch,
        image_distance=DISTANCE,
    )
    unit = WAVELENGTH * DISTANCE / (2 * RADIUS)
    spread = psf.point_spread(square, method="mdft", pitch=unit / 8, shape=161, tol=1e-2)
    sides = unit * np.array([0.25, 1.0, 2.0, 6.0])
    v = math.pi * sides / 2 / unit
    exact = (2 / math.pi * (sici(2 * v)[0] - np.sin(v) ** 2 / v)) ** 2
    # pixels of an eighth, flat inside, and a pupil of 128 steps
    assert psf.ensquared_energy(spread, sides) == approx(exact, rel=0.02)
    assert psf.ensquared_energy(spread, 0.0) == 0.0
    with pytest.raises(SamplingError, match="passes the window"):
        psf.ensquared_energy(spread, 1.0)
    with pytest.raises(SceneError, match="side"):
        psf.ensquared_energy(spread, -1.0)


def test_phase_transfer_of_a_shift_and_of_a_sign():
    """A spot at x0 has the phase -2 pi f x0; defocus of many waves reverses contrast: pi."""
    spread = psf.point_spread(wave({2: 0.1}), shape=301, pitch=UNIT / 4)
    shift = DISTANCE * 2 * 0.1 * WAVELENGTH / RADIUS
    f = np.array([0.0, 0.1, 0.3]) / UNIT
    # the window's edge cuts tails of 1e-3
    assert psf.ptf(spread, f) == approx(-2 * math.pi * f * shift, abs=5e-3)
    assert psf.ptf(spread, f, azimuth=math.pi / 2) == approx(np.zeros(3), abs=5e-3)
    blurred = psf.point_spread(wave({4: 0.6}), shape=401, pitch=UNIT / 4)
    assert abs(float(psf.ptf(blurred, 0.3 / UNIT))) == approx(math.pi, abs=1e-2)


def test_spot_diagram_of_defocus_is_an_even_disc():
    """W = c sqrt3 (2 rho^2 - 1) sends the ray at rho to 4 sqrt3 c d rho/R from the axis."""
    radius, distance, c = 5e-3, 0.05, 4e-7
    wave = psf.Wavefront.from_zernike(
        {4: c}, wavelength=6e-7, pupil_radius=radius, image_distance=distance
    )
    spots = psf.spot_diagram(wave, rings=7)
    rim = 4 * math.sqrt(3) * c * distance / radius
    reach = np.hypot(spots.x, spots.y)
    assert 0.95 * rim < reach.max() < rim
    # light inside a circle grows with its area: rounding, and the share of one of the rings
    rings = np.unique(np.round(reach / rim, 9))
    assert len(rings) >= 7
    assert spots.energy.sum() == pytest.approx(1.0, rel=1e-12)
    mean_square = float((spots.energy * reach**2).sum())
    # Gauss's rule is exact for rho^2
    assert mean_square == pytest.approx(rim**2 / 2, rel=1e-10)
    assert spots.radius == pytest.approx(rim / math.sqrt(2), rel=1e-10)
    # the first zero of J1
    assert spots.airy_radius == pytest.approx(3.8317059702 / math.pi * 6e-7 * 5.0, rel=1e-9)
    assert not spots.x.flags.writeable


@pytest.mark.parametrize("nodes", ["polar", "grid"])
def test_spot_diagram_moves_with_the_tilt(nodes):
    """W = a u lands at x = a d; without aberration, all light in one point."""
    radius, distance, tilt = 5e-3, 0.05, 3e-7
    wave = psf.Wavefront.from_zernike(
        {2: tilt},
        wavelength=6e-7,
        pupil_radius=radius,
        image_distance=distance,
        nodes=nodes,
        samples=32 if nodes == "grid" else None,
    )
    spots = psf.spot_diagram(wave)
    # Noll's second is 2 rho cos; differences of 1e-7 m over a grid's pitch lose six digits
    expected = 2 * tilt / radius * distance
    np.testing.assert_allclose(spots.x, expected, rtol=1e-9)
    np.testing.assert_allclose(spots.y, 0.0, atol=1e-9 * expected)
    assert spots.centroid == pytest.approx((expected, 0.0), rel=1e-9, abs=1e-9 * expected)
    assert spots.energy.min() > 0.0
