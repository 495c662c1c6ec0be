"""Spherical waves against sums in extended precision, closed forms and the other transforms."""

import math
from dataclasses import replace

import numpy as np
import pytest
from mpmath import mp, mpf
from pytest import approx

from nlosoptics import psf
from nlosoptics.errors import SamplingError, SceneError

WAVELENGTH, RADIUS = 632.8e-9, 12.5e-3


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


def plane(wave, reach, count, slope=0.0, lift=0.0):
    """Points over +-reach lambda N of a plane through the image, tilted by ``slope`` along x."""
    axis = np.linspace(-reach, reach, count) * WAVELENGTH * wave.f_number
    x, y = np.meshgrid(axis, axis)
    return np.stack([x, y, wave.image_distance + lift + slope * x], axis=-1)


def extended_intensity(nodes, distance, point, pupil="plane"):
    """The integral as it is written, 40 digits, over nodes (u, v, W, A w); 1 at the ideal peak."""
    x, y, z = (mpf(float(c)) for c in point)
    d, k = mpf(distance), 2 * mp.pi / mpf(WAVELENGTH)
    total, peak = mp.mpc(0), mpf(0)
    for u, v, path, size in nodes:
        u, v = mpf(float(u)), mpf(float(v))
        if pupil == "plane":
            w, normal, area = mpf(0), (mpf(0), mpf(0), mp.sign(d)), mpf(1)
        else:
            w = d - mp.sign(d) * mp.sqrt(d * d - u * u - v * v)
            normal = (-u / abs(d), -v / abs(d), (d - w) / abs(d))
            area = abs(d) / abs(d - w)
        to_c = (-u, -v, d - w)
        c = mp.sqrt(sum(t * t for t in to_c))
        to_x = (x - u, y - v, z - w)
        r = mp.sqrt(sum(t * t for t in to_x))
        # A^2 is what passes per area of u and v: E^2 area cos(normal, ray)
        cosine = sum(a * b for a, b in zip(normal, to_c, strict=True)) / c
        e = mpf(float(size)) * area / mp.sqrt(area * cosine)
        slant = sum(a * b for a, b in zip(normal, to_x, strict=True)) / r
        total += e * slant / r * mp.expj(k * (mpf(float(path)) + mp.sign(d) * (r - c)))
        peak += e * cosine / c
    return float(abs(total / peak) ** 2)


@pytest.mark.parametrize("pupil", ["plane", "sphere"])
@pytest.mark.parametrize("distance", [50e-3, -50e-3])
def test_a_map_is_the_sum_in_extended_precision(distance, pupil):
    rng = np.random.default_rng(7)
    n, pitch = 12, 2e-3
    wave = psf.Wavefront.from_map(
        rng.uniform(0, 0.3, (n, n)) * WAVELENGTH,
        rng.uniform(0, 1, (n, n)),
        wavelength=WAVELENGTH,
        pupil_pitch=pitch,
        image_distance=distance,
    )
    points = plane(wave, 2, 3, slope=0.4)
    found = psf.huygens_point_spread(wave, points, pupil=pupil)
    size = (wave.amplitude * wave.weights).ravel()
    nodes = list(zip(wave.u.ravel(), wave.v.ravel(), wave.aberration.ravel(), size, strict=True))
    with mp.workdps(40):
        expected = [extended_intensity(nodes, distance, p, pupil) for p in points.reshape(-1, 3)]
    # the tilt, some waves, is taken out and put back: 1e-16 of it, times k
    assert found.intensity.ravel() == approx(expected, rel=0, abs=1e-12 * max(expected))
    assert found.error_estimate < 1e-11


