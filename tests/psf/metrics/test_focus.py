"""Best focus and metrics through focus, against closed forms and brute force."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from pytest import approx

from nlosoptics import psf
from nlosoptics.errors import SamplingError, SceneError
from nlosoptics.psf.wave.detilted import split

WAVELENGTH = 500e-9
#: F/200: spheres differ from paraxial ones by 1/(16 N^2), 2e-6 of the defocus.
SLOW = {"wavelength": WAVELENGTH, "pupil_radius": 0.25, "image_distance": 100.0}
#: F/10: a wave of defocus at the rim is 0.4 mm.
FAST = {"wavelength": WAVELENGTH, "pupil_radius": 5e-3, "image_distance": 0.1}
TOLERANCE = 1e-6 * 8 * WAVELENGTH  # of the search, times N^2
SPHERES = 4e-6  # relative: spheres at F/200, with a factor of two


def rho2(u, v):
    """Squared pupil coordinate of `SLOW`, 1 at the rim."""
    return (u**2 + v**2) / SLOW["pupil_radius"] ** 2


def shift_of(waves, system=SLOW):
    """Shift that adds a defocus W020, in waves: paraxial, from 1/d' = 1/d + 2 W020/a^2."""
    d, a = system["image_distance"], system["pupil_radius"]
    return 1 / (1 / d + 2 * waves * WAVELENGTH / a**2) - d


def waves_of(shift, system=SLOW):
    """Paraxial defocus W020 of a shift, in waves."""
    d, a = system["image_distance"], system["pupil_radius"]
    return (1 / (d + shift) - 1 / d) * a**2 / 2 / WAVELENGTH


def converging(focus, system=FAST, **options):
    """Wave without aberration that converges to (0, 0, focus), seen from another image plane.

    Paths from the reference sphere about (0, 0, d); the difference has rounding errors of 1e-17 m,
    which ``samples`` need not resolve.
    """
    d = system["image_distance"]

    def path(u, v):
        r2 = u * u + v * v
        depth = d - math.copysign(1.0, d) * np.sqrt(d * d - r2)
        return math.copysign(1.0, d) * (abs(focus) - np.sqrt(r2 + (focus - depth) ** 2))

    return psf.Wavefront.from_function(path, **system, **options)


OUTLINES = {
    "disc": {"samples": 24},
    "ring": {"obscuration": 0.4, "samples": 24},
    "segments": {"aperture": psf.Aperture.hexagons(1, flat_to_flat=3e-3, gap=1e-4), "samples": 12},
    "vanes": {"aperture": psf.Aperture.round(5e-3, 0.3, vanes=3, vane_width=4e-4), "samples": 12},
    "off axis": {
        "aperture": psf.Aperture.ellipse(1.5e-3, 1e-3, centre=(3e-3, -1e-3)),
        "samples": 12,
    },
    "grid": {"nodes": "grid", "samples": 128},
}


@pytest.mark.parametrize(
    ("outline", "beyond"),
    [(o, b) for o, b in zip(OUTLINES, 3 * [-1.7e-3, 0.6e-3], strict=True)],
)
def test_pure_defocus_is_found_exactly(outline, beyond):
    """A focus before and behind the image plane; the sign is that of the light's direction."""
    wave = converging(FAST["image_distance"] + beyond, **OUTLINES[outline])
    f_number = FAST["image_distance"] / (2 * split(wave).half_width)
    for criterion in ("strehl", "rms", "spot"):
        # slopes on a grid are one-sided at its rim
        error = 2e-2 * abs(beyond) if (outline, criterion) == ("grid", "spot") else 0.0
        found = psf.best_focus(wave, criterion=criterion)
        assert found == approx(beyond, abs=TOLERANCE * (2 * f_number) ** 2 + error)
    assert psf.strehl(psf.focus_shifted(wave, beyond)) == approx(1.0, abs=1e-12)


def spherical_sum(wave, points):
    """Intensity at points (n, 3) by spherical waves from the nodes on the reference sphere."""
    d = wave.image_distance
    depth = d - np.sqrt(d * d - wave.u**2 - wave.v**2)
    nodes = np.stack([wave.u, wave.v, depth], axis=-1).reshape(-1, 3)
    path = np.linalg.norm(points[:, None] - nodes, axis=2) - d + wave.aberration.ravel()
    share = (wave.amplitude * wave.weights).ravel()
    return np.abs(np.exp(2j * math.pi / WAVELENGTH * path) @ share) ** 2


