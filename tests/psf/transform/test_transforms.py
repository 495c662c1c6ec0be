"""The transforms against closed forms, direct sums and each other."""

import hashlib
import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pytest import approx
from scipy.optimize import brentq
from scipy.special import j1, jn_zeros

from nlosoptics import psf
from nlosoptics.errors import SamplingError
from nlosoptics.psf.transform import airy, nufft, quadrature
from nlosoptics.psf.wave.detilted import split
from nlosoptics.psf.window.antialiased_disc import SoftDisc
from nlosoptics.psf.window.window import Window

WAVELENGTH, RADIUS = 632.8e-9, 12.5e-3
SYSTEM = {"wavelength": WAVELENGTH, "pupil_radius": RADIUS, "image_distance": 50e-3}
UNIT = WAVELENGTH * 2  # lambda N at F/2
TRUTHS = json.loads((Path(__file__).parents[2] / "truths" / "psf.json").read_text())


def zernike_wave(waves=None, **changes):
    coefficients = {j: w * WAVELENGTH for j, w in (waves or {}).items()}
    return psf.Wavefront.from_zernike(coefficients, **{**SYSTEM, **changes})


def error(spread, reference):
    difference = np.abs(spread.intensity - reference.intensity).max()
    return difference / reference.intensity.max()


def direct_field(wave, window):
    """The sum as defined, without any of the library's shortcuts."""
    phase = 2 * np.pi / WAVELENGTH * wave.aberration
    pupil = (wave.amplitude * wave.weights * np.exp(1j * phase)).ravel()
    rate = 2j * np.pi / (WAVELENGTH * wave.image_distance)
    rows = []
    for y in window.y:
        kernel = np.exp(-rate * (window.x[:, None] * wave.u.ravel() + y * wave.v.ravel()))
        rows.append(kernel @ pupil)
    return np.array(rows) / np.sum(wave.amplitude * wave.weights)


# closed forms


@pytest.mark.parametrize("row", [r for r in TRUTHS if r["name"] == "airy_zero"], ids=str)
def test_airy_zeros(row):
    place = float(row["value"])
    v = brentq(lambda v: airy.disc_field(np.array(v)).item(), np.pi * place - 1, np.pi * place + 1)
    assert v / np.pi == approx(place, abs=float(row["tolerance"]))
    assert jn_zeros(1, 3)[row["parameters"]["order"] - 1] == approx(v, rel=1e-14)


@pytest.mark.parametrize("row", [r for r in TRUTHS if r["name"] == "airy_ring_peak"], ids=str)
def test_airy_ring_peaks(row):
    v = np.array(np.pi * float(row["parameters"]["position_lambdaN"]))
    peak = airy.disc_field(v) ** 2
    assert peak == approx(float(row["value"]), abs=float(row["tolerance"]))


def test_airy_width():
    row = next(r for r in TRUTHS if r["name"] == "airy_fwhm")
    half = brentq(lambda v: airy.disc_field(np.array(v)).item() ** 2 - 0.5, 1, 2, xtol=1e-15)
    assert 2 * half / np.pi == approx(float(row["value"]), abs=float(row["tolerance"]))


def field(residual, window):
    """Complex field of the quadrature."""
    nodes = quadrature.nodes(residual, window, quadrature.node_counts(residual, window))
    return nufft.field(residual, nodes, window)


def test_quadrature_is_the_airy_field():
    residual = split(zernike_wave())
    window = Window.centred(UNIT / 10, (256, 256))  # +-12.8 lambda N
    v = np.pi * np.hypot(window.y[:, None], window.x) / UNIT
    v[128, 128] = 1.0
    closed = 2 * j1(v) / v
    closed[128, 128] = 1.0
    # the rule has converged to rounding; the transform is asked for 2e-13 rms
    assert np.abs(field(residual, window) - closed).max() < 1e-12
    spread = psf.point_spread(zernike_wave(), method="quadrature", pitch=UNIT / 10, shape=256)
    peak = spread.intensity.max()
    assert np.abs(spread.intensity / peak - closed**2).max() < 1e-12


def test_quadrature_is_the_annulus_field():
    residual = split(zernike_wave(obscuration=0.4))
    window = Window.centred(UNIT / 10, (128, 128))
    v = np.pi * np.hypot(window.y[:, None], window.x) / UNIT + 1e-30
    closed = (2 * j1(v) / v - 0.4 * 2 * j1(0.4 * v) / v) / (1 - 0.16)
    closed[64, 64] = 1.0
    assert np.abs(field(residual, window) - closed).max() < 1e-12
    assert np.abs(airy.intensity(residual, window) - closed**2).max() < 1e-14


