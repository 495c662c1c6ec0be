"""Errors, reasons to stop and sizes of batches of light that is reflected many times."""

from __future__ import annotations

import math

import numpy as np
import pytest

from nlosoptics.transient.rendering import multiple_bounces as many

BATCHES = np.random.default_rng(1).gamma(2.0, size=(7, 3, 5))


def test_the_variance_is_that_of_students_distribution():
    """s^2/n times (n - 1)/(n - 3); rounding does not take it below 0."""
    found = many._variance(BATCHES.sum(0), (BATCHES**2).sum(0), 7)
    assert found == pytest.approx(BATCHES.var(0, ddof=1) / 7 * 6 / 4, rel=1e-12)
    assert many._variance(np.array([3.0]), np.array([9.0 / 7 - 1e-16]), 7).tolist() == [0.0]


def test_the_error_is_that_of_the_worst_lit_pair():
    total, squares = BATCHES.sum(0), (BATCHES**2).sum(0)
    each = np.sqrt(BATCHES.var(0, ddof=1) * 6 / 28).sum(1) / BATCHES.mean(0).sum(1)
    worst = math.sqrt(2.0 / math.pi) * each.max()
    assert many._l1(total, squares, 7) == pytest.approx(worst, rel=1e-12)
    total[each.argmax()] = squares[each.argmax()] = 0.0
    second = math.sqrt(2.0 / math.pi) * np.sort(each)[1]
    assert many._l1(total, squares, 7) == pytest.approx(second, rel=1e-12)
    assert many._l1(0.0 * total, 0.0 * squares, 7) == math.inf


@pytest.mark.parametrize(
    ("reached", "tol", "reason"),
    [
        ([0.01, 0.02], 0.02, "tol"),
        ([0.01, 0.021], 0.02, "paths"),
        ([0.01, 0.01], None, "paths"),
        ([0.01, math.inf], 0.02, "dark"),
        ([0.03, math.inf], 0.02, "paths"),
        ([math.inf, math.inf], 0.02, "dark"),
    ],
)
def test_reasons_to_stop(reached, tol, reason):
    assert many._stopped(reached, tol) == reason
