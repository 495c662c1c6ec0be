"""Pupils of any outline against closed forms, denser rules and grids."""

import numpy as np
import pytest
from pytest import approx
from scipy.special import j1

from nlosoptics import psf
from nlosoptics.errors import SamplingError
from nlosoptics.psf.rough.otf import transfer
from nlosoptics.psf.transform import nufft, quadrature
from nlosoptics.psf.wave.detilted import split
from nlosoptics.psf.window.window import Window

WAVELENGTH, DISTANCE = 632.8e-9, 50e-3
SYSTEM = {"wavelength": WAVELENGTH, "image_distance": DISTANCE}
MM = 1e-3
WINDOW = Window.centred(1.2e-6, (90, 81))

BOX = MM * np.array([(-5, -3), (5, -3), (5, 3), (-5, 3)])
#: seen from its centroid, and not
ARROW = 5 * MM * np.array([(0, 0), (2, 0), (2, 1), (1, 1.01), (0.4, 0.4), (0, 2)])
HOOK = 2 * MM * np.array([(0, 0), (4, 0), (4, 3), (1, 3), (1, 2), (3, 2), (3, 1), (0, 1)])
#: The ends of both tines lie on one line.
FORK = MM * np.array([[-3, -2], [3, -2], [3, 2], [1, 2], [1, 0], [-1, 0], [-1, 2], [-3, 2]])
APERTURES = {
    "ellipse": psf.Aperture.ellipse(10 * MM, 6 * MM, 0.4),
    "ring": psf.Aperture.ellipse(10 * MM, 6 * MM, 0.4, obscuration=0.35),
    "shifted": psf.Aperture.ellipse(4 * MM, 3 * MM, centre=(3 * MM, -2 * MM)),
    "box": psf.Aperture.polygon(BOX),
    "triangle": psf.Aperture.regular(3, 9 * MM, 0.2),
    "pentagon": psf.Aperture.regular(5, 9 * MM, 0.2, obscuration=0.3),
    "octagon": psf.Aperture.regular(8, 9 * MM, 0.2),
    "arrow": psf.Aperture.polygon(ARROW),
    "hook": psf.Aperture.polygon(HOOK[::-1]),
    "hexagons": psf.Aperture.hexagons(2, 4 * MM, 0.1 * MM, angle=0.2),
    "lens": psf.Aperture.discs([((-2 * MM, 0), 8 * MM), ((3 * MM, MM), 7 * MM)]),
    "three discs": psf.Aperture.discs(
        [((0, 0), 9 * MM), ((3 * MM, 0), 8 * MM), ((0, 12 * MM), 12 * MM)]
    ),
    "vanes": psf.Aperture.round(9 * MM, 0.3, vanes=3, vane_width=0.3 * MM, angle=0.1),
    "cross": psf.Aperture.round(9 * MM, vanes=4, vane_width=0.3 * MM),
    "one vane": psf.Aperture.round(9 * MM, 0.3, vanes=1, vane_width=0.3 * MM),
}
every_aperture = pytest.mark.parametrize("name", APERTURES)


def bumpy(u, v):
    """About a wave, of no finite series."""
    x, y = u / (9 * MM), v / (9 * MM)
    return WAVELENGTH * (0.4 * np.exp(0.7 * x * y) + 0.3 * np.sin(3 * x - y) + 0.2 * x**3)


def polygon_field(corners, x, y):
    """Transform of a polygon over its area, a sum over its sides (Komrska, JOSA 72, 1382, 1982)."""
    square = x**2 + y**2
    total, area = np.zeros(square.shape, dtype=complex), 0.0
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        side, middle = b - a, (a + b) / 2
        area += (a[0] * b[1] - a[1] * b[0]) / 2
        wave = np.exp(-2j * np.pi * (x * middle[0] + y * middle[1]))
        total += (x * side[1] - y * side[0]) * np.sinc(x * side[0] + y * side[1]) * wave
    safe = np.where(square == 0, 1.0, square)
    return np.where(square == 0, 1.0, 1j * total / (2 * np.pi * safe) / area)


