"""Transfer functions and encircled energies of any pupil against closed forms and plain sums."""

from __future__ import annotations

import math

import numpy as np
import pytest
from pytest import approx
from scipy.integrate import dblquad

from nlosoptics import psf
from nlosoptics.psf.metrics.pupil_overlap import overlap_nodes, transfer
from nlosoptics.psf.wave.detilted import split

WAVELENGTH, RADIUS, DISTANCE = 632.8e-9, 12.5e-3, 50e-3
UNIT = WAVELENGTH * DISTANCE / (2 * RADIUS)
SYSTEM = {"wavelength": WAVELENGTH, "image_distance": DISTANCE, "pupil_radius": RADIUS}
MIX = {2: 0.2, 5: 0.3, 8: 0.15}
BOX = psf.Aperture.polygon(RADIUS * np.array([(-0.5, -0.3), (0.5, -0.3), (0.5, 0.3), (-0.5, 0.3)]))
VANED = psf.Aperture.round(RADIUS, 0.3, vanes=3, vane_width=0.05 * RADIUS, angle=0.2)
SEGMENTS = psf.Aperture.hexagons(1, 0.6 * RADIUS, 0.02 * RADIUS, angle=0.1)
ELLIPSE = psf.Aperture.ellipse(RADIUS, 0.6 * RADIUS, 0.5, obscuration=0.4)


def wave(waves=None, **changes):
    terms = {j: w * WAVELENGTH for j, w in (waves or {}).items()}
    return psf.Wavefront.from_zernike(terms, **{**SYSTEM, **changes})


def lens_area(a, b, s):
    """Area that two discs of radii a and b share, s apart."""
    if s >= a + b:
        return 0.0
    if s <= abs(a - b):
        return math.pi * min(a, b) ** 2
    p = (s * s + a * a - b * b) / (2 * s * a)
    q = (s * s + b * b - a * a) / (2 * s * b)
    kite = math.sqrt((-s + a + b) * (s + a - b) * (s - a + b) * (s + a + b)) / 2
    return a * a * math.acos(p) + b * b * math.acos(q) - kite


@pytest.mark.parametrize("azimuth", [0.0, 0.3, -1.1])
@pytest.mark.parametrize("inner", [0.3, 0.6])
def test_annulus(inner, azimuth):
    """O'Neill, J. Opt. Soc. Am. 46, 285 (1956): areas that shifted discs share."""
    ring, cells = wave(obscuration=inner), wave(aperture=psf.Aperture.round(RADIUS, inner))
    # at 0.2 the outer rim touches the inner one of 0.6 from within
    for relative in (0.05, 0.2, 0.4, 0.65, 0.9):
        s = 2 * relative
        shared = lens_area(1, 1, s) - 2 * lens_area(1, inner, s) + lens_area(inner, inner, s)
        exact = shared / (math.pi * (1 - inner**2))
        for given in (ring, cells):
            # rounding; convergence is asked to 1e-10 and overshoots it
            assert psf.mtf(given, relative / UNIT, azimuth=azimuth) == approx(exact, abs=1e-12)
    assert psf.mtf(cells, [0.0, 1.01 / UNIT], azimuth=azimuth) == approx([1.0, 0.0], abs=1e-15)


@pytest.mark.parametrize("azimuth", [0.0, 0.4, math.pi / 2, 2.5])
def test_box_is_a_product_of_triangles(azimuth):
    box = wave(aperture=BOX)
    relative = np.array([0.05, 0.2, 0.29, 0.45, 0.7])
    x, y = (2 * relative * abs(turn(azimuth)) for turn in (math.cos, math.sin))
    exact = np.maximum(1 - x, 0) * np.maximum(1 - y / 0.6, 0)
    assert psf.mtf(box, relative / UNIT, azimuth=azimuth) == approx(exact, abs=1e-13)
    assert psf.ptf(box, relative[:2] / UNIT, azimuth=azimuth) == approx([0, 0], abs=1e-12)


