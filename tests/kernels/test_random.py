"""Random numbers by address: known answers, Sobol's structure, scrambling."""

from __future__ import annotations

import numpy as np
import pytest
from pytest import approx
from scipy.stats import kstest, qmc

from nlosoptics._random import SOBOL_DIMENSIONS, scrambled_sobol, sobol_columns
from nlosoptics.kernels import random
from nlosoptics.kernels.random import disc


def points(columns, shifts, count):
    """The first points of one group, (count, dimensions)."""
    return np.array(
        [
            [random.sobol(c, s, np.uint64(i)) for c, s in zip(columns, shifts, strict=True)]
            for i in range(count)
        ]
    )


def test_sobol_columns_are_those_of_joe_and_kuo():
    """Unscrambled points against scipy's, which go in the order of the Gray code."""
    expected = qmc.Sobol(SOBOL_DIMENSIONS, scramble=False, bits=32).random(512)
    ours = points(sobol_columns(), np.zeros(SOBOL_DIMENSIONS, dtype=np.uint32), 512)
    order = np.arange(512) ^ (np.arange(512) >> 1)
    # half a cell of 2^-32 is the only difference
    assert ours[order] - 0.5 * 2.0**-32 == approx(expected, abs=1e-15)


def test_scrambling_keeps_the_strata():
    """Every dimension of 256 points has one in each of 256 cells; the pairs fill their boxes."""
    columns, shifts = scrambled_sobol(7, 302, 3)
    for group in range(3):
        found = points(columns[group], shifts[group], 256)
        for dimension in range(SOBOL_DIMENSIONS):
            assert len(np.unique((found[:, dimension] * 256).astype(int))) == 256
        # the first two dimensions are a (0, 2)-sequence: one point in each 16 x 16 box
        boxes = (found[:, :2] * 16).astype(int) @ (16, 1)
        assert len(np.unique(boxes)) == 256


def test_scrambled_points_are_uniform_and_groups_independent():
    columns, shifts = scrambled_sobol(1, 302, 2000)
    first = np.array([points(c[:2], s[:2], 2) for c, s in zip(columns, shifts, strict=True)])
    # eight tests at a family-wise 1e-3, fixed seed
    for index in range(2):
        for dimension in range(2):
            assert kstest(first[:, index, dimension], "uniform").pvalue > 1e-3 / 8
    between = np.corrcoef(first[:-1, 0, 0], first[1:, 0, 0])[0, 1]
    assert abs(between) < 4 / np.sqrt(2000)


@pytest.mark.parametrize("stream", [301, 302])
def test_uniform_numbers_depend_on_every_part_of_the_address(stream):
    """53 bits, in [0, 1), and no two addresses alike."""
    address = np.uint64
    numbers = {
        random.uniform(address(seed), address(stream), address(ray), address(draw))
        for seed in (0, 1, 2**32, 2**64 - 1)
        for ray in (0, 1, 2**32 - 1, 2**32, 2**40)
        for draw in (0, 1, 77)
    }
    assert len(numbers) == 60
    assert all(0.0 <= number < 1.0 for number in numbers)
    many = np.array(
        [
            random.uniform(address(3), address(stream), address(ray), address(0))
            for ray in range(20_000)
        ]
    )
    assert kstest(many, "uniform").pvalue > 1e-3
    assert (many * 2**53 % 1 == 0).all()


def test_disc_keeps_areas():
    """Shirley and Chiu's map: equal shares of the square in equal shares of rings and sectors."""
    u, v = np.meshgrid((np.arange(200) + 0.5) / 200, (np.arange(200) + 0.5) / 200)
    x, y = np.array([random.disc(a, b) for a, b in zip(u.ravel(), v.ravel(), strict=True)]).T
    # a ring's count is off by at most the 4 x 200 cells along each of its rims, 2 %
    rings = np.histogram(x * x + y * y, 5, (0.0, 1.0))[0]
    assert rings / 40_000 == approx(np.full(5, 0.2), abs=0.02)
    sectors = np.histogram(np.arctan2(y, x), 8, (-np.pi, np.pi))[0]
    assert sectors / 40_000 == approx(np.full(8, 0.125), abs=4e-3)
    assert (x * x + y * y).max() < 1.0
    assert disc(0.5, 0.5) == (0.0, 0.0)
