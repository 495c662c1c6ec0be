"""Search of a study by its method."""

from __future__ import annotations

from ...errors import SceneError
from ..design.file import Optimise
from ..design.study import Study
from .problem import Ask, Problem, population
from .with_optuna import sampled
from .with_scipy import cobyqa, evolution, gradient


def search(study: Study, ask: Ask) -> str:
    """Choose points until the method ends, and return why it ended."""
    table = search_table(study)
    problem = Problem(
        variables=study.variables,
        objectives=len(table.objectives),
        evaluations=table.evaluations,
        population=population(table),
        seed=study.seed,
    )
    if table.method == "cobyqa":
        return cobyqa(problem, ask)
    if table.method == "gradient":
        return gradient(problem, ask)
    if table.method == "differential-evolution":
        return evolution(problem, ask)
    return sampled(problem, ask, table.method)


def search_table(study: Study) -> Optimise:
    """Return the table of a study's search; raise `SceneError` if it has none."""
    if study.table.optimise is None:
        raise SceneError("an optimum needs a study with the table [optimise]; add it")
    return study.table.optimise


def searched_figures(study: Study) -> tuple[str, ...]:
    """Return the names of the figures that a study's search reads."""
    table = search_table(study)
    return tuple(dict.fromkeys(one.figure for one in (*table.objectives, *table.constraints)))
