"""Statistics of rough walls."""

import math

import numpy as np
import pytest
from pytest import approx
from scipy import special

from nlosoptics.errors import SceneError
from nlosoptics.psf import Roughness


def test_slope_is_that_of_the_correlation():
    rough = Roughness(1e-6, 2e-3)
    # variance of the slope per axis: -height_rms^2 C''(0), by a second difference of step l/1000
    step = 2e-6
    second = 2 * float(rough.structure(step)) / step**2
    assert rough.slope_rms == approx(1e-6 * math.sqrt(second), rel=1e-6)
    assert rough.slope_rms == approx(math.sqrt(2) * 1e-6 / 2e-3, rel=1e-14)
    with pytest.raises(SceneError, match="gaussian"):
        _ = Roughness(1e-6, 2e-3, "exponential").slope_rms


@pytest.mark.parametrize("name", ["gaussian", "exponential"])
def test_named_fall_to_1_over_e(name):
    rough = Roughness(1e-6, 2e-3, name)
    assert rough.correlation([0.0, 2e-3]) == approx([1, math.exp(-1)], rel=1e-14)
    assert rough.correlation(rough.reach(1e-6)) == approx(1e-6, rel=1e-9)
    assert rough.structure(rough.lag_of(0.3)) == approx(0.3, rel=1e-9)
    # no digits lost where C is next to 1
    tiny = 1e-12 * (2e-3 if name == "exponential" else 2e-3 * 1e6)
    assert float(rough.structure(tiny)) == approx(1e-12, rel=1e-9)


def test_table_is_joined_and_ends():
    lags = np.linspace(0, 8e-3, 81)
    rough = Roughness(1e-6, 2e-3, [lags, np.exp(-((lags / 2e-3) ** 2))])
    between = np.linspace(0, 7.9e-3, 333)
    # monotone cubics of pitch l/20
    assert rough.correlation(between) == approx(np.exp(-((between / 2e-3) ** 2)), abs=1e-3)
    assert rough.correlation([9e-3, 1.0]) == approx([0, 0], abs=0)
    assert rough.reach(1e-3) == 8e-3


def test_function_is_followed_to_its_end():
    rough = Roughness(1e-6, 2e-3, lambda r: np.exp(-r / 2e-3) * np.cos(r / 1e-3))
    # on a grid of lags with 80 a decade
    assert rough.reach(1e-3) == approx(2e-3 * math.log(1e3), rel=0.1)
    assert math.isinf(Roughness(1e-6, 2e-3, lambda r: np.ones_like(r)).reach(0.5))
    assert math.isinf(Roughness(1e-6, 2e-3, lambda r: np.ones_like(r)).lag_of(0.5))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"height_rms": -1e-9}, "height_rms"),
        ({"correlation_length": 0.0}, "correlation_length"),
        ({"autocorrelation": "white"}, "gaussian, exponential"),
        ({"autocorrelation": [1.0, 0.5]}, r"\(2, n\)"),
        ({"autocorrelation": [[0, 1e-3, 2e-3, 3e-3], [1, 0.5, 0.3, 0.2]]}, "larger lags"),
        ({"autocorrelation": [[1e-4, 1e-3, 2e-3, 3e-3], [1, 0.5, 0.3, 0]]}, "rise from 0"),
        ({"autocorrelation": [[0, 1e-3, 2e-3, 3e-3], [0.8, 0.5, 0.1, 0]]}, "must be 1"),
        ({"autocorrelation": lambda r: 1 + r}, "must be 1"),
        ({"autocorrelation": lambda r: 1.0}, "shape"),
    ],
)
def test_refuses(changes, message):
    given = {"height_rms": 1e-7, "correlation_length": 1e-3, **changes}
    with pytest.raises(SceneError, match=message):
        Roughness(**given)


L = 2e-3
CORRELATIONS = {
    "gaussian": "gaussian",
    "exponential": "exponential",
    "measured": [np.linspace(0, 5 * L, 101), np.exp(-(np.linspace(0, 5, 101) ** 2))],
    "function": lambda r: np.exp(-((r / L) ** 2)),
}


