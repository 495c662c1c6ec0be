"""Methods of scipy: COBYQA and gradients, which are local, and differential evolution."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
import scipy  # its parts are loaded lazily, on first use

from .problem import Array, Ask, Outcome, Problem

MISSED = -1e6  # margin of a failed point
STEP = 1e-6  # of differences, as a part of the ranges


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


def gradient(problem: Problem, ask: Ask) -> str:
    """Follow gradients by differences from the scene's own values.

    A point is computed together with those for its gradient.

    References
    ----------
    .. [1] D. Kraft, A Software Package for Sequential Quadratic Programming, DFVLR-FB 88-28, 1988.
    """
    known: dict[bytes, tuple[Array, Array]] = {}
    best: list[Any] = [math.inf]  # objective, coordinates and gradient of the best point
    start = problem.start

    def at(x: Array) -> tuple[Array, Array]:
        """Return objective and margins (1 + m,), and their derivatives (1 + m, n)."""
        if x.tobytes() not in known:
            known[x.tobytes()] = found = _with_derivatives(problem, ask, x)
            if np.isfinite(found[0]).all() and found[0][0] < best[0]:
                best[:] = found[0][0], x.copy(), found[1]
            elif not np.isfinite(found[0]).all() and len(best) > 1:
                # a rise that turns a line search back to the best point
                way = x - best[1]
                slope = 10.0 * np.linalg.norm(best[2][0]) * way / np.linalg.norm(way)
                found[0][:], found[1][:] = best[0] + slope @ way, slope
                found[0][1:], found[1][1:] = MISSED, 0.0
        return known[x.tobytes()]

    first = at(start)
    scale = float(np.abs(np.nan_to_num(first[1][0])).max()) or 1.0
    limits: Any = ()
    minimise: Any = scipy.optimize.minimize  # no overload of its stubs takes these arguments
    if len(first[0]) > 1:
        limits = {"type": "ineq", "fun": lambda x: at(x)[0][1:], "jac": lambda x: at(x)[1][1:]}
    result = minimise(
        lambda x: at(x)[0][0] / scale,
        start,
        jac=lambda x: at(x)[1][0] / scale,
        method="SLSQP",
        bounds=scipy.optimize.Bounds(np.zeros(len(start)), np.ones(len(start))),
        constraints=limits,
        options={"ftol": 1e-9, "maxiter": problem.evaluations},
    )
    return str(result.message)


def _with_derivatives(problem: Problem, ask: Ask, x: Array) -> tuple[Array, Array]:
    """Return objective and margins (1 + m,) and their derivatives (1 + m, n) by coordinates."""
    x = np.clip(x, 0.0, 1.0)
    steps, widths = np.full(len(x), STEP), np.zeros(len(x))
    # values are rounded, by which steps differ a little, or vanish if a range is narrow
    while (short := (np.abs(widths) < 0.5 * steps) & (steps < 0.1)).any():
        moved = x + np.diag(np.where(x < 0.5, steps, -steps))
        widths = np.diag(problem.rounded(moved) - problem.rounded(x))
        steps[short & (np.abs(widths) < 0.5 * steps)] *= 10.0
    here, *others = (
        np.array([*outcome.values, *outcome.margins])
        for outcome in ask([problem.point(one) for one in (x, *moved)])
    )
    with np.errstate(invalid="ignore"):
        rates = (np.array(others) - here).T / widths
    return here, np.where(np.isfinite(rates), rates, 0.0)


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