@pytest.mark.parametrize("slope", [0.0, 0.5, -1.0])
def test_fast_beam_on_a_tilted_plane(slope):
    """F/2 with coma: other nodes than the library's, in extended precision."""
    waves = {4: 0.2, 8: 0.3}
    wave = wave_at(2, waves)
    points = plane(wave, 3, 2, slope=slope).reshape(-1, 3)[1:]
    x, gauss = np.polynomial.legendre.leggauss(22)
    rho = np.sqrt((1 + x) / 2)[:, None]
    theta = 2 * np.pi * (np.arange(72) + 0.3) / 72 + 0 * rho
    path = sum(w * WAVELENGTH * psf.zernike(j, rho + 0 * theta, theta) for j, w in waves.items())
    size = gauss[:, None] + 0 * theta
    u, v = RADIUS * rho * np.cos(theta), RADIUS * rho * np.sin(theta)
    nodes = list(zip(*(a.ravel() for a in (u, v, path, size)), strict=True))
    with mp.workdps(30):
        expected = [extended_intensity(nodes, wave.image_distance, p) for p in points]
    found = psf.huygens_point_spread(wave, points, pupil="plane")
    # both rules have converged
    assert found.intensity == approx(expected, rel=0, abs=1e-9)
    assert found.error_estimate < 1e-10


def test_focal_line_at_f2_is_the_axial_integral():
    """On the axis the integral over r is one of the distance, done by other means."""
    wave = wave_at(2)
    d = wave.image_distance
    lifts = np.array([-30e-6, -11e-6, 0.0, 7e-6, 30e-6])
    points = np.stack([0 * lifts, 0 * lifts, d + lifts], axis=1)
    found = psf.huygens_point_spread(wave, points, pupil="plane")
    k = 2 * np.pi / WAVELENGTH
    x, gauss = np.polynomial.legendre.leggauss(400)
    square = RADIUS**2 * (1 + x) / 2
    c = np.sqrt(square + d * d)
    peak = np.sum(gauss * np.sqrt(c) * d / c**2)
    for lift, value in zip(lifts, found.intensity, strict=True):
        r = np.sqrt(square + (d + lift) ** 2)
        field = np.sum(gauss * np.sqrt(c) * (d + lift) / r**2 * np.exp(1j * k * (r - c)))
        # phases of some 1e5 rad here, which keep 1e-11
        assert value == approx(abs(field / peak) ** 2, abs=1e-9)
    # paraxially sin^2(q)/q^2 with q = pi dz/(8 lambda N^2); F/2 is a little deeper than that
    q = np.pi * 11e-6 / (8 * WAVELENGTH * 4)
    assert found.intensity[1] == approx((np.sin(q) / q) ** 2, abs=0.05)


def test_spot_on_a_tilted_plane_is_defocused_by_its_height():
    """A tilt W = a u puts the spot at x = a d, where the plane has left the focus by x tan."""
    wave = wave_at(40, {2: 10.0})
    x = 2 * 10 * WAVELENGTH / RADIUS * wave.image_distance
    slope = 8 * WAVELENGTH * 40**2 * 0.5 / x  # q = pi/2
    flat, tilted = (
        psf.huygens_point_spread(wave, [[x, 0.0, wave.image_distance + s * x]])
        for s in (0.0, slope)
    )
    # cos and tan of the oblique ray, and of F/40: 1e-3
    assert flat.intensity[0] == approx(1, abs=2e-3)
    # out of focus the oblique beam moves on by x/d per metre: followed to its axis
    moved = psf.huygens_point_spread(
        wave, [[x * (1 + slope * x / wave.image_distance), 0.0, wave.image_distance + slope * x]]
    )
    assert moved.intensity[0] == approx((2 / np.pi) ** 2, rel=0.02)
    assert tilted.intensity[0] < 0.6


def test_slow_beams_are_fraunhofers():
    """Against quadrature: 1e-6 at F/100 from the sphere, and 1/N^2 from either."""
    worst = {"plane": [], "sphere": []}
    for f_number in (25, 50, 100):
        wave = wave_at(f_number)
        unit = WAVELENGTH * f_number
        flat = psf.point_spread(
            wave, method="quadrature", pitch=unit / 3, shape=61, normalisation="ideal-peak"
        )
        y, x = np.meshgrid(flat.y, flat.x, indexing="ij")
        points = np.stack([x, y, np.full_like(x, wave.image_distance)], axis=-1)
        for pupil, errors in worst.items():
            found = psf.huygens_point_spread(wave, points, pupil=pupil)
            errors.append(np.abs(found.intensity - flat.intensity).max())
    assert worst["sphere"][-1] < 1e-6
    # the plane has tan for sin: a scale of 1/(8 N^2), on a slope of 0.7 at most
    assert worst["plane"][-1] < 1e-5
    for errors in worst.values():
        assert errors[0] / errors[1] == approx(4, rel=0.02)
        assert errors[1] / errors[2] == approx(4, rel=0.02)