def test_area_weighted_grid_is_the_airy_disc():
    reference = psf.point_spread(zernike_wave(), method="airy", pitch=UNIT / 10, shape=256)
    spread = psf.point_spread(
        zernike_wave(nodes="grid", samples=512), method="mdft", pitch=UNIT / 10, shape=256
    )
    scaled = spread.intensity / spread.intensity.max()
    # the jagged rim; 1.7e-6 as measured
    assert np.abs(scaled - reference.intensity / reference.intensity.max()).max() < 5e-5


def test_softened_rim_keeps_the_disc_and_its_spectrum():
    radius = 60.3
    axis = np.arange(-90, 91)
    disc = SoftDisc(radius)(np.hypot(axis[:, None], axis))
    assert disc.sum() == approx(np.pi * radius**2, rel=1e-13)
    # cycles per cell; up to 0.2 the kernel's spectrum lacks 4e-8
    for frequency in (0.03, 0.11, 0.2):
        spectrum = np.sum(disc * np.cos(2 * np.pi * frequency * axis))
        v = 2 * np.pi * radius * frequency
        closed = np.pi * radius**2 * 2 * j1(v) / v
        assert spectrum == approx(closed, abs=1e-7 * np.pi * radius**2)


# direct sums


@pytest.mark.parametrize("distance", [50e-3, -50e-3])
@pytest.mark.parametrize("shape", [(7, 12), (8, 5)])
def test_quadrature_is_the_direct_sum(distance, shape):
    wave = zernike_wave({2: 0.4, 3: -0.7, 5: 0.2, 8: 0.3}, image_distance=distance)
    fine = wave.resampled(48, 192)
    fine = replace(fine, amplitude=1 + 0.3 * fine.u / RADIUS - 0.2 * (fine.v / RADIUS) ** 3)
    window = Window.centred(0.7 * UNIT, shape)
    # modulus: the piston is dropped
    expected = np.abs(direct_field(fine, window))
    assert np.abs(field(split(fine), window)) == approx(expected, abs=1e-12)


@pytest.mark.parametrize("distance", [50e-3, -50e-3])
@pytest.mark.parametrize(("samples", "shape"), [(24, (7, 12)), (25, (8, 5))])
def test_mdft_is_the_direct_sum(distance, samples, shape):
    rng = np.random.default_rng(4)
    wave = psf.Wavefront.from_map(
        rng.uniform(0, 0.02, (samples, samples)) * WAVELENGTH,
        rng.uniform(0, 1, (samples, samples)),
        wavelength=WAVELENGTH,
        pupil_pitch=1e-3,
        image_distance=distance,
    )
    pitch = 0.317 * WAVELENGTH * 50e-3 / 24e-3
    spread = psf.point_spread(
        wave, method="mdft", pitch=pitch, shape=shape, normalisation="ideal-peak"
    )
    expected = np.abs(direct_field(wave, Window.centred(pitch, shape))) ** 2
    assert spread.intensity == approx(expected, abs=1e-14)


@pytest.mark.parametrize("distance", [50e-3, -50e-3])
@pytest.mark.parametrize("samples", [40, 41])
def test_fft_and_mdft_share_samples(distance, samples):
    wave = zernike_wave(
        {2: 0.3, 3: -1.1, 5: 0.1, 8: 0.2}, nodes="grid", samples=samples, image_distance=distance
    )
    fft = psf.point_spread(wave, method="fft", shape=(60, 61))
    mdft = psf.point_spread(wave, method="mdft", pitch=fft.pitch, shape=(60, 61))
    assert error(fft, mdft) < 1e-12
    assert fft.pitch <= UNIT / 2


def test_polar_wave_by_all_transforms():
    wave = zernike_wave({2: 1.0, 4: 0.2, 8: 0.3, 11: -0.1}, obscuration=0.3)
    kwargs = {"pitch": 0.37 * UNIT, "shape": (101, 120), "tol": 1e-9}
    reference = psf.point_spread(wave, method="quadrature", **kwargs)
    spread = psf.point_spread(wave, method="fft", **kwargs)
    assert error(spread, reference) < spread.error_estimate < 1e-9


# signs and orientation


