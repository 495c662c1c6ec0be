"""Antialiased grids of pupils of any outline: errors against quadrature at every tolerance."""

import itertools
import math

import numpy as np
import pytest
from pytest import approx

from nlosoptics import psf
from nlosoptics.psf.aperture.quadrature_nodes import gauss_legendre
from nlosoptics.psf.transform import spread_grid
from nlosoptics.psf.wave.detilted import split
from nlosoptics.psf.wave.zernikes import zernike_sum

WAVELENGTH, RADIUS, DISTANCE = 632.8e-9, 12.5e-3, 50e-3
UNIT = WAVELENGTH * DISTANCE / (2 * RADIUS)
TOLS = (1e-2, 1e-3, 2e-5, 1e-7, 1e-10)
MIX = {4: 0.0859, 5: 0.0429, 6: 0.0859, 7: 0.0515, 8: 0.0859, 11: 0.0429}


def random_pupil(rng):
    """Vaned, segmented, polygonal, elliptic, vignetted or divided pupil."""
    kind, outline = rng.integers(6), psf.Aperture
    if kind == 0:
        vanes, width = int(rng.integers(2, 7)), rng.uniform(0.01, 0.08) * RADIUS
        return outline.round(RADIUS, rng.uniform(0.05, 0.5), vanes=vanes, vane_width=width)
    if kind == 1:
        rings, flats = int(rng.integers(1, 3)), rng.uniform(0.35, 0.4) * RADIUS
        return outline.hexagons(rings, flats, 0.02 * RADIUS, central=bool(rng.integers(2)))
    if kind == 2:
        n = int(rng.integers(5, 10))
        turn = 2 * np.pi * (np.arange(n) + rng.uniform(-0.3, 0.3, n)) / n
        corners = np.stack([np.cos(turn), np.sin(turn)], axis=1)
        return outline.polygon(RADIUS * rng.uniform(0.35, 1, n)[:, None] * corners)
    if kind == 3:
        inner = float(rng.choice([0.0, 0.3, 0.6]))
        return outline.ellipse(RADIUS, rng.uniform(0.4, 1) * RADIUS, 0.7, obscuration=inner)
    if kind == 4:
        return outline.discs([((0, 0), RADIUS), ((rng.uniform(0.1, 0.8) * RADIUS, 0), RADIUS)])
    disc, square = outline.round(0.4 * RADIUS), outline.regular(4, 0.4 * RADIUS, 0.3)
    return outline.union(disc.moved((-0.55 * RADIUS, 0)), square.moved((0.55 * RADIUS, 0)))


def random_wave(rng, outline):
    """Zernike polynomials of up to ten waves, some with segments out of line or uneven."""
    indices = rng.choice(np.arange(2, 29), 6, replace=False).tolist()
    heights = rng.normal(size=6)
    heights *= WAVELENGTH / 6 * 10 ** rng.uniform(-1.5, 1) / np.linalg.norm(heights)
    waves, n = dict(zip(indices, heights.tolist(), strict=True)), len(outline.cells)
    alone, uneven = rng.integers(3, size=2) == 0
    return psf.Wavefront.from_function(
        lambda u, v: zernike_sum(waves, u, v, RADIUS, "noll"),
        wavelength=WAVELENGTH,
        image_distance=float(rng.choice([DISTANCE, -1.4 * DISTANCE])),
        pupil_radius=RADIUS,
        aperture=outline,
        amplitude=(lambda u, v: np.exp((0.3 * u - 0.2 * v) / RADIUS)) if uneven else None,
        pistons=WAVELENGTH * rng.uniform(-0.5, 0.5, n) if alone else None,
        tilts=WAVELENGTH / RADIUS * rng.uniform(-1, 1, (n, 2)) if alone else None,
    )


@pytest.mark.parametrize("seed", range(24))
def test_estimates_bound_the_error_at_every_tolerance(seed):
    rng = np.random.default_rng([61, seed])
    wave = random_wave(rng, random_pupil(rng))
    shape = tuple(rng.integers(20, 90, 2).tolist())
    residual = split(wave)
    far = residual.rays.reach + max(map(abs, residual.shift))
    pitch = max(UNIT * 10 ** rng.uniform(-1.3, 0.3), 2.2 * (far + UNIT) / min(shape))
    options = {"pitch": pitch, "shape": shape, "pixel_integrated": bool(rng.integers(2))}
    options.update(normalisation="ideal-peak", model="scalar")
    truth = psf.point_spread(wave, method="quadrature", tol=1e-13, **options)
    for tol in TOLS:
        if truth.error_estimate > tol / 10:  # its own nodes leave that much
            continue
        for method in ("fft", "mdft", "auto"):
            found = psf.point_spread(wave, method=method, tol=tol, **options)
            difference = np.abs(found.intensity - truth.intensity).max() / truth.intensity.max()
            assert difference < found.error_estimate, (method, tol)
            if method == "auto":
                assert found.error_estimate <= tol


@pytest.mark.parametrize("method", ["fft", "mdft"])
def test_errors_fall_with_the_tolerance(method):
    wave = psf.Wavefront.from_zernike(
        {j: a * WAVELENGTH for j, a in MIX.items()},
        wavelength=WAVELENGTH,
        image_distance=DISTANCE,
        pupil_radius=RADIUS,
        aperture=psf.Aperture.round(RADIUS, 0.2, vanes=4, vane_width=0.04 * RADIUS),
    )
    options = {"pitch": 0.1 * UNIT, "shape": 128}
    truth = psf.point_spread(wave, method="quadrature", tol=1e-13, **options).intensity
    errors = [
        np.abs(psf.point_spread(wave, method=method, tol=tol, **options).intensity - truth).max()
        / truth.max()
        for tol in (1e-1, 1e-5, 1e-7, 1e-9)
    ]
    # two decades of tolerance a step, or more; whole nodes and widths take a third of a decade
    assert all(b < a / 50 for a, b in itertools.pairwise(errors))