def fraunhofer_twin(wave, waves, pupil):
    """The wave on direction sines whose Fraunhofer image is the spherical waves' one.

    On the sphere (u, v) are sines, and the field is A/cos^(1/2) on each du dv. On the plane they
    are tangents: u = s/cos, du dv = ds dt/cos^4, and A cos^(3/2) makes it A cos^(-5/2) on ds dt.
    """
    d = wave.image_distance
    sine = RADIUS if pupil == "sphere" else RADIUS / math.hypot(1, RADIUS / d)
    s, t, weights = psf.polar_nodes(sine, 40, 144)
    cosine = np.sqrt(1 - (s * s + t * t) / d**2)
    u, v = (s, t) if pupil == "sphere" else (s / cosine, t / cosine)
    path = np.zeros_like(s)
    for j, w in waves.items():
        path += w * WAVELENGTH * psf.zernike(j, np.hypot(u, v) / RADIUS, np.arctan2(v, u))
    return replace(
        wave,
        u=s,
        v=t,
        weights=weights,
        pupil_radius=sine,
        aberration=path,
        amplitude=cosine ** (-0.5 if pupil == "sphere" else -2.5),
    )


@pytest.mark.parametrize("pupil", ["plane", "sphere"])
@pytest.mark.parametrize("waves", [{}, {8: 0.2}, {8: 0.6}, {6: 0.2, 7: -0.3, 11: 0.1}], ids=str)
def test_cosines_are_all_that_parts_slow_beams_from_fraunhofers(waves, pupil):
    """1/N^2 apart as the waves are written; in sines, with the cosines' powers, by lambda/a."""
    apart = []
    for f_number in (50, 100, 200):
        wave = wave_at(f_number, waves)
        options = {
            "method": "quadrature",
            "pitch": WAVELENGTH * f_number / 3,
            "shape": 145,  # holds the rays of 0.6 waves of coma
            "tol": 1e-12,
            "normalisation": "ideal-peak",
        }
        flat = psf.point_spread(wave, **options)
        middle = slice(52, 93)
        y, x = np.meshgrid(flat.y[middle], flat.x[middle], indexing="ij")
        points = np.stack([x, y, np.full_like(x, wave.image_distance)], axis=-1)
        found = psf.huygens_point_spread(wave, points, pupil=pupil).intensity
        apart.append(np.abs(found - flat.intensity[middle, middle]).max())
        twin = psf.point_spread(fraunhofer_twin(wave, waves, pupil), **options)
        # left is a phase of about (lambda/d) (x rho/(lambda N))^2, some 1e-4 where I is 1e-3 at
        # N = 50, and less by (lambda/a)^2 at any N
        assert np.abs(found - twin.intensity[middle, middle]).max() < 5e-6 / f_number
    # what is left, on 6e-8 at least of what falls
    assert apart[0] / apart[1] == approx(4, rel=0.05)
    assert apart[1] / apart[2] == approx(4, rel=0.1)
    if pupil == "sphere":
        # |dU| <= mean |rho^2 - 1/2|/(16 N^2) = 1/(64 N^2), |dI| <= 2 |dU|
        assert apart[1] < min(1e-6, 1 / (32 * 100**2))


def test_method_and_function_agree_on_a_surface():
    wave = wave_at(4, {8: 0.2})
    unit = WAVELENGTH * 4

    def bowl(x, y):
        return 40 * (x * x + y * y) + 0.1 * x

    kwargs = {"pitch": unit / 3, "shape": (9, 12)}
    spread = psf.point_spread(
        wave, method="huygens", image_surface=bowl, normalisation="ideal-peak", **kwargs
    )
    y, x = np.meshgrid(spread.y, spread.x, indexing="ij")
    points = np.stack([x, y, wave.image_distance + bowl(x, y)], axis=-1)
    found = psf.huygens_point_spread(wave, points)
    assert spread.intensity == approx(found.intensity, rel=1e-13)
    assert spread.method == "huygens"
    energy = psf.point_spread(wave, method="huygens", image_surface=bowl, **kwargs)
    density = psf.huygens_point_spread(wave, points, normalisation="irradiance")
    assert energy.intensity == approx(density.intensity * (unit / 3) ** 2, rel=1e-12)
    assert energy.enclosed_energy == approx(energy.intensity.sum(), rel=1e-12)
    # a defocus of the surface is a defocus of the wave, paraxially
    defocused = psf.point_spread(
        wave, method="huygens", image_surface=lambda x, y: np.full_like(x, 30e-6), **kwargs
    )
    assert np.abs(defocused.intensity - energy.intensity).max() > 0.1 * energy.intensity.max()


