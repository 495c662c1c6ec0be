"""Status of blind answers: its limits follow from the noise and from the number of data."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from nlosoptics.inverse.blind.verdict import Verdict

COUNTED, SIGMAS = np.array([900.0, 400.0, 250.0]), np.array([0.01, 0.03, 0.02])
SQUARES = np.array([1.2, 0.9, 1.7])
DETAIL = 0.04  # mean power of the images' detail


def verdict_of(counted=COUNTED, sigmas=SIGMAS, several=True, known=False):
    powers = DETAIL + sigmas**2
    images = np.sqrt(powers)[:, None, None] * np.array([[1.0, -1.0], [-1.0, 1.0]])
    frames = SimpleNamespace(counted=counted, sigmas=sigmas, images=images)
    return Verdict(frames, several, known)


def answer(squares=SQUARES):
    return SimpleNamespace(chi_square=squares[None])


def test_residuals_of_several_images():
    verdict = verdict_of()
    assert verdict.pixels == 1550
    error = math.sqrt((0.2 * 1e-4 - 0.1 * 9e-4 + 0.7 * 4e-4) / 3)
    assert verdict.model_error(answer()) == pytest.approx(error, rel=1e-12)
    assert verdict.model_error(answer(np.array([0.9, 1.0, 0.8]))) == 0.0
    excess = 3 * math.sqrt(2 / 1550)
    limit = math.sqrt(1e-3 * DETAIL + excess * (1e-4 + 9e-4 + 4e-4) / 3)
    assert verdict.model_limit() == pytest.approx(limit, rel=1e-12)
    for share, more in ((0.999, True), (1.001, False)):
        best = answer(np.array([1.0, 1.0, 1.0 + (share * limit) ** 2 * 3 / 4e-4]))
        assert verdict.fits(best) is more
        status, reasons = verdict.status(
            best, effective=1.0, margin=math.nan, rival=math.nan, rounds=2
        )
        assert status == ("converged" if more else "does_not_fit")
        assert more or f"limit {100 * limit:.2g} %" in reasons[0]
        squares = np.array([1.0, 1.0, 1.0 + excess * 1550 / 250 / share])
        assert verdict.structured(answer(squares)) is more


@pytest.mark.parametrize(("share", "vague"), [(0.999, False), (1.001, True)])
def test_much_noise_hides_the_residual_of_several_images(share, vague):
    """Three standard errors of its mean exceed 0.1 % of the detail; two rounds must agree then."""
    sigmas = np.full(3, share * math.sqrt(1e-3 * DETAIL / (3 * math.sqrt(2 / 1550))))
    verdict = verdict_of(sigmas=sigmas)
    assert verdict.vague is vague
    assert not verdict_of(sigmas=sigmas, several=False).vague
    assert not verdict_of(sigmas=sigmas, known=True).vague
    figures = {"effective": 1.0, "margin": math.nan, "rival": math.nan}
    statuses = [verdict.status(answer(np.ones(3)), **figures, rounds=n)[0] for n in (0, 1, 2)]
    assert statuses == ["ambiguous", "ambiguous" if vague else "converged", "converged"]


def test_one_image_excludes_no_blur_and_other_objects():
    """By three standard errors of the sum of the errors of two priors, of 50 values each."""
    verdict, best = verdict_of(COUNTED[:1], SIGMAS[:1], several=False), answer(np.ones(1))
    for margin, rival, named in (
        (30.1, math.inf, None),
        (30.1, 30.1, None),
        (29.9, 99.0, "a wave without blur"),
        (99.0, 29.9, "another object"),
        (99.0, -5.0, "another object"),
    ):
        status, reasons = verdict.status(best, effective=50.0, margin=margin, rival=rival, rounds=1)
        assert status == ("ambiguous" if named else "converged")
        assert not named or (named in reasons[0] and "must be 30;" in reasons[0])
