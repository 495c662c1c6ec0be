"""Figures, series and slopes of random waves, and tables of Zernike polynomials, on record."""

from functools import cached_property

import numpy as np
import pytest

from nlosoptics import psf
from nlosoptics.psf.wave import pupil_polynomials, zernikes
from nlosoptics.psf.wave.detilted import split
from nlosoptics.psf.wave.regime import regime
from nlosoptics.psf.wave.scattered_fits import LocalFits

from ...records import attempt

KINDS = ("polar", "cells", "grid", "scattered", "map")
SYSTEM = {"wavelength": 6e-7, "pupil_radius": 4e-3, "image_distance": 0.06}


def properties(one):
    """Every property of an object but its aperture, or the error that it raises."""
    found = vars(type(one))
    names = [name for name, kind in found.items() if isinstance(kind, property | cached_property)]
    return {name: attempt(getattr, one, name) for name in sorted({*names} - {"aperture"})}


def arrays(wave):
    return [wave.u, wave.v, wave.weights, wave.aberration, wave.amplitude]


@pytest.mark.parametrize("index", [0, 1, 3, 6])
@pytest.mark.parametrize("kind", KINDS)
def test_a_wave(kind, index, draw, on_record):
    case = draw(23, index, 0.4, kind)
    residual, pitch = split(case.front), case.options["pitch"]
    fits = attempt(getattr, residual, "local")
    on_record(
        {
            "wave": properties(case.front),
            "card": str(case.front._figures().rows),
            "truncation": attempt(case.front.truncation),
            "residual": properties(residual),
            "rays": properties(residual.rays),
            "shares": [residual.pixel_share(n * pitch) for n in (0.1, 1.0, 40.0)],
            "degrees": [attempt(residual.degrees, t) for t in (1e-3, 1e-9)],
            "regime": regime(residual, pitch, rayleigh_parameter=0.4),
            "coherent": regime(residual, pitch).coherent_fraction,
            "polar": isinstance(fits, LocalFits) and fits.on_polar(case.front, 7, 12),
            "jump": kind != "cells" and attempt(residual.grid_jump),
        }
    )


@pytest.mark.parametrize("index", [1, 3])
@pytest.mark.parametrize("kind", ["polar", "cells"])
def test_series(kind, index, draw, on_record):
    wave = draw(23, index, 0.4, kind).front
    residual, more = split(wave), (*wave.u.shape[:-2], *(n + 5 for n in wave.u.shape[-2:]))
    series = residual.series
    found = {
        "values": series.at_nodes(*more),
        "slopes": series.slopes(*more),
        "nodes": wave.nodes(*more),
        "resampled": arrays(wave.resampled(*more[-2:])),
        "traced": residual.traced(*more),
        "fewer": attempt(wave.resampled, 2, 3),
    }
    if kind == "polar":
        u, v = np.random.default_rng(2).uniform(-0.5, 0.5, (2, 9)) * wave.pupil_radius
        found["polar"] = [series.at(u, v, 1e-12), series.span(), series.rim_series(0.7)]
    on_record(found)


@pytest.mark.parametrize("obscuration", [0.0, 0.35])
def test_low_polynomials(obscuration, on_record):
    wave = psf.Wavefront.from_zernike({4: 3e-8, 7: 2e-8}, obscuration=obscuration, **SYSTEM)
    low = pupil_polynomials.low_polynomial(wave.aberration, 4e-3, obscuration)
    turns = np.linspace(0.0, 6.0, 7)
    on_record(
        [
            low,
            low.slopes(np.cos(turns), np.sin(turns), np.array([0.4, 0.9])),
            low.at(2e-3 * np.cos(turns), 3e-3 * np.sin(turns)),
            low.on_rims(np.cos(turns), np.sin(turns)),
            pupil_polynomials.fitted(wave.aberration, obscuration, 3),
            np.array([pupil_polynomials.powers_of(j, 6) for j in range(1, 28)]),
        ]
    )


def test_zernikes(on_record):
    rho, theta = np.linspace(0.0, 1.0, 6), np.linspace(0.0, 5.0, 6)
    orderings = {"noll": range(1, 40), "osa": range(40), "fringe": range(1, 38)}
    on_record(
        {
            name: [
                np.array([zernikes.zernike_order(j, name) for j in indices]),
                np.array([psf.zernike(j, rho, theta, ordering=name) for j in indices]),
            ]
            for name, indices in orderings.items()
        }
    )


APERTURE = psf.Aperture.regular(5, 4e-3, 0.1, obscuration=1e-3)
WAVES = {
    "plain": {},
    "obscured": {"obscuration": 0.3},
    "grid": {"nodes": "grid", "samples": 24},
    "counts": {"samples": (9, 40)},
    "cells": {"aperture": APERTURE},
    "cells on a grid": {"aperture": APERTURE, "nodes": "grid", "samples": 24},
    "osa": {"ordering": "osa"},
    "fringe": {"ordering": "fringe"},
}


@pytest.mark.parametrize("name", WAVES)
def test_waves_by_polynomials_and_functions(name, on_record):
    options = dict(WAVES[name])
    polynomial = attempt(psf.Wavefront.from_zernike, {4: 3e-8, 8: 2e-8}, **SYSTEM, **options)
    options.pop("ordering", None)

    def path(u, v):
        return 1e-8 * np.cos(400 * u) + 3e-3 * v * u

    def amplitude(u, v):
        return 1.0 - 2e4 * (u**2 + v**2)

    rippled = attempt(psf.Wavefront.from_function, path, amplitude=amplitude, **SYSTEM, **options)
    on_record([one if isinstance(one, Exception) else arrays(one) for one in (polynomial, rippled)])
