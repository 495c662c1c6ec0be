"""Propagation of sampled fields against closed forms, and against sums in the frequency domain."""

import math

import numpy as np
import pytest
from pytest import approx
from scipy.special import fresnel, j0

from nlosoptics import psf
from nlosoptics.errors import MemoryLimitError, SamplingError, SceneError
from nlosoptics.psf.propagation import propagate

WAVELENGTH = 500e-9
WAIST = 0.2e-3
RAYLEIGH = math.pi * WAIST**2 / WAVELENGTH
FRESNEL = ("fresnel_transfer", "fresnel_chirp_z")
TRANSFER = ("angular_spectrum", "fresnel_transfer")
METHODS = (*TRANSFER, "fresnel_chirp_z", "fresnel_one_step")


def gaussian(x, y, z=0.0, waist=WAIST):
    """Gaussian beam with its waist at z = 0 and phase exp(+ikz) (Siegman, Lasers, ch. 17)."""
    range_ = math.pi * waist**2 / WAVELENGTH
    q = z - 1j * range_
    turns = math.fmod(z / WAVELENGTH, 1.0)
    curved = np.exp(1j * math.pi * (x**2 + y**2) / (WAVELENGTH * q))
    return -1j * range_ / q * curved * np.exp(2j * math.pi * turns)


def beam(pitch=20e-6, shape=128, **options):
    return psf.ScalarField.from_function(
        gaussian, pitch=pitch, shape=shape, wavelength=WAVELENGTH, **options
    )


def field_of(samples, pitch, **options):
    return psf.ScalarField(samples=samples, pitch=pitch, wavelength=WAVELENGTH, **options)


def difference(one, other):
    """Relative rms difference of two arrays, the second being the reference."""
    return float(np.linalg.norm(one - other) / np.linalg.norm(other))


def truth(field, z, x, y, *, paraxial=False):
    """Band-limited wave of the samples, propagated by Gauss-Legendre quadrature over the band."""
    dx = field.pitch
    turns = abs(z) * WAVELENGTH / (2 * dx) + max(np.abs(x).max(), np.abs(y).max())
    nodes, weights = np.polynomial.legendre.leggauss(int(300 + 8 * turns / dx))
    f, weights = nodes / (2 * dx), weights / (2 * dx)
    to_f = [np.exp(-2j * math.pi * np.outer(f, axis)) * dx for axis in (field.y, field.x)]
    square = WAVELENGTH**2 * (f[:, None] ** 2 + f**2)
    path = -square / 2 if paraxial else np.sqrt(1 - square + 0j) - 1
    turned = np.exp(2j * math.pi * abs(z) / WAVELENGTH * path)
    waves = to_f[0] @ field.samples @ to_f[1].T * (turned if z > 0 else turned.conj())
    back = [np.exp(2j * math.pi * np.outer(axis, f)) * weights for axis in (y, x)]
    phase = np.exp(2j * math.pi * math.fmod(z / WAVELENGTH, 1.0))
    return back[0] @ waves @ back[1].T * phase


@pytest.mark.parametrize("method", FRESNEL)
@pytest.mark.parametrize("ranges", [0.5, 1.0, 3.0, -1.5])
def test_gaussian_beam(method, ranges):
    """Amplitude, width, curvature and Gouy phase, to another pitch."""
    z = ranges * RAYLEIGH
    found = psf.propagate(beam(), z, method=method, pitch=31e-6, shape=(96, 81), tol=1e-2)
    x, y = found.x[None, :], found.y[:, None]
    # the beam falls to 1e-18 at the border and the band's edge; left is the soft limit's 1e-11
    assert difference(found.samples, gaussian(x, y, z)) < 1e-10
    centre = found.samples[48, 40] * np.exp(-2j * math.pi * math.fmod(z / WAVELENGTH, 1.0))
    assert np.angle(centre) == approx(-math.atan(ranges), abs=1e-10)
    # a second difference of phases enlarges 1e-11 by the ratio to one pitch's phase
    phases = np.unwrap(np.angle(found.samples[48]))
    curvature = (phases[41] - 2 * phases[40] + phases[39]) / found.pitch**2
    radius = z * (1 + ranges**-2)
    assert curvature == approx(2 * math.pi / (WAVELENGTH * radius), rel=1e-8)


