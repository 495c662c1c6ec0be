"""Gradients of figures against central differences, and what searches save by them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pytest import approx

from nlosoptics.study import Study, optimum, plan_study
from nlosoptics.study.design.point import StudyPoint, stage_caches
from nlosoptics.study.design.values import number, with_unit
from nlosoptics.study.design.variables import delta_of
from nlosoptics.study.gradients import Gradients
from nlosoptics.study.search.problem import dependences, outcome

from .searches import OFF, SCENES, made, run

FLAT = str(SCENES / "letter_flat.toml")
SLOW = {"camera.f_number": 16, "camera.binning": 32}
RADIUS = {"wall.radius": ["4.6 m", "5 m", "5.5 m"]}
STOP = {"figure": "value", "address": "camera.stop_diameter"}
FOCUS = {"camera.focus_distance": {"from": "2 m", "to": "4 m"}}
WALL = {"wall.radius": {"from": "4 m", "to": "8 m", "spacing": "log"}}
SMOOTH = ("strehl", "aberration_rms", "spot_rms", "camera_focus_distance")


def study_of(*others, **tables) -> Study:
    """A study of smooth figures in five variables, of which the wave depends on four."""
    figures = [*SMOOTH[:3], {"figure": "value", "address": "camera.focus_distance"}]
    variables = FOCUS | WALL
    variables["camera.f_number"] = {"from": 8, "to": 32}
    variables["hidden.position[2]"] = {"from": "0.9 m", "to": "1.1 m"}
    variables["laser.power"] = {"from": "1 mW", "to": "5 mW"}
    given = {"set": SLOW, "variables": variables}
    return made([*figures, *others], ["strehl"], "slsqp", **(given | tables))


def differences(study: Study, name: str, delta: dict, step: float = 4e-4) -> np.ndarray:
    """Derivatives by central differences of the figure itself, extrapolated to step 0."""
    figure, found = study.figure(name), []

    def at(address: str, value: float, unit: str) -> float:
        there = delta | {address: with_unit(value, unit)}
        point = StudyPoint(study.base, there, 0, study.tol, stage_caches())
        return figure.value(point, study.folder)[0]

    for variable in study.variables:
        value = number(delta[variable.address])[0]
        span = np.log(variable.high / variable.low) * value if variable.log else 0.0
        span = span or variable.high - variable.low
        half, full = (
            (at(variable.address, value + h * span, variable.unit)
             - at(variable.address, value - h * span, variable.unit)) / (2 * h)
            for h in (step / 2, step)
        )  # fmt: skip
        found.append((4 * half - full) / 3)
    return np.array(found)


@pytest.mark.parametrize(
    ("place", "within"),
    [
        ((0.3, 0.45, 0.5, 0.6, 0.5), 1e-7),  # truncation at steps of 1e-5 and of 4e-4
        ((0.5, 0.0, 1.0, 0.0, 1.0), 1e-5),  # rounding of 1e-13 waves; derivatives of 0.01 waves
    ],
)
def test_gradients_are_central_differences(place: tuple[float, ...], within: float) -> None:
    """Inside, and on limits, where all neighbours are on one side."""
    study = study_of()
    addresses = [variable.address for variable in study.variables]
    delta = delta_of(study.variables, dict(zip(addresses, place, strict=True)))
    found = Gradients(study).at(delta, SMOOTH)
    assert set(found) == set(SMOOTH)
    for name in SMOOTH:
        wanted = differences(study, name, delta)
        assert found[name] == approx(wanted, abs=within * np.abs(wanted).max()), name


def test_figures_without_gradients_are_named() -> None:
    """The modulation has a window, own functions are unknown, and so is a rough wall's wave."""
    study = study_of(OFF, {"figure": "mtf", "frequency": 60.0})
    start = delta_of(study.variables, {v.address: v.start for v in study.variables})
    assert set(Gradients(study).at(start, ["off", "mtf", "strehl"])) == {"strehl"}
    cut = made(
        ["strehl", STOP],
        ["strehl"],
        "slsqp",
        scene=FLAT,
        set={"wall.size": ["5 mm", "5 mm"]},
        variables=FOCUS,
    )
    start = delta_of(cut.variables, {v.address: v.start for v in cut.variables})
    assert set(Gradients(cut).at(start, ["strehl", "camera_stop_diameter"])) == {
        "camera_stop_diameter"
    }


def test_plan_names_the_gradients() -> None:
    limit = {"figure": "off", "at_most": 1.0}
    plan = plan_study(study_of(OFF, constraints=[limit]))
    assert (plan.gradients, plan.differences) == (("strehl",), ("off",))
    assert "gradients      of strehl computed, of off by differences" in str(plan)
    plan = plan_study(made([OFF], ["off"], variables=FOCUS))
    assert (plan.gradients, plan.differences) == ((), ())
    assert "gradients" not in str(plan)