@pytest.mark.parametrize("beyond", [-1.7e-3, 0.6e-3])
def test_brightest_plane_of_spherical_waves_is_the_best_focus(beyond):
    """A sum along the axis knows nothing of displaced image planes."""
    wave = converging(FAST["image_distance"] + beyond, samples=24)
    shifts = np.linspace(-2.5e-3, 2.5e-3, 101)
    points = np.stack([0 * shifts, 0 * shifts, FAST["image_distance"] + shifts], axis=1)
    bright = spherical_sum(wave, points) / points[:, 2] ** 2
    top = int(np.argmax(bright))
    a, b, c = bright[top - 1 : top + 2]
    peak = shifts[top] + (shifts[1] - shifts[0]) * (a - c) / (a - 2 * b + c) / 2
    # the parabola through three planes, and 12 z/(pi N_F)^2 = 5e-7 m toward the pupil
    assert peak == approx(beyond, abs=3e-6)
    assert psf.best_focus(wave) == approx(peak, abs=3e-6)


@pytest.mark.parametrize(("radius", "shift", "width"), [(5e-3, 5e-3, 3e-5), (25e-3, -9e-5, 5e-6)])
def test_displaced_plane_has_the_field_of_spherical_waves(radius, shift, width):
    """The same field from either reference sphere, F/10 and F/2.

    A point (u, v) lies on either sphere, z shift/d deeper on one. Its distance from the image
    changes by this part, and so do the direction of its ray and the amplitude.
    """
    wave = psf.Wavefront.from_zernike(
        {2: 8e-7, 5: 2e-7, 7: 1e-7, 11: 3e-7}, **FAST | {"pupil_radius": radius}, samples=48
    )
    rng = np.random.default_rng(3)
    points = rng.uniform(-width, width, (40, 3)) + np.array([0, 0, 0.1 + shift])
    here, there = (spherical_sum(w, points) for w in (wave, psf.focus_shifted(wave, shift)))
    part = abs(shift) * (0.1 - math.sqrt(0.01 - radius**2)) / 0.01
    phase = 2 * math.pi / WAVELENGTH * width * math.sqrt(2) * radius / 0.1 * part
    assert there == approx(here, abs=2 * (part + phase) * here.max())


def test_tilted_spot_keeps_its_direction():
    """W = a u: the spot at a d moves to a d'."""
    wave = psf.focus_shifted(psf.Wavefront.from_function(lambda u, v: 1e-4 * u, **SLOW), 0.05)
    assert psf.centroid(wave) == approx((1e-4 * 100.05, 0.0), abs=1e-12)


@pytest.mark.parametrize("waves", [-1.5, 6.0])
def test_primary_spherical_aberration(waves):
    """rho^4 + c rho^2: least variance and a Strehl ratio even about c = -1; least spot at -4/3."""
    wave = psf.Wavefront.from_function(lambda u, v: waves * WAVELENGTH * rho2(u, v) ** 2, **SLOW)
    found = waves_of(psf.best_focus(wave, criterion="rms"))
    assert found == approx(-waves, rel=SPHERES, abs=2e-6)
    if abs(waves) < 2:
        found = waves_of(psf.best_focus(wave))
    else:  # the Strehl ratio has split into two equal maxima
        with pytest.raises(SamplingError, match="strehl has two best foci"):
            psf.best_focus(wave)
        middle = shift_of(-waves)
        sides = [(0.2 * middle, middle), (middle, 1.8 * middle)]
        found = sum(waves_of(psf.best_focus(wave, limits=side)) for side in sides) / 2
    assert found == approx(-waves, rel=SPHERES, abs=2e-6)
    # Rays x = x0 + s m of slopes m = (x0 - p)/d: least <x^2> at s = -<x0 m>/<m^2>.
    d, a = SLOW["image_distance"], SLOW["pupil_radius"]
    g, p = 4 * waves * WAVELENGTH / a, a / d  # x0 = d g rho^3, m = g rho^3 - p rho
    exact = -d * (g * g / 4 - g * p / 3) / (g * g / 4 - 2 * g * p / 3 + p * p / 2)
    found = psf.best_focus(wave, criterion="spot")
    assert found == approx(exact, rel=SPHERES)
    assert waves_of(found) == approx(-4 / 3 * waves, rel=4 * abs(g / p))


