"""Sampling that the transforms refuse, and the windows that they choose."""

import math
from dataclasses import replace

import numpy as np
import pytest
from pytest import approx

from nlosoptics import psf
from nlosoptics.errors import MemoryLimitError, SamplingError, SceneError

WAVELENGTH, RADIUS = 632.8e-9, 12.5e-3
SYSTEM = {"wavelength": WAVELENGTH, "pupil_radius": RADIUS, "image_distance": 50e-3}
UNIT = WAVELENGTH * 2


def zernike_wave(waves=None, **changes):
    coefficients = {j: w * WAVELENGTH for j, w in (waves or {}).items()}
    return psf.Wavefront.from_zernike(coefficients, **{**SYSTEM, **changes})


def test_steep_aberration_names_jump_pixel_limit_and_remedy():
    wave = zernike_wave({4: 3.0}, nodes="grid", samples=32)
    with pytest.raises(SamplingError) as refusal:
        psf.point_spread(wave, method="mdft")
    message = str(refusal.value)
    assert "limit 0.50" in message
    jump = float(message.split("jumps ")[1].split(" waves")[0])
    # W = sqrt(3) 3 (2 rho^2 - 1): steepest step next to the rim
    assert jump == approx(math.sqrt(3) * 3 * 4 * 2 / 32, rel=0.1)
    needed = int(message.split("use ")[1].split(" or more")[0])
    assert "\n" not in message
    enough = zernike_wave({4: 3.0}, nodes="grid", samples=needed + 2)
    # just the rays, whose repeats then touch them
    psf.point_spread(enough, method="mdft", pitch=UNIT / 4, shape=334)
    row, column = map(int, message.split("pixel (")[1].split(")")[0].split(", "))
    assert np.hypot(row - 16, column - 16) > 12


def test_tilt_alone_needs_no_samples():
    # 2.5 waves a sample: more than any transform of the whole wave could take
    wave = zernike_wave({2: 20.0}, nodes="grid", samples=33)
    flat = zernike_wave({}, nodes="grid", samples=33)
    shift = 4 * 20.0 * WAVELENGTH / (2 * RADIUS) * 50e-3
    assert np.abs(np.diff(wave.aberration)).max() > 2 * WAVELENGTH
    with pytest.raises(SamplingError, match="repeat the spot"):
        psf.point_spread(wave, method="mdft", pitch=UNIT / 4, shape=(16, 700))
    spot = psf.point_spread(flat, method="mdft", pitch=UNIT / 4, shape=65)
    polar = psf.point_spread(zernike_wave({2: 20.0}), method="fft", pitch=UNIT / 4, shape=801)
    column = 400 + round(shift / (UNIT / 4))
    cut = polar.intensity[400 - 8 : 401 + 8, column - 8 : column + 9]
    # 33 samples know the rim to 1e-3 of the peak
    assert cut == approx(spot.intensity[24:41, 24:41], abs=1e-3 * cut.max())


@pytest.mark.parametrize("method", ["auto", "fft"])
def test_narrow_window_says_how_wide(method):
    wave = zernike_wave({4: 2.0})
    with pytest.raises(SamplingError, match=r"geometric spot reaches.*limit 1 %") as refusal:
        psf.point_spread(wave, method=method, pitch=UNIT / 4, shape=31)
    needed = int(str(refusal.value).split("shape = (")[1].split(",")[0])
    # rays reach d dW/du = 2 N 2 sqrt(3) 4 waves
    assert needed == approx(2 * 4 * math.sqrt(3) * 2 * 4 * 2 * 2 / UNIT * WAVELENGTH, rel=0.1)
    psf.point_spread(wave, method=method, pitch=UNIT / 4, shape=needed)


def test_window_that_misses_a_tilted_spot():
    with pytest.raises(SamplingError, match="loses 100 %"):
        psf.point_spread(zernike_wave({3: 40.0}), pitch=UNIT / 4, shape=64)


@pytest.mark.parametrize("nodes", ["polar", "grid"])
@pytest.mark.parametrize("normalisation", ["unit-sum", "flux"])
def test_energy_needs_nyquist_or_pixels(nodes, normalisation):
    wave = zernike_wave(nodes=nodes, samples=64)
    with pytest.raises(SamplingError, match=r"wider than the Nyquist pitch.*pixel_integrated=True"):
        psf.point_spread(wave, pitch=UNIT, shape=17, normalisation=normalisation)
    kwargs = {"method": "fft", "pitch": UNIT, "shape": 17, "normalisation": "ideal-peak"}
    points = psf.point_spread(wave, **kwargs)
    assert points.intensity.max() == approx(1.0, abs=points.error_estimate)
    psf.point_spread(wave, pitch=UNIT / 2, shape=17, normalisation=normalisation)