def test_pistons_turn_the_phase_between_two_telescopes():
    a, apart, path = 0.3, 1.2, 0.11 * WAVELENGTH
    disc = psf.Aperture.round(a * RADIUS)
    half = apart / 2 * RADIUS
    pair = psf.Aperture.union(disc.moved((-half, 0)), disc.moved((half, 0)))
    given = psf.Wavefront.from_function(aperture=pair, pistons=[-path, path], **SYSTEM)
    relative = np.array([0.2, 0.55, 0.7])
    own = [lens_area(a, a, 2 * r) for r in relative]
    between = [lens_area(a, a, abs(2 * r - apart)) / 2 for r in relative]
    # P(q - s/2) is the left telescope, P*(q + s/2) the right one
    turned = np.exp(-2j * math.pi * 2 * path / WAVELENGTH)
    exact = (np.array(own) + turned * np.array(between)) / (math.pi * a**2)
    assert psf.mtf(given, relative / UNIT) == approx(np.abs(exact), abs=1e-9)
    assert psf.ptf(given, relative / UNIT) == approx(np.angle(exact), abs=1e-8)


@pytest.mark.parametrize("distance", [DISTANCE, -DISTANCE])
def test_nodes_of_an_overlap_have_its_phase(distance):
    """The sum over nodes against strips, for a wave without symmetry and of uneven amplitude."""

    def path(u, v):
        rho, theta = np.hypot(u, v) / RADIUS, np.arctan2(v, u)
        terms = {3: 0.4, 7: 0.3, 8: 0.2, 9: 0.2}
        return WAVELENGTH * sum(w * psf.zernike(j, rho, theta) for j, w in terms.items())

    given = psf.Wavefront.from_function(
        path,
        amplitude=lambda u, v: 1 + 0.3 * u / RADIUS,
        nodes="polar",
        **SYSTEM | {"image_distance": distance},
    )
    residual = split(given)
    for relative, azimuth in ((0.1, 0.0), (0.4, 0.9), (0.8, -2.0)):
        place = relative / UNIT * np.array([math.cos(azimuth), math.sin(azimuth)])
        phase, weight = overlap_nodes(residual, np.stack([place / 2, place]), 48)
        turned = 1j * phase[1] - 2j * math.pi * (place @ residual.shift)
        found = np.sum(weight[1] * np.exp(turned))
        # convergence of the strips
        assert found == approx(transfer(residual, relative / UNIT, azimuth), abs=1e-9)
        assert abs(np.angle(found)) > 1e-3


@pytest.mark.parametrize("azimuth", [0.0, 0.9])
def test_discs_of_cells_and_of_rings(azimuth):
    """One overlap by the nodes of the whole lens, the other strip by strip."""
    frequencies = np.array([0.1, 0.4, 0.8]) / UNIT
    disc, cells = wave(MIX), wave(MIX, aperture=psf.Aperture.round(RADIUS))
    expected = psf.mtf(disc, frequencies, azimuth=azimuth)
    # the bound of a converged overlap; the cells' nodes leave 1e-11 rad
    assert psf.mtf(cells, frequencies, azimuth=azimuth) == approx(expected, abs=1e-9)
    phases = (psf.ptf(given, frequencies, azimuth=azimuth) for given in (disc, cells))
    assert next(phases) == approx(next(phases), abs=1e-8)


@pytest.mark.parametrize("azimuth", [0.0, 0.7])
@pytest.mark.parametrize("outline", [VANED, SEGMENTS, ELLIPSE], ids=["vanes", "hexagons", "ring"])
def test_aberrated_pupils_are_plain_sums(outline, azimuth):
    def aberration(u, v):
        return WAVELENGTH * (20 * u + 0.6 * (u * u + v * v) / RADIUS**2 + (u / RADIUS) ** 3 / 2)

    def amplitude(u, v):
        return np.exp((0.5 * u - 0.3 * v) / RADIUS)

    given = psf.Wavefront.from_function(aberration, amplitude=amplitude, aperture=outline, **SYSTEM)
    frequency, n = 0.23 / UNIT, 1200
    shift = WAVELENGTH * DISTANCE * frequency
    axis = RADIUS * (2 * (np.arange(n) + 0.5) / n - 1)
    v, u = np.meshgrid(axis, axis, indexing="ij")
    pair = []
    for side in (-0.5, 0.5):
        x, y = u + side * shift * math.cos(azimuth), v + side * shift * math.sin(azimuth)
        phase = np.exp(2j * math.pi / WAVELENGTH * aberration(x, y))
        pair.append(outline.contains(x, y) * amplitude(x, y) * phase)
    energy = np.sum((outline.contains(u, v) * amplitude(u, v)) ** 2)
    expected = np.sum(pair[0] * np.conj(pair[1])) / energy
    # squares of 1/600 of the radius at the rims, whose errors have both signs
    assert psf.mtf(given, frequency, azimuth=azimuth) == approx(abs(expected), abs=1e-3)
    turned = psf.ptf(given, frequency, azimuth=azimuth) - np.angle(expected)
    assert abs(expected) > 0.05
    assert math.remainder(float(turned), 2 * math.pi) == approx(0, abs=2e-2)