def test_beam_width_of_all_orders_of_distance():
    """Second moments over a window that holds the beam, near and far."""
    for ranges in (1e-3, 0.1, 1.0, 30.0):
        width = WAIST * math.hypot(1, ranges)
        found = psf.propagate(beam(), ranges * RAYLEIGH, pitch=width / 10, shape=128)
        moment = np.sum(found.x**2 * found.intensity.sum(axis=0)) / found.intensity.sum()
        # the exact kernel widens the beam by order (wavelength/waist)^2 = 6e-6
        assert 2 * math.sqrt(moment) == approx(width, rel=1e-5)


@pytest.mark.parametrize("method", TRANSFER)
def test_plane_wave_gains_the_phase_of_its_angle(method):
    """One period of a tilted plane wave; the sum over its single frequency is exact."""
    tilted = psf.ScalarField.from_function(
        lambda x, y: np.exp(2j * math.pi * (3 * x - 5 * y) / 320e-6),
        pitch=10e-6,
        shape=32,
        wavelength=WAVELENGTH,
        periodic=True,
    )
    found = psf.propagate(tilted, 0.02, method=method, tol=1e-2)
    square = 34 * (WAVELENGTH / 320e-6) ** 2
    path = -square / 2 if method == "fresnel_transfer" else math.sqrt(1 - square) - 1
    turns = math.fmod(0.02 / WAVELENGTH, 1.0) + 0.02 / WAVELENGTH * path
    # phases of 1 rad times rounding; sqrt(1 - square) here loses 1e-16 x 4e4 turns
    assert difference(found.samples, tilted.samples * np.exp(2j * math.pi * turns)) < 1e-10


def test_evanescent_wave_decays():
    """A period below the wavelength, both ways."""
    period = 0.4e-6
    fine = psf.ScalarField.from_function(
        lambda x, y: np.cos(2 * math.pi * x / period) + 0 * y,
        pitch=period / 8,
        shape=8,
        wavelength=WAVELENGTH,
        periodic=True,
    )
    decay = math.exp(-2 * math.pi * 1e-6 * math.sqrt(period**-2 - WAVELENGTH**-2))
    for distance in (1e-6, -1e-6):
        found = psf.propagate(fine, distance)
        assert difference(np.abs(found.samples), decay * np.abs(fine.samples)) < 1e-12  # rounding


def test_talbot_images():
    """A grating repeats after 2 period^2/wavelength, and is shifted after half of that."""
    period = 160e-6
    grating = psf.ScalarField.from_function(
        lambda x, y: (np.sin(2 * math.pi * (x + 1e-6) / period) > 0.3) * np.ones_like(y),
        pitch=10e-6,
        shape=32,
        wavelength=WAVELENGTH,
        periodic=True,
    )
    talbot = 2 * period**2 / WAVELENGTH
    for part, shift in ((1.0, 0), (0.5, 8), (-1.0, 0)):
        found = psf.propagate(grating, part * talbot, method="fresnel_transfer")
        phase = np.exp(2j * math.pi * math.fmod(part * talbot / WAVELENGTH, 1.0))
        expected = np.roll(grating.samples, shift, axis=1) * phase
        # periodic sums are exact: rounding of phases of 64 pi
        assert difference(found.samples, expected) < 1e-12


def rectangle_diffraction(x, y, half_x, half_y, z):
    """Fresnel integrals of a rectangle (Goodman, Fourier Optics, sec. 4.5.1)."""

    def along(t, half):
        ends = [math.sqrt(2 / (WAVELENGTH * z)) * (s * half - t) for s in (1, -1)]
        (s1, c1), (s0, c0) = (fresnel(end) for end in ends)
        return (c1 - c0) + 1j * (s1 - s0)

    return along(x, half_x) * along(y, half_y) / 2j


def test_fresnel_edges():
    """Edges halfway between samples: errors within those of sampling, and falling with them."""
    half_x, half_y, z = 0.4e-3, 0.3e-3, 0.1
    errors = []
    for pitch in (8e-6, 4e-6):
        n = round(2.4e-3 / pitch)
        mask = psf.ScalarField.from_function(
            # edges lie on cell borders: the samples are the means over their cells
            lambda x, y, p=pitch: (np.abs(x - p / 2) < half_x) * (np.abs(y - p / 2) < half_y),
            pitch=pitch,
            shape=n,
            wavelength=WAVELENGTH,
        )
        found = psf.propagate(mask, z, method="fresnel_chirp_z", tol=0.3)
        x, y = found.x[None, :] - pitch / 2, found.y[:, None] - pitch / 2
        phase = np.exp(2j * math.pi * math.fmod(z / WAVELENGTH, 1.0))
        expected = rectangle_diffraction(x, y, half_x, half_y, z) * phase
        errors.append(difference(found.samples, expected))
        assert errors[-1] < mask.sampling_error
        spectrum = psf.propagate(mask, z, method="fresnel_transfer", tol=0.01)
        assert difference(spectrum.samples, expected) < mask.sampling_error
    # a hard edge has a spectrum 1/f: the error falls at least as pitch^(1/2)
    assert errors[1] < 0.75 * errors[0] < 0.1


