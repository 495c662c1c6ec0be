"""Methods of scipy: COBYQA, which is local, and differential evolution, which is global."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from scipy.optimize import Bounds, NonlinearConstraint, differential_evolution, minimize
from scipy.stats import qmc

from .problem import Array, Ask, Outcome, Problem

FIRST_STEP = 0.1  # radius of COBYQA's first trust region, relative to the ranges
PRECISION = 1e-6  # of the variables, relative to their ranges
CONVERGED = 1e-6  # relative spread of a population's objectives at which evolution ends
MISSED = -1e6  # margin of a failed point


def cobyqa(problem: Problem, ask: Ask) -> str:
    """Follow quadratic models of objective and constraints from the scene's own values.

    Parameters
    ----------
    problem : Problem
        What may be chosen; continuous variables only.
    ask : callable
        Returns the outcomes of points.

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
        one = at(coordinates)
        return math.nan if one.failed else one.values[0]

    count = len(problem.variables)
    limits: Any = ()
    if at(problem.start).margins:
        limits = NonlinearConstraint(margins, 0.0, np.inf)
    found = minimize(
        objective,
        problem.start,
        method="COBYQA",
        bounds=Bounds(np.zeros(count), np.ones(count)),
        constraints=limits,
        options={
            "initial_tr_radius": FIRST_STEP,
            "final_tr_radius": PRECISION,
            "maxfev": 10 * problem.evaluations,  # points that were seen before are free
        },
    )
    return str(found.message)


def evolution(problem: Problem, ask: Ask) -> str:
    """Evolve a population by differences of its members (Storn and Price 1997).

    Parameters
    ----------
    problem : Problem
        What may be chosen.
    ask : callable
        Returns the outcomes of points.
    """
    variables = problem.variables
    low = np.array([0.0 if v.continuous else v.low for v in variables])
    high = np.array([1.0 if v.continuous else v.high for v in variables])
    rng = np.random.default_rng(problem.seed)
    spread = qmc.LatinHypercube(len(variables), rng=rng).random(problem.population)
    first = low + (high - low) * spread
    first[0] = problem.start

    def together(_: Callable[..., Any], members: Iterable[Array]) -> list[float]:
        return [one.ranks[0] for one in ask([problem.point(member) for member in members])]

    found: Any = differential_evolution(
        float,  # never called; `together` evaluates
        Bounds(low, high),
        integrality=[not v.continuous for v in variables],
        init=first,
        rng=rng,
        polish=False,
        tol=CONVERGED,
        updating="deferred",
        workers=together,
        maxiter=problem.evaluations,
    )
    return str(found.message)
