"""Vector diffraction against Richards and Wolf's integrals and direct sums, and the model error."""

import math
from dataclasses import replace

import numpy as np
import pytest
from pytest import approx
from scipy.integrate import quad_vec
from scipy.special import jv

from nlosoptics import psf
from nlosoptics.errors import SamplingError, SceneError
from nlosoptics.psf.transform.wide_pixels import detilted_wide_spread
from nlosoptics.psf.wave.detilted import split

from ..spherical_waves import spherical_waves

WAVELENGTH, RADIUS = 632.8e-9, 5e-3
HIGH = {"model": "high-aperture"}


def wave_at(f_number, waves=None, **changes):
    settings = {
        "wavelength": WAVELENGTH,
        "pupil_radius": RADIUS,
        "image_distance": 2 * RADIUS * f_number,
        **changes,
    }
    return psf.Wavefront.from_zernike(
        {j: w * WAVELENGTH for j, w in (waves or {}).items()}, **settings
    )


def richards_wolf(f_number, x, y, angle=None):
    """Intensity in the focal plane by the integrals I0, I1, I2; 1 at the focus.

    Richards and Wolf, Proc. R. Soc. A 253 (1959) 358, eqs. 2.32 and 3.2. ``angle`` is that of the
    field before the lens, from x toward y; None for an unpolarised wave.
    """
    k = 2 * np.pi / WAVELENGTH
    r, phi = np.hypot(x, y), np.arctan2(y, x)

    def integrand(theta):
        weight, q = math.sqrt(math.cos(theta)) * math.sin(theta), k * r * math.sin(theta)
        return np.stack(
            [
                weight * (1 + math.cos(theta)) * jv(0, q),
                weight * math.sin(theta) * jv(1, q),
                weight * (1 - math.cos(theta)) * jv(2, q),
                np.full_like(r, weight * (1 + math.cos(theta))),
            ]
        )

    largest = math.asin(1 / (2 * f_number))
    (i0, i1, i2, peak), _ = quad_vec(integrand, 0, largest, epsabs=1e-14, epsrel=1e-13)
    if angle is None:
        found = i0**2 + 2 * i1**2 + i2**2
    else:
        turned = phi - angle
        found = i0**2 + i2**2 + 2 * i0 * i2 * np.cos(2 * turned)
        found += 4 * i1**2 * np.cos(turned) ** 2
    return found / peak**2


@pytest.mark.parametrize("f_number", [2, 1.2, 0.7, 0.503])
@pytest.mark.parametrize(
    ("polarisation", "angle"),
    [("unpolarised", None), ("x", 0.0), ("y", math.pi / 2), (0.4, 0.4), (-2.0, -2.0)],
)
def test_ideal_pupil_is_richards_and_wolfs(f_number, polarisation, angle):
    spread = psf.point_spread(
        wave_at(f_number),
        pitch=WAVELENGTH * f_number / 3,
        shape=(14, 17),
        normalisation="ideal-peak",
        polarisation=polarisation,
        tol=1e-11,
        **HIGH,
    )
    x, y = np.meshgrid(spread.x, spread.y)
    expected = richards_wolf(f_number, x, y, angle)
    # both integrals have converged to rounding
    assert np.abs(spread.intensity - expected).max() < 1e-12
    assert (spread.model, spread.model_error, spread.method) == ("high-aperture", 0.0, "quadrature")
    assert spread.error_estimate < 1e-11


def rotated_field(a, b, incident):
    """Field (n, 3) of a lens that turns each ray by a rotation in its meridional plane."""
    phi, theta = np.arctan2(b, a), np.arcsin(np.hypot(a, b))
    out = []
    for p, t in zip(phi, theta, strict=True):
        about_axis = np.array(
            [[math.cos(p), -math.sin(p), 0], [math.sin(p), math.cos(p), 0], [0, 0, 1]]
        )
        tilt = np.array([[math.cos(t), 0, math.sin(t)], [0, 1, 0], [-math.sin(t), 0, math.cos(t)]])
        out.append(about_axis @ tilt @ about_axis.T @ np.array([*incident, 0.0]))
    return np.array(out)