def test_disc_on_axis():
    """Intensity 4 sin^2(pi N/2) at Fresnel numbers N (Born & Wolf, sec. 8.2)."""
    radius, pitch, fine = 0.5e-3, 10e-6, 25

    def covered(x, y):
        offsets = (np.arange(fine) - (fine - 1) / 2) / fine * pitch
        return sum((np.hypot(x + a, y + b) < radius) for a in offsets for b in offsets) / fine**2

    disc = psf.ScalarField.from_function(covered, pitch=pitch, shape=128, wavelength=WAVELENGTH)
    for number in (0.5, 1.0, 1.7, 2.0, 3.0):
        z = radius**2 / (WAVELENGTH * number)
        expected = 4 * math.sin(math.pi * number / 2) ** 2
        for method in ("angular_spectrum", "fresnel_chirp_z"):
            # one dark point is no scale for errors: a window of 0.1 mm holds some power
            found = psf.propagate(disc, z, method=method, shape=11, tol=0.05)
            # averages over cells at the rim, where the phase turns by pi N pitch/radius
            limit = 2 * (math.pi * number * pitch / radius) ** 2 + 4 * found.error_estimate
            assert found.intensity[5, 5] == approx(expected, abs=limit)


def test_two_steps_are_one_and_back_is_the_start():
    start = beam(shape=160)
    for method in TRANSFER:
        whole = psf.propagate(start, RAYLEIGH, method=method, tol=1e-2)
        half = psf.propagate(start, RAYLEIGH / 2, method=method, tol=1e-2)
        both = psf.propagate(half, RAYLEIGH / 2, method=method, tol=1e-2)
        # each step to the soft limit's 1e-11; the beam is 1e-15 at the border
        assert difference(both.samples, whole.samples) < 1e-10
        assert both.z == approx(whole.z)
        back = psf.propagate(whole, -RAYLEIGH, method=method, tol=1e-2)
        assert difference(back.samples, start.samples) < 1e-10
        assert back.z == approx(0.0, abs=1e-15)


@pytest.mark.parametrize("method", TRANSFER)
def test_energy_is_conserved(method):
    """Of a random periodic field, and of a beam that stays in the window."""
    rng = np.random.default_rng(3)
    noise = field_of(rng.normal(size=(40, 31)) + 1j, 5e-6, periodic=True)
    for z in (1e-4, 0.1, 7.0):
        found = psf.propagate(noise, z, method=method, tol=1.0)
        assert found.power == approx(noise.power, rel=1e-12)  # rounding
        assert found.error_estimate < 1e-10
    start = beam()
    for z in (0.01, RAYLEIGH):
        found = psf.propagate(start, z, method=method, tol=1e-2)
        assert found.power == approx(start.power, rel=1e-12)  # tails of 1e-15 leave the window


def random_field(rng, kind):
    """Noise over the whole band, smooth spots, or hard masks, on a few to a few dozen samples."""
    ny, nx = rng.integers(6, 26, 2)
    samples = rng.normal(size=(ny, nx)) + 1j * rng.normal(size=(ny, nx))
    if kind == "smooth":
        y, x = np.ogrid[:ny, :nx]
        inside = np.exp(-20 * ((y / ny - 0.5) ** 2 + (x / nx - 0.5) ** 2))
        low = np.exp(-40 * (np.fft.fftfreq(ny)[:, None] ** 2 + np.fft.fftfreq(nx) ** 2))
        samples = np.fft.ifft2(np.fft.fft2(samples * inside) * low)
    elif kind == "mask":
        samples = np.where(np.abs(samples) > 1, 1.0, 0.0)
    return field_of(samples, WAVELENGTH * float(rng.choice([0.75, 1.0, 2.0, 20.0])))