def disc_field(radius, x, y):
    v = 2 * np.pi * radius * np.hypot(x, y) + 1e-12
    return 2 * j1(v) / v


def frequencies(window=WINDOW):
    y, x = np.meshgrid(window.y, window.x, indexing="ij")
    return x / (WAVELENGTH * DISTANCE), y / (WAVELENGTH * DISTANCE)


def of(aperture, aberration=None, **changes):
    return psf.Wavefront.from_function(aberration, aperture=aperture, **{**SYSTEM, **changes})


def field(wave, window=WINDOW):
    residual = split(wave)
    nodes = quadrature.nodes(residual, window, quadrature.node_counts(residual, window))
    return nufft.field(residual, nodes, window)


def error(spread, reference):
    return np.abs(spread.intensity - reference.intensity).max() / reference.intensity.max()


# outlines


@every_aperture
def test_nodes_and_squares_hold_the_area(name):
    aperture = APERTURES[name]
    u, v, weights = aperture.nodes(24, 24)
    assert weights.min() > 0
    assert weights.sum() == approx(aperture.area, rel=1e-14)
    assert aperture.contains(u, v).all()
    assert np.hypot(u, v).max() < aperture.bounding_radius
    for samples in (64, 65):
        _, _, squares, _ = aperture.grid_nodes(samples)
        # squares are differences of areas, rounding 1e-16 of the whole each
        assert squares.sum() == approx(aperture.area, rel=1e-13)


def test_areas_in_closed_form():
    assert APERTURES["ring"].area == approx(np.pi * 60 * MM**2 * (1 - 0.35**2), rel=1e-14)
    assert APERTURES["octagon"].area == approx(4 * 81 * MM**2 * np.sin(np.pi / 4), rel=1e-14)
    assert APERTURES["hexagons"].area == approx(19 * 16 * MM**2 * np.sqrt(3) / 2, rel=1e-14)
    assert APERTURES["hook"].area == approx(32 * MM**2, rel=1e-14)
    # its centre passes close by the sides, as seen from the far ends
    slit = psf.Aperture.polygon([(0, 0), (2, 0), (2, 0.05), (0, 0.05)], obscuration=0.5)
    assert slit.area == approx(0.75 * 0.1, rel=1e-14)
    assert slit.nodes(4, 4)[2].min() > 0
    # two equal circles through each other's centres
    lens = psf.Aperture.discs([((0, 0), 1.0), ((1, 0), 1.0)])
    assert lens.area == approx(2 * np.pi / 3 - np.sqrt(3) / 2, rel=1e-14)

    def strip(radius):  # of half width 0.15 mm, from the axis to the rim
        h = 0.15 * MM
        return h * np.sqrt(radius**2 - h**2) + radius**2 * np.arcsin(h / radius)

    ring = np.pi * (81 - 2.7**2) * MM**2
    assert APERTURES["vanes"].area == approx(ring - 3 * (strip(9 * MM) - strip(2.7 * MM)))
    inner = APERTURES["cross"]
    assert inner.area == approx(np.pi * 81 * MM**2 - 4 * strip(9 * MM) + 0.09 * MM**2, rel=1e-13)


@pytest.mark.parametrize("name", ["shifted", "arrow", "hook", "lens", "vanes", "hexagons"])
def test_square_areas_are_those_of_fine_points(name):
    aperture, n, fine = APERTURES[name], 11, 90
    u, v, squares, _ = aperture.grid_nodes(n)
    pitch = u[0, 1] - u[0, 0]
    steps = (np.arange(fine) + 0.5) / fine - 0.5
    a = u[:, :, None, None] + pitch * steps
    b = v[:, :, None, None] + pitch * steps[:, None]
    counted = aperture.contains(a, b).mean(axis=(2, 3)) * pitch**2
    # 90 x 90 points count a square that a rim cuts to about a row in 90, several rims add
    assert squares / pitch**2 == approx(counted / pitch**2, abs=0.02)


