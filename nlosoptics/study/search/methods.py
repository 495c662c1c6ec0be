"""Search of a study by its method."""

from __future__ import annotations

import math
from collections.abc import Mapping

from ...errors import SceneError
from ..design.file import InverseSensitivity, Optimise
from ..design.study import Study
from .bisection import bisect
from .problem import Array, Ask, Outcome, Problem, Slopes, dependences, outcome, population
from .with_optuna import sampled
from .with_scipy import cobyqa, evolution, slsqp


def search(study: Study, ask: Ask, slopes: Slopes) -> str:
    """Choose points until the method ends, and return why it ended.

    Parameters
    ----------
    study : Study
        Study with the table ``optimise`` or ``inverse_sensitivity``.
    ask : callable
        Returns the outcomes of points. The same outcomes lead to the same points.
    slopes : callable
        Returns derivatives at a point, for methods that use them.
    """
    table = search_table(study)
    if isinstance(table, InverseSensitivity):
        problem = Problem(
            variables=study.variables,
            objectives=1,
            evaluations=most_trials(study),
            population=trials_together(study),
            seed=study.seed,
        )
        return bisect(problem, ask, table)
    problem = Problem(
        variables=study.variables,
        objectives=len(table.objectives),
        evaluations=table.evaluations,
        population=population(table),
        seed=study.seed,
    )
    if table.method == "cobyqa":
        return cobyqa(problem, ask)
    if table.method == "slsqp":
        return slsqp(problem, ask, slopes)
    if table.method == "differential-evolution":
        return evolution(problem, ask)
    return sampled(problem, ask, table.method)


def search_table(study: Study) -> Optimise | InverseSensitivity:
    """Return the table of a study's search; raise `SceneError` if it has none."""
    found = study.table.optimise or study.table.inverse_sensitivity
    if found is None:
        raise SceneError("the study has no search; add [optimise] or [inverse_sensitivity]")
    return found


def most_trials(study: Study) -> int:
    """Return the largest number of trials that a study's search makes."""
    table = search_table(study)
    if isinstance(table, Optimise):
        return table.evaluations
    halvings = math.ceil(-math.log2(table.precision))
    return 1 + 2 * len(study.variables) * (1 + halvings)  # both sides of each value


def trials_together(study: Study) -> int:
    """Return how many trials a study's search makes together, about."""
    table = search_table(study)
    if isinstance(table, Optimise):
        return population(table)
    return 2 * len(study.variables)


def searched_figures(study: Study) -> tuple[str, ...]:
    """Return the names of the figures that a study's search reads."""
    table = search_table(study)
    if isinstance(table, InverseSensitivity):
        return (table.figure,)
    return tuple(dict.fromkeys(one.figure for one in (*table.objectives, *table.constraints)))


def dependences_of(study: Study, figures: Mapping[str, Array]) -> list[tuple[str, Array]]:
    """Return how objective and margins of a trial depend on its figures, see `dependences`."""
    table = search_table(study)
    return dependences(table, figures) if isinstance(table, Optimise) else []


def outcome_of(study: Study, figures: Mapping[str, Array]) -> Outcome:
    """Return the outcome of a trial from its figures.

    Parameters
    ----------
    study : Study
        Study with a search.
    figures : mapping of str to ndarray, (points,)
        Each figure at all points of the trial.
    """
    table = search_table(study)
    if isinstance(table, Optimise):
        return outcome(table, figures)
    found = float(figures[table.figure][0])
    return Outcome((found if table.goal == "minimise" else -found,))