def test_layouts_that_do_not_fit():
    grid = zernike_wave(nodes="grid", samples=32)
    with pytest.raises(SamplingError, match="layout 'grid'; use method='mdft'"):
        psf.point_spread(grid, method="quadrature")
    with pytest.raises(SamplingError, match="layout 'grid'; use method='mdft'"):
        psf.point_spread(grid, method="airy")
    polar = zernike_wave()
    scattered = replace(
        polar,
        layout="scattered",
        **{n: getattr(polar, n).ravel() for n in ("u", "v", "aberration", "amplitude", "weights")},
    )
    for method in ("quadrature", "airy", "fft", "mdft"):
        with pytest.raises(SamplingError, match="layout 'scattered'; use method='nufft'"):
            psf.point_spread(scattered, method=method)


def test_aberrated_wave_is_no_airy_disc():
    with pytest.raises(SamplingError, match="too much for the closed form"):
        psf.point_spread(zernike_wave({4: 1.0}), method="airy")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"method": "hugens"}, "method = 'hugens' is unknown"),
        ({"normalisation": "peak"}, "normalisation = 'peak' is unknown"),
        ({"tol": 0.0}, "tol = 0 is out of range"),
        ({"tol": math.nan}, "tol = nan is not finite"),
        ({"pitch": -1e-6}, "pitch = -1e-06 m is out of range"),
        ({"shape": 0}, "shape = 0 is out of range"),
        ({"shape": (3, 4, 5)}, r"shape = \(3, 4, 5\)"),
        ({"shape": (2.5, 3)}, "shape = 2.5 is not a whole number"),
        ({"shape": 2.5}, "shape = 2.5 is not a whole number"),
        ({"shape": object()}, "shape = .* give one whole number"),
    ],
)
def test_bad_arguments(arguments, message):
    with pytest.raises(SceneError, match=message):
        psf.point_spread(zernike_wave(), **arguments)


@pytest.mark.parametrize("shape", [64.5, "wide", (8, 8, 8), np.array([8, 8, 8])])
def test_bad_shapes_are_told(shape):
    with pytest.raises(SceneError, match="shape = .*whole number"):
        psf.point_spread(zernike_wave(), pitch=UNIT / 4, shape=shape)


def test_shape_may_be_numpys():
    known = psf.point_spread(zernike_wave(), shape=33)
    for shape in (np.int64(33), 33.0, np.array([33, 33])):
        found = psf.point_spread(zernike_wave(), shape=shape)
        assert np.array_equal(found.intensity, known.intensity)


@pytest.mark.parametrize("method", ["auto", "quadrature", "fft", "airy"])
def test_absurd_windows_are_refused_before_they_are_allocated(method):
    with pytest.raises(MemoryLimitError, match="GiB"):
        psf.point_spread(zernike_wave(), method=method, pitch=UNIT / 4, shape=10**7)
    with pytest.raises(MemoryLimitError, match="GiB"):
        psf.point_spread(
            zernike_wave(), method=method, pitch=100 * UNIT, shape=5001, pixel_integrated=True
        )


def test_huge_spot_has_no_default_window():
    with pytest.raises(SamplingError, match="pixel_integrated=True, or a shape"):
        psf.point_spread(zernike_wave({4: 60.0}))


def test_default_window_holds_the_spot():
    spread = psf.point_spread(zernike_wave({4: 3.0}))
    assert spread.pitch == approx(UNIT / 4)
    # 16 Airy units of tail: 2/(pi^2 16) of an Airy disc's energy, more of a ring's
    assert spread.enclosed_energy > 0.95


@pytest.mark.parametrize(
    ("waves", "pitch"),
    [
        ({}, 10e-6),
        ({}, 72e-6),
        ({4: 2.0}, 10e-6),
        pytest.param({4: 20.0}, 4e-6, marks=pytest.mark.thorough),
        ({4: 10.0, 6: 5.0}, 72e-6),
        ({8: 6.0}, 10e-6),
        pytest.param({11: 4.0}, 72e-6, marks=pytest.mark.thorough),
    ],
)
def test_window_shape_holds_what_is_above_tol(waves, pitch):
    wave = zernike_wave(waves)
    tol = 2e-3
    n = psf.window_shape(wave, pitch=pitch, tol=tol)
    assert n % 2 == 1
    wide = psf.point_spread(wave, pitch=pitch, shape=n + 10, pixel_integrated=True, model="scalar")
    outside = wide.intensity.copy()
    outside[5:-5, 5:-5] = 0.0
    assert outside.max() < tol * wide.intensity.max()
    # not absurdly wide: what is dropped is not far below the tolerance
    inner = wide.intensity.copy()
    half = max(1, (n // 2) // 3)
    centre = (n + 10) // 2
    inner[centre - half + 1 : centre + half, centre - half + 1 : centre + half] = 0.0
    assert inner.max() > tol / 10 * wide.intensity.max() or n == 3


def test_default_pixel_window_is_that_shape():
    wave = zernike_wave({4: 2.0})
    spread = psf.point_spread(wave, pitch=72e-6, pixel_integrated=True)
    assert spread.shape == (psf.window_shape(wave, pitch=72e-6),) * 2
