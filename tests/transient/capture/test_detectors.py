"""Detectors: counts are kept, moments are those of the response, noise is Poisson's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from nlosoptics.errors import SceneError
from nlosoptics.transient import Detector, TransientCapture, wall_grid

STEP = 0.01


def spike(at=200, n_bins=1000, height=1.0):
    H = np.zeros((n_bins, 2))
    H[at, 0] = height
    return TransientCapture(
        H=H, laser_points=np.zeros(3), sensor_points=np.zeros((2, 3)), delta_t=STEP
    )


def moments(capture, counts):
    weights = counts / counts.sum()
    mean = weights @ capture.times
    return mean, weights @ (capture.times - mean) ** 2


@pytest.mark.parametrize(
    "detector",
    [
        Detector(jitter=0.003),
        Detector(jitter=0.05),
        Detector(tail=0.08, tail_share=0.3),
        Detector(jitter=0.02, tail=0.1, tail_share=0.4),
        Detector(jitter=0.03, tail=0.004, tail_share=1.0),  # a tail far below the Gaussian
        Detector(jitter=0.05, tail=0.02, tail_share=0.5),
        Detector(tail=0.002, tail_share=0.5),
    ],
)
def test_response_keeps_counts_mean_and_variance(detector):
    share, tail = detector.tail_share, detector.tail
    light = spike()
    after = detector.expected(light)
    # 8 standard deviations and 33 tails leave out 1e-14
    assert after.sum() == pytest.approx(1.0, abs=5e-14)
    assert not after[:, 1].any()
    mean, variance = moments(light, after[:, 0])
    assert mean - light.times[200] == pytest.approx(share * tail, abs=1e-11)
    # a photon r bins past a middle is stamped there or one later, which adds r (1 - r) steps
    # squared: 0 to 1/4, and 1/6 on average where errors are smooth over bins
    spread_sq = detector.jitter**2 + share * (2.0 - share) * tail**2
    added = (variance - spread_sq) / STEP**2
    assert 0.0 < added < 0.25
    if detector.jitter > 2 * STEP:
        assert added == pytest.approx(1 / 6, abs=1e-7)


def test_response_is_the_one_integrated_by_brute_force():
    """Photons at random places of the bin with random errors, binned."""
    detector = Detector(jitter=0.012, tail=0.03, tail_share=0.5)
    draw = np.random.default_rng(2)
    n = 2_000_000
    stamps = 0.01 * (20 + draw.random(n)) + detector.jitter * draw.standard_normal(n)
    late = draw.random(n) < detector.tail_share
    stamps[late] += detector.tail * draw.standard_exponential(late.sum())
    counted = np.histogram(stamps, bins=np.arange(101) * STEP)[0] / n
    expected = detector.expected(spike(20, 100))[:, 0]
    error = np.sqrt(expected / n) + 1.0 / n
    assert np.abs(counted - expected).max() / error.max() < 5  # of 100 bins, 5 standard errors


def test_no_errors_change_nothing_and_efficiency_thins():
    light = spike(height=40.0)
    assert np.array_equal(Detector().expected(light), light.H)
    assert Detector(efficiency=0.25).expected(light).sum() == 10.0
    thinned = Detector(photons=1e6, efficiency=0.25, dark_counts=0.5).expected(light)
    assert thinned.sum() == pytest.approx(250e3 + 0.5 * light.H.size, rel=1e-14)


def test_counts_beyond_the_last_bin_are_lost():
    """Half of a Gaussian around the capture's end; the spike fills its last bin."""
    detector = Detector(jitter=0.5)
    kept = detector.expected(spike(999)).sum()
    # the middle of the bin is half a step before the end
    assert kept == pytest.approx(stats.norm.cdf(0.5 * STEP / 0.5), abs=1e-4)


