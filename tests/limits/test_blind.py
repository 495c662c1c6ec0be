"""Forecast of blind fits, against the tests from which it is derived."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest
from pytest import approx

from nlosoptics.limits.blind import SHARES, blind_forecast

RESULTS = Path(__file__).parents[2] / "benchmarks" / "results"
TOLD = {4: 0.01, 5: 0.01}  # bounds that determine a wave


@pytest.mark.parametrize(("name", "frames"), [("one_frame", 1), ("two_frames", 2)])
def test_shares_are_those_of_the_committed_results(name: str, frames: int) -> None:
    rows = [
        json.loads(line) for line in (RESULTS / f"evidence_{name}.jsonl").read_text().splitlines()
    ]
    for strength, shares in SHARES.items():
        part = [row["correlation"] > 0.9 for row in rows if row["rms"] == strength]
        assert shares[frames - 1] == sum(part) / len(part)


def test_forecast_is_interpolated_between_tested_walls() -> None:
    found = blind_forecast(0.375, 0.01, 0.0, TOLD)
    assert found.one_frame == approx((SHARES[0.25][0] + SHARES[0.5][0]) / 2)
    assert found.two_frames == 1.0
    assert "0.38 waves" in found.text
    assert blind_forecast(1.0, 0.01, 0.0, TOLD).one_frame == SHARES[1.0][0]


@pytest.mark.parametrize(
    ("case", "words"),
    [
        ((2.0, 0.01, 0.0, TOLD), "not tested for walls above 1 wave"),
        ((0.5, 0.1, 0.0, TOLD), "not tested for noise of 10 %"),
        ((0.5, 0.01, 2.0, TOLD), "not tested for a lobe"),
        ((0.01, 0.01, 0.0, TOLD), "needs no other"),
    ],
)
def test_untested_cases_have_no_share(case: tuple, words: str) -> None:
    found = blind_forecast(*case)
    assert math.isnan(found.one_frame)
    assert math.isnan(found.two_frames)
    assert words in found.text


def test_wave_that_the_image_does_not_hold_is_not_found() -> None:
    found = blind_forecast(0.5, 0.01, 0.0, {4: 0.4, 5: 0.4})
    assert (found.one_frame, found.two_frames) == (0.0, 0.0)
    assert "0.57 waves rms at best" in found.text
    assert blind_forecast(math.nan, 0.01, 0.0, {}).two_frames == 0.0
