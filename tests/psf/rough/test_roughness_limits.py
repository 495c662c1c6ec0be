"""Limits of the statistics of rough walls: what is just accepted, and what is just refused."""

import math

import numpy as np
import pytest
from pytest import approx
from scipy import special

from nlosoptics.errors import SceneError
from nlosoptics.psf import Roughness
from nlosoptics.psf.rough import autocorrelations

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
        (bump(0, 1, 1 + 0.7e-9), True),
        (bump(0, 1, 1 + 1.5e-9), False),
        (bump(0, 1, -1 - 0.7e-9), True),
        (bump(0, 1, -1 - 1.5e-9), False),
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


def test_messages_of_the_autocorrelation():
    with pytest.raises(SceneError, match="is 0.75 at lag 0 and reaches 1.25, must be 1 and at m"):
        rough(bump(0, 2, -1.25, 0.75))
    with pytest.raises(SceneError, match=r"gave shape \(\) for lags of shape \(98,\), or values"):
        rough(lambda r: 1.0)
    with pytest.raises(SceneError, match="slope_rms is available only for autocorrelation = 'gau"):
        _ = rough("exponential").slope_rms
    with pytest.raises(SceneError, match="slope_rms is available only for autocorrelation = 'gau"):
        _ = rough(lambda r: np.exp(-r / L)).slope_rms


LAGS = np.array([0.0, 1e-3, 2.5e-3, 3e-3, 5e-3])


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ([LAGS[:3], [1, 0.5, 0.0]], r"has shape \(2, 3\); give \(2, n\) with n of 4 or more"),
        ([LAGS, [1, 0.6, 0.3, 0.1, 0], LAGS], r"has shape \(3, 5\)"),
        (LAGS, r"has shape \(5,\)"),
        (np.ones((2, 5, 1)), r"has shape \(2, 5, 1\)"),
        ([LAGS, [1, 0.6, np.nan, 0.1, 0]], "must be finite lags"),
        ([[0, 1e-3, 1e-3, 3e-3, 5e-3], [1, 0.6, 0.3, 0.1, 0]], "rise from 0"),
        ([[1e-9, 1e-3, 2e-3, 3e-3, 5e-3], [1, 0.6, 0.3, 0.1, 0]], "rise from 0"),
        ([[0, 1e-3, 3e-3, 2e-3, 5e-3], [1, 0.6, 0.3, 0.1, 0]], "rise from 0"),
        ([LAGS, [1, 0.6, 0.3, 0.1, 0.0201]], "ends with 0.0201 at a lag of 0.005 m, limit 0.02;"),
        ([LAGS, [1, 0.6, 0.3, 0.1, -0.0201]], "ends with -0.0201 at a lag of 0.005 m"),
    ],
)
def test_refuses_a_table(table, message):
    with pytest.raises(SceneError, match=message):
        rough(table)


@pytest.mark.parametrize("last", [0.02, -0.02])
def test_table_is_kept_and_ends_at_its_last_lag(last):
    given = np.array([LAGS, [1, 0.6, 0.3, 0.1, last]])
    one = rough(given)
    given[1] = 0.7
    assert not one.autocorrelation.flags.writeable
    assert one.correlation(LAGS) == approx([1, 0.6, 0.3, 0.1, last], rel=1e-14)
    assert one.structure(LAGS) == approx([0, 0.4, 0.7, 0.9, 1 - last], rel=1e-14)
    assert one.correlation([[5.001e-3], [0.1]]) == approx(np.zeros((2, 1)), abs=0)
    assert one.reach(0.5) == 5e-3
    # the least lag of a value, which falls monotonely between those of the table
    assert one.correlation(one.lag_of(0.6)) == approx(0.4, rel=1e-9)
    assert 1e-3 < one.lag_of(0.6) < 2.5e-3
    assert rough(np.array([LAGS[:4], [1, 0.6, 0.1, 0.0]])).reach(0.5) == 3e-3


def test_own_structure_is_used():
    class Steep:
        end = 4 * L

        def __call__(self, r):
            return np.where(r < 2 * L, np.exp(-r / L), 0.0)

        def structure(self, r):
            return -np.expm1(-r / L)

    own = rough(Steep())
    assert float(own.structure(1e-12 * L)) == approx(1e-12, rel=1e-12)
    assert own.lag_of(1e-12) == approx(1e-12 * L, rel=1e-9)
    plain = rough(lambda r: np.exp(-r / L))
    assert float(plain.structure(0.3 * L)) == approx(1 - math.exp(-0.3), rel=1e-12)


class Ended:
    """Exponential C up to its end."""

    def __init__(self, end):
        self.end = end

    def __call__(self, r):
        return np.exp(-r / L)


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
    # not beyond the end that the function states, in 1600 steps
    for end in (6 * L, 3000 * L):
        ended = rough(Ended(end))
        for x in (0.0101, 0.5, 5.0):
            found = ended.reach(math.exp(-x)) / L
            assert x <= found * (1 + 1e-12)
            assert found < x * (end / (1e-2 * L)) ** (1 / 1600) * (1 + 1e-12)
    assert rough(Ended(6 * L)).reach(math.exp(-6.1)) == 6 * L


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


def test_split_needs_the_full_extent():
    with pytest.raises(SceneError, match="stays above 1e-16 up to 1000 correlation lengths, but"):
        rough(lambda r: 1 / (1 + r / L)).split(L)
    # C ends at 900 lengths
    long, short = rough(lambda r: np.where(r < 900 * L, np.exp(-r / L), 0.0)).split(0.8 * L)
    assert math.hypot(long.height_rms, short.height_rms) == approx(RMS, rel=1e-12)