@pytest.mark.parametrize("method", ["airy", "quadrature", "fft"])
@pytest.mark.parametrize("distance", [50e-3, -50e-3])
def test_tilt_moves_the_spot_along_it(method, distance):
    # W = a u + b v, Noll 2 and 3 being 2 rho cos and 2 rho sin
    wave = zernike_wave({2: 2.0, 3: -1.0}, image_distance=distance)
    spread = psf.point_spread(wave, method=method, pitch=UNIT / 4)
    row, column = np.unravel_index(np.argmax(spread.intensity), spread.shape)
    expected = 2 * WAVELENGTH / RADIUS * distance * np.array([2.0, -1.0])
    # 8 and 4 lambda N, both whole samples
    assert spread.x[column] == approx(expected[0], abs=1e-12)
    assert spread.y[row] == approx(expected[1], abs=1e-12)


@pytest.mark.parametrize("method", ["fft", "mdft"])
@pytest.mark.parametrize("distance", [50e-3, -50e-3])
def test_tilt_of_a_grid_moves_the_spot_along_it(method, distance):
    wave = zernike_wave({2: 2.0, 3: -1.0}, nodes="grid", samples=64, image_distance=distance)
    spread = psf.point_spread(wave, method=method)
    row, column = np.unravel_index(np.argmax(spread.intensity), spread.shape)
    expected = 2 * WAVELENGTH / RADIUS * distance * np.array([2.0, -1.0])
    # off the samples: half a pitch at best
    assert spread.x[column] == approx(expected[0], abs=spread.pitch / 2)
    assert spread.y[row] == approx(expected[1], abs=spread.pitch / 2)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("distance", [50e-3, -50e-3])
@pytest.mark.parametrize("method", ["fft", "mdft"])
def test_defocused_letter_f_is_upright_where_rays_do_not_cross(sign, distance, method):
    # A ray at p lands at d grad W = 2 c d p: the shadow of the pupil, turned by 180 deg where
    # c d < 0, never mirrored.
    letter = np.zeros((64, 64))
    letter[8:56, 18:26] = 1.0  # stem
    letter[48:56, 18:48] = 1.0  # arm at the top (largest v), toward +u
    letter[28:36, 18:40] = 1.0
    axis = (np.arange(64) - 32) * 2 * RADIUS / 63
    surface = sign * 8 * WAVELENGTH * (axis[:, None] ** 2 + axis**2) / RADIUS**2
    wave = psf.Wavefront.from_map(
        surface,
        letter,
        wavelength=WAVELENGTH,
        pupil_pitch=2 * RADIUS / 63,
        image_distance=distance,
    )
    size = 256 if method == "fft" else None
    pitch = WAVELENGTH * 50e-3 / (256 * wave.pupil_pitch) if size else 0.3 * UNIT
    spread = psf.point_spread(wave, method=method, pitch=pitch, shape=201)
    scale = 2 * sign * 8 * WAVELENGTH / RADIUS**2 * distance
    columns = np.round(spread.x / scale / wave.pupil_pitch).astype(int) + 32
    inside = (columns >= 0) & (columns < 64)
    shadow = np.zeros(spread.shape)
    picked = letter[np.ix_(columns[inside], columns[inside])]
    shadow[np.ix_(inside, inside)] = picked
    upright = np.corrcoef(shadow.ravel(), spread.intensity.ravel())[0, 1]
    turned = np.corrcoef(shadow[::-1, ::-1].ravel(), spread.intensity.ravel())[0, 1]
    mirrored = np.corrcoef(shadow[:, ::-1].ravel(), spread.intensity.ravel())[0, 1]
    # fringes within the shadow cost the correlation its last quarter
    assert upright > 0.7
    assert upright > 0.3 + max(turned, mirrored)


# energy


def test_whole_period_of_a_map_carries_all_energy():
    rng = np.random.default_rng(5)
    amplitude = rng.uniform(0, 1, (31, 31))
    wave = psf.Wavefront.from_map(
        rng.uniform(0, 0.3, (31, 31)) * WAVELENGTH,
        amplitude,
        wavelength=WAVELENGTH,
        pupil_pitch=1e-3,
        image_distance=0.1,
    )
    unit_sum = psf.point_spread(wave, method="fft")
    assert unit_sum.intensity.sum() == approx(1, abs=1e-12)
    assert unit_sum.enclosed_energy == approx(1, abs=1e-12)
    flux = psf.point_spread(wave, method="fft", normalisation="flux")
    passed = np.sum(amplitude**2) * 1e-6 / (np.pi * 15.5e-3**2)
    assert flux.intensity.sum() == approx(passed, rel=1e-12)
    assert flux.enclosed_energy == approx(1, abs=1e-12)


