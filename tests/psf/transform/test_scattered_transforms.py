"""Sums over scattered nodes: direct sums, the other transforms, traced rays, and the choice."""

import math
from dataclasses import replace

import numpy as np
import pytest
from pytest import approx

from nlosoptics import psf, raytrace
from nlosoptics.errors import MemoryLimitError, SamplingError
from nlosoptics.psf.wave.detilted import split
from nlosoptics.psf.wave.scattered_fits import cell_areas
from nlosoptics.psf.window.window import Window
from nlosoptics.scene import ConcaveWall

WAVELENGTH, RADIUS = 632.8e-9, 12.5e-3
SYSTEM = {"wavelength": WAVELENGTH, "pupil_radius": RADIUS, "image_distance": 50e-3}
UNIT = WAVELENGTH * 2  # lambda N at F/2
COMA = {2: 0.2, 4: 0.1, 8: 0.1}


def zernike_wave(waves=None, **changes):
    coefficients = {j: w * WAVELENGTH for j, w in (waves or {}).items()}
    return psf.Wavefront.from_zernike(coefficients, **{**SYSTEM, **changes})


def sunflower(count, obscuration=0.0):
    i = np.arange(count) + 0.5
    r = RADIUS * np.sqrt(obscuration**2 + (1 - obscuration**2) * i / count)
    angle = i * math.pi * (3 - math.sqrt(5))
    return r * np.cos(angle), r * np.sin(angle)


def random_nodes(count, obscuration=0.0):
    rng = np.random.default_rng(count)
    r = RADIUS * np.sqrt(obscuration**2 + (1 - obscuration**2) * rng.random(count))
    angle = 2 * math.pi * rng.random(count)
    return r * np.cos(angle), r * np.sin(angle)


def scattered_wave(waves, nodes, obscuration=0.0, **changes):
    u, v = nodes
    sites = np.stack([u, v], axis=1)
    weights = cell_areas(sites, RADIUS)[1]
    if obscuration > 0:
        weights = weights - cell_areas(sites, obscuration * RADIUS)[1]
    rho, theta = np.hypot(u, v) / RADIUS, np.arctan2(v, u)
    surface = sum(
        (w * WAVELENGTH * psf.zernike(j, rho, theta) for j, w in waves.items()), np.zeros_like(u)
    )
    settings = {
        **SYSTEM,
        "aberration": surface,
        "amplitude": np.ones_like(u),
        "weights": np.maximum(weights, 0.0),
        "obscuration": obscuration,
        **changes,
    }
    return psf.Wavefront(u=u, v=v, layout="scattered", **settings)


def flattened(wave):
    """The same nodes without their layout."""
    names = ("u", "v", "aberration", "amplitude", "weights")
    return replace(wave, layout="scattered", **{n: getattr(wave, n).ravel() for n in names})


def direct_intensity(wave, window):
    """The sum as defined, without any of the library's shortcuts."""
    pupil = wave.amplitude * wave.weights * np.exp(2j * np.pi / WAVELENGTH * wave.aberration)
    rate = 2j * np.pi / (WAVELENGTH * wave.image_distance)
    rows = []
    for y in window.y:
        kernel = np.exp(-rate * (window.x[:, None] * wave.u.ravel() + y * wave.v.ravel()))
        rows.append(kernel @ pupil.ravel())
    return np.abs(np.array(rows) / np.sum(wave.amplitude * wave.weights)) ** 2


def error(spread, reference):
    difference = np.abs(spread.intensity - reference.intensity).max()
    return difference / reference.intensity.max()


# one sum, however it is taken