def test_marginal_and_paraxial_foci():
    """rho^4 alone is in focus at the centre, rho^4 - 2 rho^2 at the rim."""
    wave = psf.Wavefront.from_function(lambda u, v: 3 * WAVELENGTH * rho2(u, v) ** 2, **SLOW)
    marginal = psf.focus_shifted(wave, shift_of(-6.0))
    rim = {name: split(w).rays.x[-1] for name, w in (("par", wave), ("mar", marginal))}
    far = 4 * 3 * WAVELENGTH * 400  # d times the slope 12 waves/a
    assert np.abs(rim["par"]).max() == approx(far, rel=1e-9)
    assert np.abs(rim["mar"]).max() < SPHERES * far
    r = np.hypot(wave.u[0, 0], wave.v[0, 0]) / SLOW["pupil_radius"]
    assert np.abs(split(wave).rays.x[0]).max() == approx(far * r**3, rel=1e-9)


@pytest.mark.parametrize("hole", [0.0, 0.3, 0.8])
def test_spherical_aberration_of_a_ring(hole):
    """Least variance of (q^2 + c q), q from e^2 to 1: c = -(1 + e^2)."""
    wave = psf.Wavefront.from_function(
        lambda u, v: 0.7 * WAVELENGTH * rho2(u, v) ** 2, obscuration=hole, **SLOW
    )
    for criterion in ("rms", "strehl"):
        found = waves_of(psf.best_focus(wave, criterion=criterion))
        assert found == approx(-(1 + hole**2) * 0.7, rel=2 * SPHERES, abs=1e-5)


def test_strehl_through_defocus_is_sinc_squared():
    wave = psf.Wavefront.from_zernike({}, **SLOW)
    waves = np.linspace(-3, 3, 31)
    found = psf.through_focus(wave, shift_of(waves))
    assert found.values == approx(np.sinc(waves) ** 2, abs=3 * SPHERES)
    assert found.f_number == 200.0
    rms = psf.through_focus(wave, shift_of(waves), criterion="rms").values
    assert rms == approx(np.abs(waves) * WAVELENGTH / math.sqrt(12), rel=SPHERES, abs=1e-20)


def test_odd_aberrations_are_even_through_focus():
    """W(-p) = -W(p) turns the sum of one side into the conjugate of the other's."""
    odd = {j: c * WAVELENGTH for j, c in {7: 0.11, 8: -0.2, 9: 0.15, 10: 0.1, 16: 0.07}.items()}
    wave = psf.Wavefront.from_zernike(odd, **SLOW)
    waves = np.linspace(0.1, 2.5, 13)
    for criterion in ("strehl", "rms"):
        near, far = (
            psf.through_focus(wave, shift_of(side * waves), criterion=criterion).values
            for side in (1, -1)
        )
        scale = 1.0 if criterion == "strehl" else WAVELENGTH
        assert near == approx(far, abs=3 * SPHERES * scale)
    assert psf.best_focus(wave, criterion="rms") == approx(0.0, abs=shift_of(-1e-5))


def random_wave(seed, outline="disc", waves=0.35):
    """Noll 2 to 22 at random, more of the low ones; segments move too."""
    rng = np.random.default_rng(seed)
    terms = {j: waves * WAVELENGTH * rng.normal() / math.sqrt(j - 1) for j in range(2, 23)}
    options = OUTLINES[outline]
    wave = psf.Wavefront.from_zernike(terms, **FAST, **options)
    if outline == "segments":
        moved = psf.Wavefront.from_function(
            pistons=rng.normal(0, 5e-8, 7), tilts=rng.normal(0, 5e-5, (7, 2)), **FAST, **options
        )
        assert moved.u.shape == wave.u.shape
        wave = replace(wave, aberration=wave.aberration + moved.aberration)
    return wave


def plain_scan(wave, shifts):
    """Strehl ratios by sums over many nodes: Fresnel's parabola, and tilt by plain projection."""
    if wave.is_spectral:
        wave = wave.resampled(48, 192 if wave.layout == "polar" else 48)
    share = (wave.amplitude * wave.weights).ravel()
    root = np.sqrt(share / share.sum())
    parabola = (wave.u**2 + wave.v**2).ravel() / 2
    columns = np.stack([np.ones(root.size), wave.u.ravel(), wave.v.ravel()], axis=1)
    basis = np.linalg.qr(columns * root[:, None])[0]
    path, parabola = (root * t for t in (wave.aberration.ravel(), parabola))
    path, parabola = ((t - basis @ (basis.T @ t)) for t in (path, parabola))
    lit = root > 0
    path, parabola, root = path[lit] / root[lit], parabola[lit] / root[lit], root[lit]
    k, d = 2 * math.pi / wave.wavelength, wave.image_distance
    bends = [1 / (d + shift) - 1 / d for shift in shifts.tolist()]
    return np.array(
        [abs(np.sum(root**2 * np.exp(1j * k * (path + c * parabola)))) ** 2 for c in bends]
    )