def test_least_and_widest_extents():
    ellipse = psf.Aperture.ellipse(2.0, 1.0, 0.3)
    assert ellipse.half_width == approx(np.hypot(2 * np.cos(0.3), np.sin(0.3)), rel=1e-14)
    # farthest point by a parabola through points 0.7 degrees apart
    assert ellipse.bounding_radius == approx(2.0, rel=1e-9)
    assert APERTURES["box"].bounding_radius == approx(np.hypot(5, 3) * MM, rel=1e-14)
    assert APERTURES["box"].perimeter == approx(32 * MM, rel=1e-14)
    assert psf.Aperture.round(2.0, 0.5).perimeter == approx(6 * np.pi, rel=1e-14)


def test_equal_discs_and_discs_that_cut_nothing():
    whole = psf.Aperture.discs([((0, 0), 1.0), ((0, 0), 1.0), ((0.2, 0), 3.0)])
    assert whole.area == approx(np.pi, rel=1e-14)
    twice = psf.Aperture.discs([((0, 0), 1.0), ((1, 0), 1.0), ((0.5, 0.1), 5.0)])
    assert twice.area == approx(2 * np.pi / 3 - np.sqrt(3) / 2, rel=1e-14)


def test_discs_within_a_polygon():
    slit = [(-0.5, -2), (0.5, -2), (0.5, 2), (-0.5, 2)]
    cut = psf.Aperture.discs([((0, 0), 1.0)], within=slit)
    # two sectors of 60 degrees and four right triangles
    assert cut.area == approx(np.pi / 3 + np.sqrt(3) / 2, rel=1e-14)
    corners = psf.Aperture.discs(
        [((0, 0), 1.0)], within=0.8 * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    )
    segment = np.arccos(0.8) - 0.8 * 0.6
    assert corners.area == approx(np.pi - 4 * segment, rel=1e-14)
    assert corners.nodes(20, 20)[2].sum() == approx(corners.area, rel=1e-14)
    inside = psf.Aperture.discs([((0, 0), 9.0), ((1, 0), 9.0)], within=slit)
    assert inside.area == approx(4.0, rel=1e-14)


def test_hexagons_stand_a_gap_apart():
    aperture = psf.Aperture.hexagons(1, 1.0, 0.25, angle=0.1)
    centres = np.array([cell.centroid for cell in aperture.cells])
    assert np.hypot(*centres[0]) == approx(0.0, abs=1e-15)
    assert np.hypot(*(centres[1:] - centres[0]).T) == approx(np.full(6, 1.25))
    assert np.arctan2(centres[1, 1], centres[1, 0]) == approx(0.1 + np.pi / 6)
    assert len(psf.Aperture.hexagons(2, 1.0, central=False).cells) == 18


def test_cells_may_touch():
    square = psf.Aperture.polygon([(0, 0), (1, 0), (1, 1), (0, 1)])
    pair = psf.Aperture.union(square, square.moved((1.0, 0.0)))
    assert pair.area == approx(2.0, rel=1e-15)
    assert len(psf.Aperture.union(psf.Aperture.hexagons(2, 1.0)).cells) == 19


# clear apertures in closed form; the nodes have converged, the transform is asked for 2e-13 rms


def test_ellipse_is_a_scaled_airy_disc():
    x, y = frequencies()
    c, s = np.cos(0.4), np.sin(0.4)
    along, across = 10 * MM * (x * c + y * s), 6 * MM * (y * c - x * s)
    closed = disc_field(1.0, along, across)
    assert np.abs(np.abs(field(of(APERTURES["ellipse"]))) - np.abs(closed)).max() < 1e-12
    hole = disc_field(0.35, along, across)
    closed = (closed - 0.35**2 * hole) / (1 - 0.35**2)
    assert np.abs(np.abs(field(of(APERTURES["ring"]))) - np.abs(closed)).max() < 1e-12


def test_box_is_a_product_of_sincs():
    x, y = frequencies()
    closed = np.sinc(10 * MM * x) * np.sinc(6 * MM * y)
    assert np.abs(np.abs(field(of(APERTURES["box"]))) - np.abs(closed)).max() < 1e-12


