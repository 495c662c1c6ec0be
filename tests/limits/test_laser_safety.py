"""Laser classes: limits against values computed by hand from the tables of IEC 60825-1:2014."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pytest import approx
from scipy.integrate import quad

from nlosoptics.errors import SceneError
from nlosoptics.limits import laser_class
from nlosoptics.scene import Laser, Scene, TransientScan

SCENES = Path(__file__).parents[2] / "examples" / "scenes"
FLAT = Scene.load(SCENES / "letter_flat.toml")


def lit(nm: float = 632.8, mw: float = 5.0, mm: float = 1.0) -> Scene:
    """A scene with a laser of some wavelength, power and diameter."""
    laser = Laser(
        wavelength=1e-9 * nm,
        power=1e-3 * mw,
        beam_diameter=1e-3 * mm,
        position=FLAT.laser.position,
    )
    return replace(FLAT, laser=laser)


@pytest.mark.parametrize(
    ("nm", "limits"),
    [
        (405.0, (0.039, 1.0, 5.0, 500.0)),  # 3.9 mJ in 100 s
        (450.0, (0.039, 1.0, 5.0, 500.0)),
        (488.0, (0.039 * 10**0.76, 1.0, 5.0, 500.0)),  # C3 = 5.754
        (532.0, (0.39, 1.0, 5.0, 500.0)),  # photochemical 1.70 mW
        (632.8, (0.39, 1.0, 5.0, 500.0)),
        (785.0, (0.576852, None, 2.884261, 500.0)),  # C4 = 1.479108
        (905.0, (1.002454, None, 5.012272, 500.0)),  # C4 = 2.570396
        (1064.0, (1.95, None, 9.75, 500.0)),  # C4 = 5
        (1180.0, (1.95 * 10**0.54, None, 9.75 * 10**0.54, 500.0)),  # C7 = 3.467
        (1250.0, (17.55, None, 87.75, 500.0)),  # C7 = 9
        (1350.0, (500.0, None, 500.0, 500.0)),  # 19.5 W without the limit of class 3B
        (1550.0, (10.0, None, 50.0, 500.0)),
        (2940.0, (10.0, None, 50.0, 500.0)),
    ],
)
def test_limits_are_those_of_the_tables(nm: float, limits: tuple[float | None, ...]) -> None:
    names = ("1", "2", "3R", "3B")
    wanted = {name: mw for name, mw in zip(names, limits, strict=True) if mw is not None}
    found = laser_class(lit(nm)).limits
    # the numbers by hand have six digits
    assert {name: 1e3 * w for name, w in found.items()} == approx(wanted, rel=1e-6)
    # just below a limit, a narrow beam is of its class or a safer one; just above, it is not
    order = [*wanted, "4"]
    for i, (name, mw) in enumerate(wanted.items()):
        assert order.index(laser_class(lit(nm, mw * 0.999)).name) <= i
        above = laser_class(lit(nm, mw * 1.001))
        assert order.index(above.name) > i
        assert above.ratio(name) == approx(1.001, rel=2e-6)


def test_factors_meet_at_their_breakpoints() -> None:
    """The standard rounds C4 of 5.012 to 5 at 1050 nm, and C7 steps from 7.943 to 8.01 at 1200."""
    for nm, step in ((450, 1e-6), (500, 1e-6), (1050, 3e-3), (1150, 1e-6), (1200, 9e-3)):
        below, above = (laser_class(lit(nm + d)).limits["1"] for d in (-1e-7, 1e-7))
        assert below == approx(above, rel=step)


@pytest.mark.parametrize(("nm", "aperture"), [(632.8, 7e-3), (1399.0, 7e-3), (1401.0, 3.5e-3)])
def test_power_in_the_aperture_bounds_that_of_uniform_and_gaussian_beams(
    nm: float, aperture: float
) -> None:
    """Tight for a narrow uniform beam, and for a Gaussian one much wider than the aperture."""

    def density(r: float, w: float) -> float:
        return float(4 * r / w**2 * np.exp(-2 * r**2 / w**2))

    for mm in (1.0, 6.0, 10.0, 200.0):
        found = laser_class(lit(nm, 10.0, mm))
        assert found.aperture == aperture
        w = 0.5e-3 * mm  # radius at 1/e^2 of the irradiance 2 P / (pi w^2) exp(-2 r^2 / w^2)
        share = quad(density, 0, aperture / 2, args=(w,))[0]
        exact = 10e-3 * max(share, min(1.0, (aperture / (2 * w)) ** 2))
        tight = 2e-3 if mm in (1.0, 200.0) else 0.6
        assert exact <= found.power <= exact * (1 + tight)


def test_wide_beam_is_of_a_safer_class() -> None:
    classes = [laser_class(lit(632.8, 5.001, mm)).name for mm in (3.0, 7.0, 20.0, 40.0)]
    assert classes == ["3B", "3B", "3R", "1"]  # 5.001, 5.001, 1.23 and 0.31 mW


def test_example_says_what_it_is() -> None:
    told = str(laser_class(FLAT))
    assert told.startswith("class 3R (estimate): 5 mW through 7 mm; limits: class 1 0.39 mW, ")


@pytest.mark.parametrize(
    ("scene", "told"),
    [
        (lit(355.0), "laser.wavelength = 3.55e-07 m is out of range, must be from 4e-07 to 4e-06"),
        (lit(10600.0), "laser.wavelength = 1.06e-05 m is out of range"),
        (
            replace(
                FLAT,
                transient=TransientScan(side=1.0, count=8, delta_t=0.01, n_bins=64, t_start=0.5),
            ),
            r"\[transient\] needs the limits of pulses",
        ),
        (FLAT.laser, "scene is a Laser; give a Scene"),
    ],
)
def test_other_lasers_are_refused(scene: Scene, told: str) -> None:
    with pytest.raises(SceneError, match=told) as error:
        laser_class(scene)
    assert "\n" not in str(error.value)


def test_class_without_a_limit_is_refused() -> None:
    with pytest.raises(SceneError, match="laser_class = '2' has no limit at this wavelength"):
        laser_class(lit(1064.0)).ratio("2")
    with pytest.raises(SceneError, match="laser_class = '4'"):
        laser_class(lit()).ratio("4")
