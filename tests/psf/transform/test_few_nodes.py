"""As few samples of round pupils as a tolerance allows, and the closed form."""

import numpy as np
import pytest
from pytest import approx
from scipy.special import j1

from nlosoptics import psf
from nlosoptics.psf.transform import airy, antialiased_pupil
from nlosoptics.psf.wave import _wave_kernels
from nlosoptics.psf.wave.detilted import split
from nlosoptics.psf.window.window import Window

WAVELENGTH, RADIUS = 632.8e-9, 12.5e-3
SYSTEM = {"wavelength": WAVELENGTH, "pupil_radius": RADIUS, "image_distance": 50e-3}
UNIT = WAVELENGTH * 2  # lambda N at F/2
MIX = {4: 0.0859, 5: 0.0429, 6: 0.0859, 7: 0.0515, 8: 0.0859, 11: 0.0429}  # 1 wave


def zernike_wave(waves, **changes):
    coefficients = {j: w * WAVELENGTH for j, w in waves.items()}
    return psf.Wavefront.from_zernike(coefficients, **{**SYSTEM, **changes})


def error(spread, reference):
    difference = np.abs(spread.intensity - reference.intensity).max()
    return difference / reference.intensity.max()


def test_phasors_are_exponentials():
    turns = np.random.default_rng(1).uniform(-1000, 1000, 5000)
    turns[:5] = 0.0, 0.25, -0.5, 0.75, 1000.125
    size = np.linspace(0.0, 2.0, turns.size)
    real, imaginary = np.empty_like(turns), np.empty_like(turns)
    _wave_kernels.phasors(turns, size, real, imaginary)
    # whole turns taken off exactly; two roundings of a value below 2
    expected = size * np.exp(2j * np.pi * (turns - np.rint(turns)))
    assert np.abs(real + 1j * imaginary - expected).max() < 2e-15


def uneven(waves, amplitude):
    """The wave of Zernike terms with an amplitude of its own."""
    wave = zernike_wave(waves)
    return psf.Wavefront(
        **{name: getattr(wave, name) for name in ("u", "v", "aberration", "weights", "layout")},
        amplitude=amplitude(wave.u / RADIUS, wave.v / RADIUS),
        **SYSTEM,
    )


@pytest.mark.parametrize("tol", [1e-2, 1e-4, 1e-6, 1e-9])
@pytest.mark.parametrize("waves", [{}, {4: 0.2, 8: 0.1}, {4: 1.5, 7: 0.8}], ids=len)
def test_uneven_amplitude_within_the_estimate(waves, tol):
    wave = uneven(waves, lambda u, v: 1 - 0.2 * (u * u + v * v) + 0.05 * u - 0.02 * u * v * v)
    options = {"shape": 400, "pitch": WAVELENGTH * 2 / 2.5}
    exact = psf.point_spread(wave, method="quadrature", tol=1e-12, **options).intensity
    found = psf.point_spread(wave, method="fft", tol=tol, **options)
    error = np.abs(found.intensity - exact).max() / exact.max()
    assert error <= found.error_estimate <= tol
    # within the slack of the bounds on the nodes, or of no consequence for tol
    assert found.error_estimate < max(300 * error, tol / 50, 1e-10)


@pytest.mark.parametrize("tol", [1e-2, 1e-4, 1e-6])
@pytest.mark.parametrize(
    "wave",
    [
        uneven({4: 1.0}, lambda u, v: 1 - 0.4 * u * u),
        uneven({4: 1.0}, lambda u, v: 1 - 0.1 * np.cos(20 * u)),
        zernike_wave({4: 1.0, 79: 0.02}),
    ],
    ids=["steep", "bumpy", "degree 11"],
)
def test_waves_that_are_no_polynomials_within_the_estimate(wave, tol):
    assert antialiased_pupil.soft_wave(split(wave), tol / 1e3) is None
    options = {"shape": 200, "pitch": UNIT / 2}
    exact = psf.point_spread(wave, method="quadrature", tol=1e-12, **options)
    found = psf.point_spread(wave, method="fft", tol=tol, **options)
    assert error(found, exact) <= found.error_estimate <= tol


WAVES = [
    ({}, {}),
    (MIX, {}),
    ({2: 0.7, 3: -1.3, 4: 0.4, 8: 0.3}, {}),
    ({j: 4 * w for j, w in MIX.items()}, {}),
    ({8: 0.4, 6: 0.5}, {"obscuration": 0.4}),
    ({7: 0.3, 9: 0.2, 4: 1.0}, {"image_distance": -50e-3}),
    ({22: 0.1, 37: 0.05}, {}),
    ({56: 0.03}, {}),
]


