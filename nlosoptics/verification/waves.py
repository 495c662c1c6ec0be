"""Waves and point spreads."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.special import j0, j1

from .. import psf
from ..scene import ConcaveWall, ConvexWall, FlatWall, WavyWall

_LENGTH = 632.8e-9
_UNIT = _LENGTH * 2.0  # wavelength times F-number, m


def _wave(waves: dict[int, float] | None = None, **changes: Any) -> psf.Wavefront:
    """Return an F/2 wave from Noll coefficients in waves."""
    pupil = {"wavelength": _LENGTH, "pupil_radius": 12.5e-3, "image_distance": 50e-3}
    terms = {j: w * _LENGTH for j, w in (waves or {}).items()}
    return psf.Wavefront.from_zernike(terms, **pupil | changes)


def walls() -> tuple[float, float]:
    """Wave aberration of curved walls, in wavelengths: values of 50 digits."""
    ends = [[0.0125, 0.0], [-0.0125, 0.0]]
    cases = (
        (FlatWall(), [0.0, 0.0]),  # a plane mirror has no aberration
        (ConcaveWall(5.0), [-0.0009362454117545122844, 0.0009093190917862065865]),
        (ConvexWall(5.0), [0.0006149361108903615431, -0.0005977624113280680310]),
        (WavyWall(2e-5, 0.3, 0.4), [-2.868256667316361400e-6, 3.533773346963684554838e-6]),
    )
    errors = [
        psf.wall_aberration(wall, (0.1, 0.05, 1.0), (-0.6, 0.0, 0.8), (0, 0, 0), ends) - expected
        for wall, expected in cases
    ]
    return abs(np.array(errors)).max() / _LENGTH, 1e-9


def airy_disc() -> tuple[float, float]:
    """Airy disc, of the peak: (2 J1(v)/v)^2, Born & Wolf, sec. 8.5.2."""
    found = psf.point_spread(
        _wave(), tol=1e-6, pitch=_UNIT / 4, shape=64, normalisation="ideal-peak", model="scalar"
    )
    x = (np.arange(64) - 32) / 4
    v = np.pi * np.hypot(x, x[:, None])
    v[32, 32] = 1.0
    expected = (2 * j1(v) / v) ** 2
    expected[32, 32] = 1.0
    return abs(found.intensity - expected).max(), 1e-6


def transforms_agree() -> tuple[float, float]:
    """Two transforms of one wave, of the errors that they state: they compute the same integral."""
    options = {"pitch": _UNIT / 4, "shape": 256, "normalisation": "ideal-peak", "model": "scalar"}
    wave = _wave({4: 0.3, 6: 0.2, 8: 0.25, 11: 0.1})
    first = psf.point_spread(wave, method="quadrature", tol=1e-9, **options)
    ratios = []
    for tol in (1e-2, 1e-4):  # a grid with softened rims, and few nodes
        second = psf.point_spread(wave, method="fft", tol=tol, **options)
        stated = first.error_estimate + second.error_estimate
        ratios += [abs(first.intensity - second.intensity).max() / stated, stated / (1.1 * tol)]
    return max(ratios), 1.0


def defocus() -> tuple[float, float]:
    """Peak of a defocused wave: sinc^2 of its path difference in waves, Born & Wolf, sec. 8.8.2."""
    waves = np.array([0.25, 0.6, 1.3])  # at the rim: W20
    found = [psf.strehl(_wave({4: w / (2 * np.sqrt(3))})) for w in waves]
    return abs(found - np.sinc(waves) ** 2).max(), 1e-9


def direct_sum() -> tuple[float, float]:
    """Point spread of tilt, coma and astigmatism, of the peak: the integral's plain sum."""
    nodes, weights = np.polynomial.legendre.leggauss(40)
    rho, theta = (nodes[:, None] + 1) / 2, 2 * np.pi * np.arange(80) / 80
    share = np.repeat(weights[:, None] * rho / 80, 80, axis=1)  # of the pupil
    W = 0.4 * 2 * rho * np.cos(theta)  # Noll's 2, 8 and 6, in waves
    W = W + 0.2 * np.sqrt(8) * (3 * rho**3 - 2 * rho) * np.cos(theta)
    W = W + 0.1 * np.sqrt(6) * rho**2 * np.cos(2 * theta)
    x, y = (np.arange(n) - n // 2 for n in (10, 8))  # quarters of the unit
    u, v = rho * np.cos(theta), rho * np.sin(theta)
    # a path that grows with u moves the spot to x > 0
    turns = W - (u * x[:, None, None] + v * y[:, None, None, None]) / 8
    expected = abs((share * np.exp(2j * np.pi * turns)).sum(axis=(-2, -1))) ** 2
    found = psf.point_spread(
        _wave({2: 0.4, 8: 0.2, 6: 0.1}),
        method="quadrature",
        tol=1e-9,
        pitch=_UNIT / 4,
        shape=(8, 10),
        normalisation="ideal-peak",
        model="scalar",
    )
    return abs(found.intensity - expected).max(), 1e-9


def tilt() -> tuple[float, float]:
    """Spot of a tilted wave, in Airy units: it moves by slope times distance."""
    tilted = psf.Wavefront.from_function(
        lambda u, v: 8e-5 * u - 4e-5 * v,
        wavelength=_LENGTH,
        pupil_radius=12.5e-3,
        image_distance=50e-3,
    )
    return abs(np.array(psf.centroid(tilted)) - (4e-6, -2e-6)).max() / _UNIT, 1e-9


def energy_in_circles() -> tuple[float, float]:
    """Energy of the Airy disc within circles: 1 - J0^2 - J1^2, Born & Wolf, sec. 8.5.2."""
    r = np.array([0.3, 1.2, 5.0])
    found = psf.encircled_energy(_wave(), r * _UNIT)
    return abs(found - 1 + j0(np.pi * r) ** 2 + j1(np.pi * r) ** 2).max(), 1e-9


def contrast() -> tuple[float, float]:
    """MTF of a clear disc: the overlap of two circles, Born & Wolf, sec. 9.5.3."""
    s = np.array([0.1, 0.5, 0.9])
    expected = 2 / np.pi * (np.arccos(s) - s * np.sqrt(1 - s**2))
    return abs(psf.mtf(_wave(), s / _UNIT) - expected).max(), 1e-9


def energy_in_all() -> tuple[float, float]:
    """Energy of an aberrated point spread over the whole plane: it is that of the pupil."""
    wave = _wave({8: 0.3, 11: 0.2})
    spread = psf.point_spread(wave, pitch=2 * _UNIT, shape=256, tol=1e-4, pixel_integrated=True)
    # beyond radius r lies 2/(pi^2 r) of a disc's light
    return abs(spread.intensity.sum() - 1), 2 / np.pi**2 / 256


def _design_program(table: psf.ZernikeTable, rms: float) -> tuple[float, float]:
    """Rms aberration of the table, in waves: the design program's own, to its last digit."""
    wavelength = table.wavelength or _LENGTH
    wave = psf.Wavefront.from_zernike(
        table.coefficients,
        ordering=table.ordering,
        wavelength=wavelength,
        pupil_radius=12.5e-3,
        image_distance=50e-3,
    )
    digits = len(np.format_float_positional(rms, trim="-").partition(".")[2])
    return abs(psf.rms_aberration(wave) / wavelength - rms), 0.51 * 10.0**-digits
