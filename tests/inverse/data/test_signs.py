"""Signs of a wrong answer have the values of their definitions, and limits beyond these."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from nlosoptics.inverse.data.signs import (
    SIGNS,
    block_means,
    doubt,
    expected_correlation,
    risk,
    signs,
    told,
)

SIDE = 64


def square(background=0.0):
    """Return a bright square of 16 x 16 pixels in the middle of a frame."""
    level = np.full((SIDE, SIDE), background)
    level[24:40, 24:40] = 1.0
    return level


@pytest.mark.parametrize(
    ("residual", "excess", "rest"),
    [
        (2.0, 10.0, 2.9 / 10.0),  # the power above 1.1 times the noise's, over the detail's
        (2.0, 1e-9, 1.0),  # of an image without detail, at most all
        (1.04, 10.0, 0.0),  # a residual of the noise's power leaves nothing
    ],
)
def test_unexplained_power_is_that_above_the_noise(residual, excess, rest):
    found = signs(square(), square(), residual=residual, excess=excess)
    assert found["unexplained"] == pytest.approx(rest, rel=1e-12)


def test_grain_is_the_share_of_pixels_with_an_edge():
    """All steps are 1 but for the corner with a step along both axes, of sqrt(2)."""
    found = signs(square(), square(), residual=1.0, excess=10.0)
    total, squares = 62.0 + np.sqrt(2.0), 64.0
    assert found["grain"] == pytest.approx(total**2 / squares / SIDE**2, rel=1e-12)


def test_border_is_the_brightness_of_the_outermost_pixels():
    """The frame's edge is 2 of 64 pixels wide; above 1.5 times the mean it counts no more."""
    level = square(0.25)
    found = signs(level, level, residual=1.0, excess=10.0)
    assert found["border"] == pytest.approx(0.25 / level.mean(), rel=1e-12)
    assert signs(1.0 - level, level, residual=1.0, excess=10.0)["border"] < 1.5
    frame = np.ones((SIDE, SIDE))
    frame[2:-2, 2:-2] = 0.0
    assert signs(frame, frame, residual=1.0, excess=10.0)["border"] == 1.5


def test_unsteady_is_the_distance_of_both_objects():
    level, rng = square(), np.random.default_rng(0)
    again = level + 0.3 * rng.random(level.shape)
    lost = 1.0 - np.corrcoef(level.ravel(), again.ravel())[0, 1]
    found = signs(level, again, residual=1.0, excess=10.0)
    assert found["unsteady"] == pytest.approx(np.sqrt(lost), rel=1e-9)
    same = signs(level, 2.0 * level + 1.0, residual=1.0, excess=10.0)
    assert same["unsteady"] == pytest.approx(0.0, abs=1e-7)
    # a uniform object has no correlation with another one
    uniform = signs(level, np.ones_like(level), residual=1.0, excess=10.0)
    assert uniform["unsteady"] == 1.0


def test_dim_parts_have_less_than_a_quarter_of_the_brightness():
    """By their power."""
    level = square()
    level[4:8, 4:20] = 0.2
    level[56:60, 4:20] = 0.3
    found = signs(level, level, residual=1.0, excess=10.0)
    dim, rest = 64 * 0.2**2, 256 * 1.0 + 64 * 0.3**2
    assert found["dim"] == pytest.approx(dim / (dim + rest), rel=1e-12)
    assert signs(square(), square(), residual=1.0, excess=10.0)["dim"] == 0.0


def test_the_expected_correlation_follows_from_both_forecasts():
    """A distance of 0.3 and a linear estimate of correlation 0.9."""
    assert expected_correlation(0.3, 0.9) == pytest.approx(1.0 - 0.88 * 0.009 ** (2 / 3), rel=1e-12)
    assert expected_correlation(0.0, 0.9) == expected_correlation(0.3, 1.0) == 1.0
    assert expected_correlation(2.0, 0.0) == 0.0