@pytest.mark.parametrize("distance", [50e-3, -50e-3])
@pytest.mark.parametrize("shape", [(33, 40), (34, 37)])
def test_sum_over_scattered_nodes_is_the_direct_sum(distance, shape):
    wave = scattered_wave(COMA, random_nodes(3000), image_distance=distance)
    wave = replace(wave, amplitude=1 + 0.5 * wave.u / RADIUS)
    spread = psf.point_spread(
        wave, method="nufft", pitch=UNIT / 2, shape=shape, normalisation="ideal-peak"
    )
    expected = direct_intensity(wave, Window.centred(UNIT / 2, shape))
    # the transform is asked for 2e-13 rms
    assert np.abs(spread.intensity - expected).max() < 1e-12 * expected.max()


@pytest.mark.parametrize("samples", [64, 65])
def test_a_grid_is_the_same_sum_as_fft_and_mdft(samples):
    wave = zernike_wave(COMA, nodes="grid", samples=samples)
    fft = psf.point_spread(wave, method="fft", shape=61)
    for method in ("nufft", "mdft"):
        spread = psf.point_spread(wave, method=method, pitch=fft.pitch, shape=61)
        assert error(spread, fft) < 1e-12
    # nodes without a layout are the same nodes
    spread = psf.point_spread(flattened(wave), method="nufft", pitch=fft.pitch, shape=61)
    assert error(spread, fft) < 1e-12


@pytest.mark.parametrize("distance", [50e-3, -50e-3])
def test_tilt_moves_the_spot_along_it(distance):
    wave = scattered_wave({2: 2.0, 3: -1.0}, sunflower(2000), image_distance=distance)
    spread = psf.point_spread(wave, method="nufft", pitch=UNIT / 4, shape=129)
    row, column = np.unravel_index(np.argmax(spread.intensity), spread.shape)
    expected = 2 * WAVELENGTH / RADIUS * distance * np.array([2.0, -1.0])
    # 8 and 4 lambda N, both whole samples
    assert (spread.x[column], spread.y[row]) == approx(expected, abs=1e-12)


# error estimates


@pytest.mark.parametrize("nodes", [sunflower, random_nodes])
@pytest.mark.parametrize(
    ("waves", "count", "obscuration"),
    [
        ({}, 1000, 0.0),
        ({}, 4000, 0.4),
        (COMA, 4000, 0.0),
        pytest.param({4: 1.0}, 20000, 0.0, marks=pytest.mark.thorough),
        pytest.param({11: 0.3, 6: 0.5}, 16000, 0.3, marks=pytest.mark.thorough),
    ],
)
def test_estimates_bound_the_error(nodes, waves, count, obscuration):
    wave = scattered_wave(waves, nodes(count, obscuration), obscuration)
    reference = zernike_wave(waves, obscuration=obscuration)
    for kwargs in (
        {"pitch": UNIT / 3, "shape": 129},
        {"pitch": 4 * UNIT, "shape": 11, "pixel_integrated": True},
    ):
        spread = psf.point_spread(wave, method="nufft", **kwargs)
        exact = psf.point_spread(reference, method="quadrature", **kwargs)
        assert error(spread, exact) <= spread.error_estimate
        # it follows the error closely
        assert spread.error_estimate < 3 * error(spread, exact)


def test_monte_carlo_weights_are_known_to_be_poor():
    """Equal areas of random nodes err by 1/sqrt(n); the estimate sees it."""
    wave = scattered_wave(COMA, random_nodes(4000))
    wave = replace(wave, weights=np.full(4000, math.pi * RADIUS**2 / 4000))
    kwargs = {"pitch": UNIT / 3, "shape": 65}
    spread = psf.point_spread(wave, method="nufft", **kwargs)
    exact = psf.point_spread(zernike_wave(COMA), method="quadrature", **kwargs)
    assert 0.01 < error(spread, exact) <= spread.error_estimate


def test_nodes_that_would_alias_are_refused():
    with pytest.raises(SamplingError, match=r"aberration jumps .* waves at node .*, limit 0.50"):
        psf.point_spread(scattered_wave({4: 3.0}, sunflower(1000)), pitch=UNIT / 3, shape=289)
    with pytest.raises(SamplingError, match="repeat the spot every") as refusal:
        psf.point_spread(scattered_wave({}, sunflower(400)), pitch=UNIT / 3, shape=257)
    needed = int(str(refusal.value).split("use ")[1].split(" or more")[0])
    psf.point_spread(scattered_wave({}, sunflower(needed + 50)), tol=0.1, pitch=UNIT / 3, shape=257)