@pytest.mark.parametrize("sides", [3, 4, 5, 6, 7, 8, 40])
def test_regular_polygons(sides):
    turn = 0.2 + 2 * np.pi * np.arange(sides) / sides
    corners = 9 * MM * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    closed = polygon_field(corners, *frequencies())
    wave = of(psf.Aperture.regular(sides, 9 * MM, 0.2))
    assert np.abs(np.abs(field(wave)) - np.abs(closed)).max() < 1e-12


@pytest.mark.parametrize("corners", [ARROW, HOOK, FORK], ids=["arrow", "hook", "fork"])
def test_polygons_that_are_not_convex(corners):
    wave = of(psf.Aperture.polygon(corners))
    closed = polygon_field(corners, *frequencies())
    assert np.abs(np.abs(field(wave)) - np.abs(closed)).max() < 1e-12


def test_segments_are_a_hexagon_times_an_array_factor():
    aperture = APERTURES["hexagons"]
    x, y = frequencies()
    turn = 0.2 + np.pi / 3 * np.arange(6)
    corners = 4 * MM / np.sqrt(3) * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    centres = np.array([cell.centroid for cell in aperture.cells])
    factor = sum(np.exp(-2j * np.pi * (x * a + y * b)) for a, b in centres) / len(centres)
    closed = polygon_field(corners, x, y) * factor
    assert np.abs(np.abs(field(of(aperture))) - np.abs(closed)).max() < 1e-12


def test_pistons_and_tilts_of_segments():
    """Each segment's spot moves and turns its phase; all add up."""
    aperture, rng = APERTURES["hexagons"], np.random.default_rng(3)
    pistons = rng.normal(size=19) * WAVELENGTH
    tilts = rng.normal(size=(19, 2)) * WAVELENGTH / (4 * MM)
    x, y = frequencies()
    turn = 0.2 + np.pi / 3 * np.arange(6)
    corners = 4 * MM / np.sqrt(3) * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    closed = 0.0
    for cell, piston, tilt in zip(aperture.cells, pistons, tilts, strict=True):
        a, b = cell.centroid
        wave = np.exp(2j * np.pi * (piston / WAVELENGTH - x * a - y * b))
        closed = closed + wave * polygon_field(
            corners, x - tilt[0] / WAVELENGTH, y - tilt[1] / WAVELENGTH
        )
    wave = of(aperture, pistons=pistons, tilts=tilts)
    assert np.abs(np.abs(field(wave)) - np.abs(closed) / 19).max() < 1e-12
    assert psf.strehl(wave) == approx(
        np.abs(closed[45, 40] / 19) ** 2, abs=1e-13
    )  # WINDOW's sample on the axis


def test_two_telescopes_have_fringes():
    disc = psf.Aperture.round(3 * MM)
    pair = psf.Aperture.union(disc.moved((-5 * MM, 0)), disc.moved((5 * MM, 0)))
    x, y = frequencies()
    path = 0.15 * WAVELENGTH
    closed = disc_field(3 * MM, x, y) * np.cos(2 * np.pi * (5 * MM * x - path / WAVELENGTH))
    wave = of(pair, pistons=[-path, path])
    assert np.abs(np.abs(field(wave)) - np.abs(closed)).max() < 1e-12
    assert wave.pupil_radius == approx(8 * MM)
    assert wave.flux == approx(2 * 9 / 64, rel=1e-14)


# aberrated apertures


@pytest.mark.thorough
@every_aperture
def test_aberrated_apertures_are_the_direct_sum(name):
    aperture = APERTURES[name]
    wave = of(aperture, bumpy, amplitude=lambda u, v: 1 + 40 * u - 3000 * v**2)
    window = Window.centred(4e-6, (9, 8))
    x, y = frequencies(window)
    u, v, weights = (a.ravel() for a in aperture.nodes(70, 70))
    size = weights * (1 + 40 * u - 3000 * v**2)
    pupil = size * np.exp(2j * np.pi / WAVELENGTH * bumpy(u, v))
    turns = np.multiply.outer(x, u) + np.multiply.outer(y, v)
    expected = np.abs(np.exp(-2j * np.pi * turns) @ pupil) / size.sum()
    # the series lacks 1e-10 rad at most by its own estimate, which is a bound with room
    assert np.abs(field(wave, window)) == approx(expected, abs=1e-12)
    assert psf.strehl(wave) == approx(expected[4, 4] ** 2, abs=1e-12)


