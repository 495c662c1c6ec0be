"""The transforms against each other, where they differ only by rounding, nodes or the rim.

Held elsewhere: one grid by fft, mdft and nufft (test_scattered_transforms), rays against waves for
defocus and astigmatism (test_geometric), the sum of a whole period and the flux that passes
(test_transforms).
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from pytest import approx
from scipy.integrate import quad
from scipy.special import j1

from nlosoptics import psf

WAVELENGTH, RADIUS = 632.8e-9, 12.5e-3
LENS = {"wavelength": WAVELENGTH, "image_distance": 50e-3}
UNIT = WAVELENGTH * 2  # lambda N at F/2


def zernike_wave(waves=None, **changes):
    coefficients = {j: w * WAVELENGTH for j, w in (waves or {}).items()}
    return psf.Wavefront.from_zernike(coefficients, pupil_radius=RADIUS, **LENS, **changes)


def error(spread, reference):
    difference = np.abs(spread.intensity - reference.intensity).max()
    return difference / reference.intensity.max()


# nodes of two kinds


def bent(u, v):
    """Waves of a cubic and a parabola, nothing of it symmetric."""
    u, v = u / RADIUS, v / RADIUS
    return WAVELENGTH * (0.3 * u**3 + 0.2 * u * u * v + 0.4 * (u * u + v * v))


def apodised(u, v):
    """A Gaussian, exp(-31) = 3.4e-14 at the rim: no rim that a grid could miss."""
    return np.exp(-31 * (u * u + v * v) / RADIUS**2)


@pytest.mark.parametrize("method", ["fft", "mdft"])
@pytest.mark.parametrize("samples", [128, 129])
def test_without_a_rim_polar_nodes_and_grids_are_one_integral(method, samples):
    polar = psf.Wavefront.from_function(bent, amplitude=apodised, pupil_radius=RADIUS, **LENS)
    assert polar.amplitude.min() < 1e-13
    pitch = 2.04 * RADIUS / samples
    axis = (np.arange(samples) - samples // 2) * pitch
    v, u = np.meshgrid(axis, axis, indexing="ij")
    grid = psf.Wavefront.from_map(
        bent(u, v), apodised(u, v), pupil_pitch=pitch, pupil_radius=RADIUS, **LENS
    )
    own = psf.point_spread(grid, method="fft", shape=151)
    found = psf.point_spread(grid, method=method, pitch=own.pitch, shape=151)
    exact = psf.point_spread(polar, method="quadrature", pitch=own.pitch, shape=151, tol=1e-12)
    # equal steps integrate what is smooth and ends at nothing to rounding: 5e-14 as measured, and
    # the quadrature is asked for 1e-12
    assert error(found, exact) < 2e-12
    assert error(found, exact) <= found.error_estimate + exact.error_estimate


@pytest.mark.parametrize("method", ["fft", "mdft"])
@pytest.mark.parametrize("waves", [{}, {4: 0.2, 8: 0.1}], ids=str)
def test_hard_edge_on_a_grid_falls_with_its_cells(method, waves):
    """Cells weighted by their area have the rim's mass, not its place: (cell)^2."""
    errors = []
    for samples in (128, 256, 512):
        wave = zernike_wave(waves, nodes="grid", samples=samples)
        pitch = {"fft": {}, "mdft": {"pitch": UNIT / 4}}[method]
        found = psf.point_spread(wave, method=method, shape=128, **pitch)
        exact = psf.point_spread(
            zernike_wave(waves), method="quadrature", pitch=found.pitch, shape=128, tol=1e-12
        )
        errors.append(error(found, exact))
        assert errors[-1] <= found.error_estimate
    assert errors[-1] < 5e-5
    # a few cells of the rim more or less at each step
    assert errors[0] / errors[1] == approx(4, rel=0.2)
    assert errors[1] / errors[2] == approx(4, rel=0.2)


# rays