def test_period_of_a_disc_lacks_only_the_far_rings():
    spread = psf.point_spread(zernike_wave(nodes="grid", samples=256), method="fft")
    # a sampled rim passes about twice the 4/(pi^2 n) that lies beyond half a period
    assert 1 - 3 * 4 / (np.pi**2 * 256) < spread.intensity.sum() < 1
    assert spread.enclosed_energy == approx(spread.intensity.sum(), rel=1e-13)


@pytest.mark.parametrize("obscuration", [0.0, 0.4])
def test_normalisations(obscuration):
    wave = zernike_wave({11: 0.07}, obscuration=obscuration)
    kwargs = {"method": "quadrature", "pitch": UNIT / 5, "shape": 129}
    peak = psf.point_spread(wave, normalisation="ideal-peak", **kwargs)
    assert peak.intensity[64, 64] == approx(psf.strehl(wave), rel=1e-12)
    unit_sum = psf.point_spread(wave, **kwargs)
    flux = psf.point_spread(wave, normalisation="flux", **kwargs)
    assert flux.intensity == approx(unit_sum.intensity * (1 - obscuration**2), rel=1e-13)
    # the density of a clear pupil's peak is pi/(4 (lambda N)^2)
    density = np.pi / 4 * (1 - obscuration**2) / UNIT**2
    assert unit_sum.intensity == approx(peak.intensity * density * (UNIT / 5) ** 2, rel=1e-12)
    assert unit_sum.enclosed_energy == approx(unit_sum.intensity.sum(), rel=1e-13)


def test_window_sums_to_the_energy_within():
    wave = zernike_wave({8: 0.1})
    # the corners hold 4e-3 of the energy, which samples good to 1e-3 of the peak need not show
    spread = psf.point_spread(wave, pitch=UNIT / 8, shape=513, tol=1e-6)
    within = psf.encircled_energy(wave, spread.x[-1])
    beyond = psf.encircled_energy(wave, spread.x[-1] * np.sqrt(2))
    assert within < spread.enclosed_energy < beyond


# error estimates

CASES = [
    ({}, 0.0),
    ({8: 0.005}, 0.0),
    ({8: 0.05}, 0.3),
    ({11: 0.3}, 0.0),
    ({8: 0.5}, 0.4),
    ({4: 3.0}, 0.0),
    ({2: 5.0, 4: 0.5}, 0.0),
    pytest.param({11: 2.0, 8: 1.0}, 0.3, marks=pytest.mark.thorough),
    pytest.param({4: 10.0}, 0.4, marks=pytest.mark.thorough),
    pytest.param({22: 0.2, 37: 0.1}, 0.0, marks=pytest.mark.thorough),
]


@pytest.mark.parametrize(("waves", "obscuration"), CASES)
def test_estimates_bound_the_error(waves, obscuration):
    wave = zernike_wave(waves, samples=(48, 192), obscuration=obscuration)
    reference = psf.point_spread(wave, method="quadrature", pitch=UNIT / 3)
    assert reference.error_estimate < 1e-6
    kwargs = {"pitch": UNIT / 3, "shape": reference.shape}
    for method in ("airy", "fft"):
        try:
            spread = psf.point_spread(wave, method=method, **kwargs)
        except SamplingError:
            assert method == "airy"
            continue
        # two digits of room, and the rounding of the reference
        assert error(spread, reference) <= spread.error_estimate
        assert spread.error_estimate < 300 * error(spread, reference) + 1e-12
    for samples in (256, 512):
        grid = zernike_wave(waves, nodes="grid", samples=samples, obscuration=obscuration)
        try:
            spread = psf.point_spread(grid, method="mdft", **kwargs)
        except SamplingError as refusal:
            assert "aberration jumps" in str(refusal)  # noqa: PT017
            continue
        assert error(spread, reference) <= spread.error_estimate
        assert spread.error_estimate < 300 * error(spread, reference) + 1e-12


def test_auto_takes_the_closed_form_only_within_tol():
    flat, bent = zernike_wave(), zernike_wave({8: 0.02})
    # wide enough that the closed form is the cheapest
    kwargs = {"pitch": 4 * UNIT, "shape": 3, "pixel_integrated": True}
    assert psf.point_spread(flat, **kwargs, model="scalar").method == "airy"
    assert psf.point_spread(bent, **kwargs, model="scalar").method != "airy"
    assert psf.point_spread(bent, tol=0.9, **kwargs, model="scalar").method == "airy"