@pytest.mark.parametrize("kind", ["noise", "smooth", "mask"])
@pytest.mark.parametrize("seed", range(8))
def test_errors_are_within_their_estimates(kind, seed):
    """Any window, pitch and distance; the reference is a quadrature over the sampled band."""
    rng = np.random.default_rng([seed, 20])
    field = random_field(rng, kind)
    n, dx = max(field.shape), field.pitch
    z = float(rng.choice([-1, 1])) * 10 ** rng.uniform(-1.5, 1.0) * n * dx**2 / WAVELENGTH
    pitch = dx * float(rng.choice([1.0, 1.0, 0.4, 1.7]))
    shape = tuple(int(count) for count in rng.integers(5, 36, 2))
    held = 0
    for method in METHODS:
        own = method == "fresnel_one_step"
        options = {} if own else {"pitch": pitch, "shape": shape}
        try:
            found = psf.propagate(field, z, method=method, tol=1.0, **options)
        except SamplingError:
            continue
        exact = truth(field, z, found.x, found.y)
        paraxial = method != "angular_spectrum"
        reference = truth(field, z, found.x, found.y, paraxial=True) if paraxial else exact
        assert difference(found.samples, reference) <= found.error_estimate
        # the norm of the exact field instead of the paraxial one changes a ratio by itself
        assert difference(found.samples, exact) * (1 - found.model_error) <= (
            found.model_error + found.error_estimate
        )
        held += 1
    assert held >= 1


@pytest.mark.parametrize("seed", range(8))
def test_sampling_error_bounds_what_samples_lose(seed):
    """Beams that are too narrow for the pitch or too wide for the window, in closed form."""
    rng = np.random.default_rng([seed, 21])
    pitch, n = 10e-6, 32
    waist = 10 ** rng.uniform(-0.4, 1.3) * pitch
    shift = rng.uniform(-0.5, 0.5, 2) * pitch
    beam_of = psf.ScalarField.from_function(
        lambda x, y: gaussian(x - shift[0], y - shift[1], waist=waist),
        pitch=pitch,
        shape=n,
        wavelength=WAVELENGTH,
    )
    z, side = 3e-3, 256
    found = psf.propagate(beam_of, z, method="fresnel_transfer", shape=side, tol=0.3)
    expected = gaussian(found.x[None, :] - shift[0], found.y[:, None] - shift[1], z, waist)
    error = difference(found.samples, expected)
    assert error <= beam_of.sampling_error + found.error_estimate


