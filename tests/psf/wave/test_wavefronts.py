"""The sampled wave: nodes, areas, spectral resampling, checks."""

import math
from dataclasses import replace

import numpy as np
import pytest
from pytest import approx

from nlosoptics import psf
from nlosoptics.errors import MemoryLimitError, SamplingError, SceneError
from nlosoptics.psf.aperture.quadrature_nodes import circle_shares
from nlosoptics.psf.wave.polar_series import PolarSpectrum, values_at

RADIUS = 12.5e-3
SYSTEM = {"wavelength": 632.8e-9, "pupil_radius": RADIUS, "image_distance": 50e-3}


def smooth(u, v):
    """A function that no finite series holds."""
    x, y = u / RADIUS, v / RADIUS
    return np.exp(x - 0.5 * y) + np.sin(2 * x * y) + x**5


@pytest.mark.parametrize("obscuration", [0.0, 0.4])
def test_polar_nodes_integrate_polynomials(obscuration):
    u, v, weights = psf.polar_nodes(2.0, 4, 12, obscuration)
    # int r^6 cos^2 sin^4: degree 6 < 12; closed form in polar coordinates
    expected = math.pi / 8 * (2.0**8 - (2.0 * obscuration) ** 8) / 8
    assert np.sum(weights * u**2 * v**4) == approx(expected, rel=1e-14)
    assert weights.sum() == approx(math.pi * 4 * (1 - obscuration**2), rel=1e-14)


@pytest.mark.parametrize("samples", [2, 3, 64, 65])
@pytest.mark.parametrize("obscuration", [0.0, 0.35])
def test_grid_cells_add_up_to_the_pupil(samples, obscuration):
    _, _, weights = psf.grid_nodes(1.5, samples, obscuration)
    # every cell is a difference of areas, rounding 1e-16 of the disc each
    assert weights.sum() == approx(math.pi * 1.5**2 * (1 - obscuration**2), rel=1e-13)


