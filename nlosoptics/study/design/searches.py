"""Checks of what a search minimises, and under which constraints."""

from __future__ import annotations

from ...errors import SceneError
from .file import Optimise, Within
from .variables import Variable

#: Least population of the methods that choose from lists; others choose by themselves.
LEAST = {"differential-evolution": 5, "tpe": 1, "nsga-ii": 2}


def check_search(
    table: Optimise, variables: tuple[Variable, ...], varied: set[str], figures: tuple[str, ...]
) -> None:
    """Raise `SceneError` if a search does not fit its study."""
    method, objectives = table.method, table.objectives
    for kind, entries in (("objectives", objectives), ("constraints", table.constraints)):
        for i, entry in enumerate(entries):
            _check_limits(f"optimise.{kind}[{i}]", entry, figures, needed=kind == "constraints")
    for i, objective in enumerate(objectives):
        if objective.limited and ("over" in objective.model_fields_set or not objective.maximised):
            raise SceneError(
                f"optimise.objectives[{i}] has limits, which make the share of points within them "
                'the objective; write goal = "maximise", and leave out over'
            )
    if len(objectives) > 1 and method != "nsga-ii":
        raise SceneError(
            f"optimise.method = {method!r} takes one objective, there are {len(objectives)}; use "
            "nsga-ii, or make constraints of the others"
        )
    for variable in variables:
        if variable.address in varied:
            raise SceneError(f"{variable.address} is varied twice in the study; remove one of them")
        if not variable.continuous and method not in LEAST:
            raise SceneError(
                f"optimise.variables.{variable.address} is a list, which method {method} does not "
                f"take; use {', '.join(LEAST)}, or give from and to"
            )
    least = LEAST.get(method, 1)
    if table.population is not None and (table.population < least or method not in LEAST):
        raise SceneError(
            f"optimise.population = {table.population} does not go with method {method}, must be "
            + (f"at least {least}" if method in LEAST else "1; remove it")
        )


def _check_limits(place: str, entry: Within, figures: tuple[str, ...], *, needed: bool) -> None:
    """Check the figure and the limits of an objective or constraint."""
    if entry.figure not in figures:
        raise SceneError(
            f"{place}.figure = {entry.figure!r} is unknown, must be one of {', '.join(figures)}"
        )
    low, high = entry.at_least, entry.at_most
    if low is not None and high is not None and low > high:
        raise SceneError(f"{place}: at_least = {low:g} is above at_most = {high:g}; exchange them")
    if needed and not entry.limited:
        raise SceneError(f"{place} has no limit; add at_least or at_most")
