"""Transfer functions of pupils in parts, against line by line sums and closed forms."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from pytest import approx

from nlosoptics import psf
from nlosoptics._checks import Budget, within
from nlosoptics.errors import MemoryLimitError, SamplingError
from nlosoptics.psf.metrics import pupil_overlap
from nlosoptics.psf.metrics.pupil_overlap import round_overlap, series_at, transfer
from nlosoptics.psf.wave.detilted import split

WAVELENGTH, RADIUS, DISTANCE = 500e-9, 4e-3, 0.09
SYSTEM = {"wavelength": WAVELENGTH, "image_distance": DISTANCE, "pupil_radius": RADIUS}
#: A triangle and a disc without any symmetry, 0.2 mm apart at the least.
CORNERS = 1e-3 * np.array([(-3.1, -2.2), (0.4, -1.6), (-1.7, 2.3)])
CENTRE, SIZE = 1e-3 * np.array([1.6, 1.1]), 1.3e-3
PAIR = psf.Aperture.union(
    psf.Aperture.polygon(CORNERS), psf.Aperture.ellipse(SIZE, SIZE, centre=tuple(CENTRE))
)
PISTONS, TILTS = np.array([1.3e-7, -0.6e-7]), np.array([(6e-5, -9e-5), (-4e-5, 7e-5)])


def bend(u, v):
    """Aberration common to both, m: with tilt, and of no symmetry."""
    x, y = u / RADIUS, v / RADIUS
    return WAVELENGTH * (
        0.9 * x - 0.4 * y + 0.7 * x * x - 0.5 * x * y + 0.6 * y**3 + 0.3 * x * x * y
    )


def uneven(u, v):
    return np.exp((0.6 * u - 0.4 * v) / RADIUS)


def spans(level, azimuth):
    """Both ends of triangle and disc on a line across the turned pupil, nan where it misses."""
    turn = np.array(
        [[math.cos(azimuth), math.sin(azimuth)], [-math.sin(azimuth), math.cos(azimuth)]]
    )
    met = []
    for a, b in zip(CORNERS @ turn.T, np.roll(CORNERS, -1, axis=0) @ turn.T, strict=True):
        share = (level - a[1]) / (b[1] - a[1])
        met.append(np.where((share >= 0) & (share < 1), a[0] + share * (b[0] - a[0]), np.nan))
    with np.errstate(invalid="ignore"):
        half = np.sqrt(SIZE**2 - (level - (turn @ CENTRE)[1]) ** 2)
    low = np.fmin.reduce(met)
    high = np.fmax.reduce(met)
    middle = (turn @ CENTRE)[0]
    return [(low, high), (middle - half, middle + half)]


@np.errstate(invalid="ignore")
def plain(frequency, azimuth, path, amplitude):
    """Sum over lines along the shift and Gauss-Legendre nodes within each overlap."""
    shift = WAVELENGTH * DISTANCE * frequency
    count = 6000
    level = RADIUS * (2 * (np.arange(count) + 0.5) / count - 1)
    nodes, weights = np.polynomial.legendre.leggauss(16)
    ends = spans(level, azimuth)

    def field(cell, along):
        u = math.cos(azimuth) * along - math.sin(azimuth) * level[:, None]
        v = math.sin(azimuth) * along + math.cos(azimuth) * level[:, None]
        return amplitude(u, v) * np.exp(2j * math.pi / WAVELENGTH * path(cell, u, v))

    def integral(low, high, values):
        wide = np.nan_to_num(np.maximum(high - low, 0))
        along = np.nan_to_num(low)[:, None] + wide[:, None] * (nodes + 1) / 2
        return np.sum(values(along) @ weights / 2 * wide)

    total = energy = 0.0
    for a, (low_a, high_a) in enumerate(ends):
        energy += integral(low_a, high_a, lambda x, a=a: np.abs(field(a, x)) ** 2)
        for c, (low_c, high_c) in enumerate(ends):
            low = np.maximum(low_a + shift / 2, low_c - shift / 2)
            high = np.minimum(high_a + shift / 2, high_c - shift / 2)
            total += integral(
                low,
                high,
                lambda x, a=a, c=c: field(a, x - shift / 2) * np.conj(field(c, x + shift / 2)),
            )
    return total / energy


@pytest.mark.parametrize("share", [0.12, -0.4])
@pytest.mark.parametrize(
    ("bent", "even", "azimuth"),
    [(False, False, 0.35), (False, True, 2.3), (True, False, -1.9), (True, True, 0.8)],
)
def test_two_unlike_cells(bent, even, azimuth, share):
    """Each with itself and with the other, with pistons, tilts and an uneven amplitude or not."""
    options = {"pistons": PISTONS, "tilts": TILTS} if bent else {}
    wave = psf.Wavefront.from_function(
        bend if bent else None,
        amplitude=None if even else uneven,
        aperture=PAIR,
        samples=20,
        **options,
        **SYSTEM,
    )
    centres = np.array([cell.centroid for cell in PAIR.cells])

    def path(cell, u, v):
        own = PISTONS[cell] + TILTS[cell, 0] * (u - centres[cell, 0])
        return bend(u, v) + own + TILTS[cell, 1] * (v - centres[cell, 1]) if bent else 0.0 * u

    frequency = share * 2 * RADIUS / (WAVELENGTH * DISTANCE)
    exact = plain(frequency, azimuth, path, (lambda u, v: 0 * u + 1) if even else uneven)
    assert abs(exact) > 0.01
    # lines of 1/6000 of the pupil at the ends of a disc and of sides
    assert transfer(split(wave), frequency, azimuth) == approx(exact, abs=2e-5)
    assert transfer(split(wave), 0.0, azimuth) == 1
    assert psf.mtf(wave, 3 * RADIUS / (WAVELENGTH * DISTANCE), azimuth=azimuth) == 0


@pytest.mark.parametrize("waves", [(1.0, -0.4), (7.0, 9.0)])
@pytest.mark.parametrize("distance", [DISTANCE, -0.06])
def test_bent_box(waves, distance):
    """The phase difference of W = a u^2 + b v^2 is linear: a product of triangles and sincs."""
    sides = 1e-3 * np.array([5.0, 3.2])
    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * sides / 2 + (0.3e-3, -0.2e-3)
    curves = 4 * WAVELENGTH * np.array(waves) / sides**2
    wave = psf.Wavefront.from_function(
        lambda u, v: curves[0] * (u - 0.3e-3) ** 2 + curves[1] * (v + 0.2e-3) ** 2,
        aperture=psf.Aperture.polygon(corners),
        **SYSTEM | {"image_distance": distance},
    )
    for share, azimuth in ((0.02, 0.6), (0.35, -2.2)):
        s = share * sides.max()
        parts = abs(s * np.array([math.cos(azimuth), math.sin(azimuth)]))
        left = np.maximum(sides - parts, 0)
        exact = np.prod(left / sides * np.sinc(2 * curves * parts * left / WAVELENGTH))
        found = psf.mtf(wave, s / (WAVELENGTH * abs(distance)), azimuth=azimuth)
        assert found == approx(abs(exact), abs=1e-8)  # residual of a fit and of its nodes


@pytest.mark.parametrize("waves", [3.0, 20.0])
@pytest.mark.parametrize("distance", [DISTANCE, -0.06])
def test_discs_by_one_set_of_nodes_and_by_strips(waves, distance):
    system = SYSTEM | {"image_distance": distance}
    wave = psf.Wavefront.from_zernike({2: 2e-7, 4: waves * WAVELENGTH / 8, 8: 1.5e-7}, **system)
    residual = split(wave)
    cutoff = 2 * RADIUS / (WAVELENGTH * abs(distance))
    for share, azimuth in ((0.03, 0.8), (0.4, -1.3), (0.9, 2.6)):
        strips = abs(transfer(residual, share * cutoff, azimuth))
        found = round_overlap(residual, share * cutoff, azimuth)
        assert found == approx(strips, abs=1e-9)
        assert psf.mtf(wave, -share * cutoff, azimuth=azimuth) == found
    assert round_overlap(residual, cutoff * (1 + 1e-12), 0.3) == 0
    assert 0 < round_overlap(residual, cutoff * (1 - 1e-3), 0.3) < 1e-4


def test_series_on_the_patches_of_each_cell():
    """Curved and straight sides, of one or several functions."""
    wave = psf.Wavefront.from_function(bend, amplitude=uneven, aperture=PAIR, samples=20, **SYSTEM)
    residual = split(wave)
    rng = np.random.default_rng(6)
    share = np.sqrt(rng.random((300, 1)))
    corner = rng.random((300, 1))
    triangle = CORNERS[0] + share * (
        (1 - corner) * (CORNERS[1] - CORNERS[0]) + corner * (CORNERS[2] - CORNERS[0])
    )
    angle = 2 * math.pi * corner[:, 0]
    disc = CENTRE + SIZE * share * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    many = [residual.series, residual.amplitude_series]
    for cell, points in enumerate((triangle, disc)):
        u, v = points.T
        path, amplitude = series_at(many, cell, u, v)
        rest = bend(u, v) - path
        plane = np.stack([np.ones_like(u), u, v], axis=1)
        fit = np.linalg.lstsq(plane, rest, rcond=None)[0]
        assert plane @ fit == approx(rest, abs=1e-6 * WAVELENGTH)
        assert fit[1:] == approx(residual.tilt, abs=1e-9)
        assert amplitude == approx(uneven(u, v), abs=1e-8)
        with pytest.raises(SamplingError, match=f"2 points of cell {cell} lie in none of its"):
            series_at(many, cell, np.append(u, [5e-3, 6e-3]), np.append(v, [1e-3, 0.0]))
    with pytest.raises(SamplingError, match=r"the first at u = 0.005 m, v = 0.001 m; give sides"):
        series_at(many, 0, np.append(triangle[:, 0], 5e-3), np.append(triangle[:, 1], 1e-3))


def test_points_on_the_rims_of_patches():
    """Corners, and points between them on the lines that patches share."""
    wave = psf.Wavefront.from_function(bend, amplitude=uneven, aperture=PAIR, samples=20, **SYSTEM)
    amplitude = split(wave).amplitude_series
    a, b = PAIR.patches
    for s in (0.0, 0.37, 1.0):
        for t in (0.0, 0.6, 1.0):
            points = (1 - s) * a.at([t])[:, 0] + s * b.at([t])[:, 0]
            for patch, cell in enumerate(PAIR.owners):
                u, v = points[patch, None].T
                assert series_at([amplitude], int(cell), u, v)[0] == approx(uneven(u, v), abs=1e-7)


def test_overlaps_that_do_not_converge_or_fit(monkeypatch):
    wave = psf.Wavefront.from_function(bend, aperture=PAIR, samples=20, **SYSTEM)
    frequency = 0.1 * 2 * RADIUS / (WAVELENGTH * DISTANCE)
    residual = split(wave)
    with within(Budget(memory=2.0**10, seconds=60.0)):
        message = (
            "the overlap of two pupils needs .* GiB, .*; use psf.point_spread and its transfer"
        )
        with pytest.raises(MemoryLimitError, match=message):
            transfer(residual, frequency, 0.3)
    steps = {}
    monkeypatch.setattr(pupil_overlap, "_summed", lambda *a: steps.setdefault(a[-1], 3e-6 / a[-1]))
    assert abs(transfer(residual, frequency, 0.3)) == approx(3e-6 / 64, rel=1e-9)
    assert list(steps) == [4, 6, 9, 14, 24, 40, 64]
    steps.clear()
    monkeypatch.setattr(pupil_overlap, "_summed", lambda *a: steps.setdefault(a[-1], 1.0 / a[-1]))
    message = f"at {frequency:.4g} /m changes by 0.0094 with more nodes, limit 1e-06; use psf.point"
    with pytest.raises(SamplingError, match=re.escape(message)):
        transfer(residual, frequency, 0.3)


def test_scaled_amplitude_changes_nothing():
    wave = psf.Wavefront.from_function(bend, amplitude=uneven, aperture=PAIR, samples=20, **SYSTEM)
    brighter = replace(wave, amplitude=3.7 * wave.amplitude)
    even = psf.Wavefront.from_function(bend, aperture=PAIR, samples=20, **SYSTEM)
    for one, other in ((wave, brighter), (even, replace(even, amplitude=2.6 * even.amplitude))):
        found = [transfer(split(given), 7e4, 0.3) for given in (one, other)]
        assert found[0] == approx(found[1], abs=1e-12)
        assert abs(found[0]) > 0.01
