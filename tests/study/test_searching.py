"""Paths of searches: resumed, killed and extended to the same bits; wrong ones in one line."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from nlosoptics.errors import MissingExtraError, SceneError
from nlosoptics.study import (
    Results,
    Study,
    optimum,
    plan_study,
    run_study,
    searching,
)
from nlosoptics.study.store import Store

from .searches import CONCAVE, HERE, METHODS, OFF, PLANE, POWER, made, run


def same(one: Results, other: Results) -> bool:
    """Whether all but times agree bit for bit, in the order of the trials."""
    trials = [results.study.dimensions[0].deltas for results in (one, other)]
    data = [results.dataset.drop_vars("seconds") for results in (one, other)]
    return trials[0] == trials[1] and data[0].identical(data[1])


@pytest.mark.thorough
@pytest.mark.parametrize("method", METHODS)
def test_stopped_search_goes_on_as_if_it_had_not_stopped(method: str, tmp_path: Path) -> None:
    """Interrupted after any number of blocks, and with more evaluations than at first."""
    study = made([OFF], ["off"], method, 9, variables=PLANE)
    calls = iter([False] * 5 + [True] * 99)
    part = run(study, tmp_path, interrupted=lambda: next(calls))
    assert not part.complete
    with pytest.raises(SceneError, match="pending|has not ended"):
        optimum(part)
    assert len(optimum(part, incomplete=True).front) <= 1
    done = run(study, tmp_path)
    assert done.complete
    assert same(done, run_study(study, tmp_path / "once", workers=0))
    longer = made([OFF], ["off"], method, 14, variables=PLANE)
    calls = iter([False] * 3 + [True] * 99)
    assert not run(longer, tmp_path, interrupted=lambda: next(calls)).complete
    grown = run(longer, tmp_path)
    assert len(grown.study) > len(done.study)
    assert same(grown, run_study(longer, tmp_path / "at once", workers=0))


class _Killed(BaseException):
    pass


def _several(evaluations: int) -> Study:
    draws = {"count": 2, "of": {"camera.exposure": {"from": "0.5 s", "to": "1.5 s"}}}
    method = "differential-evolution"
    return made([OFF], ["off"], method, evaluations, variables=POWER, draws=draws)


@pytest.mark.thorough
def test_a_kill_between_any_two_writes_loses_nothing(tmp_path: Path, monkeypatch) -> None:
    """Every third write of a search of six trials of two draws is the last one."""
    study = _several(6)
    whole = run_study(study, tmp_path / "whole", workers=0)
    left = 0

    def failing(real):
        def write(*given, **named):
            nonlocal left
            left -= 1
            if left < 0:
                raise _Killed
            return real(*given, **named)

        return write

    names = ("create", "add_trials", "add", "_write", "set_ended")
    kills = 0
    for name in names:
        monkeypatch.setattr(Store, name, failing(getattr(Store, name)))
    while True:
        left = kills
        try:
            run_study(study, tmp_path / f"{kills}", workers=0)
            break
        except _Killed:
            left = 10**6
        assert same(run_study(study, tmp_path / f"{kills}", workers=0), whole), kills
        kills += 3
    assert kills > 15


CHILD = """
import sys
from nlosoptics.study import Study, run_study
run_study(Study.load(sys.argv[1]), sys.argv[2], workers=0)
"""


@pytest.mark.thorough
@pytest.mark.parametrize("method", ["differential-evolution", "tpe"])
def test_a_killed_search_repeats_its_path_bit_for_bit(method: str, tmp_path: Path) -> None:
    """SIGKILL as soon as a random number of chunks exists; resumed to the same bits."""
    (tmp_path / "own_figures.py").write_bytes((HERE / "own_figures.py").read_bytes())
    (tmp_path / "study.toml").write_text(
        f'scene = "{CONCAVE}"\n'
        'figures = [{ figure = "own_figures:steps", pace = 0.02, name = "steps" }]\n'
        f'[optimise]\nmethod = "{method}"\nevaluations = 40\n'
        'objectives = [{ figure = "steps", goal = "minimise" }]\n[optimise.variables]\n'
        '"camera.f_number" = { from = 2, to = 16, spacing = "log" }\n'
        '"hidden.image" = ["../objects/R.png", "../objects/F.png"]\n'
    )
    store = tmp_path / "store"
    seed = int(time.time())
    random = np.random.default_rng(seed)
    for _ in range(2):
        child = subprocess.Popen(
            [sys.executable, "-c", CHILD, str(tmp_path / "study.toml"), str(store)]
        )
        while child.poll() is None and not list(store.glob("status/c/*/*")):
            time.sleep(0.003)
        time.sleep(random.uniform(0.0, 0.8))
        child.send_signal(signal.SIGKILL)
        child.wait()
    study = Study.load(tmp_path / "study.toml")
    resumed = run_study(study, store, workers=0)
    assert same(resumed, run_study(study, tmp_path / "undisturbed", workers=0)), seed


@pytest.mark.thorough
def test_processes_choose_the_same_points(tmp_path: Path) -> None:
    study = made([OFF], ["off"], "nsga-ii", 40, variables=PLANE)
    there = run_study(study, tmp_path / "there", workers=2)
    assert same(there, run_study(study, tmp_path / "here", workers=0))


def test_another_path_than_that_of_the_store_is_refused(tmp_path: Path, monkeypatch) -> None:
    study = made([OFF], ["off"], evaluations=4, variables=POWER)
    before = run(study, tmp_path)
    for change, told in (
        ({"method": "tpe"}, 'optimise.method = "tpe" instead of "cobyqa"'),
        ({"variables": PLANE}, 'camera.exposure.from = "1 ms" instead of absent'),
    ):
        other = study.definition | {"optimise": study.definition["optimise"] | change}
        with pytest.raises(SceneError, match=f"results of another study: .*{told}"):
            run(Study.from_tables(other, HERE), tmp_path)
    with pytest.raises(SceneError, match="again does not go with a search"):
        run(study, tmp_path, again=True)
    monkeypatch.setattr(searching, "delta_of", lambda v, p: {"laser.power": "0.0042 W"})
    with pytest.raises(SceneError, match=r"would choose laser.power = 4.2 mW, but the store has"):
        run(study, tmp_path)
    monkeypatch.undo()
    assert same(run(study, tmp_path), before)


def test_figures_may_be_added_to_a_search(tmp_path: Path) -> None:
    run(made([OFF], ["off"], evaluations=6, variables=POWER), tmp_path)
    more = made([OFF, "own_figures:power"], ["off"], evaluations=6, variables=POWER)
    grown = run(more, tmp_path)
    assert same(grown, run_study(more, tmp_path / "once", workers=0))
    assert np.array_equal(grown.dataset["power"], grown.dataset["laser.power"])


def test_plan_counts_trials_without_computing() -> None:
    draws = {"count": 4, "of": {"wall.radius": {"sigma": "1 cm"}}}
    plan = plan_study(made(["strehl"], ["strehl"], evaluations=30, variables=POWER, draws=draws))
    assert (plan.points, plan.point_spreads) == (120, 120)


def edited(**changes) -> dict:
    search = {
        "method": "cobyqa",
        "evaluations": 5,
        "objectives": [{"figure": "power", "goal": "minimise"}],
        "variables": POWER,
    }
    return {"optimise": {k: v for k, v in (search | changes).items() if v is not None}}


ONE = {"figure": "power", "goal": "maximise"}


@pytest.mark.parametrize(
    ("tables", "told"),
    [
        (edited(variables={"laser.pwer": {"from": 1, "to": 2}}), "laser.pwer = .* unknown key"),
        (edited(variables={"laser.power": {"from": "2 mW", "to": "1 mW"}}), "is not below to"),
        (edited(variables={"laser.power": ["1 mW"]}), "leaves no choice; give two values"),
        (edited(variables={"camera.f_number": [2, 4]}), "is a list, which method cobyqa does not"),
        (edited(objectives=[{"figure": "sharp", "goal": "minimise"}]), "'sharp' is unknown, must"),
        (edited(objectives=[ONE, ONE]), "takes one objective, there are 2; use nsga-ii"),
        (edited(objectives=[ONE | {"at_least": 1.0, "over": "mean"}]), "leave out over"),
        (edited(constraints=[{"figure": "power"}]), r"constraints\[0\] has no limit; add at_least"),
        (
            edited(constraints=[{"figure": "power", "at_least": 2.0, "at_most": 1.0}]),
            "at_least = 2 is above at_most = 1; exchange",
        ),
        (edited(method="simplex"), "method = .simplex.: it should be"),
        (edited(population=8), "does not go with method cobyqa"),
        (edited(method="differential-evolution", population=3), "must be at least 5"),
        (edited() | {"axes": {"laser.power": ["1 mW"]}}, "laser.power is varied twice"),
        (
            {
                "axes": {"camera.f_number": [2]},
                "compensate": {"figure": "sharp", "goal": "minimise", "variables": POWER},
            },
            "'sharp' is unknown, must be one of strehl",
        ),
        (
            {
                "axes": {"camera.f_number": [2]},
                "figures": [{"figure": "value", "address": "camera.colour"}],
            },
            "value of camera.colour: the scene has no such value",
        ),
    ],
)
def test_wrong_search_is_one_line(tables: dict, told: str) -> None:
    with pytest.raises(SceneError, match=told) as error:
        Study.from_tables({"scene": CONCAVE, "figures": ["own_figures:power"]} | tables, HERE)
    assert "\n" not in str(error.value)


def test_optuna_is_optional(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "optuna", None)
    with pytest.raises(MissingExtraError, match="optuna is not installed; run pip install"):
        run(made([OFF], ["off"], "tpe", 4, variables=POWER), tmp_path)
    assert run(made([OFF], ["off"], evaluations=4, variables=POWER), tmp_path / "b").complete


def test_trials_are_read_by_any_json_reader(tmp_path: Path) -> None:
    results = run(made([OFF], ["off"], evaluations=4, variables=POWER), tmp_path)
    kept = Store.open(tmp_path / "store").trials()
    assert kept == json.loads(json.dumps(results.study.dimensions[0].deltas))


def test_a_search_computes_the_figures_that_it_limits() -> None:
    limit = {"figure": "photons", "at_least": 1.0}
    study = made([OFF], ["off"], constraints=[limit], variables=POWER)
    assert [figure.name for figure in study.figures] == ["off", "photons"]