@pytest.mark.parametrize("tol", [1e-2, 1e-4, 1e-8])
@pytest.mark.parametrize("waves", [{}, {4: 0.001}, {8: 0.3}, {4: 4.0, 6: 1.0}])
def test_auto_keeps_its_tolerance(tol, waves):
    wave = zernike_wave(waves)
    spread = psf.point_spread(wave, tol=tol, pitch=UNIT / 3, model="scalar")
    reference = psf.point_spread(wave, method="quadrature", pitch=UNIT / 3, shape=spread.shape)
    assert spread.error_estimate <= tol
    assert error(spread, reference) <= tol


def test_too_few_nodes_show_in_the_estimate():
    def sampled(n_r, n_theta):
        wave = zernike_wave(samples=(n_r, n_theta))
        return replace(wave, aberration=0.2 * WAVELENGTH * np.exp(3 * wave.u / RADIUS))

    kwargs = {"pitch": UNIT / 3, "shape": 512}
    reference = psf.point_spread(sampled(24, 96), method="quadrature", **kwargs)
    coarse = sampled(4, 10)
    spread = psf.point_spread(coarse, method="quadrature", **kwargs)
    assert 1e-4 < error(spread, reference) <= spread.error_estimate
    with pytest.raises(SamplingError, match=r"no transform reaches tol.*more pupil nodes"):
        psf.point_spread(coarse, tol=1e-4, **kwargs)


def test_varying_amplitude_is_not_an_airy_disc():
    wave = zernike_wave()
    wave = replace(wave, amplitude=np.exp(-((wave.u**2 + wave.v**2) / RADIUS**2)))
    spread = psf.point_spread(wave, pitch=UNIT / 4, shape=129, model="scalar")
    assert spread.method != "airy"
    soft = psf.point_spread(wave, method="fft", pitch=UNIT / 4, shape=129)
    assert error(soft, spread) < 1e-5
    with pytest.raises(SamplingError):
        psf.point_spread(
            replace(wave, amplitude=np.exp(-9 * (wave.u**2 + wave.v**2) / RADIUS**2)),
            method="airy",
        )


# same bits

HASHES = """
import hashlib
from nlosoptics import psf
L = 632.8e-9
for nodes in ("polar", "grid"):
    w = psf.Wavefront.from_zernike({2: L, 4: L / 3, 8: L / 2}, wavelength=L, pupil_radius=0.0125,
        image_distance=0.05, nodes=nodes, samples=None if nodes == "polar" else 256)
    for method in ("quadrature", "fft") if nodes == "polar" else ("fft", "mdft"):
        s = psf.point_spread(w, method=method)
        print(nodes, method, hashlib.sha256(s.intensity.tobytes()).hexdigest())
    s = psf.point_spread(w, tol=1e-6 if nodes == "polar" else 0.1)
    print(nodes, "auto", hashlib.sha256(s.intensity.tobytes()).hexdigest())
    s = psf.point_spread(w, pitch=5e-6, shape=21, pixel_integrated=True, tol=0.1)
    print(nodes, "pixels", hashlib.sha256(s.intensity.tobytes()).hexdigest())
"""


@pytest.mark.thorough
def test_same_bits_for_any_thread_count():
    results = []
    for threads in ("1", "2"):
        counts = dict.fromkeys(
            (
                "OMP_NUM_THREADS",
                "OPENBLAS_NUM_THREADS",
                "MKL_NUM_THREADS",
                "NUMBA_NUM_THREADS",
            ),
            threads,
        )
        done = subprocess.run(
            [sys.executable, "-c", HASHES],
            env={**os.environ, **counts},
            capture_output=True,
            text=True,
            check=True,
        )
        results.append(done.stdout)
    assert results[0] == results[1]
    assert len(results[0].splitlines()) == 8


def test_results_are_owned_and_read_only():
    spread = psf.point_spread(zernike_wave(), shape=16)
    with pytest.raises(ValueError, match="read-only"):
        spread.intensity[0, 0] = 1.0
    again = psf.point_spread(zernike_wave(), shape=16)
    digest = [hashlib.sha256(s.intensity.tobytes()).digest() for s in (spread, again)]
    assert digest[0] == digest[1]
