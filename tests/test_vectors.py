"""Scalar products of many vectors."""

from __future__ import annotations

import numpy as np
import pytest

from nlosoptics._vectors import dot


@pytest.mark.parametrize(
    ("first", "second"),
    [((3,), (3,)), ((7, 3), (3,)), ((50, 1, 3), (1, 40, 3)), ((0, 3), (0, 3))],
)
def test_equals_a_sum_bit_for_bit(first: tuple[int, ...], second: tuple[int, ...]) -> None:
    """Another order of the three terms would change the last bit of some products."""
    draws = np.random.default_rng(1)
    a, b = draws.normal(size=first), draws.normal(size=second)
    before = a.copy(), b.copy()
    assert np.array_equal(dot(a, b), (a * b).sum(axis=-1))
    assert np.array_equal(a, before[0])
    assert np.array_equal(b, before[1])
