"""Ray density against closed forms and against diffraction."""

import math
from dataclasses import replace

import numpy as np
import pytest
from pytest import approx

from nlosoptics import psf
from nlosoptics.errors import SamplingError

WAVELENGTH, RADIUS = 632.8e-9, 12.5e-3
SYSTEM = {"wavelength": WAVELENGTH, "pupil_radius": RADIUS, "image_distance": 50e-3}
UNIT = WAVELENGTH * 2  # lambda N at F/2


def zernike_wave(waves=None, **changes):
    coefficients = {j: w * WAVELENGTH for j, w in (waves or {}).items()}
    return psf.Wavefront.from_zernike(coefficients, **{**SYSTEM, **changes})


def rays(wave, pitch, shape=None, **options):
    return psf.point_spread(
        wave, method="geometric", pitch=pitch, shape=shape, pixel_integrated=True, **options
    )


def error(spread, reference):
    difference = np.abs(spread.intensity - reference.intensity).max()
    return difference / reference.intensity.max()


LAYOUTS = {
    "polar": zernike_wave,
    "cells": lambda waves: zernike_wave(waves, aperture=psf.Aperture.ellipse(RADIUS, RADIUS)),
}

# closed forms


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("distance", [50e-3, -50e-3])
@pytest.mark.parametrize("noll", [4, 6])
def test_defocus_and_astigmatism_spread_evenly_over_a_disc(layout, distance, noll):
    """A disc of the pupil's shape: |grad W| grows as r in both."""
    waves = 40
    wave = replace(LAYOUTS[layout]({noll: waves}), image_distance=distance)
    bend = {4: 4 * math.sqrt(3), 6: 2 * math.sqrt(6)}[noll] * waves * WAVELENGTH / RADIUS
    radius = bend * abs(distance)
    spread = rays(wave, radius / 12.3)
    # all rays are inside: shares of boxes add up to rounding
    assert spread.intensity.sum() == approx(1, abs=1e-12)
    assert spread.enclosed_energy == approx(1, abs=1e-12)
    y, x = np.meshgrid(spread.y, spread.x, indexing="ij")
    within = np.hypot(x, y) < 0.85 * radius
    even = spread.pitch**2 / (math.pi * radius**2)
    assert spread.intensity[within] == approx(even, rel=0.03)
    assert np.all(spread.intensity[np.hypot(x, y) > 1.15 * radius] == 0)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_rays_of_spherical_aberration_pile_up_without_bound(layout):
    """W = c rho^4 at its paraxial focus: r = 4 c rho^3 d/a, so a radius r holds r^(2/3)."""
    c = 80
    wave = LAYOUTS[layout]({11: c / (6 * math.sqrt(5)), 4: c / (2 * math.sqrt(3))})
    widest = 4 * c * WAVELENGTH / RADIUS * 50e-3
    spread = rays(wave, widest / 40)
    assert np.isfinite(spread.intensity).all()
    assert spread.intensity.sum() == approx(1, abs=1e-12)
    radii = np.array([0.1, 0.3, 0.6, 0.9]) * widest
    # pixels of 1/40 of the radius, cut by circles
    assert psf.encircled_energy(spread, radii) == approx((radii / widest) ** (2 / 3), abs=0.015)


@pytest.mark.parametrize("uneven", [0.0, 0.5])
def test_rays_of_a_flat_wave_land_in_one_pixel(uneven):
    wave = zernike_wave()
    spread = rays(replace(wave, amplitude=1 + uneven * wave.u / RADIUS), 20 * UNIT, 9)
    expected = np.zeros((9, 9))
    expected[4, 4] = 1.0
    assert spread.intensity == approx(expected, abs=1e-12)  # sums of parts round
    # a square of 20 lambda N leaves about 2 / (10 pi^2) of an Airy pattern's light to the others
    assert spread.error_estimate > 0.01


def test_tilt_moves_the_rays():
    wave = zernike_wave({2: 30.0, 3: -20.0, 4: 20.0})
    spread = rays(wave, 20 * UNIT, 41)
    y, x = np.meshgrid(spread.y, spread.x, indexing="ij")
    centre = np.array([np.sum(spread.intensity * c) for c in (x, y)]) / spread.intensity.sum()
    expected = 2 * WAVELENGTH / RADIUS * 50e-3 * np.array([30.0, -20.0])
    # boxes keep their centre; pixels are binned by area
    assert centre == approx(expected, abs=1e-3 * UNIT)


