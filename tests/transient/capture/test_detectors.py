"""Detectors: counts are kept, moments are those of the response, noise is Poisson's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from nlosoptics.errors import SamplingError, SceneError
from nlosoptics.transient import Detector, TransientCapture, wall_grid, without_pile_up

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


def two_peaks(pulses):
    """Light of 1.9 photons per pulse in two peaks and a background, in 60 bins."""
    t = STEP * (np.arange(60) + 0.5)
    rate = (
        0.004 + 0.2 * np.exp(-(((t - 0.2) / 0.03) ** 2)) + 0.1 * np.exp(-(((t - 0.4) / 0.04) ** 2))
    )
    return TransientCapture(
        H=pulses * rate, laser_points=np.zeros(3), sensor_points=np.zeros(3), delta_t=STEP
    )


def photon_by_photon(light, pulses, dead_time):
    """Counts of a detector that meets one photon after the other, at continuous times."""
    draw = np.random.default_rng(8)
    photons = draw.poisson(light.H.sum() / pulses, pulses)
    share = np.concatenate([[0.0], np.cumsum(light.H)]) / light.H.sum()
    at = np.full((pulses, photons.max()), np.inf)
    inside = np.arange(photons.max()) < photons[:, None]
    at[inside] = np.interp(draw.random(photons.sum()), share, light.edges)
    ready, counted = np.zeros(pulses), []
    for t in np.sort(at, axis=1).T:
        seen = (t >= ready) & np.isfinite(t)
        counted.append(t[seen])
        ready[seen] = t[seen] + dead_time
    return np.histogram(np.concatenate(counted), light.edges)[0].astype(float)


@pytest.mark.parametrize("dead_time", [np.inf, 0.1, 0.0733])
def test_pile_up_is_that_of_single_photons(dead_time):
    """Of 300,000 pulses, 1 % of groups of six bins and five standard errors of each bin."""
    pulses = 300_000
    light = two_peaks(pulses)
    counted = photon_by_photon(light, pulses, dead_time)
    detector = Detector(pulses=pulses, dead_time=dead_time)
    groups = counted.reshape(10, 6).sum(axis=1)
    for counts in (detector.expected(light), detector.measure(light, seed=2).H):
        assert np.abs(counts - counted).max() < 5 * np.sqrt(2 * counted.max())
        assert counts.reshape(10, 6).sum(axis=1) == pytest.approx(groups, rel=0.01, abs=500)
    assert counted.sum() < 0.9 * light.H.sum()
    back = without_pile_up(replace(light, H=counted), pulses=pulses, dead_time=dead_time)
    assert 0.7 < np.std((back.H - light.H) / back.standard_error) < 1.3  # of 60, four spreads


def test_few_photons_do_not_pile_up_and_time_stamps_come_after():
    light = two_peaks(1000)
    plain, many = Detector(jitter=0.02, dark_counts=0.1), 10**9
    piled = Detector(jitter=0.02, dark_counts=0.1, pulses=many)
    assert piled.expected(light) == pytest.approx(plain.expected(light), rel=3e-6)
    piled = Detector(jitter=0.02, tail=0.03, tail_share=0.4, dark_counts=50.0, pulses=2000)
    counts = sum(piled.measure(light, seed=k).H for k in range(40))
    expected = 40 * piled.expected(light)
    assert (counts - expected) / np.sqrt(expected) == pytest.approx(0.0, abs=4.5)


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
        ({"pulses": 0}, "detector.pulses = 0 is out of range"),
        ({"dead_time": 1.0}, "without detector.pulses has no effect"),
        ({"dead_time": "long", "pulses": 5}, "detector.dead_time = 'long'"),
        ({"dead_time": float("nan"), "pulses": 5}, "detector.dead_time = nan is not finite"),
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
    with pytest.raises(SceneError, match="at least the width of a bin, 0.01 m"):
        Detector(pulses=9, dead_time=0.005).expected(spike())
    with pytest.raises(SceneError, match="a bin of -1"):
        without_pile_up(spike(height=-1.0), pulses=9)
    with pytest.raises(SamplingError, match="bin 200 has 9 counts, but only 9 of 9 pulses"):
        without_pile_up(spike(height=9.0), pulses=9)