def test_a_box_is_a_product_of_sincs():
    box = psf.Aperture.polygon(
        RADIUS * np.array([(-0.5, -0.3), (0.5, -0.3), (0.5, 0.3), (-0.5, 0.3)])
    )
    wave = psf.Wavefront.from_function(
        wavelength=WAVELENGTH, image_distance=DISTANCE, pupil_radius=RADIUS, aperture=box
    )
    for method, tol in (("mdft", 1e-3), ("mdft", 1e-8), ("fft", 1e-3), ("fft", 1e-8)):
        found = psf.point_spread(
            wave, method=method, tol=tol, pitch=UNIT / 3, shape=(51, 64), normalisation="ideal-peak"
        )
        x, y = found.x / UNIT / 2, found.y / UNIT / 2
        closed = np.sinc(x) ** 2 * np.sinc(0.6 * y)[:, None] ** 2
        assert np.abs(found.intensity - closed).max() < found.error_estimate <= tol


def test_auto_buys_time_with_the_tolerance():
    outline = psf.Aperture.hexagons(2, 0.4 * RADIUS, 0.01 * RADIUS)
    wave = psf.Wavefront.from_zernike(
        {4: 0.1 * WAVELENGTH},
        wavelength=WAVELENGTH,
        image_distance=DISTANCE,
        pupil_radius=RADIUS,
        aperture=outline,
    )

    def chosen(tol, pitch, shape):
        found = psf.point_spread(wave, tol=tol, pitch=pitch * UNIT, shape=shape, model="scalar")
        assert found.error_estimate <= tol
        return found.method

    # few Airy units make few cells, whose products are the cheapest; FFTs win on wide windows
    assert chosen(1e-3, 0.1, 128) == "mdft"
    assert chosen(1e-3, 0.45, 400) == "fft"
    # a tolerance below what chosen nodes promise
    assert chosen(5e-12, 0.1, 64) == "quadrature"


def test_energy_is_that_of_quadrature():
    outline = psf.Aperture.round(RADIUS, 0.3, vanes=3, vane_width=0.05 * RADIUS)
    wave = psf.Wavefront.from_zernike(
        {8: 0.3 * WAVELENGTH},
        wavelength=WAVELENGTH,
        image_distance=DISTANCE,
        pupil_radius=RADIUS,
        aperture=outline,
    )
    options = {"pitch": 2 * UNIT, "shape": 61, "pixel_integrated": True}
    truth = psf.point_spread(wave, method="quadrature", tol=1e-13, **options)
    for method in ("fft", "mdft"):
        found = psf.point_spread(wave, method=method, tol=1e-4, **options)
        # errors add up over 61^2 pixels as random numbers would, or less
        room = 61 * found.error_estimate * truth.intensity.max()
        assert found.enclosed_energy == approx(truth.enclosed_energy, abs=room)
        assert room < 2e-3


@pytest.mark.parametrize("oversampling", spread_grid.OVERSAMPLINGS)
@pytest.mark.parametrize("width", spread_grid.WIDTHS)
def test_repeats_of_the_kernel_stay_below_their_bounds(width, oversampling):
    beta = spread_grid.sharpness(width, oversampling)
    fraction, weights = gauss_legendre(3000)
    angle = math.pi / 2 * fraction
    heights = (np.exp(beta * (np.cos(angle) - 1)) - np.exp(-beta)) * np.cos(angle) * weights

    def spectrum(frequency):
        return np.sum(heights * np.cos(math.pi * width * frequency * np.sin(angle)))

    edge = 0.5 / oversampling
    # rounding of 300 sums, 1e-15 of the spectrum's peak each
    room = 300 * 1e-15 * spectrum(0.0) / spectrum(edge)
    bounds = spread_grid.leaks(width, oversampling)
    # a bound holds up to its place, so that the next smaller place is the least that it must cover
    for index in range(0, spread_grid.PLACES + 1, 4):
        place = edge * index / spread_grid.PLACES
        beyond = sum(abs(spectrum(k - place)) + abs(spectrum(k + place)) for k in range(1, 150))
        assert beyond / spectrum(place) < bounds[index] + room
    assert np.all(np.diff(bounds) >= 0)
    # a width more reduces the repeats by exp(-pi sqrt(1 - 1/oversampling))
    decades = math.pi * math.sqrt(1 - 1 / oversampling) / math.log(10)
    assert bounds[-1] < 60 * 10.0 ** (-decades * width) + 1e-11


def test_each_block_has_the_bound_of_its_outer_edge():
    # 10 pixels in 8 blocks, 16 along the longer side: block 0 begins at the edge of 10/16 of half
    # the window, block 4 holds pixels 5 and 6, whose outer edge is 2 of 8 pixels from the middle
    index = spread_grid._outer(10, 8, 16)
    assert index[0] == 10 * spread_grid.PLACES // 16
    assert index[4] == 2 * 2 * spread_grid.PLACES // 16
    assert spread_grid._outer(64, 8, 64).tolist() == [16, 12, 8, 4, 4, 8, 12, 16]


def test_spread_nodes_are_read_only():
    outline = psf.Aperture.regular(6, RADIUS)
    grid = spread_grid.SpreadGrid(1e-3, 20, 6, 1.5, single=False)
    for part in spread_grid._kept_cells_of(outline, 8, 8, grid):
        assert not part.flags.writeable