@pytest.mark.thorough
@pytest.mark.parametrize("waves", [{8: 10.0}, {11: 15.2}], ids=["coma", "spherical"])
def test_rays_of_coma_and_spherical_hold_the_energy_of_the_waves(waves):
    """2 % above 50 waves from peak to valley, on pixels."""
    assert np.ptp(zernike_wave(waves, samples=48).aberration) > 50 * WAVELENGTH
    wave = zernike_wave(waves)
    rays = psf.point_spread(wave, method="geometric", pitch=30 * UNIT, pixel_integrated=True)
    truth = psf.point_spread(
        wave, method="fft", tol=1e-4, pitch=rays.pitch, shape=rays.shape, pixel_integrated=True
    )
    assert truth.error_estimate < 1e-4
    radii = np.arange(1, rays.shape[0] // 2) * rays.pitch
    difference = psf.encircled_energy(rays, radii) - psf.encircled_energy(truth, radii)
    assert np.abs(difference).max() < 0.02


# energy


def energy_in_a_square(waves, half, n_image=48, n_r=40, n_theta=128):
    """Share within +-half, in lambda N: Gauss-Legendre nodes in image and pupil, direct sums."""
    x, radial = np.polynomial.legendre.leggauss(n_r)
    s, across = np.polynomial.legendre.leggauss(n_image)
    r, theta = np.meshgrid(
        np.sqrt((1 + x) / 2), 2 * np.pi * np.arange(n_theta) / n_theta, indexing="ij"
    )
    path = sum((w * psf.zernike(j, r, theta) for j, w in waves.items()), np.zeros_like(r))
    # areas of a unit disc, pi in all
    areas = np.repeat(radial / 4, n_theta) * 2 * np.pi / n_theta
    pupil = np.exp(2j * np.pi * path).ravel() * areas
    turn = -1j * np.pi * half * s[:, None]
    kernels = [np.exp(turn * c.ravel()) for c in (r * np.sin(theta), r * np.cos(theta))]
    field = (kernels[0] * pupil) @ kernels[1].T
    # Parseval: |U|^2 over the plane, in (lambda N)^2, is 4 pi
    return half**2 * float(across @ np.abs(field) ** 2 @ across) / (4 * np.pi)


def energy_of_the_airy_disc(half):
    """Rings and the part of their angle that is in the square."""

    def ring(v, edge=math.pi * half):
        inside = 1 - 4 / math.pi * math.acos(min(1.0, edge / v)) if v > edge else 1.0
        return 2 * j1(v) ** 2 / v * inside

    edge = math.pi * half
    options = {"limit": 400, "epsabs": 1e-13, "epsrel": 1e-12}
    inner = quad(ring, 1e-9, edge, **options)[0]
    return inner + quad(ring, edge, edge * math.sqrt(2), **options)[0]


def test_sums_over_other_nodes_are_the_airy_discs_energy():
    # quad's own error beside the root at the square's edge
    assert energy_in_a_square({}, 8.25) == approx(energy_of_the_airy_disc(8.25), abs=1e-11)
    finer = energy_in_a_square({8: 0.2}, 8.25, 60, 50, 160)
    assert energy_in_a_square({8: 0.2}, 8.25) == approx(finer, abs=1e-13)


@pytest.mark.parametrize(
    ("method", "waves", "samples"),
    [
        ("airy", {}, None),
        ("quadrature", {}, None),
        ("fft", {}, None),
        ("nufft", {}, (40, 160)),
        ("quadrature", {8: 0.2}, None),
        ("fft", {8: 0.2}, None),
        ("nufft", {8: 0.2}, (40, 160)),
        ("quadrature", {4: 0.1, 6: 0.1, 11: -0.05}, None),
        ("fft", {4: 0.1, 6: 0.1, 11: -0.05}, None),
    ],
    ids=str,
)
def test_a_window_sums_to_the_energy_within(method, waves, samples):
    wave = zernike_wave(waves, samples=samples)
    spread = psf.point_spread(
        wave, method=method, pitch=UNIT / 2, shape=33, tol=1e-12, pixel_integrated=True
    )
    exact = energy_in_a_square(waves, 33 / 4) if waves else energy_of_the_airy_disc(33 / 4)
    # the pixels' filter is good to 4e-11 of the peak; 1e-12 as measured
    assert spread.intensity.sum() == approx(exact, abs=1e-10)
    assert spread.enclosed_energy == approx(exact, abs=1e-10)
    flux = psf.point_spread(
        wave,
        method=method,
        pitch=UNIT / 2,
        shape=33,
        tol=1e-12,
        pixel_integrated=True,
        normalisation="flux",
    )
    # a clear disc passes all of it
    assert flux.intensity.sum() == approx(exact, abs=1e-10)
