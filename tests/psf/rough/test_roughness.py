"""Statistics of rough walls."""

import math

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


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"height_rms": -1e-9}, "height_rms"),
        ({"correlation_length": 0.0}, "correlation_length"),
        ({"autocorrelation": "white"}, "gaussian, exponential"),
        ({"autocorrelation": [1.0, 0.5]}, "is a list; give"),
        ({"autocorrelation": lambda r: 1 + r}, "must be 1"),
        ({"autocorrelation": lambda r: 1.0}, "shape"),
    ],
)
def test_refuses(changes, message):
    given = {"height_rms": 1e-7, "correlation_length": 1e-3, **changes}
    with pytest.raises(SceneError, match=message):
        Roughness(**given)