def test_gate_cuts_bins_and_keeps_dark_counts_out():
    H = np.ones((10, 2))
    even = TransientCapture(
        H=H, laser_points=np.zeros(3), sensor_points=np.zeros((2, 3)), delta_t=STEP, t_start=1.0
    )
    expected = Detector(gate=(1.025, 1.06), dark_counts=0.5).expected(even)
    shares = [0, 0, 0.5, 1, 1, 1, 0, 0, 0, 0]
    # differences of edges near 1 m against bins of 0.01 m
    assert expected[:, 0] == pytest.approx(1.5 * np.array(shares), abs=1e-13)
    closed = Detector(gate=(5.0, 6.0)).measure(even, seed=1)
    assert not closed.H.any()


@pytest.mark.parametrize("mean", [0.01, 0.7, 9.99, 10.0, 37.5, 1e4])
def test_counts_are_poissons(mean):
    """Chi-square of the counts against Poisson's chances, bins of 10 or more."""
    n = 40_000
    light = TransientCapture(
        H=np.full((n, 1), mean),
        laser_points=np.zeros(3),
        sensor_points=np.zeros((1, 3)),
        delta_t=1.0,
    )
    counts = Detector().measure(light, seed=11).H.ravel()
    assert (counts == np.rint(counts)).all()
    cuts = np.unique(stats.poisson.ppf(np.linspace(0.01, 0.99, 40), mean))
    chances = np.diff(np.concatenate([[0.0], stats.poisson.cdf(cuts, mean), [1.0]]))
    seen = np.bincount(np.searchsorted(cuts, counts), minlength=len(cuts) + 1)
    kept = chances * n >= 10
    distance = float(((seen - n * chances)[kept] ** 2 / (n * chances)[kept]).sum())
    # one in a million of right generators fails
    assert distance < stats.chi2.ppf(1 - 1e-6, max(kept.sum() - 1, 1))
    assert counts.mean() == pytest.approx(mean, abs=5 * np.sqrt(mean / n))


def test_draws_have_their_own_addresses(on_threads):
    """No thread, and no other bin, changes a bin's count; seeds do."""
    light = TransientCapture(
        H=np.random.default_rng(0).random((50, 4, 4)) * 30,
        laser_points=np.zeros(3),
        sensor_points=wall_grid(1.0, 4),
        delta_t=0.01,
        by_bounce={3: np.zeros((50, 4, 4))},
        details={"seed": 7},
    )
    first, again = (on_threads(n, lambda: Detector().measure(light, seed=3)) for n in (1, 2))
    assert np.array_equal(first.H, again.H)
    assert not np.array_equal(first.H, Detector().measure(light, seed=4).H)
    H = light.H.copy()
    H[0] = 0.0
    part = TransientCapture(
        H=H, laser_points=np.zeros(3), sensor_points=wall_grid(1.0, 4), delta_t=0.01
    )
    assert np.array_equal(Detector().measure(part, seed=3).H[1:], first.H[1:])
    assert first.quantity == "counts"
    assert first.standard_error == pytest.approx(np.sqrt(light.H), rel=1e-15)
    assert not first.by_bounce
    assert first.details["seed"] == 7


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"jitter": 5e-11}, r"jitter = 5e-11 .*if it is in seconds, give 0.0149896"),
        ({"tail": 1e-10, "tail_share": 0.1}, "tail = 1e-10 is too short"),
        ({"tail": 0.1}, "is incomplete; give both"),
        ({"tail_share": 0.1}, "is incomplete; give both"),
        ({"efficiency": 1.1}, "detector.efficiency = 1.1 is out of range"),
        ({"dark_counts": -1}, "detector.dark_counts"),
        ({"photons": 0}, "detector.photons"),
        ({"gate": (1.0, 1.0)}, "closes at 1 m"),
        ({"gate": 1.0}, "must be .opens, closes."),
        ({"jitter": float("nan")}, "not finite"),
    ],
)
def test_bad_detectors(given, words):
    with pytest.raises(SceneError, match=words):
        Detector(**given)


def test_captures_that_cannot_be_counted():
    with pytest.raises(SceneError, match="a bin of -1"):
        Detector().expected(spike(height=-1.0))
    with pytest.raises(SceneError, match="no light, detector.photons = 100"):
        Detector(photons=100).expected(spike(height=0.0))
    with pytest.raises(SceneError, match="limit 2.50"):
        Detector().measure(spike(height=1e18))