@pytest.mark.parametrize("shape", [(20, 31), (9, 40), (10, 10)])
@pytest.mark.parametrize("periodic", [False, True])
def test_sampling_error_is_of_the_outer_tenth(shape, periodic):
    """Twenty times its energy in the band, and ten times that in the window."""
    rng = np.random.default_rng(shape)
    samples = rng.normal(size=shape) + 1j * rng.normal(size=shape)
    waves = np.fft.fft2(samples)
    outer = {True: 0.0, False: 0.0}
    for (i, j), value in np.ndenumerate(samples):
        beyond = any(abs(k - n // 2) > 0.45 * n for k, n in zip((i, j), shape, strict=True))
        outer[False] += abs(value) ** 2 * beyond
        signed = [k if k < (n + 1) // 2 else k - n for k, n in zip((i, j), shape, strict=True)]
        beyond = any(abs(k) > 0.45 * n for k, n in zip(signed, shape, strict=True))
        outer[True] += abs(waves[i, j]) ** 2 * beyond
    lost = 20 * outer[True] / np.sum(np.abs(waves) ** 2)
    lost += 0 if periodic else 10 * outer[False] / np.sum(np.abs(samples) ** 2)
    field = field_of(samples, 1e-5, periodic=periodic)
    assert field.sampling_error == approx(math.sqrt(lost), rel=1e-9)
    assert field.shape == shape
    assert field.x == approx(1e-5 * (np.arange(shape[1]) - shape[1] // 2))
    assert field.y == approx(1e-5 * (np.arange(shape[0]) - shape[0] // 2))
    assert field.intensity == approx(np.abs(samples) ** 2)
    assert field_of(np.zeros(shape), 1e-5).sampling_error == 0


def test_samples_of_a_function():
    """Coordinates broadcast; one number is a square; the first bad sample is named."""
    field = psf.ScalarField.from_function(
        lambda x, y: x + 1j * y,
        pitch=0.2,
        shape=(3, 5),
        wavelength=WAVELENGTH,
        z=0.7,
        periodic=True,
    )
    assert field.samples == approx(field.x + 1j * field.y[:, None])
    assert (field.z, field.periodic, field.pitch) == (0.7, True, 0.2)
    flat = psf.ScalarField.from_function(lambda x, y: 2.0, pitch=0.2, shape=3, wavelength=1e-6)
    assert (flat.shape, flat.z, flat.periodic) == ((3, 3), 0.0, False)
    bad = np.ones((4, 5), dtype=complex)
    bad[2, 3], bad[3, 1] = np.nan, np.inf
    with pytest.raises(SceneError, match=r"not finite at 2 points, the first is \[2, 3\]"):
        field_of(bad, 1e-5)
    for shape in ((0, 3), (3, 0), (3,), (2, 2, 2)):
        with pytest.raises(SceneError, match="samples have the shape"):
            field_of(np.ones(shape), 1e-5)


@pytest.mark.parametrize(("across", "error"), [(100, 0.15), (1000, 0.05)])
def test_sampling_error_of_a_sharp_disc(across, error):
    """The estimates that the documentation states."""
    disc = psf.ScalarField.from_function(
        lambda x, y: np.hypot(x, y) < 0.5e-3,
        pitch=1e-3 / across,
        shape=2 * across,
        wavelength=WAVELENGTH,
    )
    assert disc.sampling_error == approx(error, rel=0.05)


@pytest.mark.parametrize(("waist", "limit"), [(1.5, 1e-10), (0.8, 1e-3)])
def test_narrow_beam_beyond_the_paraxial_regime(waist, limit):
    """A Gaussian of one to two wavelengths, by a Hankel transform over angles."""
    waist *= WAVELENGTH
    narrow = psf.ScalarField.from_function(
        lambda x, y: np.exp(-(x**2 + y**2) / waist**2),
        pitch=0.4 * WAVELENGTH,
        shape=40,
        wavelength=WAVELENGTH,
    )
    z = 10 * WAVELENGTH
    found = psf.propagate(narrow, z, method="angular_spectrum", shape=(90, 70), tol=0.5)
    nodes, weights = np.polynomial.legendre.leggauss(400)
    angle, weights = (nodes + 1) * math.pi / 4, weights * math.pi / 4
    rho = np.sin(angle) / WAVELENGTH
    waves = math.pi * waist**2 * np.exp(-((math.pi * waist * rho) ** 2))
    waves *= weights * rho * np.cos(angle) / WAVELENGTH * 2 * math.pi
    r = np.hypot(found.x[None, :], found.y[:, None])
    bessel = j0(2 * math.pi * r[..., None] * rho)
    expected = bessel @ (waves * np.exp(2j * math.pi * z / WAVELENGTH * np.cos(angle)))
    error = difference(found.samples, expected)
    # evanescent waves, exp(-(pi waist/wavelength)^2) of the spectrum's peak, are missing in both
    assert error <= found.error_estimate + narrow.sampling_error
    assert error < limit


@pytest.mark.parametrize("pitch", [0.25, 0.4, 0.6])
@pytest.mark.parametrize("distance", [0.1, 1.0, 4.0])
def test_near_field(pitch, distance):
    """Wavelengths from a field with evanescent waves; the reference is an FFT of 60 windows."""
    n, dx, size = 24, pitch * WAVELENGTH, 1501
    for kind in ("smooth", "noise"):
        rng = np.random.default_rng([n, 22])
        samples = rng.normal(size=(n, n)) + 1j * rng.normal(size=(n, n))
        if kind == "smooth":
            x = np.arange(n) - n // 2
            samples = np.exp(-(x**2 + x[:, None] ** 2) * pitch**2)
        field = field_of(samples, dx)
        found = psf.propagate(field, distance * WAVELENGTH, method="angular_spectrum", tol=1.0)
        wide = np.zeros((size, size), dtype=complex)
        wide[:n, :n] = samples
        f = np.fft.fftfreq(size, pitch)
        waves = np.exp(2j * math.pi * distance * np.sqrt(1 - f**2 - f[:, None] ** 2 + 0j))
        expected = np.fft.ifft2(np.fft.fft2(wide) * waves)[:n, :n]
        assert difference(found.samples, expected) <= found.error_estimate
        assert found.error_estimate < (1e-3 if kind == "smooth" else 0.7)


def test_methods_agree():
    """Spots off the axis, on a lattice that all methods share."""
    spots = psf.ScalarField.from_function(
        lambda x, y: (
            np.exp(-((x - 0.2e-3) ** 2 + y**2) / 0.1e-3**2)
            + 1j * np.exp(-((x + 0.1e-3) ** 2 + (y - 0.2e-3) ** 2) / 0.15e-3**2)
        ),
        pitch=20e-6,
        shape=100,
        wavelength=WAVELENGTH,
    )
    z = 2.5 * 100 * spots.pitch**2 / WAVELENGTH
    one = psf.propagate(spots, z, method="fresnel_one_step")
    assert one.pitch == approx(WAVELENGTH * z / (100 * spots.pitch))
    found = {
        method: psf.propagate(spots, z, method=method, pitch=one.pitch, shape=one.shape)
        for method in METHODS
    }
    for method in FRESNEL:
        # all three sum the same integral
        assert difference(found[method].samples, one.samples) < 1e-9
    gap = difference(one.samples, found["angular_spectrum"].samples)
    assert 1e-9 < gap < one.model_error < 1e-3
    # a transposed or flipped field gives a transposed or flipped result
    turned = field_of(spots.samples.T, spots.pitch)
    again = psf.propagate(turned, z, method="angular_spectrum", pitch=one.pitch, shape=100)
    assert difference(again.samples.T, found["angular_spectrum"].samples) < 1e-12


def test_auto_takes_what_the_distance_asks_for():
    near = psf.propagate(beam(), 1e-3)
    assert near.method in TRANSFER
    assert near.error_estimate + near.model_error < 1e-3
    far = psf.propagate(beam(), 10.0, pitch=0.2e-3)
    assert far.method == "fresnel_chirp_z"
    assert "fewest operations within tol = 0.001" in far.reason
    # a waist of 1.5 wavelengths spreads beyond the paraxial regime
    narrow = psf.ScalarField.from_function(
        lambda x, y: np.exp(-(x**2 + y**2) / (1.5 * WAVELENGTH) ** 2),
        pitch=0.4 * WAVELENGTH,
        shape=32,
        wavelength=WAVELENGTH,
    )
    exact = psf.propagate(narrow, 20e-6, shape=128, tol=1e-2)
    assert (exact.method, exact.model_error) == ("angular_spectrum", 0.0)
    assert "model error" in exact.reason
    edged = psf.propagate(field_of(np.ones((16, 16)), 5e-6), 1e-4)
    assert "sampling_error" in edged.reason


def test_methods_that_need_too_much_memory_are_passed_over(monkeypatch):
    """The next method is taken, the reason says so, and both agree to their errors."""
    options = {"distance": 0.5 * RAYLEIGH, "tol": 1e-3}
    first = psf.propagate(beam(), **options)

    def fits_memory(method, *_):
        if method == first.method:
            raise MemoryLimitError("too large")

    monkeypatch.setattr(propagate, "fits_memory", fits_memory)
    second = psf.propagate(beam(), **options)
    assert second.method != first.method
    assert f"{first.method} does not fit into memory" in second.reason
    assert difference(second.samples, first.samples) < 2e-3


def test_no_distance_is_no_change():
    for field in (beam(), beam(periodic=True)):
        same = psf.propagate(field, 0.0)
        assert np.array_equal(same.samples, field.samples)
        assert (same.error_estimate, same.z) == (0.0, 0.0)
    finer = psf.propagate(beam(), 0.0, pitch=7e-6, shape=100)
    # interpolation of a beam that falls to 1e-18 at the border
    expected = gaussian(finer.x[None, :], finer.y[:, None])
    assert difference(finer.samples, expected) < 1e-10


@pytest.mark.parametrize("shape", [(25, 33), (9, 60), (21, 4)])
@pytest.mark.parametrize("smooth", [False, True])
def test_no_distance_to_another_shape_keeps_the_samples(shape, smooth):
    """Cut or with zeros around them, however much light is at the edge of the band."""
    rng = np.random.default_rng(1)
    samples = rng.normal(size=(20, 31)) + 1j * rng.normal(size=(20, 31))
    if smooth:  # a sample in the corner lies as far from the output as any
        samples = np.zeros((20, 31), complex)
        samples[0, 0] = samples[19, 30] = 1.0
    expected = np.zeros(shape, complex)
    for (i, j), value in np.ndenumerate(samples):
        row, column = i - 10 + shape[0] // 2, j - 15 + shape[1] // 2
        if 0 <= row < shape[0] and 0 <= column < shape[1]:
            expected[row, column] = value
    if not expected.any():
        with pytest.raises(SamplingError, match="of the power.*another distance or window"):
            psf.propagate(field_of(samples, 1e-5), 0.0, shape=shape, tol=1e-6)
        return
    found = psf.propagate(field_of(samples, 1e-5), 0.0, shape=shape, tol=1e-6)
    assert difference(found.samples, expected) < 1e-12
    assert found.error_estimate < 1e-9


@pytest.mark.parametrize("pitch", [0.3, 0.66, 1.5])
def test_no_distance_to_another_pitch(pitch):
    """Band-limited interpolation, also of pitches that hold evanescent waves."""
    pitch *= WAVELENGTH
    smooth = field_of(
        np.exp(-((np.arange(24) - 11.3) ** 2) / 9 + 0j)[:, None] * np.hanning(17), pitch
    )
    found = psf.propagate(smooth, 0.0, pitch=1.7 * pitch, shape=(13, 9), tol=0.1)
    lattice = [
        np.sinc(o[:, None] / pitch - i / pitch)
        for o, i in ((found.y, smooth.y), (found.x, smooth.x))
    ]
    expected = lattice[0] @ smooth.samples @ lattice[1].T
    assert difference(found.samples, expected) <= found.error_estimate


def test_field_knows_its_lattice():
    field = beam(shape=(4, 7), z=0.5)
    assert field.x[3] == 0.0
    assert field.y[2] == 0.0
    assert field.power == approx(np.sum(np.abs(field.samples) ** 2) * 4e-10)
    assert not field.samples.flags.writeable
    assert psf.propagate(field, 0.25, tol=0.5).z == 0.75


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"samples": np.full((3, 3), np.nan)}, r"not finite at 9 points, the first is \[0, 0\]"),
        ({"samples": np.ones(3)}, r"shape \(3,\)"),
        ({"samples": "light"}, "no complex numbers"),
        ({"pitch": 0.0}, "pitch = 0 m is out of range"),
        ({"wavelength": -5e-7}, "wavelength = -5e-07 m is out of range"),
        ({"z": math.inf}, "z = inf is not finite"),
    ],
)
def test_bad_fields_are_refused(changes, message):
    good = {"samples": np.ones((3, 3)), "pitch": 1e-5, "wavelength": WAVELENGTH}
    with pytest.raises(SceneError, match=message):
        psf.ScalarField(**good | changes)


@pytest.mark.parametrize(
    ("options", "kind", "message"),
    [
        ({"distance": math.nan}, SceneError, "distance = nan is not finite"),
        ({"method": "asm"}, SceneError, "method = 'asm' is unknown"),
        ({"tol": 0.0}, SceneError, "tol = 0 is out of range"),
        ({"pitch": -1e-6}, SceneError, "pitch = -1e-06 m is out of range"),
        ({"shape": 0}, SceneError, "shape = 0 is out of range"),
        ({"method": "fresnel_chirp_z"}, SamplingError, "limit tol = 0.001; use .* method='auto'"),
        (
            {"method": "fresnel_one_step", "pitch": 1e-5},
            SamplingError,
            "output pitch .* not 1e-05 m; omit pitch, or use method='fresnel_chirp_z'",
        ),
        (
            {"method": "fresnel_chirp_z", "distance": 0.0},
            SamplingError,
            "needs a distance above 0 m",
        ),
        ({"distance": 1e4, "shape": 200_000}, MemoryLimitError, "use a smaller shape"),
    ],
)
def test_bad_requests_are_refused(options, kind, message):
    options = {"distance": 1e-3} | options
    with pytest.raises(kind, match=message):
        psf.propagate(beam(), **options)


def test_periodic_fields_keep_their_lattice():
    with pytest.raises(SceneError, match="periodic = True.*omit pitch and shape"):
        psf.propagate(beam(periodic=True), 0.1, pitch=1e-5)
    with pytest.raises(SceneError, match="carries power"):
        psf.propagate(field_of(np.zeros((4, 4)), 1e-5), 0.1)
    assert psf.propagate(beam(periodic=True), 0.1, pitch=20e-6, shape=128).periodic
