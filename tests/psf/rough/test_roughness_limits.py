"""Limits of the statistics of rough walls: what is just accepted, and what is just refused."""

import math

import numpy as np
import pytest
from pytest import approx

from nlosoptics.errors import SceneError
from nlosoptics.psf import Roughness

L = 2.3e-3
RMS = 1.7e-7


def rough(autocorrelation, length=L):
    return Roughness(RMS, length, autocorrelation)


def bump(low, high, value, at_zero=1.0):
    """C of one value between two lags, in units of L, and of another at 0."""
    return lambda r: np.where(r == 0, at_zero, np.where((r > low * L) & (r < high * L), value, 0.0))


@pytest.mark.parametrize(
    ("autocorrelation", "accepted"),
    [
        (bump(0, 1, 0.5, 1 + 0.7e-9), True),
        (bump(0, 1, 0.5, 1 + 1.5e-9), False),
        (bump(0, 1, 0.5, 1 - 0.7e-9), True),
        (bump(0, 1, 0.5, 1 - 1.5e-9), False),
        # it is examined from a thousandth of the length to a thousand lengths
        (bump(0, 0.999e-3, 2.0), True),
        (bump(0, 1.001e-3, 2.0), False),
        (bump(0.999e3, math.inf, 2.0), False),
        (bump(1.001e3, math.inf, 2.0), True),
        (lambda r: np.exp(-r / L) + np.where(r > L, np.nan, 0), False),
        (lambda r: np.exp(-r / L)[:-1], False),
    ],
)
def test_autocorrelation_is_1_at_most(autocorrelation, accepted):
    if accepted:
        assert rough(autocorrelation).correlation(3 * L) == approx(0, abs=2)
    else:
        with pytest.raises(SceneError, match="must be 1 and at most 1|not finite"):
            rough(autocorrelation)


def test_reach_of_functions():
    """At most one step of the search above the lag, 80 a decade or so."""
    plain = rough(lambda r: np.exp(-r / L))
    step = 1e5 ** (1 / 400)
    for x in (0.0101, 0.0107, 0.5, 7.3, 990.0):  # exp(-990) is 0
        found = plain.reach(math.exp(-x)) / L if x < 700 else rough(bump(0, x, 0.5)).reach(0.4) / L
        assert x <= found * (1 + 1e-12)
        assert found < x * step * (1 + 1e-12)
    assert plain.reach(0.9999) == approx(1e-2 * L, rel=1e-12)
    assert rough(bump(0, math.inf, 0.5)).reach(0.4) == math.inf
    assert rough(bump(0, math.inf, 0.5)).reach(0.5) == approx(1e-2 * L, rel=1e-12)


@pytest.mark.parametrize("name", ["gaussian", "exponential"])
def test_reach_and_lag_of_named(name):
    one = rough(name)
    power = 2 if name == "gaussian" else 1
    for x in (1e-3, 0.7, 3.0):
        assert one.reach(math.exp(-(x**power))) == approx(x * L, rel=1e-12)
        assert one.lag_of(-math.expm1(-(x**power))) == approx(x * L, rel=1e-10)
    # below the first lag that is tried, 1e-8 L, and at the last, 1000 L
    small = 3e-9
    assert one.lag_of(-math.expm1(-(small**power))) == approx(small * L, rel=1e-10)
    assert math.isfinite(one.lag_of(1.0))


def test_lag_of_a_far_fall():
    near = rough(lambda r: np.where(r < 999 * L, 1.0, 0.0))
    assert near.lag_of(0.5) == approx(999 * L, rel=1e-10)
    assert near.lag_of(0.0) == approx(0.0, abs=1e-12 * L)
    assert rough(lambda r: np.where(r < 1001 * L, 1.0, 0.0)).lag_of(0.5) == math.inf
    # the first of several falls that are further apart than the steps of the search, 2.3 %
    wavy = rough(lambda r: 0.5 + 0.5 * np.cos(r / L))
    assert wavy.lag_of(0.5) == approx(math.pi / 2 * L, rel=1e-10)
    assert wavy.lag_of(1.0) == math.inf or wavy.lag_of(1.0) > 3 * L