@pytest.mark.parametrize("name", ["ellipse", "arrow", "lens", "octagon", "cross"])
@pytest.mark.parametrize("samples", [4, 6, 8])
def test_estimate_bounds_the_lack_of_nodes(name, samples):
    window = {"pitch": 0.6e-6, "shape": 96, "method": "quadrature"}
    truth = psf.point_spread(of(APERTURES[name], bumpy, samples=40), **window)
    few = psf.point_spread(of(APERTURES[name], bumpy, samples=samples), **window)
    assert truth.error_estimate < 1e-9
    missed = error(few, truth)
    assert 1e-11 < missed < few.error_estimate
    # the last terms are larger than those that lack, which are 0 at the nodes and average out
    assert few.error_estimate < 2e5 * missed


def test_round_aperture_is_the_polar_pupil():
    coefficients = {4: 0.3 * WAVELENGTH, 8: 0.2 * WAVELENGTH}
    given = {"pupil_radius": 9 * MM, **SYSTEM}
    polar = psf.Wavefront.from_zernike(coefficients, obscuration=0.3, **given)
    cells = psf.Wavefront.from_zernike(
        coefficients, aperture=psf.Aperture.round(9 * MM, 0.3), **given
    )
    assert cells.layout == "cells"
    assert np.abs(np.abs(field(cells)) - np.abs(field(polar))).max() < 1e-11
    assert psf.strehl(cells) == approx(psf.strehl(polar), rel=1e-11)
    assert psf.rms_aberration(cells) == approx(psf.rms_aberration(polar), rel=1e-11)
    fitted = psf.fit_zernike(cells, 8)
    assert fitted[8] == approx(0.2 * WAVELENGTH, rel=1e-9)
    assert psf.spot_radius(cells) == approx(psf.spot_radius(polar), rel=1e-10)
    assert psf.centroid(cells) == approx(psf.centroid(polar), abs=1e-15)


def test_resampling_changes_nothing():
    wave = of(APERTURES["arrow"], bumpy)
    finer = wave.resampled(40, 44)
    assert finer.u.shape[1:] == (40, 44)
    assert finer.aberration == approx(bumpy(finer.u, finer.v), abs=1e-11 * WAVELENGTH)
    window = {"pitch": 0.6e-6, "shape": 48}
    straight = psf.point_spread(finer, method="nufft", **window)
    assert error(straight, psf.point_spread(wave, method="quadrature", **window)) < 1e-11
    with pytest.raises(SamplingError, match="fewer than the present"):
        finer.resampled(10, 44)


# grids


@pytest.mark.parametrize(
    ("name", "aberration", "pixels"),
    [
        ("ellipse", bumpy, True),
        ("box", None, False),
        ("arrow", None, True),
        ("vanes", bumpy, False),
    ],
)
def test_grids_agree_within_their_estimate(name, aberration, pixels):
    aperture = APERTURES[name]
    window = {"pitch": 0.75e-6, "shape": 96, "pixel_integrated": pixels}
    if pixels:
        window = {"pitch": 4e-6, "shape": 32, "pixel_integrated": True}
    truth = psf.point_spread(of(aperture, aberration), **window, model="scalar")
    errors = []
    for samples in (128, 256):
        grid = of(aperture, aberration, nodes="grid", samples=samples)
        assert grid.weights.sum() == approx(aperture.area, rel=1e-12)
        spread = psf.point_spread(grid, method="mdft", **window)
        errors.append(error(spread, truth))
        assert errors[-1] < spread.error_estimate
        # bounds add up what in truth differs in sign
        assert spread.error_estimate < 100 * errors[-1]
        assert error(psf.point_spread(grid, method="nufft", **window), spread) < 1e-8
    # second order, on rims that squares cut by chance
    assert errors[1] < 0.4 * errors[0]