def test_energy_follows_the_amplitude():
    wave = zernike_wave({4: 40.0})
    wave = replace(wave, amplitude=1 + 0.5 * wave.u / RADIUS)
    spread = rays(wave, 60 * UNIT)
    flux = rays(wave, 60 * UNIT, spread.shape, normalisation="flux")
    assert flux.intensity.sum() == approx(wave.flux, rel=1e-12)
    share = np.sum(wave.amplitude**2 * wave.weights * wave.u) / np.sum(
        wave.amplitude**2 * wave.weights
    )
    magnification = 4 * math.sqrt(3) * 40 * WAVELENGTH / RADIUS**2 * 50e-3
    centre = np.sum(spread.intensity * spread.x)
    # the tilt of the amplitude-weighted plane is 0 for a centred parabola, but for its own mean
    assert centre == approx(share * magnification, rel=1e-3)


def test_a_window_sums_to_the_energy_within():
    wave = zernike_wave({4: 30.0})
    radius = 4 * math.sqrt(3) * 30 * WAVELENGTH / RADIUS * 50e-3
    # the window's edge at 0.98 of the radius cuts off four segments
    cut = rays(wave, 0.98 * radius / 9.5, 19)
    angle = math.acos(0.98)
    segment = (angle - math.sin(angle) * math.cos(angle)) / math.pi
    # boxes a tenth of a pixel wide stand for slanting cells
    assert cut.enclosed_energy == approx(1 - 4 * segment, abs=2e-4)
    assert cut.enclosed_energy == approx(cut.intensity.sum(), rel=1e-12)


# against waves

MANY = [
    ({6: 20.0}, 0.4),
    pytest.param({4: 20.0}, 0.0, marks=pytest.mark.thorough),
    pytest.param({11: 11.0, 4: 8.0}, 0.4, marks=pytest.mark.thorough),
    pytest.param({4: 12.0, 6: 8.0, 11: 3.0}, 0.0, marks=pytest.mark.thorough),
]


@pytest.mark.parametrize(("waves", "obscuration"), MANY)
def test_encircled_energy_is_the_waves(waves, obscuration):
    """2 % above 50 waves from peak to valley."""
    wave = zernike_wave(waves, obscuration=obscuration)
    assert np.ptp(zernike_wave(waves, samples=48).aberration) > 50 * WAVELENGTH
    spread = rays(wave, 30 * UNIT)
    truth = psf.point_spread(
        wave,
        method="quadrature",
        tol=1e-4,
        pitch=spread.pitch,
        shape=spread.shape,
        pixel_integrated=True,
    )
    radii = np.arange(1, spread.shape[0] // 2) * spread.pitch
    difference = psf.encircled_energy(spread, radii) - psf.encircled_energy(truth, radii)
    assert np.abs(difference).max() < 0.02
    # and the estimate holds, with two digits of room
    assert error(spread, truth) <= spread.error_estimate < 100 * error(spread, truth)


@pytest.mark.parametrize(
    ("waves", "obscuration", "pitch"),
    [
        ({4: 1.0}, 0.0, 10),
        ({4: 5.0}, 0.4, 100),
        ({8: 3.0}, 0.4, 10),
        ({11: 3.0, 8: 2.0}, 0.0, 100),
    ],
)
def test_estimates_bound_the_error(waves, obscuration, pitch):
    wave = zernike_wave(waves, obscuration=obscuration)
    spread = rays(wave, pitch * UNIT)
    truth = psf.point_spread(
        wave,
        method="quadrature",
        pitch=spread.pitch,
        shape=spread.shape,
        pixel_integrated=True,
    )
    assert error(spread, truth) <= spread.error_estimate


# the choice


def test_auto_takes_rays_where_they_do():
    wave = zernike_wave({4: 20.0, 11: 1.0})
    kwargs = {"pitch": 80 * UNIT, "pixel_integrated": True, "shape": 9}
    loose = psf.point_spread(wave, tol=0.2, **kwargs)
    truth = psf.point_spread(wave, tol=1e-4, **kwargs, model="scalar")
    assert loose.method == "geometric"
    assert truth.method in {"quadrature", "fft"}
    assert error(loose, truth) <= loose.error_estimate <= 0.2
    # few waves, or a fine tolerance: waves
    few = psf.point_spread(zernike_wave({4: 2.0}), tol=0.2, **kwargs)
    assert few.method != "geometric"
    assert psf.point_spread(wave, tol=1e-2, **kwargs, model="scalar").method != "geometric"


def test_points_have_no_ray_density():
    with pytest.raises(SamplingError, match="use pixel_integrated=True"):
        psf.point_spread(zernike_wave({4: 3.0}), method="geometric")
