"""Answers against closed forms, on figures that are simple functions of the values."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import scipy.stats
from pytest import approx

from nlosoptics.errors import SceneError
from nlosoptics.study import Results, Study, fraction_within, run_study, sensitivities
from nlosoptics.study import sobol_indices as indices
from nlosoptics.study.answers import interval

HERE = Path(__file__).parent
SCENE = str(HERE.parents[1] / "examples" / "scenes" / "letter_flat.toml")
OF = {
    "laser.power": {"from": "1 mW", "to": "2 mW"},
    "camera.exposure": {"from": "1 s", "to": "3 s"},
}


def run(path: Path, figure: str, **tables) -> Results:
    given = {"scene": SCENE, "figures": [f"own_figures:{figure}"], **tables}
    return run_study(Study.from_tables(given, HERE), path / "store", workers=0)


def test_sensitivities_are_differences_from_the_nominal_scene(tmp_path: Path) -> None:
    cases = {"laser.power": ["4 mW", "7 mW", "-1 W"], "camera.exposure": ["1 s"]}
    results = run(tmp_path, "power", one_at_a_time=cases)
    bars = sensitivities(results, "power")
    assert [bar.case for bar in bars] == [
        "laser.power = 7 mW",
        "laser.power = 4 mW",
        "camera.exposure = 1 s",
        "laser.power = -1 W",  # refused by the laser
    ]
    assert [bar.change for bar in bars[:3]] == approx([2e-3, -1e-3, 0.0], abs=1e-18)
    assert [bar.resolved for bar in bars] == [True, True, False, False]
    with pytest.raises(SceneError, match="a yield needs a study with .draws. alone"):
        fraction_within(results, "power", at_least=1.0)


def test_a_change_below_its_error_is_not_resolved(tmp_path: Path) -> None:
    bars = sensitivities(
        run(tmp_path, "drawn", one_at_a_time={"laser.power": ["1 mW", "2 mW", "3 mW", "4 mW"]}),
        "drawn",
    )
    # the figure's error is 1/4, so that a difference has an error of sqrt(2)/4
    assert [bar.resolved for bar in bars] == [abs(bar.change) > 2**0.5 / 4 for bar in bars]
    assert {bar.resolved for bar in bars} == {True, False}


def test_yield_is_a_share_with_its_exact_interval(tmp_path: Path) -> None:
    draws = {"count": 64, "method": "sobol", "of": OF}
    results = run(tmp_path, "power", draws=draws)
    found = fraction_within(results, "power", at_least=1.25e-3, at_most=1.75e-3)
    assert (found.met, found.points, found.failed) == (32, 64, 0)  # Sobol's balance
    # Clopper and Pearson: quantiles of beta distributions
    assert found.low == approx(scipy.stats.beta.ppf(0.025, 32, 33), rel=1e-9)
    assert found.high == approx(scipy.stats.beta.ppf(0.975, 33, 32), rel=1e-9)
    with pytest.raises(SceneError, match="at_least and at_most are both missing"):
        fraction_within(results, "power")
    with pytest.raises(SceneError, match="figure = 'strehl' is unknown, must be one of power"):
        fraction_within(results, "strehl", at_least=0.0)


def test_failed_points_count_against_the_yield(tmp_path: Path) -> None:
    draws = {"count": 16, "of": {"laser.power": {"from": "2 mW", "to": "4 mW"}}}
    found = fraction_within(run(tmp_path, "fragile", draws=draws), "fragile", at_least=0.0)
    assert (found.met, found.points, found.failed) == (8, 16, 8)


def test_statistics_of_an_incomplete_study_are_refused_unless_asked_for(tmp_path: Path) -> None:
    draws = {"count": 16, "of": OF}
    given = {"scene": SCENE, "figures": ["own_figures:power"], "draws": draws}
    asked = iter([False] * 4 + [True] * 99)
    study = Study.from_tables(given, HERE)
    part = run_study(study, tmp_path / "store", workers=0, interrupted=lambda: next(asked))
    with pytest.raises(SceneError, match=r"of 16 in .* are pending"):
        fraction_within(part, "power", at_least=0.0)
    found = fraction_within(part, "power", at_least=0.0, incomplete=True)
    assert found.points == found.met == part.counts["done"] < 16


@pytest.mark.thorough
def test_sobol_indices_are_the_shares_of_the_variance(tmp_path: Path) -> None:
    """The figure is p t, of uniform p and t: first-order shares in closed form."""
    draws = {"count": 128, "method": "saltelli", "of": OF}
    results = run(tmp_path, "energy", draws=draws)
    found = indices(results, "energy")
    mean, variance = np.array([1.5, 2.0]), np.array([1.0, 4.0]) / 12
    parts = variance * mean[::-1] ** 2
    both = variance.prod()
    total = parts.sum() + both
    assert found["address"].values.tolist() == list(OF)
    # errors of a balanced design of 128 rows are below 0.01; those of independent draws 0.1
    assert found["first"].values == approx(parts / total, abs=0.02)
    assert found["total"].values == approx((parts + both) / total, abs=0.02)
    assert np.all(found["first_low"] < found["first"])
    assert np.all(found["first"] < found["first_high"])
    assert indices(results, "energy").identical(found)


def wavy(draws: np.ndarray) -> np.ndarray:
    """A figure of merit with many peaks."""
    return np.sin(12 * draws[:, 0]) * np.cos(9 * draws[:, 1]) + draws[:, 0]


@pytest.mark.parametrize("limit", [0.2, 0.9])
def test_the_interval_of_sobol_draws_covers_the_true_yield(limit: float) -> None:
    """In at least 95 of 100 scrambles, and it is narrower than that of independent draws."""
    truth = (wavy(np.random.default_rng(0).random((2_000_000, 2))) >= limit).mean()
    covered, widths = 0, []
    for seed in range(100):
        draws = scipy.stats.qmc.Sobol(2, rng=np.random.default_rng(seed)).random(1024)
        good = wavy(draws) >= limit
        low, high = interval(good, 0.95, sobol=True)
        covered += low <= truth <= high
        exact = interval(good, 0.95)
        widths.append((high - low) / (exact[1] - exact[0]))
    assert covered >= 95
    assert np.median(widths) < 0.8