@pytest.mark.parametrize("cutoff", [0.3 * L, L, 10 * L])
@pytest.mark.parametrize("name", CORRELATIONS)
def test_parts_add_up(name, cutoff):
    rough = Roughness(1e-7, L, CORRELATIONS[name])
    long, short = rough.split(cutoff)
    lags = np.append(0.0, np.geomspace(1e-6 * L, 100 * L, 2001))
    total = sum(p.height_rms**2 * p.correlation(lags) for p in (long, short))
    # by construction; rounding
    assert total == approx(1e-14 * rough.correlation(lags), abs=1e-12 * 1e-14, rel=0)
    for part in (long, short):
        assert float(part.correlation(part.correlation_length)) == approx(math.exp(-1), rel=1e-9)
        assert np.abs(part.correlation(part.reach(1e-6) * np.geomspace(1, 10, 99))).max() < 1.1e-6


def test_gaussian_stays_gaussian():
    cutoff = 3 * L
    long, short = Roughness(1e-7, L).split(cutoff)
    assert long.autocorrelation == "gaussian"
    assert long.correlation_length == approx(math.hypot(L, cutoff), rel=1e-15)
    assert long.height_rms == approx(1e-7 * L / math.hypot(L, cutoff), rel=1e-15)
    assert short.height_rms == approx(1e-7 * cutoff / math.hypot(L, cutoff), rel=1e-15)


def test_short_part_keeps_its_digits():
    """Of a cutoff far below l what stays is the Laplacian's share, ``exp(-x) (1 - x)``."""
    _, short = Roughness(1e-7, L).split(1e-6 * L)
    x = np.linspace(0, 4, 9)
    # the next order, (cutoff/l)^2
    assert short.correlation(L * np.sqrt(x)) == approx(np.exp(-x) * (1 - x), abs=1e-11)
    assert float(short.structure(1e-7 * L)) == approx(2e-14, rel=1e-10)
    assert short.height_rms == approx(1e-13, rel=1e-11)


@pytest.mark.parametrize("cutoff", [0.01 * L, 0.3 * L, 10 * L])
def test_exponential_is_filtered_as_its_spectrum(cutoff):
    """Hankel transform of ``2 pi l^2/(1 + (2 pi f l)^2)^1.5`` with the filter, by Gauss nodes."""
    long, _ = Roughness(1e-7, L, "exponential").split(cutoff)
    edges = np.linspace(0, 13 / cutoff, 4001)
    x, w = np.polynomial.legendre.leggauss(12)
    q = (edges[:-1] + np.diff(edges) / 2 * (x[:, None] + 1)).ravel()
    weight = (np.diff(edges) / 2 * w[:, None]).ravel()
    power = L**2 / (1 + (q * L) ** 2) ** 1.5 * np.exp(-((q * cutoff / 2) ** 2)) * q * weight
    for r in (0.0, 0.05 * L, L, 5 * L):
        expected = np.sum(power * special.j0(q * r))
        # the table's quintics
        found = (long.height_rms / 1e-7) ** 2 * float(long.correlation(r))
        assert found == approx(expected, abs=1e-8)


def test_function_is_filtered_as_the_closed_form():
    lags = np.linspace(0, 10 * L, 501)
    for cutoff in (0.1 * L, L, 10 * L):
        closed, rest = Roughness(1e-7, L).split(cutoff)
        long, short = Roughness(1e-7, L, CORRELATIONS["function"]).split(cutoff)
        share = (closed.height_rms / 1e-7) ** 2
        found = (long.height_rms / 1e-7) ** 2 * long.correlation(lags)
        # the table's quintics
        assert found == approx(share * closed.correlation(lags), abs=1e-8)
        # the same over the share that stays, 1 % at the least
        assert short.correlation(lags) == approx(rest.correlation(lags), abs=1e-6)


def test_limits_of_the_split():
    for name in ("gaussian", "exponential"):
        rough = Roughness(1e-7, L, name)
        long, short = rough.split(0.0)
        assert long is rough
        assert short.height_rms == 0
        long, short = rough.split(math.inf)
        assert short is rough
        assert long.height_rms == 0


@pytest.mark.parametrize(
    ("autocorrelation", "cutoff", "message"),
    [
        ("gaussian", -1e-3, "cutoff = -0.001"),
        ("gaussian", math.nan, "cutoff"),
        ("exponential", 1e-9 * L, "of the variance"),
        ("exponential", 1e4 * L, "of the variance"),
        (CORRELATIONS["measured"], 0.01 * L, "spacing of the measured lags"),
        (CORRELATIONS["measured"], 0.06 * L, "negative power"),
        (lambda r: 0.5 + 0.5 * np.exp(-((r / L) ** 2)), L, "stays above"),
    ],
)
def test_refuses_to_split(autocorrelation, cutoff, message):
    rough = Roughness(1e-7, L, autocorrelation)
    with pytest.raises(SceneError, match=message):
        rough.split(cutoff)
