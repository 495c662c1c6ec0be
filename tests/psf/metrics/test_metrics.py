"""Strehl ratio, rms, encircled energy, MTF and widths against closed forms."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pytest import approx

from nlosoptics import psf
from nlosoptics.errors import SamplingError, SceneError

WAVELENGTH, RADIUS = 632.8e-9, 12.5e-3
SYSTEM = {"wavelength": WAVELENGTH, "pupil_radius": RADIUS, "image_distance": 50e-3}
UNIT = WAVELENGTH * 2
TRUTHS = json.loads((Path(__file__).parents[2] / "truths" / "psf.json").read_text())

#: Aberration in waves at (x, y) = (u, v)/radius, times the row's w.
SHAPES = {
    "strehl_defocus": lambda x, y: x**2 + y**2,
    "strehl_defocus_annular": lambda x, y: x**2 + y**2,
    "strehl_spherical": lambda x, y: (x**2 + y**2) ** 2,
    "strehl_spherical_balanced": lambda x, y: (x**2 + y**2) ** 2 - (x**2 + y**2),
    "strehl_astigmatism": lambda x, y: x**2,
    "strehl_coma": lambda x, y: x * (x**2 + y**2),
}


def shaped(shape, waves, obscuration=0.0, **changes):
    wave = psf.Wavefront.from_zernike({}, obscuration=obscuration, **SYSTEM, **changes)
    surface = waves * WAVELENGTH * shape(wave.u / RADIUS, wave.v / RADIUS)
    return replace(wave, aberration=surface)


@pytest.mark.parametrize("row", [r for r in TRUTHS if r["name"] in SHAPES], ids=str)
def test_strehl_closed_forms(row):
    parameters = row["parameters"]
    wave = shaped(SHAPES[row["name"]], float(parameters["w"]), float(parameters.get("e", 0)))
    assert psf.strehl(wave) == approx(float(row["value"]), abs=float(row["tolerance"]))


def test_strehl_takes_the_nodes_that_the_phase_needs():
    # 40 waves of defocus: sinc^2(40.3); 24 radii alone would alias it
    expected = np.sinc(40.3) ** 2
    assert psf.strehl(shaped(SHAPES["strehl_defocus"], 40.3)) == approx(expected, rel=1e-9)


def test_strehl_after_removal():
    wave = shaped(lambda x, y: 0.7 * x - 0.3 * y + 0.4 * (x**2 + y**2) + 0.1 * x**2, 1.0)
    assert psf.strehl(wave) < 0.2
    # what is left of 0.1 x^2 is 0.05 (x^2 - y^2)
    left = shaped(lambda x, y: 0.05 * (x**2 - y**2), 1.0)
    assert psf.strehl(wave, remove=("tilt", "defocus")) == approx(psf.strehl(left), rel=1e-12)
    with pytest.raises(SceneError, match="one of piston, tilt, defocus"):
        psf.strehl(wave, remove=("coma",))


def test_strehl_of_a_pure_tilt_is_the_airy_disc_there():
    wave = shaped(lambda x, y: x, 0.4)
    v = 2 * np.pi * 0.4
    from scipy.special import j1

    assert psf.strehl(wave) == approx((2 * j1(v) / v) ** 2, abs=1e-14)
    assert psf.strehl(wave, remove=("tilt",)) == approx(1.0, abs=1e-14)


def test_rms_names_what_it_removes():
    wave = psf.Wavefront.from_zernike({1: 4e-8, 2: 3e-8, 4: 2e-8, 11: 1e-8}, **SYSTEM)

    def rms(*remove):
        return psf.rms_aberration(wave, remove=remove)

    # Noll coefficients are orthonormal; rounding only
    assert rms() == approx(np.sqrt(16 + 9 + 4 + 1) * 1e-8, rel=1e-13)
    assert rms("piston") == approx(np.sqrt(9 + 4 + 1) * 1e-8, rel=1e-13)
    assert rms("piston", "tilt") == approx(np.sqrt(4 + 1) * 1e-8, rel=1e-13)
    assert rms("piston", "tilt", "defocus") == approx(1e-8, rel=1e-12)
    assert psf.rms_aberration(wave) == rms("piston", "tilt")


def test_marechal():
    wave = psf.Wavefront.from_zernike({8: WAVELENGTH / 100}, **SYSTEM)
    # exp(-sigma^2) up to the fourth order, (2 pi/100)^4/4
    assert psf.strehl(wave) == approx(np.exp(-((2 * np.pi / 100) ** 2)), abs=4e-6)


@pytest.mark.parametrize("row", [r for r in TRUTHS if r["name"] == "airy_encircled"], ids=str)
def test_encircled_energy_of_the_dark_rings(row):
    zeros = [float(r["value"]) for r in TRUTHS if r["name"] == "airy_zero"]
    radius = zeros[row["parameters"]["ring"] - 1] * UNIT
    wave = psf.Wavefront.from_zernike({}, **SYSTEM)
    assert psf.encircled_energy(wave, radius) == approx(
        float(row["value"]), abs=float(row["tolerance"])
    )
    spread = psf.point_spread(wave, pitch=UNIT / 10, model="scalar")
    # pixels on the circle count by area, whatever falls where within them: second order
    assert psf.encircled_energy(spread, radius) == approx(float(row["value"]), abs=2e-5)


@pytest.mark.parametrize(
    "pupil",
    [
        {"obscuration": 0.3},
        {"aperture": psf.Aperture.hexagons(1, 0.6 * SYSTEM["pupil_radius"], 0.0)},
    ],
    ids=["ring", "hexagons"],
)
def test_encircled_energy_of_an_aberrated_wave(pupil):
    wave = psf.Wavefront.from_zernike({2: 2e-7, 6: 1e-7, 8: 3e-7}, **pupil, **SYSTEM)
    radii = np.array([[0.0, 1e-6], [4e-6, 2e-5]])
    energy = psf.encircled_energy(wave, radii)
    spread = psf.point_spread(wave, pitch=UNIT / 16, shape=801, model="scalar")
    assert energy[0, 0] == 0.0
    # the pixels' cut by the circle
    assert energy == approx(psf.encircled_energy(spread, radii), abs=3e-4)
    assert np.all(np.diff(energy.ravel()) > 0)
    flux = psf.point_spread(wave, pitch=UNIT / 16, shape=801, normalisation="flux", model="scalar")
    assert psf.encircled_energy(flux, radii) == approx(psf.encircled_energy(spread, radii))


def test_encircled_energy_refuses():
    wave = psf.Wavefront.from_zernike({}, **SYSTEM)
    spread = psf.point_spread(wave, shape=16)
    with pytest.raises(SamplingError, match="passes the window's edge"):
        psf.encircled_energy(spread, 1e-3)
    with pytest.raises(SceneError, match="at least 0"):
        psf.encircled_energy(wave, -1.0)
    grid = psf.Wavefront.from_zernike({}, nodes="grid", samples=16, **SYSTEM)
    with pytest.raises(SamplingError, match="point_spread"):
        psf.encircled_energy(grid, 1e-6)


def diffraction_mtf(relative):
    """MTF of a round pupil at a fraction of the cut-off (Goodman, sec. 6.3)."""
    relative = np.minimum(relative, 1.0)
    return 2 / np.pi * (np.arccos(relative) - relative * np.sqrt(1 - relative**2))


def test_mtf_of_a_round_pupil():
    wave = psf.Wavefront.from_zernike({}, **SYSTEM)
    relative = np.array([0.0, 0.1, 0.5, 0.9, 1.0, 1.3])
    exact = diffraction_mtf(relative)
    assert psf.mtf(wave, relative / UNIT) == approx(exact, abs=1e-13)
    spread = psf.point_spread(wave, pitch=UNIT / 4, shape=1024, model="scalar")
    # what lies outside the window: 2/(pi^2 128)
    assert psf.mtf(spread, relative / UNIT) == approx(exact, abs=2e-3)


@pytest.mark.parametrize("azimuth", [0.0, 0.5, np.pi / 2])
def test_mtf_of_an_aberrated_wave(azimuth):
    wave = psf.Wavefront.from_zernike({4: 1e-7, 6: 8e-8, 8: 1e-7, 3: 3e-7}, **SYSTEM)
    frequencies = np.array([0.05, 0.3, 0.7]) / UNIT
    spread = psf.point_spread(wave, pitch=UNIT / 4, shape=1024, model="scalar")
    # what lies outside the window
    assert psf.mtf(wave, frequencies, azimuth=azimuth) == approx(
        psf.mtf(spread, frequencies, azimuth=azimuth), abs=2e-3
    )
    assert np.all(psf.mtf(wave, frequencies, azimuth=azimuth) < diffraction_mtf(frequencies * UNIT))


def test_mtf_refuses():
    grid = psf.Wavefront.from_zernike({}, nodes="grid", samples=16, **SYSTEM)
    with pytest.raises(SamplingError, match="needs polar nodes"):
        psf.mtf(grid, 1e5)
    with pytest.raises(SceneError, match="finite"):
        psf.mtf(grid, np.nan)


def test_width_of_the_airy_disc():
    row = next(r for r in TRUTHS if r["name"] == "airy_fwhm")
    spread = psf.point_spread(
        psf.Wavefront.from_zernike({}, **SYSTEM), pitch=UNIT / 12, model="scalar"
    )
    # polynomials of the tenth degree on a twelfth of lambda N
    assert psf.fwhm(spread) == approx([float(row["value"]) * UNIT] * 2, rel=1e-8)


def test_width_refuses_a_window_without_edges():
    spread = psf.point_spread(psf.Wavefront.from_zernike({}, **SYSTEM), pitch=UNIT / 40, shape=20)
    with pytest.raises(SamplingError, match="above half its peak"):
        psf.fwhm(spread)