@pytest.mark.thorough
@pytest.mark.parametrize("outline", OUTLINES)
@pytest.mark.parametrize("seed", [101])
def test_best_focus_of_random_waves_is_that_of_a_dense_scan(outline, seed):
    """Twenty planes for each wave of defocus, out to eight waves."""
    wave = random_wave(seed, outline, waves=0.15 if outline == "grid" else 0.35)
    found = psf.best_focus(wave)
    best = psf.through_focus(wave, [found]).values[0]
    reach = 64 * WAVELENGTH * (FAST["image_distance"] / (2 * split(wave).half_width)) ** 2
    shifts = np.linspace(-1, 1, 321) * reach
    scan = plain_scan(wave, shifts)
    # spheres at F/10: 1/(16 N^2) of a defocus of some waves
    assert best > scan.max() - 2e-3
    assert abs(found - shifts[np.argmax(scan)]) < reach / 160 + 5e-3 * abs(found)


@pytest.mark.thorough
@pytest.mark.parametrize("seed", [11])
def test_least_rms_and_spot_of_random_waves(seed):
    wave = random_wave(seed, "ring", waves=1.0)
    shifts = np.linspace(-1, 1, 601) * 6e-3
    for criterion in ("rms", "spot"):
        scan = psf.through_focus(wave, shifts, criterion=criterion).values
        found = psf.best_focus(wave, criterion=criterion)
        assert abs(found - shifts[np.argmin(scan)]) <= 1e-5 + 1e-12  # half a step
        assert psf.through_focus(wave, [found], criterion=criterion).values[0] <= scan.min()


def plain_mtf(wave, shift, frequency, azimuth, pupil, samples=240):
    """Overlap of two displaced pupils, by their cells' centres. ``pupil`` is (inside, W)."""
    inside, surface = pupil
    d, a = wave.image_distance, wave.pupil_radius
    axis = (np.arange(samples) + 0.5) * 2 * a / samples - a
    u, v = np.meshgrid(axis, axis)
    move = wave.wavelength * (d + shift) * frequency / 2
    total, power = 0j, float(inside(u, v).sum())
    pair = []
    for side in (1, -1):
        x, y = u + side * move * math.cos(azimuth), v + side * move * math.sin(azimuth)
        path = surface(x, y) + (1 / (d + shift) - 1 / d) * (x**2 + y**2) / 2
        pair.append(inside(x, y) * np.exp(2j * math.pi * path / wave.wavelength))
    total = np.sum(pair[0] * np.conj(pair[1]))
    return abs(total) / power


@pytest.mark.thorough
@pytest.mark.parametrize(("hole", "share"), [(0.0, 0.5), (0.35, 0.15)])
def test_best_mtf_is_that_of_a_dense_scan(hole, share):
    """Astigmatism, coma and spherical aberration, along a direction between the axes."""
    a, azimuth = FAST["pupil_radius"], 0.4
    frequency = share / (WAVELENGTH * 10)

    def surface(u, v):
        x, y = u / a, v / a
        r2 = x * x + y * y
        return WAVELENGTH * (0.6 * r2**2 + 0.5 * x * y + 0.4 * y * r2 + 0.3 * r2)

    wave = psf.Wavefront.from_function(surface, obscuration=hole, **FAST)
    pupil = (lambda u, v: (np.hypot(u, v) <= a) & (np.hypot(u, v) >= hole * a)), surface
    options = {"criterion": "mtf", "frequency": frequency, "azimuth": azimuth}
    found = psf.best_focus(wave, **options)
    shifts = np.linspace(-1.2e-3, 1.8e-3, 61)
    scan = [plain_mtf(wave, s, frequency, azimuth, pupil) for s in shifts.tolist()]
    # square cells of 1/240 of the pupil at its rims, and the window's share of a hard rim's tails
    value = psf.through_focus(wave, [found], **options).values[0]
    assert value == approx(max(scan), abs=5e-3)
    assert abs(found - shifts[np.argmax(scan)]) < 5e-5 + 5e-3 * abs(found)


