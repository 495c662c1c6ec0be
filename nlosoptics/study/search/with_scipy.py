"""Methods of scipy: COBYQA, which is local, and differential evolution, which is global."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
import scipy  # its parts are loaded lazily, on first use

from .problem import Array, Ask, Outcome, Problem

MISSED = -1e6  # margin of a failed point


def cobyqa(problem: Problem, ask: Ask) -> str:
    """Follow quadratic models of objective and constraints from the scene's own values.

    References
    ----------
    .. [1] T. M. Ragonneau, Model-Based Derivative-Free Optimization Methods and Software, PhD
       thesis, Hong Kong Polytechnic University, 2022.
    """

    def at(coordinates: Array) -> Outcome:
        return ask([problem.point(coordinates)])[0]

    def margins(coordinates: Array) -> Array:
        return np.maximum(at(coordinates).margins, MISSED)

    def objective(coordinates: Array) -> float:
        outcome = at(coordinates)
        return math.nan if outcome.failed else outcome.values[0]

    count = len(problem.variables)
    limits: Any = ()
    if at(problem.start).margins:
        limits = scipy.optimize.NonlinearConstraint(margins, 0.0, np.inf)
    result = scipy.optimize.minimize(
        objective,
        problem.start,
        method="COBYQA",
        bounds=scipy.optimize.Bounds(np.zeros(count), np.ones(count)),
        constraints=limits,
        options={
            "initial_tr_radius": 0.1,  # of the ranges, as below
            "final_tr_radius": 1e-6,
            "maxfev": 10 * problem.evaluations,  # points that were seen before are free
        },
    )
    return str(result.message)


def evolution(problem: Problem, ask: Ask) -> str:
    """Evolve a population by differences of its members (Storn and Price 1997)."""
    variables = problem.variables
    low = np.array([0.0 if v.continuous else v.low for v in variables])
    high = np.array([1.0 if v.continuous else v.high for v in variables])
    rng = np.random.default_rng(problem.seed)
    spread = scipy.stats.qmc.LatinHypercube(len(variables), rng=rng).random(problem.population)
    first = low + (high - low) * spread
    first[0] = problem.start

    def together(_: Callable[..., Any], members: Iterable[Array]) -> list[float]:
        return [outcome.ranks[0] for outcome in ask([problem.point(member) for member in members])]

    result: Any = scipy.optimize.differential_evolution(
        float,  # never called; `together` evaluates
        scipy.optimize.Bounds(low, high),
        integrality=[not v.continuous for v in variables],
        init=first,
        rng=rng,
        polish=False,
        tol=1e-6,  # relative spread of the population's objectives
        updating="deferred",
        workers=together,
        maxiter=problem.evaluations,
    )
    return str(result.message)