def test_unusual_signs_are_said_with_the_heaviest_first():
    """Without an unusual one, the one that weighs most is said."""
    usual = {name: sign.mean for name, sign in SIGNS.items()}
    said = [*told({**usual, "border": 0.8, "halo": 0.9, "grain": 0.22})]
    assert ["halo" in said[0], "frame's edge" in said[1], "grainy" in said[2]] == [True] * 3
    assert "0.90 of the power" in said[0]
    assert "0.80 times as bright" in said[1]
    assert "0.22 on a scale" in said[2]
    assert len([*told({**usual, "dim": SIGNS["dim"].mean + 1e-3})]) == 1
    assert "dim parts hold" in next(told({**usual, "dim": SIGNS["dim"].mean + 1e-3}))


def test_risk_is_the_probability_of_the_regression():
    """Logistic in the sum of the signs; 32 % at the limit, half at 0.763."""
    object_ = np.random.default_rng(0).random((SIDE, SIDE))
    values = signs(object_, object_, residual=1.0, excess=10.0)
    for wanted, expected in ((0.0, 0.318), (0.763, 0.5), (-700.0, 0.0)):
        border = (wanted - doubt(values)) / SIGNS["border"].weight + values["border"]
        assert risk({**values, "border": border}) == pytest.approx(expected, abs=1e-3)


def test_blocks_tell_where_a_residual_is_strong():
    """One bright pixel raises its block alone, and the median not at all."""
    values = np.ones((20, 33))
    values[9, 17] = 65.0
    means = block_means(values, 8)
    assert means.shape == (2, 4)
    assert means[1, 2] == 2.0
    assert means.sum() == 9.0
    assert block_means(values, 64).shape == (1, 1)


def test_soft_edges_are_measured_by_the_steps_of_the_object():
    """A disc's edge falls by its whole brightness; a ramp of ten pixels by a tenth in each."""
    sharp, ramp = np.zeros((SIDE, SIDE)), np.zeros((SIDE, SIDE))
    sharp[20:40, 20:40] = 3.0
    ramp[10:50] = (
        3.0 * np.minimum(1.0, np.minimum(np.arange(40), np.arange(40)[::-1]) / 10)[:, None]
    )
    softness = [signs(o, o, residual=1.0, excess=10.0)["soft"] for o in (sharp, ramp)]
    assert softness == pytest.approx([-0.25, -0.1], abs=1e-9)


def test_one_halo_is_told_from_other_dim_parts():
    """Wide spots around all dots are a halo; as many elsewhere are a part of the object."""
    rng = np.random.default_rng(0)
    dots = np.zeros((SIDE, SIDE))
    dots[rng.integers(8, 56, 12), rng.integers(8, 56, 12)] = 1.0
    moved = rng.permutation(dots.ravel()).reshape(dots.shape)
    spots, others = (gaussian_filter(centres, 2.0, mode="constant") for centres in (dots, moved))
    near, elsewhere = (
        signs(dots + 2.0 * dim, dots, residual=1.0, excess=10.0) for dim in (spots, others)
    )
    # not all, since the spots' brightest parts count as bright
    assert near["halo"] > 0.7
    assert elsewhere["halo"] < 0.4
    assert near["dim"] == pytest.approx(elsewhere["dim"], rel=0.5)
    # a blur that passes half of the object's power leaves halos in right objects too
    hidden = signs(dots + 2.0 * spots, dots, residual=1.0, excess=10.0, passed=0.5)
    assert hidden["halo"] == pytest.approx(0.5 * near["halo"], rel=1e-12)
    # of dim parts too faint to matter, a tenth of the light is a hundredth of the power
    faint, fainter = (
        signs(dots + x * spots, dots, residual=1.0, excess=10.0) for x in (0.02, 0.002)
    )
    assert fainter["dim"] < faint["dim"] < 5e-3
    assert fainter["halo"] / faint["halo"] == pytest.approx(0.01, rel=0.2)