def direct(nodes, distance, x, y, incidents):
    """Energy per area of a sum of plane waves over nodes (u, v, W, A, w), for unit energy.

    It is the mean over ``incidents``, the directions of the field before the lens.
    """
    u, v, path, amplitude, area = (np.ravel(a) for a in nodes)
    a, b = u / distance, v / distance
    cosine = np.sqrt(1 - a**2 - b**2)
    k = 2 * np.pi / WAVELENGTH
    wave = np.exp(1j * k * (path - np.multiply.outer(x, a) - np.multiply.outer(y, b)))
    total = np.zeros(x.shape)
    for incident in incidents:
        # Strength A cos^(1/2), and d(solid angle) = da db/cos
        field = rotated_field(-a, -b, incident) * (amplitude * area / np.sqrt(cosine))[:, None]
        total += np.sum(np.abs(wave @ field) ** 2, axis=-1) / len(incidents)
    return total / (WAVELENGTH * distance) ** 2 / np.sum(amplitude**2 * area / cosine)


BENT = {4: 0.1, 5: -0.15, 8: 0.05, 9: 0.03}


def bent(u, v):
    rho, theta = np.hypot(u, v) / RADIUS, np.arctan2(v, u)
    return sum(w * WAVELENGTH * psf.zernike(j, rho, theta) for j, w in BENT.items())


def shade(u, v):
    return 1 + 0.3 * u / RADIUS - 0.2 * (v / RADIUS) ** 2