def test_phase_of_a_shifted_spot_is_linear():
    tilt = 0.8 * UNIT / DISTANCE
    for outline in (VANED, BOX):
        given = psf.Wavefront.from_function(lambda u, v: tilt * u, aperture=outline, **SYSTEM)
        # the spot is at x = +a d
        frequencies = np.array([0.05, 0.2]) / UNIT
        assert psf.ptf(given, frequencies) == approx(
            -2 * math.pi * frequencies * 0.8 * UNIT, abs=1e-9
        )


def test_energy_of_a_ring_on_cells():
    r = np.array([0.0, 0.02, 0.3, 1.0, 2.5, 8.0]) * UNIT
    for inner in (0.0, 0.4):
        cells = wave(MIX, aperture=psf.Aperture.round(RADIUS, inner))
        exact = psf.encircled_energy(wave(MIX, obscuration=inner), r)
        # the softened disc's step where the image's band ends; nodes leave 1e-11 rad
        assert psf.encircled_energy(cells, r) == approx(exact, abs=1e-10)


def test_energy_of_a_box_is_an_integral_of_sincs():
    box, radius = wave(aperture=BOX), 0.9 * UNIT
    # of (1, 0.6) x the pupil radius: half a diameter wide
    exact, _ = dblquad(
        lambda y, x: np.sinc(x / 2) ** 2 * np.sinc(0.3 * y) ** 2,
        0,
        0.9,
        0,
        lambda x: math.sqrt(0.81 - x * x),
        epsabs=1e-12,
    )
    assert psf.encircled_energy(box, radius) == approx(4 * exact * 0.5 * 0.3, abs=1e-10)


@pytest.mark.parametrize("outline", [VANED, SEGMENTS], ids=["vanes", "hexagons"])
def test_energy_of_aberrated_pupils_is_a_plain_sum(outline):
    given, radius = wave(MIX, aperture=outline), 1.7 * UNIT
    fine = wave(MIX, aperture=outline, samples=28)
    pupil = fine.weights * np.exp(2j * math.pi / WAVELENGTH * fine.aberration)
    share, weight = np.polynomial.legendre.leggauss(24)
    r = radius * np.sqrt((1 + share) / 2)
    angles = 2 * math.pi * np.arange(48) / 48
    x, y = np.outer(r, np.cos(angles)).ravel(), np.outer(r, np.sin(angles)).ravel()
    scale = 2 * math.pi / (WAVELENGTH * DISTANCE)
    turns = np.outer(x, fine.u.ravel()) + np.outer(y, fine.v.ravel())
    field = np.exp(-1j * scale * turns) @ pupil.ravel()
    mean = (np.abs(field).reshape(24, 48) ** 2).mean(axis=1) @ weight / 2
    energy = mean * math.pi * radius**2 / (outline.area * (WAVELENGTH * DISTANCE) ** 2)
    assert psf.encircled_energy(given, radius) == approx(energy, abs=1e-10)
    many = psf.encircled_energy(given, np.array([[0.5, 1.7], [6.0, 20.0]]) * UNIT)
    assert many[0, 1] == approx(energy, abs=1e-10)
    assert np.all(np.diff(many.ravel()) > 0)
    assert 0.9 < many[1, 1] < 1