@pytest.mark.parametrize("f_number", [3, 10])
def test_energy_of_the_focal_plane(f_number):
    """The share within a window, against the Airy disc's."""
    wave = wave_at(f_number)
    spread = psf.point_spread(wave, method="huygens", pitch=WAVELENGTH * f_number / 3, shape=61)
    flat = psf.point_spread(wave, method="quadrature", pitch=spread.pitch, shape=61)
    # |U|^2 is the flux but for the rays' cosine, cos of at most atan(1/(2 N)) on average
    assert spread.enclosed_energy == approx(flat.enclosed_energy, rel=0.3 / f_number**2)


def test_error_of_other_layouts_is_bounded():
    exact = wave_at(4, {8: 0.2})
    grid = wave_at(4, {8: 0.2}, nodes="grid", samples=96)
    i = np.arange(3000) + 0.5
    r, angle = RADIUS * np.sqrt(i / 3000), i * np.pi * (3 - np.sqrt(5))
    u, v = r * np.cos(angle), r * np.sin(angle)
    scattered = replace(
        exact,
        layout="scattered",
        u=u,
        v=v,
        aberration=0.2 * WAVELENGTH * psf.zernike(8, r / RADIUS, angle),
        amplitude=np.ones_like(u),
        weights=np.full_like(u, np.pi * RADIUS**2 / 3000),
    )
    points = plane(exact, 4, 15, slope=0.3)
    truth = psf.huygens_point_spread(exact, points)
    assert truth.error_estimate < 1e-10
    for wave in (grid, scattered):
        found = psf.huygens_point_spread(wave, points)
        error = np.abs(found.intensity - truth.intensity).max() / truth.intensity.max()
        assert 1e-6 < error <= found.error_estimate < 0.05


def test_same_bits_for_any_thread_count(on_threads):
    wave = wave_at(3, {7: 0.3})
    points = plane(wave, 5, 17, slope=0.2)
    one, two = (on_threads(n, lambda: psf.huygens_point_spread(wave, points)) for n in (1, 2))
    assert one.intensity.tobytes() == two.intensity.tobytes()


def test_what_is_refused():
    wave = wave_at(4)
    with pytest.raises(SceneError, match="image_surface with method = 'mdft'"):
        psf.point_spread(wave, method="mdft", image_surface=lambda x, y: x)
    with pytest.raises(SceneError, match="image_surface without a shape"):
        psf.point_spread(wave, method="huygens", image_surface=lambda x, y: x)
    with pytest.raises(SamplingError, match="use pixel_integrated=False"):
        psf.point_spread(wave, method="huygens", pitch=1e-5, shape=5, pixel_integrated=True)
    with pytest.raises(SceneError, match="not beyond the pupil"):
        psf.huygens_point_spread(wave, [[0.0, 0.0, -0.1]])
    with pytest.raises(SceneError, match="NaN or infinity"):
        psf.huygens_point_spread(wave, [[0.0, math.nan, 0.1]])
    with pytest.raises(SceneError, match=r"give \(\.\.\., 3\)"):
        psf.huygens_point_spread(wave, [[0.0, 0.1]])
    with pytest.raises(SceneError, match="wider than its sphere"):
        psf.huygens_point_spread(wave_at(0.4), [[0.0, 0.0, 0.01]], pupil="sphere")
    coarse = wave_at(4, nodes="grid", samples=16)
    with pytest.raises(SamplingError, match="nodes repeat the spot there"):
        psf.huygens_point_spread(coarse, plane(coarse, 20, 3))
    steep = wave_at(4, {4: 3.0}, nodes="grid", samples=32)
    with pytest.raises(SamplingError, match="aberration jumps"):
        psf.huygens_point_spread(steep, plane(steep, 2, 3))
