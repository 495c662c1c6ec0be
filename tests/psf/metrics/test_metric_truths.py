"""Metrics against closed forms, other integrals, and the metrics of prysm."""

from __future__ import annotations

import math

import numpy as np
import pytest
from pytest import approx
from scipy.integrate import quad
from scipy.special import j0, j1

from nlosoptics import psf

WAVELENGTH, RADIUS, DISTANCE = 632.8e-9, 12.5e-3, 50e-3
UNIT = WAVELENGTH * DISTANCE / (2 * RADIUS)


def wave(waves=None, **changes):
    return psf.Wavefront.from_zernike(
        {j: w * WAVELENGTH for j, w in (waves or {}).items()},
        **{
            "wavelength": WAVELENGTH,
            "pupil_radius": RADIUS,
            "image_distance": DISTANCE,
            **changes,
        },
    )


def annulus_density(v, inner):
    """Energy of an annulus per v = pi r/(lambda N); its amplitude is a disc's less a disc's."""
    if v == 0:
        return 0.0
    field = 2 * j1(v) / v
    if inner:
        field -= inner**2 * 2 * j1(inner * v) / (inner * v)
    return field**2 * v / 2 / (1 - inner**2)


def energy_within(v, inner=0.0):
    return quad(annulus_density, 0, v, args=(inner,), limit=400, epsabs=1e-13, epsrel=1e-12)[0]


def test_energy_of_the_airy_disc_at_any_radius():
    """1 - J0^2 - J1^2 (Born and Wolf, Principles of Optics, 7th ed., sec. 8.5.2)."""
    r = np.array([0.1, 0.5, 0.9, 1.7, 5.3, 20.0])
    v = np.pi * r
    exact = 1 - j0(v) ** 2 - j1(v) ** 2
    assert psf.encircled_energy(wave(), r * UNIT) == approx(exact, rel=1e-12)
    assert [energy_within(x) for x in v] == approx(exact, rel=1e-11)


@pytest.mark.parametrize("inner", [0.2, 0.5, 0.8])
def test_energy_of_an_annulus(inner):
    r = np.array([0.3, 1.0, 2.5, 8.0])
    exact = [energy_within(math.pi * x, inner) for x in r]
    # the integral's own error
    assert psf.encircled_energy(wave(obscuration=inner), r * UNIT) == approx(exact, rel=1e-10)


@pytest.mark.parametrize("inner", [0.0, 0.4])
def test_energy_in_squares(inner):
    """The inscribed circle's, and of the rings beyond it the part of the angle within."""
    pitch = UNIT / 4
    spread = psf.point_spread(
        wave(obscuration=inner),
        pitch=pitch,
        shape=65,
        pixel_integrated=True,
        tol=1e-6,
        model="scalar",
    )
    for pixels in (1, 5, 13, 41):
        half = pixels * pitch / 2

        def ring(v, edge=math.pi * half / UNIT):
            return annulus_density(v, inner) * (1 - 4 / math.pi * math.acos(min(1, edge / v)))

        edge = math.pi * half / UNIT
        exact = energy_within(edge, inner)
        exact += quad(ring, edge, edge * math.sqrt(2), limit=400, epsabs=1e-12)[0]
        # whole pixels, integrated with the spread's error at most
        limit = max(1e-9, spread.error_estimate)
        assert psf.ensquared_energy(spread, 2 * half) == approx(exact, abs=limit)


@pytest.mark.parametrize(("relative", "waves"), [(0.1, 4.0), (0.35, 1.0), (0.95, 0.25)])
def test_mtf_of_defocus(relative, waves):
    """Hopkins, Proc. R. Soc. A 231, 91 (1955), as one integral over the overlap's width.

    W20 rho^2 differs by 2 W20 s x between pupils that are s radii apart, -s/2 and s/2 from x.
    """
    s = 2 * relative
    turn = 2 * math.pi * 2 * waves * s

    def height(x):
        return 2 * math.sqrt(max(0.0, 1 - (abs(x) + s / 2) ** 2))

    edge = 1 - s / 2
    options = {"limit": 500, "epsabs": 1e-12}
    found = 2 * quad(height, 0, edge, weight="cos", wvar=turn, **options)[0] / math.pi
    # Noll 4 is sqrt(3)(2 rho^2 - 1)
    blurred = wave({4: waves / (2 * math.sqrt(3))})
    assert psf.mtf(blurred, relative / UNIT) == approx(abs(found), abs=1e-9)
    spread = psf.point_spread(blurred, pitch=UNIT / 4, shape=512)
    # light outside the window is missing from both the sum and the spectrum
    limit = 2 * (1 - spread.enclosed_energy)
    assert psf.mtf(spread, relative / UNIT) == approx(abs(found), abs=limit)


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


@pytest.mark.parametrize("inner", [0.3, 0.6])
def test_mtf_of_an_annulus(inner):
    """O'Neill, J. Opt. Soc. Am. 46, 285 (1956): areas that shifted discs share."""
    spread = psf.point_spread(wave(obscuration=inner), pitch=UNIT / 4, shape=1024, model="scalar")
    for relative in (0.05, 0.2, 0.4, 0.65, 0.9):
        s = 2 * relative
        shared = lens_area(1, 1, s) - 2 * lens_area(1, inner, s) + lens_area(inner, inner, s)
        exact = shared / (math.pi * (1 - inner**2))
        # light outside the window, see above
        limit = 2 * (1 - spread.enclosed_energy)
        assert limit < 0.01
        assert psf.mtf(spread, relative / UNIT) == approx(exact, abs=limit)