def widest_stop(method: str) -> Study:
    """Closed form: rms of defocus, D^2 / (16 sqrt 3) (1/s - 1/z), is at most 0.07 waves."""
    return made(
        ["aberration_rms", STOP],
        [{"figure": "camera_stop_diameter", "goal": "maximise"}],
        method,
        scene=FLAT,
        set={"camera.focus_distance": "1.8 m"},
        constraints=[{"figure": "aberration_rms", "at_most": 0.07}],
        variables={"camera.stop_diameter": {"from": "2 mm", "to": "20 mm"}},
    )


def sharpest(method: str) -> Study:
    """Three variables, of which two end on their limits."""
    variables = FOCUS | {"wall.radius": {"from": "4 m", "to": "6 m"}}
    variables["hidden.position[2]"] = {"from": "0.9 m", "to": "1.1 m"}
    goal = [{"figure": "strehl", "goal": "maximise"}]
    return made(["strehl"], goal, method, 100, set=SLOW, variables=variables)


@pytest.mark.parametrize(
    ("of", "value", "most"), [(widest_stop, 4.261219e-3, 10), (sharpest, 0.9904952, 20)]
)
def test_gradients_save_trials(of, value: float, most: int, tmp_path: Path, monkeypatch) -> None:
    """The same optimum with a half of the trials of differences, and of those of COBYQA."""
    with_gradients = optimum(run(of("slsqp"), tmp_path / "gradients"))
    others = [optimum(run(of("cobyqa"), tmp_path / "cobyqa"))]
    monkeypatch.setattr(Gradients, "at", lambda self, delta, names: {})
    others.append(optimum(run(of("slsqp"), tmp_path / "differences")))
    assert "computed" in with_gradients.results.dataset.attrs["search"]
    assert "by differences" in others[1].results.dataset.attrs["search"]
    count = len(with_gradients.objectives)
    assert count <= most
    best = with_gradients.objectives[with_gradients.best, 0]
    assert best == approx(value, rel=1e-6)  # digits of the value
    for other in others:
        assert len(other.objectives) >= 2 * count
        # a constraint may be missed by 1e-6, and COBYQA ends at 1e-6 of the ranges
        assert other.objectives[other.best, 0] == approx(best, rel=1e-5)


def test_closed_form_of_the_widest_stop(tmp_path: Path) -> None:
    study = widest_stop("slsqp")
    scene = study.base.scene({"camera.focus_distance": None})
    bend = 1.0 / 1.8 - 1.0 / scene.focus_distance
    width = np.sqrt(0.07 * scene.laser.wavelength * 16.0 * np.sqrt(3.0) / bend)
    found = optimum(run(study, tmp_path))
    # the next order of the defocus of a lens at f/12 is (D / 4 s)^2, below 1e-6
    assert found.objectives[found.best, 0] == approx(width, rel=2e-6)


def drawn(objective: dict, **tables) -> Study:
    """Three walls; the focus that serves all of them."""
    draws = {"count": 3, "method": "latin", "of": RADIUS}
    goal = [{"figure": "strehl", "goal": "maximise"} | objective]
    return made(["strehl"], goal, "slsqp", set=SLOW, draws=draws, variables=FOCUS, **tables)


@pytest.mark.parametrize("share", [1.0, 2 / 3])
@pytest.mark.parametrize("objective", [{}, {"over": "mean"}, {"goal": "minimise"}])
def test_trials_of_several_points(objective: dict, share: float) -> None:
    """Objective and margin along a direction of the figures, by differences of the outcome."""
    limits = {"figure": "strehl", "at_least": 0.7, "at_most": 0.99, "share": share}
    table = drawn(objective, constraints=[limits]).table.optimise
    rng = np.random.default_rng(1)
    for _ in range(8):
        values, change = rng.uniform(0.5, 1.0, 3), 1e-7 * rng.normal(size=3)
        figures = {"strehl": values}
        up, down = (outcome(table, {"strehl": values + s * change}) for s in (1.0, -1.0))
        rises = np.array([*up.values, *up.margins]) - np.array([*down.values, *down.margins])
        found = [2 * slopes @ change for _, slopes in dependences(table, figures)]
        # rounding of values of 1 against changes of 1e-7
        assert found == approx(rises, abs=1e-14)


def test_focus_for_several_walls(tmp_path: Path, monkeypatch) -> None:
    """The best mean Strehl ratio, with gradients of all draws and by differences."""
    study = drawn({"over": "mean"})
    found = optimum(run(study, tmp_path / "gradients"))
    monkeypatch.setattr(Gradients, "at", lambda self, delta, names: {})
    other = optimum(run(study, tmp_path / "differences"))
    assert len(found.objectives) < len(other.objectives)
    best = found.objectives[found.best, 0]
    # forward differences over 1e-4 of the range end so far from the flat maximum
    assert best == approx(other.objectives[other.best, 0], rel=1e-7)
    assert best >= other.objectives[other.best, 0]


def test_search_that_starts_at_a_failed_point_says_so(tmp_path: Path) -> None:
    study = made(["own_figures:not_finite"], ["not_finite"], "slsqp", variables=FOCUS)
    found = optimum(run(study, tmp_path))
    assert "no trial is feasible; not_finite" in str(found)
