"""Kernels of pupils and transforms, each alone, on record; series against exact values.

The kernels are plain Python here, see `plain_kernels`. No two sizes are equal and no number is
round, so that an exchange of any two of them is seen.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from nlosoptics.scene import ConcaveWall

from ..plain_kernels import TIGHT, after, complexes, numbers, plain

soft = plain("psf.transform._antialiased_kernels")
batch = plain("psf.batch._batch_kernels")
waves = plain("psf.wave._wave_kernels")
aiming = plain("psf.pupil._aiming_kernels")
sums = plain("psf.transform._transform_kernels")


def triangle(size, seed=0):
    """Coefficients of a polynomial: [i, j] of u^i v^j, i + j < size."""
    return np.triu(numbers(size, size, seed=seed)[::-1])[::-1].copy()


@pytest.mark.parametrize("kernel", [waves.phasors, None], ids=["of waves", "of batches"])
def test_phasors_are_exact_to_rounding(kernel):
    turns = np.concatenate([numbers(400, low=-3.0, high=3.0), np.arange(-16.0, 17.0) / 8 + 1e-9])
    real, imaginary = np.empty(turns.size), np.empty(turns.size)
    if kernel is None:
        batch._phasors(turns, real, imaginary)
    else:
        kernel(turns, np.ones(turns.size), real, imaginary)
    angle = 2 * np.pi * (turns - np.round(turns)).astype(np.longdouble)
    angle *= np.longdouble("3.14159265358979323846264338327950288") / np.longdouble(np.pi)
    assert np.abs(real - np.cos(angle)).max() < 3e-16
    assert np.abs(imaginary - np.sin(angle)).max() < 3e-16


def test_a_softened_rim(on_record):
    table = numbers(23)
    places = [1.0, 2.29, 2.3, 2.71, 3.3, 5.1, 6.549, 6.551, 6.8, 9.0]
    found = [soft._profile(r, 2.3, 4, table) for r in places]
    lows, highs = np.array([6.2, 2.1]), np.array([8.7, 3.4])
    tables = numbers(2, 16, low=0.2)
    for y in (0.0, 1.7, 3.0, 5.1, 6.9, 8.3):
        for count in (1, 2):
            for centre in (7, 10):
                size = np.zeros(2 * centre + 1)
                half = soft._cut(y, lows, highs, 4, tables[:count], size)
                found += [half, size]
    on_record(found, TIGHT)


@pytest.mark.parametrize("rims", [1, 2])
@pytest.mark.parametrize("degree", [0, 2])
def test_a_soft_pupil(rims, degree, on_record):
    amplitudes = triangle(degree + 1, seed=3) if degree else np.empty((0, 0))
    given = (triangle(4), amplitudes, 0.13, np.array([6.2, 2.1]), np.array([8.7, 3.4]), 4)
    tables, work = numbers(2, 16, low=0.2)[:rims], np.zeros((6, 24))
    found = []
    for shape, centre in (((19, 25), 9), ((7, 5), 9), ((19, 25), 6)):
        out = complexes(*shape)
        found.append([soft.soft_pupil(*given, tables, centre, work, out), out, work[:, :13]])
    on_record(found, TIGHT)


def test_parts_of_soft_transforms(on_record):
    even, odd = complexes(5, 7), complexes(5, 7, seed=2)
    flat = numbers(5, 14), numbers(5, 14, seed=1)
    firsts = np.array([3, 40, 22])
    landing = np.array([[0.0, 0.6, 0.9, 1.1], [0.1, 0.7, 1.9, 2.6]])
    zones, distance = numbers(3, 2, low=0.3), np.array([0.4, 1.9, 7.3, 31.0])
    strip = np.array([[0.4, 0.3], [2.2, 0.5], [-0.3, 0.2]])
    lined = landing[:, :2]
    found = [
        after(soft.spread, complexes(3), firsts, numbers(3, 4), numbers(3, 6), 17, np.zeros(260)),
        after(soft.turned, numbers(3, 5), numbers(5, 6)),
        after(soft.squares, complexes(4, 7), 1.7, np.zeros((3, 5))),
        after(soft.waves, 0.37, 0.61, np.zeros((4, 6)), np.zeros((4, 5))),
        after(soft.folded, complexes(7, 4), np.zeros((4, 4), complex), np.zeros((3, 4), complex)),
        after(soft.refolded, even, odd, np.zeros((4, 18)), np.zeros((3, 18))),
        after(soft.refolded, even, odd, np.zeros((4, 20)), np.zeros((3, 20))),
        after(soft.split_squares, *flat, 1.3, np.zeros((5, 7)), np.zeros((5, 7))),
        after(
            soft.densest,
            numbers(9),
            numbers(9, seed=1),
            numbers(9, low=0.1),
            1.0,
            0.4,
            0.0 * numbers(6, 6),
        ),
        after(soft.rim_errors, distance, 9.7, 1.3, 0.8, zones, landing, 0.11, np.zeros(4)),
        after(soft.rim_errors, distance, 5.1, 0.2, 0.8, strip, landing, 0.23, np.zeros(4)),
        after(soft.rim_errors, distance, 5.1, 0.2, 0.8, strip, lined, 0.23, np.zeros(4)),
    ]
    for sizes in (np.array([2.3e-3, 1.1e-3]), np.array([1e-9, 2.0])):
        for counts in (np.array([11.0, 7.0]), np.array([60.0, 90.0]), np.array([0.3, 0.2])):
            slope = np.array([310.0, 4.7e3])
            given = (numbers(4, low=0.1), slope, sizes, counts, 3e-11)
            found.append(after(soft.node_errors, *given, np.zeros(4)))
    on_record(found, TIGHT)


def test_least_periods(on_record):
    landing = np.array([[0.0, 0.6, 0.9, 1.1], [0.1, 0.7, 1.9, 2.6]])
    distance, light = np.array([0.4, 1.9, 7.3, 31.0]), np.array([0.9, 0.3, 0.05, 0.003])
    zones = numbers(3, 2, low=0.3)
    found = []
    for goal in (1e-1, 1e-3, 1e-4, 1e-8):
        error = np.zeros(4)
        given = (light, goal, error, distance, 1.3, 0.8, zones, landing, 0.11)
        found += [soft.least_period(4.1, 97.0, *given), error]
    on_record(found, TIGHT)


def test_blocks_of_an_image(on_record):
    found = []
    for shape in ((13, 17), (5, 7)):
        strongest, far = np.zeros((4, 5)), np.zeros((4, 5))
        first = np.array([-3.3, 1.7])
        soft.block_maxima(numbers(*shape, low=0.0), first, 0.7, np.zeros(shape[1]), strongest, far)
        found += [strongest, far]
    on_record(found, TIGHT)


@pytest.mark.parametrize("shape", [(6, 9), (7, 4), (5, 5)], ids=str)
def test_a_batch(shape, on_record):
    rows, columns = (shape[0] + 1) // 2, (shape[1] + 1) // 2
    values, ramps, sizes = numbers(4, 3, 5), numbers(2, 5), numbers(4, 5, low=0.1)
    parts, fields = numbers(2, 2, 2, 3, 5), numbers(2, 2, 2, rows, columns)
    on_record(
        [
            after(batch.pupil_parts, values, ramps, sizes, np.zeros(parts.shape)),
            after(batch.phase_gradients, values, ramps, sizes, parts, np.zeros(values.shape)),
            after(batch.intensities, fields, 1.7, np.zeros(shape)),
            after(batch.field_gradients, fields, 1.7, numbers(*shape), np.zeros(fields.shape)),
        ],
        TIGHT,
    )


def test_waves_at_nodes(on_record):
    n = waves.BLOCK + 7
    u, v, path, size = numbers(4, n, low=0.1)
    out = np.zeros(n, complex)
    on_record(
        [
            after(waves.tilted_wave, u, v, path, size, 3.1, -1.7, 5.3, out),
            after(waves.unit_wave, path, 2.7, np.zeros(n, complex)),
            after(waves.delayed, complexes(5, 4), numbers(4), numbers(5), 1.3, -0.7, 2.1),
            after(waves.moments, numbers(8), np.array([0.3, 0.0, 0.9, 0.2, -0.1, 1.4, 0.8, 0.0])),
            after(waves.moments, np.array([2.0, 5.0]), np.array([0.7, 0.3])),
        ],
        TIGHT,
    )


def test_polynomials_and_slopes(on_record):
    rho, turns = np.array([0.2, 0.5, 0.9]), np.array([0.3, 1.7, 2.9, 4.4])
    cosine, sine = np.cos(turns), np.sin(turns)
    u, v = np.array([[0.0, 0.05, 0.4, 0.9, -1.3, 0.2], [0.0, -0.1, 0.5, -0.2, 0.7, -1.6]])
    slopes = [np.zeros((3, 4)) for _ in range(2)]
    inverse = [numbers(7, seed=k) for k in range(6)]
    on_record(
        [
            after(waves.extended_polynomial, triangle(4), u, v, 0.0, np.zeros(6)),
            after(waves.extended_polynomial, triangle(5), u, v, 0.35, np.zeros(6)),
            after(waves.polynomial, triangle(5), rho, cosine, sine, np.zeros((3, 4))),
            after(waves.slopes, triangle(5), rho, cosine, sine, np.zeros((4, 4)), *slopes),
            after(waves.patch_gradient, *inverse, np.zeros(7), np.zeros(7)),
        ],
        TIGHT,
    )


def test_jacobians(on_record):
    radii = np.array([0.1, 0.3, 0.301, 0.8, 0.95])
    x, y = numbers(5, 7), numbers(5, 7, seed=1)
    patches = numbers(2, 5, 6), numbers(2, 5, 6, seed=1)
    coefficients = numbers(3, 4, 5)
    on_record(
        [
            [waves.jacobian_extremes(x, y, radii, apart) for apart in (0.0, 0.01, 0.19)],
            waves.patch_jacobian_extremes(*patches, numbers(2, 3, 4, low=0.2)),
            *(
                after(waves.patch_terms, coefficients, k, m, np.ones((4, 5)), np.zeros(3))
                for k, m in ((2, 3), (1, -1), (4, 2), (0, 5))
            ),
        ],
        TIGHT,
    )


def test_a_start_where_all_paths_are_equal():
    """From the centre of a sphere and back: the first point is stationary, without curvature."""
    terms, tables = ConcaveWall(2.0, size=1.5).compiled()
    centre = np.array([0.0, 0.0, 2.0])
    found = aiming.stationary_point(terms, tables, centre, centre, 0.0, 0.0, 1.0)
    assert found == (0.0, 0.0, aiming.FOUND)
    outside = aiming.stationary_point(terms, tables, centre, centre, 4.0, 0.3, 1.0)
    assert outside == (4.0, 0.3, aiming.OFF_SURFACE)


def test_patterns_and_pixels(on_record):
    table = numbers(40, 6)
    u, v, w, path = numbers(4, 5)
    points = numbers(3, 3, low=1.5, high=2.0)
    boxes = (
        np.array([-1.2, 0.3, 2.6, 3.9, 5.2, 1.5, 8.0]),
        np.array([0.4, -0.3, 2.2, 4.6, 1.0, 1.5, 2.0]),
    )
    wide = (
        np.array([2.1, 0.4, 1.7, 0.9, 0.3, 0.0, 0.5]),
        np.array([1.3, 0.5, 6.1, 0.7, 1.4, 0.0, 0.4]),
    )
    found = [
        after(sums.airy_quarter, 0.37, obscuration, 4, table, np.zeros((6, 6)))
        for obscuration in (0.0, 0.3)
    ]
    for row, column, shape in ((2, 3, (5, 7)), (0, 0, (4, 6)), (4, 5, (5, 6))):
        found.append(after(sums.mirrored, numbers(6, 8), row, column, np.zeros(shape)))
    for distance in (1.3, -1.3):
        for curved in (True, False):
            given = (points, u, v, 0.2 * w, path, numbers(5, low=0.1), distance, 7.7, curved)
            found.append(after(sums.huygens_field, *given, np.zeros((3, 2))))
    found.append(after(sums.splat, *boxes, *wide, numbers(7, low=0.2), np.zeros((4, 5))))
    on_record(found, TIGHT)
    assert math.isclose(sums._disc(0.0, 4, table), table[0, 0])
