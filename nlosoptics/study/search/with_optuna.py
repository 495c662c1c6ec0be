"""Samplers of Optuna: TPE and NSGA-II. Its study is kept in memory and made by replay."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...errors import MissingExtraError
from ..design.variables import Variable
from .problem import Ask, Problem


def sampled(problem: Problem, ask: Ask, method: str) -> str:
    """Choose points by a sampler of Optuna."""
    try:
        import optuna
    except ModuleNotFoundError:
        raise MissingExtraError(
            "optuna is not installed; run pip install 'nlosoptics[study]', or use method cobyqa or "
            "differential-evolution"
        ) from None
    seed = int(np.random.SeedSequence(problem.seed).generate_state(1)[0])
    sampler: Any = optuna.samplers.TPESampler(seed=seed)
    if method == "nsga-ii":
        sampler = optuna.samplers.NSGAIISampler(seed=seed, population_size=problem.population)
    before = optuna.logging.get_verbosity()
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    try:
        study = optuna.create_study(directions=["minimize"] * problem.objectives, sampler=sampler)
    finally:
        optuna.logging.set_verbosity(before)
    start = {v.address: v.start if v.continuous else int(v.start) for v in problem.variables}
    study.enqueue_trial(start)
    asked = 0
    while asked < problem.evaluations:
        count = min(problem.population, problem.evaluations - asked)
        trials = [study.ask() for _ in range(count)]
        points = [{v.address: _suggested(trial, v) for v in problem.variables} for trial in trials]
        for trial, outcome in zip(trials, ask(points), strict=True):
            study.tell(trial, outcome.ranks)
        asked += count
    return f"{problem.evaluations} evaluations"


def _suggested(trial: Any, variable: Variable) -> float:
    """Return the coordinate that a sampler suggests."""
    if variable.continuous:
        return float(trial.suggest_float(variable.address, 0.0, 1.0))
    last = len(variable.values) - 1
    if variable.ordered:
        return float(trial.suggest_int(variable.address, 0, last))
    return float(trial.suggest_categorical(variable.address, range(last + 1)))
