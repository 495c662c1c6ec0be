"""Figures of random waves and of their point spreads, on record."""

import numpy as np
import pytest

from nlosoptics import psf

from ...records import attempt

KINDS = ("polar", "cells", "grid", "scattered", "map")
SEED = 23


@pytest.fixture(params=[(kind, index) for kind in KINDS for index in (1, 5)], ids=str)
def case(request, draw):
    kind, index = request.param
    return draw(SEED, index, 0.4, kind)


def test_figures_of_a_wave(case, on_record):
    wave = case.front
    cutoff = 1 / (wave.wavelength * wave.f_number)
    frequency, radius = cutoff * np.linspace(0, 1.1, 5), np.array([0.3, 1.0, 4.0]) / cutoff
    on_record(
        {
            "strehl": attempt(psf.strehl, wave, remove=("piston", "tilt", "defocus")),
            "peak strehl": attempt(psf.peak_strehl, wave),
            "rms": attempt(psf.rms_aberration, wave),
            "zernikes": attempt(psf.fit_zernike, wave, 8, ordering="fringe"),
            "mtf": attempt(psf.mtf, wave, frequency, azimuth=0.4),
            "ptf": attempt(psf.ptf, wave, frequency, azimuth=0.4),
            "energy": attempt(psf.encircled_energy, wave, radius),
            "spots": attempt(psf.spot_diagram, wave, rings=4),
            "centroid": attempt(psf.centroid, wave),
            "radius": attempt(psf.spot_radius, wave),
        }
    )


def test_figures_of_a_point_spread(case, on_record):
    unit = case.front.wavelength * case.front.f_number
    asked = {"tol": 0.05, "pitch": 0.4 * unit, "shape": 24, "max_seconds": 2.0, "model": "scalar"}
    spread = attempt(psf.point_spread, case.front, **asked)
    lengths = np.array([0.3, 1.0, 4.0]) * unit
    on_record(
        [spread]
        if isinstance(spread, Exception)
        else {
            "fwhm": attempt(psf.fwhm, spread),
            "mtf": attempt(psf.mtf, spread, 0.2 / lengths, azimuth=0.4),
            "ptf": attempt(psf.ptf, spread, 0.2 / lengths, azimuth=0.4),
            "energy": attempt(psf.encircled_energy, spread, lengths),
            "squares": attempt(psf.ensquared_energy, spread, lengths),
            "centroid": attempt(psf.centroid, spread),
        }
    )


@pytest.mark.parametrize("criterion", ["strehl", "mtf", "spot", "rms"])
def test_focus(case, criterion, on_record):
    options = {"criterion": criterion}
    if criterion == "mtf":
        options["frequency"] = 0.2 / (case.front.wavelength * case.front.f_number)
    shifts = 8 * case.front.wavelength * case.front.f_number**2 * np.array([-1.0, 0.0, 0.5])
    on_record(
        [
            attempt(psf.through_focus, case.front, shifts, **options),
            attempt(psf.best_focus, case.front, **options),
        ]
    )
