"""Figures of images made by hand and of scattered nodes, against plain sums."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from pytest import approx

from nlosoptics import psf
from nlosoptics._checks import Budget, within
from nlosoptics.errors import MemoryLimitError, SamplingError, SceneError
from nlosoptics.psf.wave.zernikes import zernike

WAVELENGTH, RADIUS, DISTANCE = 600e-9, 3e-3, 0.05
SYSTEM = {"wavelength": WAVELENGTH, "pupil_radius": RADIUS, "image_distance": DISTANCE}
PITCH = 0.7e-6


def pictured(intensity, pitch=PITCH, share=0.83):
    """A point spread of given samples, whose window holds a share of the energy."""
    real = psf.point_spread(psf.Wavefront.from_zernike({}, **SYSTEM), shape=3, pitch=1e-6)
    return replace(real, intensity=np.asarray(intensity), pitch=pitch, enclosed_energy=share)


@pytest.fixture(scope="module")
def uneven():
    return pictured(np.random.default_rng(7).random((9, 12)) + 0.2)


def inside_of(spread, holds, fine=60):
    """Energy in a figure by small squares: ``fine`` across each pixel."""
    at = (np.arange(fine) + 0.5) / fine - 0.5
    x, y = ((v[:, None] + spread.pitch * at).ravel() for v in (spread.x, spread.y))
    held = holds(x[None, :], y[:, None])
    shares = held.reshape(spread.shape[0], fine, spread.shape[1], fine).mean(axis=(1, 3))
    whole = spread.intensity.sum() / spread.enclosed_energy
    return float((shares * spread.intensity).sum() / whole)


def test_energy_in_circles_and_squares(uneven):
    sizes = PITCH * np.array([[0.0, 0.3], [1.9, 4.49]])
    circles = [
        [inside_of(uneven, lambda x, y, r=r: x**2 + y**2 < r * r) for r in row] for row in sizes
    ]
    squares = [
        [inside_of(uneven, lambda x, y, h=h: (abs(x) < h) & (abs(y) < h)) for h in row]
        for row in sizes
    ]
    # small squares at the rim: 1/60 of its length, with both signs
    assert psf.encircled_energy(uneven, sizes) == approx(np.array(circles), abs=5e-4)
    assert psf.ensquared_energy(uneven, 2 * sizes) == approx(np.array(squares), abs=2e-3)
    assert psf.encircled_energy(uneven, 1.5 * PITCH).shape == ()
    assert psf.encircled_energy(uneven, []).shape == psf.ensquared_energy(uneven, []).shape == (0,)


def test_sizes_that_are_no_sizes(uneven):
    for bad in (-1e-9, math.nan, math.inf):
        with pytest.raises(SceneError, match=re.escape("give finite radii of at least 0")):
            psf.encircled_energy(uneven, [0.0, bad])
        with pytest.raises(SceneError, match=re.escape("give finite sides of at least 0")):
            psf.ensquared_energy(uneven, [0.0, bad])
    for options in ({"frequency": math.inf}, {"frequency": 1.0, "azimuth": math.nan}):
        for metric in (psf.mtf, psf.ptf):
            with pytest.raises(SceneError, match="frequency is NaN or|azimuth = .* is not finite"):
                metric(uneven, **options)


@pytest.mark.parametrize("azimuth", [0.0, 0.6, -2.1])
def test_transfer_of_an_image_is_a_plain_sum(uneven, azimuth):
    frequencies = np.array([[0.0, 2e4, -3e5], [1e5, 5e5, 9e5]])
    x, y = np.meshgrid(uneven.x, uneven.y)
    along = math.cos(azimuth) * x + math.sin(azimuth) * y
    sums = [
        [np.sum(uneven.intensity * np.exp(-2j * math.pi * f * along)) for f in row]
        for row in frequencies
    ]
    total = uneven.intensity.sum()
    assert psf.mtf(uneven, frequencies, azimuth=azimuth) == approx(np.abs(sums) / total, abs=1e-13)
    assert psf.ptf(uneven, frequencies, azimuth=azimuth) == approx(np.angle(sums), abs=1e-10)


def test_centroid_of_an_image(uneven):
    x, y = np.meshgrid(uneven.x, uneven.y)
    total = uneven.intensity.sum()
    exact = (np.sum(x * uneven.intensity) / total, np.sum(y * uneven.intensity) / total)
    assert psf.centroid(uneven) == approx(exact, rel=1e-12)


@pytest.mark.parametrize(("row", "column"), [(9.3, 14.8), (6.0, 20.45), (12.2, 8.0)])
def test_widths_of_a_gaussian_off_the_centre(row, column):
    j, i = np.arange(21.0)[:, None], np.arange(31.0)
    spot = np.exp(-((i - column) ** 2) / (2 * 2.3**2) - (j - row) ** 2 / (2 * 1.7**2))
    half = 2 * math.sqrt(2 * math.log(2)) * PITCH
    # polynomials of the tenth degree on 1.7 samples per standard deviation
    assert psf.fwhm(pictured(spot)) == approx((2.3 * half, 1.7 * half), rel=3e-4)


def scattered(n=400, seed=5, **terms):
    """Nodes at random, of uneven area and amplitude, some of them dark."""
    rng = np.random.default_rng(seed)
    r, angle = RADIUS * np.sqrt(rng.random(n)), 2 * math.pi * rng.random(n)
    u, v = r * np.cos(angle), r * np.sin(angle)
    amplitude = rng.random(n) + 0.3
    amplitude[::7] = 0.0
    return psf.Wavefront(
        u=u,
        v=v,
        aberration=terms.pop("path", lambda u, v: 0 * u)(u, v),
        amplitude=amplitude,
        weights=(rng.random(n) + 0.5) * math.pi * RADIUS**2 / n,
        layout="scattered",
        **SYSTEM,
    )


def rough(u, v):
    """A tilt, a defocus and more, rad over k."""
    x, y = u / RADIUS, v / RADIUS
    return WAVELENGTH * (
        0.3 + 0.21 * x - 0.13 * y + 0.17 * (x * x + y * y) + 0.05 * x**3 - 0.04 * x * y
    )


@pytest.mark.parametrize(
    "remove", [(), ("piston",), ("tilt",), ("defocus",), "defocus", ("defocus", "tilt", "tilt")]
)
def test_scattered_nodes_after_removal(remove):
    """Least squares with weights amplitude times area; piston is removed along with the rest."""
    wave = scattered(path=rough)
    weights = wave.amplitude * wave.weights
    names = (remove,) if isinstance(remove, str) else remove
    columns = [np.ones_like(wave.u)] if names else []
    columns += [wave.u, wave.v] if "tilt" in names else []
    columns += [wave.u**2 + wave.v**2] if "defocus" in names else []
    rest = wave.aberration
    if columns:
        basis = np.stack(columns, axis=1)
        root = np.sqrt(weights)
        basis = basis / np.abs(basis).max(axis=0)
        fit = np.linalg.lstsq(basis * root[:, None], rest * root, rcond=None)[0]
        rest = rest - basis @ fit
    exact = math.sqrt(np.sum(weights * rest**2) / weights.sum())
    assert psf.rms_aberration(wave, remove=remove) == approx(exact, rel=1e-9)
    phasors = np.exp(2j * math.pi / WAVELENGTH * rest)
    ratio = abs(np.sum(weights * phasors)) ** 2 / weights.sum() ** 2
    assert psf.strehl(wave, remove=remove) == approx(ratio, rel=1e-9)


@pytest.mark.parametrize(("ordering", "first"), [("noll", 1), ("osa", 0), ("fringe", 1)])
@pytest.mark.parametrize("n", [1, 6])
def test_fits_of_each_ordering(ordering, first, n):
    terms = {first + k: (1.3 - 0.7 * k) * 1e-8 for k in range(n)}

    def path(u, v):
        rho, theta = np.hypot(u, v) / RADIUS, np.arctan2(v, u)
        return sum(c * zernike(j, rho, theta, ordering=ordering) for j, c in terms.items())

    found = psf.fit_zernike(scattered(path=path), n, ordering=ordering)
    assert list(found) == list(terms)
    assert found == approx(terms, abs=1e-19)


def test_fit_weighs_by_the_amplitude():
    """One constant is the weighted mean, to which dark nodes do not add."""
    wave = scattered(path=rough)
    weights = wave.amplitude * wave.weights
    exact = np.sum(weights * wave.aberration) / weights.sum()
    assert psf.fit_zernike(wave, 1) == approx({1: exact}, rel=1e-12)


def test_nodes_that_do_not_determine_a_fit():
    few = scattered(7, path=rough)  # one of them dark... and the eighth
    lit = int(np.count_nonzero(few.amplitude))
    assert lit == 6
    assert len(psf.fit_zernike(few, lit)) == lit
    with pytest.raises(SamplingError, match="6 lit nodes cannot determine 7 Zernike terms"):
        psf.fit_zernike(few, lit + 1)
    line = replace(few, v=0.0 * few.v)
    with pytest.raises(SamplingError, match="the nodes determine only 2 of 3 Zernike terms"):
        psf.fit_zernike(line, 3)
    with pytest.raises(SceneError, match="ordering = 'wyant' is unknown"):
        psf.fit_zernike(few, 3, ordering="wyant")
    with pytest.raises(SceneError, match="n_terms"):
        psf.fit_zernike(few, 0)
    for limit, fits in ((24 * 3 * 6, True), (24 * 3 * 6 - 1, False)):
        with within(Budget(memory=limit, seconds=1.0)):
            if fits:
                psf.fit_zernike(few, 3)
            else:
                with pytest.raises(MemoryLimitError, match="a fit of 3 Zernike terms needs"):
                    psf.fit_zernike(few, 3)