def test_cutoff_of_a_measured_autocorrelation():
    """The widest spacing of the lags counts, and is itself a cutoff."""
    lags = np.append(np.linspace(0, 3 * L, 61), [3.2 * L, 5 * L])
    measured = rough([lags, np.exp(-((lags / L) ** 2))])
    widest = float(np.diff(lags).max())
    long, short = measured.split(widest * (1 + 1e-12))
    expected = rough("gaussian").split(widest)
    assert long.height_rms == approx(expected[0].height_rms, rel=1e-2)
    assert short.height_rms == approx(expected[1].height_rms, rel=1e-2)
    with pytest.raises(
        SceneError, match=r"cutoff = 0.00412 m is below the spacing of the measured l"
    ):
        measured.split(widest * (1 - 5e-3))


def test_cutoffs_below_rounding():
    """The first part is the whole, and the second has no height."""
    long, short = rough("gaussian").split(1e-170)
    assert long.height_rms == RMS
    assert short.height_rms == 0
    assert short.correlation_length == L
    long, short = rough("exponential").split(0)
    assert (long.height_rms, short.height_rms, short.correlation_length) == (RMS, 0, L)
    long, short = rough("exponential").split(math.inf)
    assert (long.height_rms, short.height_rms, long.correlation_length) == (0, RMS, L)


@pytest.mark.parametrize(("part", "share"), [("long", 1), ("short", 0)])
def test_parts_below_a_millionth(part, share):
    """Both sides of the least share of a part, by the share that the closed form passes."""
    gauss = rough(lambda r: np.exp(-((r / L) ** 2)))
    for least, refused in ((0.8e-6, True), (1.25e-6, False)):
        held = least if part == "short" else 1 - least
        cutoff = L * math.sqrt(held / (1 - held))
        if refused:
            with pytest.raises(
                SceneError, match=f"leaves {1 - held:.3g} of the variance to the long"
            ):
                gauss.split(cutoff)
        else:
            found = gauss.split(cutoff)[1 - share]
            assert (found.height_rms / RMS) ** 2 == approx(least, rel=1e-2)


@pytest.mark.parametrize("cutoff", [0.35 * L, 1.9 * L])
def test_gaussian_parts_are_the_closed_forms(cutoff):
    """Covariances of the whole and of the filtered heights, l^2/(l^2 + c^2) of the variance."""
    long, short = rough("gaussian").split(cutoff)
    r = np.linspace(0, 4, 9) * L
    wide = math.hypot(L, cutoff)
    passed = (L / wide) ** 2
    expected = np.exp(-((r / L) ** 2)) - passed * np.exp(-((r / wide) ** 2))
    assert (short.height_rms / RMS) ** 2 * short.correlation(r) == approx(expected, abs=1e-13)
    assert (long.height_rms / RMS) ** 2 == approx(passed, rel=1e-13)
    assert short.structure(r) == approx(1 - short.correlation(r), abs=1e-13)
    assert short.autocorrelation.end == approx(27 * wide, rel=1e-13)
    assert short.correlation(short.correlation_length) == approx(math.exp(-1), rel=1e-10)
    assert short.correlation(0.999 * short.correlation_length) > math.exp(-1)


@pytest.mark.parametrize("cutoff", [0.2 * L, 3.1 * L])
def test_filter_is_a_convolution(cutoff):
    """``2/c^2 int C(t) t I0(2 r t/c^2) exp(-(r^2 + t^2)/c^2) dt``, by Gauss nodes."""
    end = 6.5 * L
    node, weight = np.polynomial.legendre.leggauss(12)

    def whole(r):
        return np.where(r < end, (1 - r / end) ** 3 * np.cos(r / L) ** 2, 0.0)

    found = autocorrelations.smoothed(whole, L, end, cutoff)
    t = ((np.arange(400)[:, None] + (node + 1) / 2) * end / 400).ravel()
    for r in (0.0, 0.31 * L, 2.2 * L, 6.4 * L, end + 2.5 * cutoff):
        kernel = special.i0e(2 * r * t / cutoff**2) * np.exp(-(((r - t) / cutoff) ** 2))
        expected = np.tile(weight, 400) @ (whole(t) * t * kernel) * end / 400 / cutoff**2
        # the table's quintics
        assert float(found.covariance(np.array(r))) == approx(expected, abs=1e-8)
    assert found.end == end + 7 * cutoff
    assert found.covariance(np.array([found.end, 2 * found.end])) == approx([0, 0], abs=0)
    assert found(np.array([0.0, L]))[0] == approx(1.0, rel=1e-14)
    assert found.passed == approx(float(found.covariance(np.array(0.0))), rel=1e-14)
    rest = autocorrelations.Remainder(whole, found)
    assert rest.end == found.end
    r = np.array([0.0, 0.4 * L, 3 * L])
    expected = (whole(r) - found.covariance(r)) / (1 - found.passed)
    assert rest(r) == approx(expected, rel=1e-12)


def test_fall_length_is_searched_over_eight_decades():
    for true in (1.03e-4, 0.3, 1.0, 9.8e3):
        found = autocorrelations.fall_length(lambda r, true=true: np.exp(-r / (true * L)), L)
        assert found == approx(true * L, rel=1e-12)
