"""Statistics of rough walls."""

import math

import numpy as np
import pytest
from pytest import approx

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