def test_segments_on_a_grid():
    aperture, rng = APERTURES["hexagons"], np.random.default_rng(5)
    # more than half a wave apart, which no smooth wave may be between squares
    terms = {
        "pistons": rng.normal(size=19) * WAVELENGTH,
        "tilts": rng.normal(size=(19, 2)) * WAVELENGTH / (20 * MM),
    }
    window = {"pitch": 0.75e-6, "shape": 96}
    truth = psf.point_spread(of(aperture, **terms), **window, model="scalar")
    for samples in (128, 400):  # squares wider and narrower than the gap
        grid = of(aperture, nodes="grid", samples=samples, **terms)
        spread = psf.point_spread(grid, method="mdft", **window)
        assert error(spread, truth) < spread.error_estimate
    assert spread.error_estimate < 0.01
    assert psf.centroid(grid) == approx(psf.centroid(of(aperture, **terms)), abs=2e-7)


@pytest.mark.parametrize("samples", [128, 256])
def test_transfer_function_of_a_box_on_a_grid(samples):
    """The common area of displaced boxes, a product of triangles."""
    grid = of(APERTURES["box"], nodes="grid", samples=samples)
    found = transfer(split(grid))
    du, dv = np.random.default_rng(0).uniform(-11 * MM, 11 * MM, (2, 2000))
    closed = np.clip(1 - np.abs(du) / (10 * MM), 0, 1) * np.clip(1 - np.abs(dv) / (6 * MM), 0, 1)
    assert np.abs(found.at(du, dv) - closed).max() < found.error < 0.01
    with pytest.raises(SamplingError, match="sample it with nodes="):
        transfer(split(of(APERTURES["box"])))


def test_squares_that_two_cells_share_count_as_one_of_them():
    left = psf.Aperture.polygon(3 * MM * np.array([(-1, -1), (0, -1), (0, 1), (-1, 1)]))
    # not of one width, or what is wrong would be a quarter wave off everywhere
    right = psf.Aperture.polygon(MM * np.array([(0, -3), (1.5, -3), (1.5, 3), (0, 3)]))
    pair = psf.Aperture.union(left, right)
    apart = {"pistons": [0.0, WAVELENGTH / 4]}
    window = {"pitch": 1e-6, "shape": 64}
    truth = psf.point_spread(of(pair, **apart), **window)
    # the middle column lies half in each
    grid = psf.point_spread(of(pair, nodes="grid", samples=129, **apart), method="mdft", **window)
    assert 1e-3 < error(grid, truth) < grid.error_estimate < 0.1
    alike = psf.point_spread(of(pair, nodes="grid", samples=129), method="mdft", **window)
    assert alike.error_estimate < 5e-4  # without a step nothing is mixed


# energy


# other transforms


def strong(u, v):
    """Tens of waves."""
    return WAVELENGTH * (24 * (u / (9 * MM)) ** 2 + 16 * (v / (9 * MM)) ** 3)


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["ellipse", "arrow"])
def test_rays_land_within_their_estimate(name):
    wave = of(APERTURES[name], strong)
    window = {"pitch": 24e-6, "shape": 41, "pixel_integrated": True}
    rays = psf.point_spread(wave, method="geometric", **window)
    truth = psf.point_spread(wave, method="quadrature", tol=1e-3, **window)
    assert rays.enclosed_energy == approx(1.0, abs=1e-3)
    assert error(rays, truth) < rays.error_estimate < 0.8
    # energy in boxes about each ray
    assert psf.centroid(rays) == approx(psf.centroid(wave), abs=0.05 * 24e-6)


def test_rays_of_a_disc_are_those_of_polar_nodes():
    given = {"pupil_radius": 9 * MM, **SYSTEM}
    window = {"method": "geometric", "pitch": 24e-6, "shape": 41, "pixel_integrated": True}
    polar = psf.point_spread(psf.Wavefront.from_function(strong, **given), **window)
    cells = psf.point_spread(of(psf.Aperture.round(9 * MM), strong), **window)
    # rays on other places, a quarter of a pixel apart
    assert error(cells, polar) < 0.02
    assert cells.error_estimate == approx(polar.error_estimate, rel=0.1)