@pytest.mark.parametrize(("waves", "changes"), WAVES)
def test_estimate_bounds_the_error_at_every_tolerance(waves, changes):
    wave = zernike_wave(waves, **changes)
    kwargs = {"pitch": 0.31 * UNIT, "shape": (281, 300)}
    reference = psf.point_spread(wave, method="quadrature", tol=1e-13, **kwargs)
    for tol in (1e-2, 1e-3, 1e-6, 1e-9, 1e-11):
        for method in ("fft", "auto"):
            spread = psf.point_spread(wave, method=method, tol=tol, model="scalar", **kwargs)
            # both transforms round at 1e-12
            assert error(spread, reference) <= spread.error_estimate + 1e-12
            if method == "auto":
                assert spread.error_estimate <= tol


@pytest.mark.parametrize("obscuration", [0.0, 0.2])
@pytest.mark.parametrize("tol", [1e-2, 1e-6, 1e-9, 1e-11])
def test_pupils_of_few_cells_keep_their_estimate(obscuration, tol):
    """A small window needs so few cells that the softened rims reach the centre."""
    wave = zernike_wave({}, obscuration=obscuration)
    kwargs = {"pitch": 0.1 * UNIT, "shape": (3, 12)}
    reference = psf.point_spread(wave, method="quadrature", tol=1e-13, **kwargs)
    spread = psf.point_spread(wave, method="fft", tol=tol, **kwargs)
    # the transform of the quadrature rounds at 1e-12
    assert error(spread, reference) <= spread.error_estimate + 1e-12


@pytest.mark.parametrize("pitch", [1.3, pytest.param(4.0, marks=pytest.mark.thorough)])
def test_samples_beyond_nyquist_fold_the_pupil(pitch):
    wave = zernike_wave({j: 20 * w for j, w in MIX.items()} | {2: 3.3})
    kwargs = {"pitch": pitch * UNIT, "shape": 512, "normalisation": "ideal-peak"}
    exact = psf.point_spread(wave, method="quadrature", tol=1e-10, **kwargs)
    spread = psf.point_spread(wave, method="fft", tol=1e-6, **kwargs)
    assert error(spread, exact) <= spread.error_estimate <= 1e-6


def test_pixels_are_integrated_alike():
    wave = zernike_wave(MIX)
    kwargs = {"pitch": 0.8 * UNIT, "shape": (40, 51), "pixel_integrated": True}
    exact = psf.point_spread(wave, method="quadrature", tol=1e-10, **kwargs)
    spread = psf.point_spread(wave, method="fft", tol=1e-6, **kwargs)
    assert error(spread, exact) <= spread.error_estimate <= 1e-6


@pytest.mark.parametrize("shift", [(0, 0), (3, -5), (0.5, 0)])
def test_an_eighth_of_the_plane_gives_the_disc(shift):
    # Noll 2 and 3 of a wave move the spot by 4 lambda N
    pitch, shape = UNIT / 4, (60, 51)
    wave = zernike_wave({2: shift[0] / 16, 3: shift[1] / 16}, obscuration=0.3)
    spread = psf.point_spread(
        wave, method="airy", pitch=pitch, shape=shape, normalisation="ideal-peak"
    )
    y, x = np.indices(shape) - np.array([30, 25])[:, None, None]
    exact = psf.point_spread(
        wave, method="quadrature", tol=1e-13, pitch=pitch, shape=shape, normalisation="ideal-peak"
    )
    assert error(spread, exact) < 1e-12  # of the quadrature
    assert (x[0, np.argmax(spread.intensity.max(axis=0))] - shift[0]) == approx(0, abs=0.5)
    assert (y[np.argmax(spread.intensity.max(axis=1)), 0] - shift[1]) == approx(0, abs=0.5)


@pytest.mark.parametrize("obscuration", [0.0, 0.3])
@pytest.mark.parametrize("pitch", [0.01, 0.1, 3.0])
def test_the_table_of_the_closed_form_is_exact(obscuration, pitch):
    """Samples from the peak out to 1200 lambda N, past the reach of the table."""
    residual = split(zernike_wave({}, obscuration=obscuration))
    window = Window.centred(pitch * UNIT, (560, 601))
    found = airy.intensity(residual, window)
    y, x = np.ogrid[-280:280, -300:301]
    v = np.maximum(np.pi * pitch * np.hypot(y, x), 1e-9)
    disc, hole = (2 * j1(r) / r for r in (v, max(obscuration, 1e-3) * v))
    share = obscuration**2
    exact = ((disc - share * hole) / (1 - share)) ** 2
    # of roundings of a value of at most 1
    assert np.abs(found - exact).max() < 1e-13
