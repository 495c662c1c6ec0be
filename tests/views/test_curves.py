"""Curves: their data, units, labels, and what is refused."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from nlosoptics import views
from nlosoptics.errors import SamplingError, SceneError

pytest.importorskip("matplotlib")

FREQUENCY = np.linspace(0.0, 5e5, 11)
FALLING = np.linspace(1.0, 0.0, 11)


def lines_of(axes):
    return {line.get_label(): np.array(line.get_data()) for line in axes.lines}


def test_mtf_is_drawn_over_cycles_per_mm(assert_drawn):
    axes = views.mtf(FREQUENCY, FALLING**2, FALLING**3, diffraction_limit=FALLING)
    lines = lines_of(axes)
    for name, values in (
        ("along x", FALLING**2),
        ("along y", FALLING**3),
        ("diffraction limit", FALLING),
    ):
        np.testing.assert_array_equal(lines[name][0], FREQUENCY * 1e-3)
        np.testing.assert_array_equal(lines[name][1], values)
    assert axes.get_xlabel() == "spatial frequency in the image (cycles/mm)"
    assert axes.get_ylabel() == "modulation"
    assert axes.get_xlim() == (0.0, 500.0)
    assert {t.get_text() for t in axes.get_legend().get_texts()} == set(lines)
    assert_drawn(axes)


def test_radii_that_hold_shares_are_marked(assert_drawn):
    """A ramp reaches 50 % at half its length and, cut off at 70 %, never 80 %."""
    radius = np.linspace(0.0, 7e-6, 8)
    axes = views.encircled_energy(radius, radius / 10e-6, diffraction_limit=np.ones(8))
    lines = lines_of(axes)
    # rounding of um
    np.testing.assert_allclose(lines["50 % within 5 µm"], [[5.0], [0.5]], rtol=1e-12)
    assert "80 % not within 7 µm" in lines
    np.testing.assert_allclose(lines["encircled energy"][0], radius * 1e6)
    assert axes.get_xlabel() == "radius (µm)"
    assert axes.get_ylabel() == "fraction of the energy"
    assert_drawn(axes)
    first = views.encircled_energy([1e-6, 2e-6], [0.6, 0.9], shares=(0.5,))
    assert "50 % within 1 µm" in lines_of(first)


@pytest.mark.parametrize(
    ("draw", "message"),
    [
        (lambda: views.mtf(FREQUENCY, FALLING[:3]), r"along_x has shape \(3,\), must be \(11,\)"),
        (lambda: views.mtf([0.0], [1.0]), r"frequency has shape \(1,\), must be \(n,\)"),
        (lambda: views.mtf(FREQUENCY, FALLING * np.nan), "along_x has 11 of 11 values"),
        (lambda: views.encircled_energy(FALLING, FALLING), "radius must increase"),
        (
            lambda: views.encircled_energy(FREQUENCY, FALLING, shares=(1.5,)),
            "shares = 1.5 is out of range",
        ),
    ],
)
def test_curves_that_do_not_fit_are_refused(draw, message):
    with pytest.raises((SamplingError, SceneError), match=message) as refusal:
        draw()
    assert "\n" not in str(refusal.value)


def fit(**history):
    return SimpleNamespace(history={name: np.array(v) for name, v in history.items()})


def test_history_draws_each_record_over_its_iterations(assert_drawn):
    residual, change = [9.0, 3.0, 1.2, 1.0], [1.0, 0.1, 0.01, 0.001]
    found = fit(objective=[-1.0, -2.0, -3.0, -3.5], residual=residual, change=change)
    axes = views.history(found)
    assert [axis.get_ylabel() for axis in axes] == [
        "objective",
        "residual, rms of the noise",
        "relative change",
    ]
    assert {axis.get_xlabel() for axis in axes} == {"iteration"}
    np.testing.assert_array_equal(axes[1].lines[0].get_data(), [[1, 2, 3, 4], residual])
    assert list(axes[1].lines[1].get_ydata()) == [1.0, 1.0]
    assert [axis.get_yscale() for axis in axes] == ["linear", "linear", "log"]
    assert_drawn(axes)
    assert views.history(found, axes=axes) == axes


def test_restarts_are_dots():
    (restarts,) = views.history(fit(fourier_error=[0.3, 0.1, 0.2]))
    assert restarts.get_xlabel() == "restart"
    assert restarts.lines[0].get_linestyle() == "None"


def test_a_fit_without_records_is_told():
    with pytest.raises(SceneError, match="history of this fit is empty"):
        views.history(fit(objective=[], residual=[]))
    (axes,) = views.history(fit(change=[1.0]))
    with pytest.raises(
        SceneError, match="1 axes were given, must be 2: one each for objective, relative"
    ):
        views.history(fit(objective=[1.0], change=[1.0]), axes=(axes,))
