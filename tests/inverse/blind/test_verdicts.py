"""Verdicts on answers: formulas of several unlike images, the side of each limit, and its text."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from nlosoptics.inverse.blind.verdict import Verdict

COUNTED, SIGMAS = np.array([900.0, 400.0, 250.0]), np.array([0.01, 0.03, 0.02])
SQUARES, WALLS = np.array([1.2, 0.9, 1.7]), np.array([0.3, -0.4, 0.0, 0.1, 0.2, -0.2])


def verdict_of(counted=COUNTED, sigmas=SIGMAS, several=True):
    frames = SimpleNamespace(counted=counted, sigmas=sigmas)
    return Verdict(frames, (4, 6, 9), several)


def answer(squares=SQUARES, walls=WALLS):
    return SimpleNamespace(chi_square=squares[None], coefficients=walls[None])


def test_figures_of_several_images():
    verdict, best = verdict_of(), answer()
    assert verdict.pixels == 1550
    error = math.sqrt((0.2 * 1e-4 - 0.1 * 9e-4 + 0.7 * 4e-4) / 3)
    assert verdict.model_error(best) == pytest.approx(error, rel=1e-12)
    assert verdict.model_error(answer(np.array([0.9, 1.0, 0.8]))) == 0.0
    noise = 3 * math.sqrt(2 / 1550) * (1e-4 + 9e-4 + 4e-4) / 3
    for scale in (1.0, 5.0):
        length = min(scale * math.hypot(0.5, 0.3), 1.0)
        found = [verdict.model_limit(answer(walls=scale * WALLS), whole) for whole in (True, False)]
        assert found[0] == pytest.approx(math.hypot(0.004 + 0.003 * length, math.sqrt(noise)))
        assert found[1] > found[0]
    incomplete = found[1] ** 2 - noise
    assert incomplete > 0.007**2
    for share, well in ((0.999, True), (1.001, False)):
        limit = verdict.model_limit(answer(), complete=False)
        level = (share * 0.6 * limit) ** 2 * 3 / 4e-4
        assert verdict.well(answer(np.array([1.0, 1.0, 1.0 + level]))) is well
    excess = 3 * math.sqrt(2 / 1550)
    for share, more in ((0.999, False), (1.001, True)):
        squares = np.array([1.0, 1.0, 1.0 + share * excess * 1550 / 250])
        assert verdict.structured(answer(squares)) is more
    assert not verdict.alone(100.0)
    assert verdict.alone(100.1)
    assert not verdict.alone(math.nan)


def told(verdict, best, margin=-80.0, sharp=-900.0, rival=150.0, **options):
    given = {"expected": math.nan, "held": 0.0, "start_error": None} | options
    return " ".join(verdict.faults(best, (margin, sharp), rival, **given))


@pytest.mark.parametrize(("share", "vague"), [(0.999, False), (1.001, True)])
def test_much_noise_hides_the_residual_of_several_images(share, vague):
    """Its three standard errors exceed a quarter of the square of the limit at one wave."""
    sigma = share * math.sqrt(0.25 * 0.007**2 / (3 * math.sqrt(2 / 1550)))
    sigmas = np.full(3, sigma)
    assert verdict_of(sigmas=sigmas).vague is vague
    assert not verdict_of(sigmas=sigmas, several=False).vague


def test_an_answer_that_noise_hides_is_doubted_by_its_modes_and_its_rounds():
    verdict = verdict_of()
    assert verdict.doubts((4, 6, 9), 2) == ()
    (once,) = verdict.doubts((4, 6, 9), 1)
    assert "only 1 of the search's rounds found this object, must be 2; expose longer" in once
    (wider,) = verdict.doubts((4, 6, 9, 10), 2)
    assert "needs 4 modes where 3 were given, as wrong ones do; expose longer" in wider


def test_residuals_beyond_the_noise_come_first():
    verdict = verdict_of()
    limit = verdict.model_limit(answer(), complete=True)
    for share in (0.999, 1.001):
        level = (share * limit) ** 2 * 3 / 4e-4
        said = told(verdict, answer(np.array([1.0, 1.0, 1.0 + level])))
        assert said == (
            f"wall and object leave {100 * share * limit:.2g} % of the images' range beyond the "
            f"noise, limit {100 * limit:.2g} %; check the defocus and the pupil, or give more modes"
            if share > 1
            else ""
        )
    single = verdict_of(several=False)
    larger = answer(np.array([1.0, 1.0, 1.0 + level]))
    assert not told(single, larger).startswith("wall and object")  # modes may be missing


ONE = {"counted": np.array([2000.0]), "several": False}
SHARPLY = (
    "a wave without blur explains the image nearly as well: its free energy is above the answer's "
    "by {} only; give a second image with a known defocus"
)


@pytest.mark.parametrize("sigma", [0.004, 0.01, 0.02])
def test_one_image_against_no_blur(sigma):
    """By 70 for certain, or by so much per pixel against the fit that stays sharp."""
    verdict = verdict_of(sigmas=np.array([sigma]), **ONE)
    best = answer(np.array([1.0]), 2.0 * WALLS[:3])  # one wave
    limit = 2000 * (0.092 + 0.045 * max(0.0, math.log(0.01 / sigma)))
    options = {"rival": math.nan, "expected": 9.0}  # would not pass
    assert told(verdict, best, margin=-70.1, sharp=0.0, **options) == ""
    assert told(verdict, best, -70.0, -0.999 * limit, **options) == SHARPLY.format("70")
    assert told(verdict, best, -12.34, -0.999 * limit) == SHARPLY.format("12.3")
    sure = {"margin": -70.0, "sharp": -1.001 * limit}
    assert told(verdict, best, **sure, expected=1.0 / 0.6 - 1e-3) == ""
    assert told(verdict, best, **sure, expected=1.0 / 0.6 + 1e-3) == (
        "a wave of 1.7 waves rms is expected, that of the answer has 1 waves rms, as wrong answers "
        "have; give a second image with a known defocus"
    )
    assert told(verdict, best, **sure).startswith("a wave of unknown strength is expected")
    assert told(verdict, best, **sure, expected=1.0, rival=100.1) == ""
    assert told(verdict, best, **sure, expected=1.0, rival=99.96) == (
        "another wall explains the image nearly as well: its free energy is above the answer's by "
        "100 only; give a second image with a known defocus"
    )


@pytest.mark.parametrize("sigma", [0.01, 0.025])
def test_one_image_about_a_start(sigma):
    """By 50, or by 100 of the prior: then not more than 1 / noise above, nor fitted noise."""
    verdict = verdict_of(sigmas=np.array([sigma]), **ONE)
    best, noisy = answer(np.array([0.931**2]), WALLS[:3]), answer(np.array([0.929**2]), WALLS[:3])
    prior = {"start_error": 0.2, "sharp": 0.0, "rival": math.nan}
    assert told(verdict, noisy, -50.1, **prior) == ""
    assert told(verdict, best, -50.0, **prior) == SHARPLY.format("50")
    assert told(verdict, best, -49.0, held=51.1, **prior) == ""
    assert told(verdict, best, -49.0, held=51.0, **prior) == SHARPLY.format("49")
    assert told(verdict, noisy, -49.0, held=51.1, **prior) == SHARPLY.format("49")
    above = 1 / sigma
    assert told(verdict, best, 0.999 * above, held=300.0, **prior) == ""
    assert told(verdict, best, 1.001 * above, held=300.0, **prior) != ""


@pytest.mark.parametrize(
    ("scale", "margin", "several", "status"),
    [
        (0.239, -5.0, False, "ambiguous"),
        (0.241, -5.0, False, "unconverged"),
        (0.241, 0.0, False, "ambiguous"),
        (0.239, -5.0, True, "unconverged"),
        (0.241, 0.0, True, "unconverged"),
    ],
)
def test_status(scale, margin, several, status):
    """Below 0.12 waves, or no better than without blur, one image is fitted by no wall."""
    verdict = verdict_of(several=several)
    best = answer(walls=scale * WALLS[:3])
    assert verdict.status(best, margin, ("a fault",)) == status
    assert verdict.status(best, margin, ()) == "converged"