@pytest.mark.thorough
@pytest.mark.parametrize("outline", ["ring", "grid", "segments"])
def test_mtf_by_an_image_is_that_of_the_pupil(outline):
    """Of a disc both are known; here its outline and layout hide that it is one."""
    terms = {4: 1e-7, 8: 5e-8}
    disc = psf.Wavefront.from_zernike(terms, **FAST)
    hidden = {
        "ring": {"obscuration": 1e-3},
        "grid": {"nodes": "grid", "samples": 256},
        "segments": {"aperture": psf.Aperture.round(FAST["pupil_radius"])},
    }[outline]
    wave = psf.Wavefront.from_zernike(terms, **FAST, **hidden)
    shifts = [-3e-4, 0.0, 2e-4]
    for frequency in (2e4, 1e5, 1.7e5):
        options = {"criterion": "mtf", "frequency": frequency}
        expected = psf.through_focus(disc, shifts, **options).values
        found = psf.through_focus(wave, shifts, **options).values
        assert found == approx(expected, abs=1e-3)  # tails outside the window; cells of the grid


def test_any_function_of_a_wave_is_a_criterion():
    """Encircled energy about the axis; it is best where the wave converges."""

    def within(wave):
        return float(psf.encircled_energy(wave, 4e-6))

    wave = converging(0.1005, samples=24)
    found = psf.best_focus(wave, criterion=within, limits=(0.3e-3, 0.6e-3))
    assert found == approx(0.5e-3, abs=1e-6)  # even about focus up to the growth of the spot
    assert psf.through_focus(wave, [found], criterion=within).criterion == "within"


@pytest.mark.thorough
def test_line_foci_of_astigmatism_are_equal_until_limits_choose():
    """x^2 - y^2: turned by a right angle, one side of focus is the other."""
    wave = psf.Wavefront.from_function(
        lambda u, v: 2 * WAVELENGTH * (u**2 - v**2) / SLOW["pupil_radius"] ** 2, **SLOW
    )
    with pytest.raises(SamplingError, match="strehl has two best foci"):
        psf.best_focus(wave)
    near, far = (
        waves_of(psf.best_focus(wave, limits=tuple(sorted((0.0, shift_of(side * 4.0))))))
        for side in (1, -1)
    )
    assert near == approx(-far, rel=1e-4)
    assert 1.0 < near < 2.0  # toward a line focus, at 2
    assert waves_of(psf.best_focus(wave, criterion="rms")) == approx(0.0, abs=1e-4)
    # along x the line at W020 = -2 is sharp
    sharp = psf.best_focus(wave, criterion="mtf", frequency=2e3)
    assert waves_of(sharp) == approx(-2.0, rel=2e-3)  # the cutoff moves with the plane
    assert waves_of(
        psf.best_focus(wave, criterion="mtf", frequency=2e3, azimuth=math.pi / 2)
    ) == approx(2.0, rel=2e-3)


@pytest.mark.parametrize(
    ("options", "error", "words"),
    [
        ({"criterion": "sharp"}, SceneError, "one of strehl, rms, spot, mtf"),
        ({"criterion": "mtf"}, SceneError, "frequency is missing"),
        ({"frequency": 1e4}, SceneError, "without criterion='mtf'"),
        ({"criterion": "mtf", "frequency": 3e5}, SamplingError, "mtf changes by less than 0.0001"),
        ({"limits": (0.3e-3, 0.9e-3)}, SamplingError, "edge of the search from shift = 0.0003 m"),
        ({"limits": (-0.2, 1e-3)}, SceneError, "on its side of the pupil"),
        ({"limits": (-0.05, 0.05)}, SamplingError, "image planes from shift = -0.05 m .* limit"),
    ],
)
def test_what_has_no_best_focus_is_refused(options, error, words):
    wave = psf.Wavefront.from_zernike({4: 1e-7}, **FAST)
    with pytest.raises(error, match=words):
        psf.best_focus(wave, **options)


def test_too_few_nodes_and_no_focus_are_refused():
    coarse = psf.Wavefront.from_zernike({}, nodes="grid", samples=32, **FAST)
    with pytest.raises(SamplingError, match="waves between neighbours in the image plane at 0.11"):
        psf.through_focus(coarse, [0.01])
    assert psf.best_focus(coarse) == approx(0.0, abs=1e-9)
    rough = np.random.default_rng(1).normal(0, 2e-7, (32, 32))
    with pytest.raises(SamplingError, match="limits nearer to focus, or more pupil samples"):
        psf.best_focus(replace(coarse, aberration=rough))
    with pytest.raises(SceneError, match="leaves no focus on the side of the image plane"):
        psf.best_focus(psf.Wavefront.from_zernike({4: -2e-3}, **(FAST | {"image_distance": -0.01})))
    with pytest.raises(SceneError, match="on one side of it; give a smaller shift"):
        psf.focus_shifted(coarse, -0.1)
    with pytest.raises(SceneError, match=r"shifts have shape \(\)"):
        psf.through_focus(coarse, 0.0)
