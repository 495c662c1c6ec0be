"""Samplers of Optuna: TPE and NSGA-II. Its study is kept in memory and made by replay."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from ...errors import MissingExtraError
from ..design.variables import Variable
from .problem import Ask, Problem


def sampled(problem: Problem, ask: Ask, method: str) -> str:
    """Choose points by a sampler of Optuna."""
    with _quiet() as optuna:
        sampler = _sampler(optuna.samplers, problem, method)
        study = optuna.create_study(directions=["minimize"] * problem.objectives, sampler=sampler)
        start = {v.address: v.start if v.continuous else int(v.start) for v in problem.variables}
        study.enqueue_trial(start)
    asked = 0
    while asked < problem.evaluations:
        count = min(problem.population, problem.evaluations - asked)
        with _quiet():
            trials = [study.ask() for _ in range(count)]
            points = [
                {v.address: _suggested(trial, v) for v in problem.variables} for trial in trials
            ]
        outcomes = ask(points)
        with _quiet():
            for trial, outcome in zip(trials, outcomes, strict=True):
                study.tell(trial, outcome.ranks)
        asked += count
    return f"{problem.evaluations} evaluations"


@contextmanager
def _quiet() -> Iterator[Any]:
    """Give Optuna, without its log and its warnings about experimental parts."""
    try:
        import optuna
    except ModuleNotFoundError:
        raise MissingExtraError(
            "optuna is not installed; run pip install 'nlosoptics[study]', or use method cobyqa or "
            "differential-evolution"
        ) from None
    before = optuna.logging.get_verbosity()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        optuna.logging.set_verbosity(optuna.logging.ERROR)
        try:
            yield optuna
        finally:
            optuna.logging.set_verbosity(before)


def _sampler(samplers: Any, problem: Problem, method: str) -> Any:
    seed = int(np.random.SeedSequence(problem.seed).generate_state(1)[0])
    if method == "tpe":
        return samplers.TPESampler(seed=seed)
    return samplers.NSGAIISampler(seed=seed, population_size=problem.population)


def _suggested(trial: Any, variable: Variable) -> float:
    """Return the coordinate that a sampler suggests."""
    if variable.continuous:
        return float(trial.suggest_float(variable.address, 0.0, 1.0))
    last = len(variable.values) - 1
    if variable.ordered:
        return float(trial.suggest_int(variable.address, 0, last))
    return float(trial.suggest_categorical(variable.address, range(last + 1)))