@pytest.mark.parametrize("samples", [8, 9])
def test_disc_just_fits_its_grid(samples):
    u, _, _ = psf.grid_nodes(1.0, samples)
    pitch = u[0, 1] - u[0, 0]
    assert u[0, samples // 2] == 0.0
    nearest_edge = min(-u[0, 0], u[0, -1]) + pitch / 2
    assert nearest_edge == approx(1.0, rel=1e-15)


def test_cell_area_is_that_of_fine_sampling():
    axis = (np.arange(7) - 3) * 0.3
    share = circle_shares(axis, axis, 0.3, 0.8)
    fine = (np.arange(7 * 200) + 0.5) / 200 * 0.3 - 3.5 * 0.3
    inside = np.hypot(fine[:, None], fine) < 0.8
    counted = inside.reshape(7, 200, 7, 200).mean(axis=(1, 3))
    # 200 x 200 points count a cut cell's area to about one row in 200, less by averaging
    assert share == approx(counted, abs=2e-3)
    assert share == approx(share.T, abs=1e-14)
    assert share == approx(share[::-1], abs=1e-14)


@pytest.mark.parametrize("obscuration", [0.0, 0.4])
def test_resampling_is_spectral(obscuration):
    u, v, _ = psf.polar_nodes(RADIUS, 24, 96, obscuration)
    series = PolarSpectrum(smooth(u, v), RADIUS, obscuration)
    u, v, _ = psf.polar_nodes(RADIUS, 61, 301, obscuration)
    # rounding, amplified at the smallest radius by the division by r
    assert series.at_nodes(61, 301) == approx(smooth(u, v), abs=2e-13)


def test_resampling_to_the_same_nodes_changes_nothing():
    rng = np.random.default_rng(1)
    values = rng.normal(size=(6, 16))  # the highest angular order included
    series = PolarSpectrum(values, 1.0, 0.0)
    assert series.at_nodes(6, 16) == approx(values, abs=1e-13)


@pytest.mark.parametrize("obscuration", [0.0, 0.4])
def test_series_at_scattered_points_and_beyond_the_rim(obscuration):
    u, v, _ = psf.polar_nodes(RADIUS, 24, 96, obscuration)
    series = PolarSpectrum(smooth(u, v), RADIUS, obscuration)
    rng = np.random.default_rng(2)
    r = RADIUS * np.sqrt(rng.uniform(obscuration**2, 1, 500))
    angle = rng.uniform(0, 7, 500)
    u, v = r * np.cos(angle), r * np.sin(angle)
    assert values_at(series, None, u, v, 1e-13)[0] == approx(smooth(u, v), abs=1e-11)
    # beyond the rim the radial derivative continues it: second order in the distance
    u, v = 1.001 * RADIUS * np.cos(angle), 1.001 * RADIUS * np.sin(angle)
    assert values_at(series, None, u, v, 1e-13)[0] == approx(smooth(u, v), abs=20 * 1e-6)


def test_two_functions_in_one_transform():
    u, v, _ = psf.polar_nodes(RADIUS, 16, 64)
    first = PolarSpectrum(smooth(u, v), RADIUS, 0.0)
    second = PolarSpectrum(smooth(v, u) ** 2, RADIUS, 0.0)
    a, b = values_at(first, second, u, v, 1e-13)
    assert a == approx(values_at(first, None, u, v, 1e-13)[0], abs=1e-11)
    assert b == approx(values_at(second, None, u, v, 1e-13)[0], abs=1e-11)


@pytest.mark.parametrize("obscuration", [0.0, 0.4])
def test_slopes_are_the_gradient(obscuration):
    u, v, _ = psf.polar_nodes(RADIUS, 24, 96, obscuration)
    series = PolarSpectrum(smooth(u, v), RADIUS, obscuration)
    du, dv, share = series.slopes(24, 96)
    step = 1e-5 * RADIUS
    assert share.sum() == approx(1.0, abs=1e-14)
    # central differences: 1e-10 by truncation, 1e-10 by rounding over the step
    expected = (smooth(u + step, v) - smooth(u - step, v)) / (2 * step)
    assert du[:-1] * RADIUS == approx(expected * RADIUS, abs=5e-9)
    expected = (smooth(u, v + step) - smooth(u, v - step)) / (2 * step)
    assert dv[:-1] * RADIUS == approx(expected * RADIUS, abs=5e-9)


@pytest.mark.parametrize("n_r", [6, 10, 14])
def test_truncation_bounds_what_is_missed(n_r):
    u, v, _ = psf.polar_nodes(RADIUS, n_r, 4 * n_r)
    series = PolarSpectrum(smooth(3 * u, v), RADIUS, 0.0)
    u, v, _ = psf.polar_nodes(RADIUS, 40, 160)
    missed = np.abs(series.at_nodes(40, 160) - smooth(3 * u, v)).max()
    assert 1e-13 < missed < series.truncation()
    # an eighth of the terms, whose sum converges: not far above either
    assert series.truncation() < 2e3 * missed


def test_resampled_wavefront_keeps_weights_and_strehl():
    wave = psf.Wavefront.from_zernike({8: 40e-9}, **SYSTEM)
    finer = wave.resampled(40, 200)
    assert finer.weights.sum() == approx(math.pi * RADIUS**2, rel=1e-14)
    assert psf.rms_aberration(finer) == approx(40e-9, rel=1e-12)
    with pytest.raises(SamplingError, match="fewer than the present 24 x 96"):
        wave.resampled(10, 96)
    grid = psf.Wavefront.from_zernike({}, nodes="grid", samples=8, **SYSTEM)
    with pytest.raises(SamplingError, match="only a wavefront of layout 'polar'"):
        grid.resampled(40, 200)


def test_map_is_taken_as_it_is():
    wave = psf.Wavefront.from_map(
        np.zeros((6, 6)), np.ones((6, 6)), wavelength=1e-6, pupil_pitch=1e-3, image_distance=-0.1
    )
    assert wave.u[0] == approx((np.arange(6) - 3) * 1e-3)
    assert wave.v[:, 0] == approx((np.arange(6) - 3) * 1e-3)
    assert wave.pupil_radius == approx(2.5e-3)
    assert wave.f_number == approx(20.0)
    assert np.all(wave.weights == 1e-6)


def test_arrays_are_owned_and_read_only():
    surface = np.zeros((4, 4))
    wave = psf.Wavefront.from_map(
        surface, np.ones((4, 4)), wavelength=1e-6, pupil_pitch=1e-3, image_distance=0.1
    )
    surface[0, 0] = 1.0
    assert wave.aberration[0, 0] == 0.0
    for name in ("u", "v", "aberration", "amplitude", "weights"):
        assert not getattr(wave, name).flags.writeable


def wave_with(**changes):
    return replace(psf.Wavefront.from_zernike({}, samples=(4, 12), **SYSTEM), **changes)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"wavelength": -1e-6}, r"wavelength = -1e-06 m is out of range"),
        ({"wavelength": 632.8}, r"wavelength = 632.8 m is out of range.*give metres"),
        ({"image_distance": 0.0}, "image_distance = 0 m"),
        ({"image_distance": math.inf}, "image_distance = inf is not finite"),
        ({"pupil_radius": 0.0}, "pupil_radius = 0 m"),
        ({"obscuration": 1.0}, "obscuration = 1 is out of range"),
        ({"layout": "hexagonal"}, "one of polar, cells, grid, scattered"),
        ({"aberration": np.zeros((4, 11))}, r"aberration has shape \(4, 11\) and u has \(4, 12\)"),
        ({"aberration": np.full((4, 12), np.nan)}, r"aberration = nan at \(0, 0\)"),
        ({"amplitude": np.full((4, 12), -1.0)}, r"amplitude = -1 at \(0, 0\) is below 0"),
        ({"amplitude": np.zeros((4, 12))}, "amplitude is 0 everywhere"),
        ({"pupil_radius": 13e-3}, "off the nodes of layout 'polar'"),
        ({"aberration": "flat"}, "not an array of real numbers"),
        ({"amplitude": np.full((4, 12), 1j)}, "amplitude is not an array of real numbers"),
        ({"aberration": np.zeros(48)}, "needs 2 dimensions"),
    ],
)
def test_bad_wavefronts_are_refused(changes, message):
    with pytest.raises(SceneError, match=message):
        wave_with(**changes)


