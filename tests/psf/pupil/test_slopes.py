"""Wave fronts from slopes, and from the facets of a rough wall."""

import numpy as np
import pytest
from pytest import approx
from scipy import fft, ndimage

from nlosoptics import psf
from nlosoptics.errors import SceneError
from nlosoptics.psf.pupil.slope_integration import integrated_slopes, slope_filter
from nlosoptics.raytrace.fans.footprints import lens_footprint

SYSTEM = {"wavelength": 632.8e-9, "image_distance": 50e-3}
RADIUS = 12.5e-3


def axes(n):
    pitch = 2 * RADIUS / n
    axis = (np.arange(n) - n // 2) * pitch
    v, u = np.meshgrid(axis, axis, indexing="ij")
    return u, v, pitch


def masks(n):
    u, v, _ = axes(n)
    r = np.hypot(u, v) / RADIUS
    return {
        "rectangle": np.ones_like(r, dtype=bool),
        "disc": r < 0.98,
        "ring": (r < 0.98) & (r > 0.4),
        "halves": (r < 0.98) & (abs(u) > 0.1 * RADIUS),
        "spots": ndimage.gaussian_filter(np.random.default_rng(2).normal(size=(n, n)), 1.5) > 0,
        "line": (v == 0) & (r < 0.98),
    }


SHAPES = tuple(masks(8))


def quadratic(u, v):
    """A sum of Zernike terms up to astigmatism, m, and its gradient."""
    x, y = u / RADIUS, v / RADIUS
    height = 1e-6 * (3 * x - y + 2 * (2 * (x * x + y * y) - 1) + 1.5 * (x * x - y * y) + 4 * x * y)
    du = 1e-6 * (3 + 8 * x + 3 * x + 4 * y) / RADIUS
    dv = 1e-6 * (-1 + 8 * y - 3 * y + 4 * x) / RADIUS
    return height, np.stack([du, dv], axis=-1)


def by_pieces(values, mask):
    """Values less their mean over every piece of the mask, 0 beside it."""
    pieces, count = ndimage.label(mask)
    out = np.zeros_like(values)
    for i in range(1, count + 1):
        here = pieces == i
        out[here] = values[here] - values[here].mean()
    return out


@pytest.mark.parametrize("n", [32, 65])
@pytest.mark.parametrize("shape", SHAPES)
def test_quadratics_come_back_exactly(shape, n):
    u, v, pitch = axes(n)
    mask = masks(n)[shape]
    height, slopes = quadratic(u, v)
    wave, residual = psf.wavefront_from_slopes(slopes, pitch, mask, **SYSTEM)
    # rounding, amplified by the number of steps across
    assert wave.aberration == approx(by_pieces(height, mask), abs=1e-13 * abs(height).max())
    assert residual < 1e-13 * abs(slopes).max()
    assert np.array_equal(wave.amplitude > 0, mask)
    assert np.array_equal(wave.u, u)
    assert np.array_equal(wave.v, v)


@pytest.mark.parametrize(("index", "degree"), [(8, 3), (11, 4), (14, 4)])
def test_higher_orders_converge_in_second_order(index, degree):
    """Noll terms, their slopes by exact differences of the polynomial in the complex plane."""

    def term(x, y):
        return psf.zernike(index, np.hypot(x, y), np.arctan2(y, x))

    errors, residuals = [], []
    for n in (33, 65, 129):
        u, v, pitch = axes(n)
        mask = np.hypot(u, v) < 0.98 * RADIUS
        x, y = u / RADIUS, v / RADIUS

        # differences over +-1 and +-1/2 by Richardson are exact for polynomials up to degree 4
        def slope(dx, dy, x=x, y=y):
            wide = (term(x + dx, y + dy) - term(x - dx, y - dy)) / 2
            half = term(x + dx / 2, y + dy / 2) - term(x - dx / 2, y - dy / 2)
            return (4 * half - wide) / 3

        slopes = 1e-6 * np.stack([slope(1, 0), slope(0, 1)], axis=-1) / RADIUS
        wave, residual = psf.wavefront_from_slopes(slopes, pitch, mask, **SYSTEM)
        errors.append(np.abs(wave.aberration - by_pieces(1e-6 * term(x, y), mask)).max())
        residuals.append(residual)
    # degree 3 and 4: the trapezoid's error is pitch^2 W'''/12, with edges that move by a node
    assert np.log2(errors[0] / errors[1]) == approx(2, abs=0.25)
    assert np.log2(errors[1] / errors[2]) == approx(2, abs=0.15)
    # what is no gradient of it falls likewise, or is 0
    assert residuals[2] < 0.3 * residuals[1] + 1e-18


@pytest.mark.parametrize("shape", SHAPES)
def test_random_slopes_against_dense_least_squares(shape):
    mask = masks(10)[shape]
    mask[0, 0], mask[0, 1], mask[1, 0] = True, False, False  # a piece of a single node
    rng = np.random.default_rng(5)
    slopes = rng.normal(size=(*mask.shape, 2))
    matrix, right = dense(mask, slopes, 0.3)
    least = np.linalg.lstsq(matrix, right, rcond=None)[0]
    expected = np.zeros(mask.shape)
    expected[mask] = least
    surface, residual = integrated_slopes(slopes, 0.3, mask)
    # the dense solution's own rounding
    assert surface == approx(by_pieces(expected, mask), abs=1e-12)
    misfit = (matrix @ least - right) / 0.3
    assert residual == approx(np.sqrt(np.mean(misfit**2)), rel=1e-12)


def dense(mask, slopes, pitch):
    """Differences of neighbours as a matrix, and what they should be."""
    number = np.full(mask.shape, -1)
    number[mask] = np.arange(mask.sum())
    rows, right = [], []
    for i, j in np.argwhere(mask):
        for k, (a, b) in enumerate(((i, j + 1), (i + 1, j))):
            if a < mask.shape[0] and b < mask.shape[1] and mask[a, b]:
                row = np.zeros(mask.sum())
                row[number[a, b]], row[number[i, j]] = 1, -1
                rows.append(row)
                right.append(pitch * (slopes[i, j, k] + slopes[a, b, k]) / 2)
    return np.array(rows), np.array(right)


def test_what_lies_beside_the_mask_is_not_read():
    u, v, pitch = axes(32)
    mask = masks(32)["disc"]
    _, slopes = quadratic(u, v)
    expected, _ = integrated_slopes(slopes, pitch, mask)
    slopes[~mask] = np.nan
    found, _ = integrated_slopes(slopes, pitch, mask)
    assert np.array_equal(found, expected)


def test_threads_change_no_bit():
    mask = masks(200)["disc"]
    slopes = np.random.default_rng(1).normal(size=(200, 200, 2))
    one, residual = integrated_slopes(slopes, 1.0, mask)
    with fft.set_workers(2):
        two, again = integrated_slopes(slopes, 1.0, mask)
    assert np.array_equal(one, two)
    assert residual == again


def test_tilt_moves_the_spot_to_its_side():
    """W = a u lands at x = +a d_i."""
    slopes = np.zeros((64, 64, 2))
    slopes[..., 0] = 2e-4
    wave, _ = psf.wavefront_from_slopes(slopes, 4e-4, np.ones((64, 64), dtype=bool), **SYSTEM)
    spread = psf.point_spread(wave, method="fft")
    n = spread.intensity.shape[0]
    x = (np.arange(n) - n // 2) * spread.pitch
    peak = x[np.argmax(spread.intensity.sum(axis=0))]
    assert peak == approx(2e-4 * SYSTEM["image_distance"], abs=spread.pitch)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"slopes": np.zeros((4, 4))}, r"slopes have shape \(4, 4\) and mask \(4, 4\)"),
        ({"slopes": np.zeros((4, 4, 3))}, r"slopes have shape \(4, 4, 3\)"),
        ({"slopes": np.zeros((4, 5, 2)), "mask": np.ones((4, 5), bool)}, "grid is square"),
        ({"mask": np.ones((4, 5), bool)}, r"mask \(4, 5\)"),
        ({"mask": np.zeros((4, 4), bool)}, "mask is false everywhere"),
        ({"mask": np.ones((4, 4))}, "mask holds float64; give booleans"),
        ({"slopes": np.full((4, 4, 2), np.nan)}, r"slopes\[0, 0\] hold NaN"),
        ({"slopes": "steep"}, "not an array of real numbers"),
        ({"pitch": 0.0}, "pitch = 0 m is out of range"),
        ({"pitch": -1.0}, "pitch = -1 m is out of range"),
        ({"pitch": "wide"}, "pitch"),
        ({"wavelength": 0.6}, "wavelength = 0.6 m is out of range"),
        ({"image_distance": 0.0}, "image_distance = 0 m"),
    ],
)
def test_bad_slopes_are_refused(change, message):
    arguments = {"slopes": np.zeros((4, 4, 2)), "pitch": 1e-3, "mask": np.ones((4, 4), bool)}
    with pytest.raises(SceneError, match=message):
        psf.wavefront_from_slopes(**(arguments | SYSTEM | change))