def coma_transfer(relative, waves):
    """Transfer of Noll 8 along x, by a plain sum over the overlap: midpoints, in one stroke."""
    s, n = 2 * relative, 4000
    y = (np.arange(n) + 0.5) / n * math.sqrt(1 - s * s / 4)
    half = np.sqrt(1 - y * y) - s / 2
    x, gauss = np.polynomial.legendre.leggauss(60)
    along = half[:, None] * x
    pair = []
    for side in (1, -1):
        u = along + side * s / 2
        square = u * u + (y * y)[:, None]
        pair.append(math.sqrt(8) * waves * (3 * square - 2) * u)
    turned = np.exp(2j * math.pi * (pair[0] - pair[1])) * gauss * half[:, None]
    return 2 * turned.sum() * math.sqrt(1 - s * s / 4) / n / math.pi


@pytest.mark.parametrize("relative", [0.1, 0.4, 0.8])
def test_modulus_and_phase_of_coma(relative):
    found = coma_transfer(relative, 0.15)
    blurred = wave({8: 0.15})
    # midpoints of n = 4000 beside a root at the tip: n^(-3/2)
    assert psf.mtf(blurred, relative / UNIT) == approx(abs(found), abs=1e-5)
    # across, the phases of coma's two halves cancel less: not the same figure
    assert abs(float(psf.mtf(blurred, relative / UNIT, azimuth=math.pi / 2)) - abs(found)) > 1e-3
    spread = psf.point_spread(blurred, pitch=UNIT / 4, shape=1024, model="scalar")
    limit = 2 * (1 - spread.enclosed_energy) / abs(found)
    turned = psf.ptf(blurred, [relative / UNIT, -relative / UNIT])
    assert turned == approx([-np.angle(found), np.angle(found)], abs=1e-5)
    # the pupil's autocorrelation at p + s/2 and p - s/2 has the spectrum's sign turned: x = +a d
    assert psf.ptf(spread, relative / UNIT) == approx(-np.angle(found), abs=limit + 1e-5)


@pytest.mark.parametrize(("steps", "limit"), [(4, 1e-5), (6, 1e-6), (10, 1e-9)])
def test_width_of_the_airy_disc_at_any_pitch(steps, limit):
    """1.0289939 lambda N, by solving (2 J1(v)/v)^2 = 1/2."""
    low, high = 1.0, 2.0
    for _ in range(60):
        v = (low + high) / 2
        low, high = (v, high) if (2 * j1(v) / v) ** 2 > 0.5 else (low, v)
    spread = psf.point_spread(wave(), pitch=UNIT / steps, shape=64, tol=1e-12, model="scalar")
    assert psf.fwhm(spread) == approx([2 * low / math.pi * UNIT] * 2, rel=limit)


@pytest.mark.parametrize("waves", [{4: 0.1}, {6: 0.12}, {8: 0.15, 11: -0.05}], ids=str)
def test_strehl_ratio_is_the_image_on_the_axis(waves):
    """By the transform to the image, which takes no part in the metric."""
    spread = psf.point_spread(
        wave(waves), shape=71, normalisation="ideal-peak", tol=1e-9, model="scalar"
    )
    assert psf.strehl(wave(waves)) == approx(float(spread.intensity[35, 35]), abs=1e-9)


def test_prysms_metrics(peer):
    otf = peer("prysm.otf")
    frequencies = np.array([0.05, 0.3, 0.6, 0.9]) / UNIT
    theirs = otf.diffraction_limited_mtf(2.0, 1e6 * WAVELENGTH, frequencies / 1e3)
    assert psf.mtf(wave(), frequencies) == approx(theirs, abs=1e-13)
    spread = psf.point_spread(wave({5: 0.1, 8: 0.1}), pitch=UNIT / 4, shape=256)
    transfer = otf.mtf_from_psf(spread.intensity, 1e6 * spread.pitch)
    row = transfer.data.shape[0] // 2
    ours = psf.mtf(spread, 1e3 * transfer.x[0, row : row + 64])
    # the same Fourier sum
    assert ours == approx(transfer.data[row, row : row + 64], abs=1e-12)


@pytest.mark.parametrize("distance", [DISTANCE, -DISTANCE])
def test_transfer_of_an_uneven_wave_is_that_of_its_image(distance):
    """Without any symmetry, of uneven amplitude, on either side of the pupil."""

    def path(u, v):
        rho, theta = np.hypot(u, v) / RADIUS, np.arctan2(v, u)
        terms = {3: 0.2, 7: 0.1, 8: 0.1, 9: 0.1}
        return WAVELENGTH * sum(w * psf.zernike(j, rho, theta) for j, w in terms.items())

    given = psf.Wavefront.from_function(
        path,
        amplitude=lambda u, v: 1 + 0.3 * u / RADIUS,
        wavelength=WAVELENGTH,
        pupil_radius=RADIUS,
        image_distance=distance,
    )
    spread = psf.point_spread(given, pitch=UNIT / 4, shape=1024, model="scalar")
    limit = 2 * (1 - spread.enclosed_energy)  # light outside the window
    for relative, azimuth in ((0.1, 0.0), (0.4, 0.9)):
        here, there = (
            psf.mtf(s, relative / UNIT, azimuth=azimuth)
            * np.exp(1j * psf.ptf(s, relative / UNIT, azimuth=azimuth))
            for s in (given, spread)
        )
        assert here == approx(complex(there), abs=limit)
        assert abs(np.angle(here)) > 1e-3
