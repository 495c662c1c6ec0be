"""Checks of what a search minimises, and under which constraints."""

from __future__ import annotations

from ...errors import SceneError
from .designs import Dimension
from .file import InverseSensitivity, Optimise, StudyTable, Within
from .variables import Variable

LISTS = ("differential-evolution", "tpe", "nsga-ii")  # methods that choose from lists
SEVERAL = ("nsga-ii",)  # methods for several objectives
ALONE = ("slsqp", "cobyqa")  # methods that choose one point at a time
#: Least population of each method.
LEAST = {"differential-evolution": 5, "tpe": 1, "cma-es": 4, "nsga-ii": 2}


def check_search(
    table: StudyTable,
    variables: tuple[Variable, ...],
    dimensions: tuple[Dimension, ...],
    figures: tuple[str, ...],
) -> None:
    """Raise `SceneError` if a search does not fit its study.

    Parameters
    ----------
    table : StudyTable
        Checked study file.
    variables : tuple of Variable
        Values that the search may change.
    dimensions : tuple of Dimension
        Dimensions of the design.
    figures : tuple of str
        Names of the figures.
    """
    if table.optimise is not None and table.inverse_sensitivity is not None:
        raise SceneError("[optimise] and [inverse_sensitivity] are both given; remove one of them")
    varied = {address for dimension in dimensions for address in dimension.addresses}
    varied |= set(table.compensate.variables if table.compensate is not None else ())
    for variable in variables:
        if variable.address in varied:
            raise SceneError(f"{variable.address} is varied twice in the study; remove one of them")
    if table.optimise is not None:
        _check_optimise(table.optimise, variables, figures)
    if table.inverse_sensitivity is not None:
        _check_inverse(table.inverse_sensitivity, variables, dimensions, figures)


def _check_optimise(
    table: Optimise, variables: tuple[Variable, ...], figures: tuple[str, ...]
) -> None:
    method = table.method
    for i, objective in enumerate(table.objectives):
        place = f"optimise.objectives[{i}]"
        _check_figure(place, objective.figure, figures)
        if not _check_limits(place, objective):
            continue
        if "over" in objective.model_fields_set:
            raise SceneError(
                f"{place}: over = {objective.over!r} does not go with limits, which make the share "
                "of points within them the objective; remove one"
            )
        if objective.goal != "maximise":
            raise SceneError(
                f"{place}.goal = {objective.goal!r} would make the share of points within the "
                'limits small; write goal = "maximise"'
            )
        if method == "slsqp":
            raise SceneError(
                f"{place} has limits, which make the share of points within them the objective; it "
                "has no gradient, which method slsqp needs; use differential-evolution"
            )
    for i, constraint in enumerate(table.constraints):
        place = f"optimise.constraints[{i}]"
        _check_figure(place, constraint.figure, figures)
        if not _check_limits(place, constraint):
            raise SceneError(f"{place} has no limit; add at_least or at_most")
    count = len(table.objectives)
    if count > 1 and method not in SEVERAL:
        raise SceneError(
            f"optimise.method = {method!r} takes one objective, there are {count}; use "
            f"{SEVERAL[0]}, or make constraints of the others"
        )
    for variable in variables:
        if not variable.continuous and method not in LISTS:
            raise SceneError(
                f"optimise.variables.{variable.address} is a list, which method {method} does not "
                f"take; use {', '.join(LISTS)}, or give from and to"
            )
    if method == "cma-es" and len(variables) < 2:
        raise SceneError(
            "optimise.method = 'cma-es' needs two or more variables, there is one; use cobyqa"
        )
    if table.population is not None and method in ALONE:
        raise SceneError(
            f"optimise.population = {table.population} does not go with method {method}, which "
            "chooses one point at a time; remove it"
        )
    if table.population is not None and table.population < LEAST[method]:
        raise SceneError(
            f"optimise.population = {table.population} is too small for {method}, must be at "
            f"least {LEAST[method]}"
        )


def _check_inverse(
    table: InverseSensitivity,
    variables: tuple[Variable, ...],
    dimensions: tuple[Dimension, ...],
    figures: tuple[str, ...],
) -> None:
    _check_figure("inverse_sensitivity", table.figure, figures)
    others = [d.name for d in dimensions if d.name != "trial"]
    if others:
        raise SceneError(
            f"[inverse_sensitivity] changes values of the base scene one by one and does not go "
            f"with the dimension {others[0]}; remove that"
        )
    for variable in variables:
        if not variable.inside:
            raise SceneError(
                f"inverse_sensitivity.of.{variable.address} does not contain the scene's own "
                "value, from which changes are counted; set one within from and to"
            )


def _check_figure(place: str, name: str, figures: tuple[str, ...]) -> None:
    if name not in figures:
        raise SceneError(
            f"{place}.figure = {name!r} is unknown, must be one of {', '.join(figures)}"
        )


def _check_limits(place: str, given: Within) -> bool:
    """Return whether limits are given; raise `SceneError` if nothing is within them."""
    low, high = given.at_least, given.at_most
    if low is not None and high is not None and low > high:
        raise SceneError(f"{place}: at_least = {low:g} is above at_most = {high:g}; exchange them")
    return low is not None or high is not None