@pytest.mark.parametrize(
    ("polarisation", "incidents"),
    [("unpolarised", [(1, 0), (0, 1)]), (0.3, [(math.cos(0.3), math.sin(0.3))])],
)
@pytest.mark.parametrize("pupil", ["annulus", "behind", "cells", "grid", "scattered"])
def test_aberrated_wave_is_the_sum_of_plane_waves(pupil, polarisation, incidents):
    """F/0.8 with a shaded pupil; the sum takes its own nodes, and turns each field by matrices."""
    distance = 1.6 * RADIUS * (-1 if pupil == "behind" else 1)
    given = {"wavelength": WAVELENGTH, "image_distance": distance}
    x, gauss = np.polynomial.legendre.leggauss(40)
    if pupil in ("annulus", "behind"):
        wave = psf.Wavefront.from_function(
            bent, amplitude=shade, pupil_radius=RADIUS, obscuration=0.4, **given
        )
        square = (0.16 + 0.84 * (1 + x) / 2)[:, None]
        theta = 2 * np.pi * (np.arange(120) + 0.3) / 120
        u, v = (RADIUS * np.sqrt(square) * f(theta) for f in (np.cos, np.sin))
        area = gauss[:, None] + 0 * theta
    elif pupil == "cells":
        half = 0.6 * RADIUS
        corners = [(-half, -half), (half, -half), (half, half), (-half, half)]
        wave = psf.Wavefront.from_function(
            bent,
            amplitude=shade,
            pupil_radius=RADIUS,
            aperture=psf.Aperture.polygon(corners),
            **given,
        )
        u, v = np.meshgrid(half * x, half * x)
        area = gauss[:, None] * gauss
    else:
        n = 48
        axis = (np.arange(n) - n // 2) * 1.3 * RADIUS / n
        u, v = np.meshgrid(axis, axis)
        wave = psf.Wavefront.from_map(
            bent(u, v), shade(u, v), pupil_pitch=1.3 * RADIUS / n, pupil_radius=RADIUS, **given
        )
        area = np.ones_like(u)
        if pupil == "scattered":
            u, v, area = psf.polar_nodes(RADIUS, 30, 100)
            wave = psf.Wavefront(
                u=u.ravel(),
                v=v.ravel(),
                aberration=bent(u, v).ravel(),
                amplitude=shade(u, v).ravel(),
                weights=area.ravel(),
                pupil_radius=RADIUS,
                layout="scattered",
                **given,
            )
    own = {"grid": "mdft", "scattered": "nufft"}.get(pupil, "quadrature")
    spread = psf.point_spread(
        wave,
        method=own,
        pitch=WAVELENGTH * 0.8 / 3,
        shape=(44, 45),
        tol=1e-11,
        polarisation=polarisation,
        **HIGH,
    )
    area = area * float(np.sum(wave.weights) / np.sum(area))
    some = np.s_[3::7, 2::8]
    x, y = (c[some] for c in np.meshgrid(spread.x, spread.y))
    expected = direct((u, v, bent(u, v), shade(u, v), area), distance, x, y, incidents)
    difference = spread.intensity[some] / spread.pitch**2 - expected
    # nodes of both sums have converged, or are the same
    assert np.abs(difference).max() < 1e-11 * expected.max()
    if pupil not in ("grid", "scattered"):  # whose bounds hold the error of their outline
        assert spread.error_estimate < 1e-9


@pytest.mark.parametrize("normalisation", ["unit-sum", "ideal-peak", "flux"])
def test_scattered_nodes_keep_their_estimate(normalisation):
    """A thousand nodes on a spiral, each with the same area, against polar nodes."""
    n = 1000
    index = np.arange(n) + 0.5
    rho, theta = np.sqrt(index / n), index * np.pi * (3 - math.sqrt(5))
    u, v = RADIUS * rho * np.cos(theta), RADIUS * rho * np.sin(theta)
    given = {"wavelength": WAVELENGTH, "image_distance": 1.6 * RADIUS, "pupil_radius": RADIUS}
    wave = psf.Wavefront(
        u=u,
        v=v,
        aberration=bent(u, v),
        amplitude=np.ones(n),
        weights=np.full(n, math.pi * RADIUS**2 / n),
        layout="scattered",
        **given,
    )
    options = {"pitch": WAVELENGTH / 5, "shape": 41, "normalisation": normalisation, **HIGH}
    few = psf.point_spread(wave, method="nufft", **options)
    exact = psf.point_spread(psf.Wavefront.from_function(bent, **given), **options)
    error = np.abs(few.intensity - exact.intensity).max() / exact.intensity.max()
    assert 1e-4 < error <= few.error_estimate < 3 * error


@pytest.mark.parametrize("polarisation", ["unpolarised", 0.3])
@pytest.mark.parametrize("side", [0.7, 2.3])
def test_bound_of_few_nodes(side, polarisation):
    """What eight rings do not resolve, on pixels of less and of more than an Airy unit."""
    given = {"wavelength": WAVELENGTH, "image_distance": 1.7 * RADIUS, "pupil_radius": RADIUS}

    def bump(u, v):
        return 1e-7 * np.exp(-((u / 2e-3) ** 2) - (v / 1.5e-3) ** 2 + 0.2 * u / RADIUS)

    few, many = (
        psf.point_spread(
            psf.Wavefront.from_function(bump, amplitude=shade, samples=n, nodes="polar", **given),
            method="quadrature",
            polarisation=polarisation,
            pitch=side * 1.7 / 2 * WAVELENGTH,
            shape=(5, 8),
            pixel_integrated=True,
            **HIGH,
        )
        for n in (8, 96)
    )
    error = np.abs(few.intensity - many.intensity).max() / many.intensity.max()
    assert 1e-8 < error <= few.error_estimate < 0.5
    assert many.error_estimate < 1e-8


def test_slow_beams_are_airys():
    """The models differ by 1/N^2: to F/400 by the factor of 16 from F/100."""
    apart = []
    for f_number in (100, 400):
        options = {"pitch": WAVELENGTH * f_number / 4, "shape": 65, "normalisation": "ideal-peak"}
        wave = wave_at(f_number)
        exact = psf.point_spread(wave, method="airy", **options)
        vector = psf.point_spread(wave, **HIGH, **options)
        apart.append(np.abs(vector.intensity - exact.intensity).max())
        # 2 (J2(v)/v)^2 is at most 0.065
        assert apart[-1] == approx(0.065 / (2 * f_number) ** 2, rel=0.02)
    assert apart[0] / apart[1] == approx(16, rel=1e-3)


@pytest.mark.parametrize("f_number", [2, 0.7])
def test_energy_of_the_plane_is_one(f_number):
    """What a square window misses is the tail: of Airy's times the rim's share of the energy."""
    sine = 1 / (2 * f_number)
    secant = 2 * (1 - math.sqrt(1 - sine**2)) / sine**2  # mean of 1/cos over the pupil's area
    rim = 1 / math.sqrt(1 - sine**2) / secant
    for half in (20, 40):
        spread = psf.point_spread(
            wave_at(f_number),
            pitch=WAVELENGTH * f_number / 2,
            shape=4 * half + 1,
            pixel_integrated=True,
            **HIGH,
        )
        # lambda N/(pi^3 r^3) per area outside a square of this half side
        tail = 4 * math.sqrt(2) / (half + 0.25) / math.pi**3 * rim
        # the tail's oscillation, and its next order of 1/r
        assert 1 - spread.enclosed_energy == approx(tail, rel=0.02)
        assert spread.enclosed_energy == approx(spread.intensity.sum(), rel=1e-12)


def test_flux_scales_with_the_transmitted_energy():
    shaded = psf.Wavefront.from_function(
        None,
        amplitude=shade,
        pupil_radius=RADIUS,
        wavelength=WAVELENGTH,
        image_distance=1.4 * RADIUS,
    )
    options = {"pitch": WAVELENGTH / 4, "shape": 33, **HIGH}
    unit, flux = (
        psf.point_spread(shaded, normalisation=name, **options).intensity
        for name in ("unit-sum", "flux")
    )
    assert flux == approx(unit * shaded.flux, rel=1e-14)


def test_unpolarised_is_the_mean_of_two_polarisations():
    wave = wave_at(0.7, BENT)
    options = {"pitch": WAVELENGTH / 5, "shape": 65}
    x, y, turned, across = (
        psf.point_spread(wave, polarisation=p, **options).intensity
        for p in ("x", "y", 0.7, 0.7 + math.pi / 2)
    )
    mean = psf.point_spread(wave, **HIGH, **options).intensity
    assert (x + y) / 2 == approx(mean, abs=1e-12 * mean.max())
    assert (turned + across) / 2 == approx(mean, abs=1e-12 * mean.max())
    assert np.abs(x - y).max() > 0.05 * mean.max()


def test_pixels_are_integrals():
    """Each pixel against Gauss-Legendre nodes in it, which are samples of images moved by tilts."""
    wave = wave_at(0.8, {8: 0.05})
    side = 0.9 * WAVELENGTH
    exact = {"tol": 1e-9, **HIGH}
    pixels = psf.point_spread(wave, pitch=side, shape=5, pixel_integrated=True, **exact).intensity
    x, gauss = np.polynomial.legendre.leggauss(9)
    total = np.zeros((5, 5))
    options = {"pitch": side, "shape": 5, "normalisation": "ideal-peak", **exact}
    for i, up in enumerate(x):
        for j, across in enumerate(x):
            tilt = -side / 2 * (across * wave.u + up * wave.v) / wave.image_distance
            moved = replace(wave, aberration=wave.aberration + tilt)
            points = psf.point_spread(moved, **options).intensity
            total += gauss[i] * gauss[j] / 4 * points
    fine = {"pitch": side / 8, "shape": 31, **exact}
    samples = psf.point_spread(wave, **fine).intensity
    ideal = psf.point_spread(wave, **{**fine, "normalisation": "ideal-peak"}).intensity
    expected = 64 * total * samples.max() / ideal.max()
    # the filter of the pixels keeps 4e-11, nine nodes 1e-11
    assert pixels == approx(expected, abs=1e-10 * pixels.max())


def test_rays_on_wide_pixels_carry_the_cosine():
    """30 waves of defocus: rays with 1/cos of energy, within both estimates of the waves."""
    wave = wave_at(0.8, {4: 30 / (2 * math.sqrt(3))})
    options = {"pitch": 12 * WAVELENGTH, "shape": 17, "pixel_integrated": True, **HIGH}
    rays = psf.point_spread(wave, method="geometric", **options)
    waves = psf.point_spread(wave, method="quadrature", tol=1e-4, **options)
    peak = waves.intensity.max()
    assert np.abs(rays.intensity - waves.intensity).max() < rays.error_estimate * peak
    assert rays.intensity.sum() == approx(1, abs=1e-9)
    scalar = psf.point_spread(wave, method="quadrature", tol=1e-4, **{**options, "model": "scalar"})
    # rim over centre: 1/cos of 39 degrees
    ring, middle = (np.s_[8, 8 + 6], np.s_[8, 8])
    gained = waves.intensity[ring] / waves.intensity[middle]
    gained /= scalar.intensity[ring] / scalar.intensity[middle]
    by_rays = rays.intensity[ring] / rays.intensity[middle]
    assert gained > 1.1
    assert by_rays == approx(waves.intensity[ring] / waves.intensity[middle], rel=0.1)
    auto = psf.point_spread(wave, tol=1.01 * rays.error_estimate, **options)
    assert auto.method == "geometric"


# the choice


@pytest.mark.parametrize(
    ("f_number", "tol", "model"),
    [(2, 1e-3, "high-aperture"), (2, 0.05, "scalar"), (40, 1e-3, "scalar"), (40, 1e-6, None)],
)
def test_auto_takes_the_vector_model_where_tol_needs_it(f_number, tol, model):
    spread = psf.point_spread(wave_at(f_number), tol=tol, shape=33)
    assert spread.model == (model or "high-aperture")
    assert spread.model_error <= tol
    scalar = psf.point_spread(wave_at(f_number), tol=tol, shape=33, model="scalar")
    assert (scalar.model_error > tol) is (spread.model == "high-aperture")
    if spread.model == "high-aperture":
        assert spread.model_error == 0
        assert f"the scalar model errs by {scalar.model_error:.2g}" in spread.reason
    else:
        assert spread.intensity == approx(scalar.intensity, rel=1e-15)
        assert spread.model_error == scalar.model_error


def test_a_method_by_name_is_scalar_unless_the_model_is_named():
    wave = wave_at(1)
    named = psf.point_spread(wave, method="quadrature", shape=33)
    assert named.model == "scalar"
    assert named.model_error > 0.05
    assert psf.point_spread(wave, method="quadrature", shape=33, **HIGH).model == "high-aperture"


def test_the_model_error_of_a_clear_pupil_does_not_depend_on_its_nodes():
    options = {"shape": 33, "model": "scalar"}
    few, many = (
        psf.point_spread(wave_at(0.7, obscuration=0.3, samples=n), **options).model_error
        for n in ((1, 1), (48, 192))
    )
    assert few == approx(many, rel=1e-12)
    assert few > 0.1


@pytest.mark.parametrize(
    ("f_number", "least", "more"),
    [
        pytest.param(8, 0.00025, 0.00098, marks=pytest.mark.thorough),
        pytest.param(4, 0.00102, 0.0039, marks=pytest.mark.thorough),
        (2, 0.0041, 0.016),
        pytest.param(1.2, 0.0118, 0.047, marks=pytest.mark.thorough),
        (0.7, 0.0396, 0.166),
    ],
    ids=str,
)
def test_error_of_an_ideal_spot_is_bounded_within_a_factor_of_three(f_number, least, more):
    """Against the integrals: 0.03 % to 4 % of the peak, and more for unit energy."""
    wave = wave_at(f_number)
    options = {"pitch": WAVELENGTH * f_number / 4, "shape": 49, "model": "scalar"}
    scalar = psf.point_spread(wave, normalisation="ideal-peak", **options)
    x, y = np.meshgrid(scalar.x, scalar.y)
    true = np.abs(scalar.intensity - richards_wolf(f_number, x, y)).max()
    assert true == approx(least, rel=0.02)
    assert true <= scalar.model_error <= 3 * true
    sine = 1 / (2 * f_number)
    secant = 2 * (1 - math.sqrt(1 - sine**2)) / sine**2
    root = 1 - sine**2
    # mean of cos^(-1/2) (1 + cos)/2, by integrals of powers of the cosine
    mean = (2 * (1 - root**0.75) / 3 + 2 * (1 - root**1.25) / 5) / sine**2
    unit = psf.point_spread(wave, **options)
    assert secant / mean**2 - 1 == approx(more, rel=0.02)
    assert abs(mean**2 / secant - 1) <= unit.model_error <= 3 * abs(mean**2 / secant - 1)


def random_case(seed):
    """A wave with its window, from F/0.55 to F/30, with up to half a wave rms of aberration."""
    draw = np.random.default_rng(seed)
    f_number = math.exp(draw.uniform(math.log(0.55), math.log(30)))
    size = math.exp(draw.uniform(math.log(0.003), math.log(0.5)))
    terms = draw.choice(np.arange(4, 22), size=draw.integers(1, 6), replace=False)
    waves = {int(j): size * draw.normal() for j in terms}
    kind = draw.integers(4)
    changes = {}
    if kind == 1:
        changes = {"obscuration": draw.uniform(0.1, 0.6)}
    elif kind == 2:
        changes = {"aperture": psf.Aperture.round(RADIUS, 0.3, vanes=3, vane_width=2e-4)}
    elif kind == 3:
        changes = {"nodes": "grid", "samples": 128}
    wave = wave_at(f_number, waves, **changes)
    pixel = draw.choice([0.0, 0.0, 0.0, 0.7, 1.5, 4.0])
    pitch = WAVELENGTH * f_number * (pixel or draw.choice([0.25, 0.37, 0.5]))
    half = split(wave).rays.reach + 8 * WAVELENGTH * f_number
    options = {
        "pitch": pitch,
        "shape": 2 * math.ceil(half / pitch) + 3,
        "pixel_integrated": bool(pixel),
        "normalisation": str(draw.choice(["unit-sum", "ideal-peak", "flux"])),
        "method": "mdft" if kind == 3 else "quadrature",
    }
    return wave, options


@pytest.mark.parametrize("seed", range(20))
def test_model_error_bounds_the_error_of_random_waves(seed):
    """Constants of the bound were chosen on 900 other waves."""
    wave, options = random_case(seed)
    scalar = psf.point_spread(wave, model="scalar", **options)
    vector = psf.point_spread(wave, **HIGH, **options)
    peak = min(scalar.intensity.max(), vector.intensity.max())
    true = np.abs(scalar.intensity - vector.intensity).max() / peak
    assert scalar.model_error >= true
    assert scalar.model_error <= 10 * true


def test_every_point_spread_bounds_its_model():
    """Wide pixels, rough walls and bands of wavelengths; all below the bound for any wave."""
    wave = wave_at(2)
    geometry = {"footprint": 0.5, "cos_sum": 2.0, "pitch": WAVELENGTH / 2, "shape": 33}
    rough = psf.Roughness(height_rms=40e-9, correlation_length=4e-3)
    found = [
        detilted_wide_spread(split(wave), 40e-6, (33, 33), 1e-2),
        psf.mean_point_spread(wave, rough, **geometry),
        psf.sample_point_spread(wave, rough, effective_distance=0.5, seed=1, **geometry),
    ]
    for spread in found:
        assert spread.model == "scalar"
        assert 0 < spread.model_error <= 1 / 16
        assert "scalar, error" in spread._figures().rows["model"]
    # of pixels that hold nearly all energy, less than of points
    assert found[0].model_error < 0.1 * found[1].model_error


def test_spherical_waves_differ_by_the_polarisation_only():
    """They carry the cosines of the sine condition: F/1.2 to half of 1.2 %."""
    wave = wave_at(1.2)
    options = {"pitch": 0.3 * WAVELENGTH, "shape": 25, "normalisation": "ideal-peak"}
    spread = psf.point_spread(wave, model="scalar", **options)
    x, y = np.meshgrid(spread.x, spread.y)
    points = np.stack([x, y, np.full_like(x, wave.image_distance)], axis=-1).reshape(-1, 3)
    spheres, _ = spherical_waves(wave, points)
    true = np.abs(spheres.reshape(x.shape) - richards_wolf(1.2, x, y)).max()
    assert true <= spread.model_error <= 3 * true


# bad input


@pytest.mark.parametrize("options", [{}, {"model": "scalar"}, HIGH, {"method": "quadrature"}])
def test_a_pupil_wider_than_its_sphere_is_refused(options):
    with pytest.raises(SceneError, match=r"F/0.4, limit F/0.5.*use a smaller pupil"):
        psf.point_spread(wave_at(0.4), shape=33, **options)
    # a square's corners reach farther than its radius
    corner = psf.Wavefront.from_map(
        np.zeros((32, 32)), wavelength=WAVELENGTH, pupil_pitch=1e-4, image_distance=2e-3
    )
    with pytest.raises(SceneError, match=r"reaches 0.002263 m from the axis at F/0.442"):
        psf.point_spread(corner, shape=33, **options)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"model": "vector"}, r"model = 'vector'.*one of auto, scalar, high-aperture"),
        ({"polarisation": "circular"}, r"polarisation = 'circular'"),
        ({"polarisation": math.nan}, r"polarisation = nan"),
        ({"polarisation": "x", "model": "scalar"}, r"'x' with the scalar model.*use model="),
        ({"polarisation": 0.2, "method": "fft"}, r"0.2 with the scalar model.*use model="),
        ({"method": "airy", **HIGH}, r"'airy' with model = 'high-aperture'.*method='auto'"),
    ],
)
def test_options_that_contradict_are_refused(options, message):
    with pytest.raises(SceneError, match=message):
        psf.point_spread(wave_at(1), shape=33, **options)


def test_methods_and_limits_that_do_not_fit_are_refused():
    wave = wave_at(1)
    with pytest.raises(SamplingError, match=r"'mdft'.*'polar'; use method='quadrature'"):
        psf.point_spread(wave, method="mdft", shape=33, **HIGH)
    with pytest.raises(SamplingError, match=r"rays give the energy per pixel"):
        psf.point_spread(wave, method="geometric", shape=33, **HIGH)
    with pytest.raises(
        SamplingError, match=r"would take about .* s, limit max_seconds = .*model='scalar'"
    ):
        psf.point_spread(wave, shape=801, max_seconds=0.05, **HIGH)
    coarse = psf.Wavefront.from_zernike(
        {4: 1e-7},
        wavelength=WAVELENGTH,
        pupil_radius=RADIUS,
        image_distance=2 * RADIUS,
        nodes="grid",
        samples=64,
    )
    with pytest.raises(SamplingError, match=r"reaches tol = 1e-08, .*; use a tol"):
        psf.point_spread(coarse, shape=33, tol=1e-8, **HIGH)