# ---------------------------------------------------------------- facets to the pupil


def facets(scene, cell, slope_rms):
    """Return random slopes and centres of cells that cover what the lens sees."""
    seen = lens_footprint(scene.wall, scene.object_point, scene.camera)
    axes = (
        np.arange(a // cell - 1, b // cell + 3) + 0.5
        for a, b in zip(seen.low, seen.high, strict=True)
    )
    x, y = np.meshgrid(*(cell * axis for axis in axes))
    slopes = np.random.default_rng(0).normal(scale=slope_rms, size=(*x.shape, 2))
    return slopes, np.stack([x, y, 0 * x], axis=-1)


@pytest.mark.parametrize("shape", [(6, 9), (9, 6), (2, 5)])
def test_filter_of_a_rectangle_is_the_least_squares_surface(shape):
    slopes = np.random.default_rng(4).normal(size=(*shape, 2))
    solve = slope_filter(shape)
    (cos_y, cos_x), (source_y, source_x) = solve.cosines, solve.sources
    along = cos_y @ slopes[..., 0] @ source_x.T + source_y @ slopes[..., 1] @ cos_x.T
    surface = 0.3 * cos_y.T @ (along * solve.inverse) @ cos_x
    expected, _ = integrated_slopes(slopes, 0.3, np.ones(shape, dtype=bool))
    # rounding
    assert surface == approx(expected, abs=1e-13)