@pytest.mark.parametrize(
    ("surface", "message"),
    [
        (np.zeros((4, 5)), "a grid is square"),
        ([[0.0, np.inf], [0.0, 0.0]], r"aberration = inf at \(0, 1\)"),
    ],
)
def test_bad_maps_are_refused(surface, message):
    with pytest.raises(SceneError, match=message):
        psf.Wavefront.from_map(surface, wavelength=1e-6, pupil_pitch=1e-3, image_distance=0.1)


def test_maps_of_complex_amplitude_are_refused():
    """Their phase would be lost."""
    with pytest.raises(SceneError, match="amplitude is not an array of real numbers; .* a phase"):
        psf.Wavefront.from_map(
            np.zeros((4, 4)),
            np.full((4, 4), 1j),
            wavelength=1e-6,
            pupil_pitch=1e-3,
            image_distance=0.1,
        )


def test_absurd_sizes_are_refused_before_they_are_allocated():
    with pytest.raises(MemoryLimitError, match="1000000 x 1000000 samples"):
        psf.Wavefront.from_zernike({}, nodes="grid", samples=1_000_000, **SYSTEM)
    with pytest.raises(MemoryLimitError, match="pupil nodes"):
        psf.polar_nodes(1.0, 1_000_000, 1_000_000)
