"""Methods of scipy: SLSQP and COBYQA, which are local, and differential evolution, global."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
import scipy  # its parts are loaded lazily, on first use

from .problem import Array, Ask, Outcome, Problem, Slopes

FIRST_STEP = 0.1  # of a local method, relative to the ranges
PRECISION = 1e-6  # of the variables, relative to their ranges
DECREASE = 1e-9  # of the scaled objective at which SLSQP ends
CONVERGED = 1e-6  # relative spread of a population's objectives at which evolution ends
MISSED = -1e6  # margin of a failed point
FAILED = 1e6  # scaled objective of a failed point, whose change over the first step is 0.01
DIFFERENCE = 1e-4  # step of finite differences, relative to the ranges


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
        limits = scipy.optimize.NonlinearConstraint(margins, 0.0, np.inf)
    found = scipy.optimize.minimize(
        objective,
        problem.start,
        method="COBYQA",
        bounds=scipy.optimize.Bounds(np.zeros(count), np.ones(count)),
        constraints=limits,
        options={
            "initial_tr_radius": FIRST_STEP,
            "final_tr_radius": PRECISION,
            "maxfev": 10 * problem.evaluations,  # points that were seen before are free
        },
    )
    return str(found.message)


def slsqp(problem: Problem, ask: Ask, slopes: Slopes) -> str:
    """Solve quadratic programs with gradients, from the scene's own values.

    Parameters
    ----------
    problem : Problem
        What may be chosen; continuous variables only.
    ask : callable
        Returns the outcomes of points.
    slopes : callable
        Returns derivatives at points. Those that it does not know are differences of points that
        are asked for together.

    References
    ----------
    .. [1] D. Kraft, A Software Package for Sequential Quadratic Programming, report DFVLR-FB 88-28,
       1988.
    """

    def rows(outcome: Outcome) -> Array:
        if outcome.failed:
            return np.array([math.nan, *np.full(len(outcome.margins), MISSED)])
        return np.array([outcome.values[0], *outcome.margins])

    def at(coordinates: Array) -> Array:
        return rows(ask([problem.point(coordinates)])[0])

    def jacobian(coordinates: Array) -> Array:
        here = at(coordinates)
        if np.isnan(here[0]):
            return np.zeros((len(here), len(coordinates)))
        found = slopes(problem.point(coordinates))
        if np.isnan(found).any():
            steps = np.where(coordinates + DIFFERENCE <= 1.0, DIFFERENCE, -DIFFERENCE)
            there = ask([problem.point(row) for row in coordinates + np.diag(steps)])
            rises = np.array([rows(one) - here for one in there]).T / steps
            rises[:, np.isnan(rises[0])] = 0.0  # next to a failed point
            found = np.where(np.isnan(found), rises, found)
        return found

    start, count = problem.start, len(problem.variables)
    # SLSQP's first step is a steepest descent as long as the gradient.
    slope = float(np.linalg.norm(jacobian(start)[0]))
    scale = FIRST_STEP / slope if slope > 0.0 else 1.0

    def objective(coordinates: Array) -> float:
        return float(np.nan_to_num(scale * at(coordinates)[0], nan=FAILED))

    def gradient(coordinates: Array) -> Array:
        return np.asarray(scale * jacobian(coordinates)[0])

    limits: Any = ()
    if len(at(start)) > 1:
        limits = {
            "type": "ineq",
            "fun": lambda coordinates: at(coordinates)[1:],
            "jac": lambda coordinates: jacobian(coordinates)[1:],
        }
    found: Any = scipy.optimize.minimize(
        objective,
        start,
        jac=gradient,
        method="SLSQP",
        bounds=scipy.optimize.Bounds(np.zeros(count), np.ones(count)),
        constraints=limits,
        options={"ftol": DECREASE, "maxiter": problem.evaluations},
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
    spread = scipy.stats.qmc.LatinHypercube(len(variables), rng=rng).random(problem.population)
    first = low + (high - low) * spread
    first[0] = problem.start

    def together(_: Callable[..., Any], members: Iterable[Array]) -> list[float]:
        return [one.ranks[0] for one in ask([problem.point(member) for member in members])]

    found: Any = scipy.optimize.differential_evolution(
        float,  # never called; `together` evaluates
        scipy.optimize.Bounds(low, high),
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