# rays and aimed nodes


def test_traced_rays_give_the_aimed_point_spread(flat_scene):
    scene = replace(flat_scene, wall=ConcaveWall(60.0))
    rays = raytrace.pupil_rays(scene, n_rays=20000)
    wave = psf.wavefront_from_rays(rays, psf.exit_pupil(scene), scene.laser.wavelength)
    polar = psf.wavefront(scene)
    # what the curved wall leaves beside the tilt
    kwargs = {"pitch": polar.wavelength * polar.f_number / 3, "shape": 161}
    exact = psf.point_spread(polar, method="quadrature", **kwargs)
    spread = psf.point_spread(wave, tol=0.1, **kwargs)
    assert spread.method == "nufft"
    assert error(spread, exact) <= spread.error_estimate < 0.05


def test_aimed_nodes_in_an_array(flat_scene):
    """Equal areas on a sunflower are nearly its cells."""
    u, v = (c * psf.exit_pupil(flat_scene).radius / RADIUS for c in sunflower(5000))
    wave = psf.wavefront(flat_scene, nodes=np.stack([u, v], axis=1))
    kwargs = {"pitch": wave.wavelength * wave.f_number / 3, "shape": 65}
    spread = psf.point_spread(wave, tol=0.1, **kwargs)
    exact = psf.point_spread(psf.wavefront(flat_scene), method="quadrature", **kwargs)
    assert spread.method == "nufft"
    assert error(spread, exact) <= spread.error_estimate < 0.1


def test_local_slopes_are_the_gradient():
    """Cubics through scattered nodes against the derivatives of x^2 y and x y."""
    wave = scattered_wave({}, random_nodes(2000))
    a, b = wave.u / RADIUS, wave.v / RADIUS
    surface = WAVELENGTH * (a * a * b - 2 * a * b)
    residual = split(replace(wave, aberration=surface))
    tilt_u, tilt_v = residual.tilt
    expected = WAVELENGTH / RADIUS * np.stack([2 * a * b - 2 * b, a * a - 2 * a], axis=1)
    # a cubic is in the fit's space: rounding over the neighbours' spacing, and the ridge
    found = residual.local.slopes + np.array([tilt_u, tilt_v])
    assert np.abs(found - expected).max() < 1e-8 * WAVELENGTH / RADIUS


def test_crowded_spokes_find_neighbours_across():
    """Polar nodes without their layout: the nearest lie in a line, next to the rim."""
    wave = flattened(zernike_wave({6: 1.0}, samples=(40, 160)))
    residual = split(wave)
    bend = 2 * math.sqrt(6) * WAVELENGTH / RADIUS**2
    # W = sqrt(6) (u^2 - v^2) lambda/a^2, on which farther neighbours are as good as near ones
    expected = bend * np.stack([wave.u, -wave.v], axis=1)
    found = residual.local.slopes + np.array(residual.tilt)
    assert np.abs(found - expected).max() < 1e-6 * bend * RADIUS


def test_nodes_in_a_line_are_refused():
    u = np.linspace(-RADIUS, RADIUS, 100)
    wave = scattered_wave({}, random_nodes(100))
    line = replace(wave, u=u, v=0 * u)
    with pytest.raises(SamplingError, match="lie on a few lines"):
        psf.point_spread(line, pitch=UNIT / 4, shape=32)


# comparison


def test_absurd_windows_are_refused_before_they_are_allocated():
    wave = scattered_wave({}, sunflower(500))
    for method in ("auto", "nufft"):
        with pytest.raises(MemoryLimitError, match="GiB"):
            psf.point_spread(wave, method=method, pitch=UNIT / 4, shape=10**7)
