"""Figures of searches for the best design: fronts of two objectives, one objective by trials."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import SceneError
from .canvas import BLUE, GREY, VERMILION, new_axes, space_ticks

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ..study import Optimum


def pareto(found: Optimum, *, first: int = 0, second: int = 1, axes: Axes | None = None) -> Axes:
    """Draw two objectives of an optimisation against each other, with the Pareto front.

    A trial is on the front if it meets all constraints and no other such trial is at least as good
    in all objectives and better in one.

    Parameters
    ----------
    found : Optimum
        Result of `nlosoptics.study.optimum`, with two objectives or more.
    first, second : int
        Index of the objective on the horizontal axis and of that on the vertical axis, from 0. If
        there are more than two objectives, the front is that of all of them, and no line joins its
        points.
    axes : matplotlib Axes, optional
        Axes to draw on; a new figure by default.

    Returns
    -------
    Axes
        Axes with one mark for each trial: a dot if it meets all constraints, a cross if not, and a
        red dot on the front. Trials that could not be computed appear only in the legend, with
        their number.

    Raises
    ------
    SceneError
        If there are fewer than two objectives, or no trial with values.

    See Also
    --------
    nlosoptics.study.optimum : Best trials of an optimisation.
    search_history : Objective of each trial.
    """
    count = len(found.labels)
    if not {first, second} <= set(range(count)) or first == second:
        raise SceneError(
            f"objectives {first} and {second} are not two of {count}; give numbers from 0 to "
            f"{count - 1}, or draw search_history for one objective"
        )
    if axes is None:
        (axes,) = new_axes(1, width=6.4, height=4.6)
    x, y = found.objectives[:, first], found.objectives[:, second]
    _draw_trials(axes, x, y, found)
    front = np.array(found.front, dtype=int)
    order = front[np.argsort(x[front], kind="stable")]
    # the corners of the steps are the worst objectives that the two points beside them dominate
    steps = "steps-post" if found.goals[first] == "minimise" else "steps-pre"
    axes.plot(
        x[order], y[order], marker="o", ls="-" if count == 2 else "", drawstyle=steps,
        color=VERMILION, ms=5, lw=1,
        label=f"front: {len(front)} trials",
    )  # fmt: skip
    axes.set(xlabel=_aim(found, first), ylabel=_aim(found, second))
    space_ticks(axes)
    axes.grid(alpha=0.25)
    axes.legend(fontsize=8)
    return axes


def search_history(found: Optimum, *, axes: Axes | None = None) -> Axes:
    """Draw the progress of an optimisation: the objective of each trial, and the best one so far.

    Parameters
    ----------
    found : Optimum
        Result of `nlosoptics.study.optimum`, with one objective.
    axes : matplotlib Axes, optional
        Axes to draw on; a new figure by default.

    Returns
    -------
    Axes
        Axes with the trials in their order. Trials that violate a constraint are crosses, and do
        not count for the best one.

    Raises
    ------
    SceneError
        If there are several objectives, or no trial has a value.

    See Also
    --------
    nlosoptics.study.optimum : Best trials of an optimisation.
    pareto : Two objectives against each other.
    """
    if len(found.labels) != 1:
        raise SceneError(f"there are {len(found.labels)} objectives; draw them with pareto")
    if axes is None:
        (axes,) = new_axes(1, width=6.4, height=4.2)
    values = found.objectives[:, 0]
    trials = np.arange(len(values))
    _draw_trials(axes, trials, values, found)
    good = np.where(found.feasible, values, np.nan)
    better = np.fmin if found.goals[0] == "minimise" else np.fmax
    best = better.accumulate(good)
    axes.step(trials, best, where="post", color=VERMILION, lw=1.5, label="best so far")
    axes.set(xlabel="trial", ylabel=_aim(found, 0))
    space_ticks(axes, integer=True)
    axes.grid(alpha=0.25)
    axes.legend(fontsize=8)
    return axes


def _draw_trials(
    axes: Axes, x: np.ndarray[Any, Any], y: np.ndarray[Any, Any], found: Optimum
) -> None:
    """Draw feasible trials as dots and those outside the constraints as crosses."""
    if found.failed.all():
        raise SceneError(f"{found.results.path} has no trial with values, so nothing to draw")
    outside = ~found.feasible & ~found.failed
    for chosen, marker, colour, told in (
        (found.feasible, "o", BLUE, "feasible"),
        (outside, "x", GREY, "outside constraints"),
    ):
        if chosen.any():
            axes.plot(
                x[chosen], y[chosen], marker, color=colour, ms=4, alpha=0.6,
                label=f"{told}: {int(chosen.sum())} trials",
            )  # fmt: skip
    if found.failed.any():
        axes.plot([], [], " ", label=f"failed: {int(found.failed.sum())} trials")


def _aim(found: Optimum, objective: int) -> str:
    """Return the label of an objective with its goal."""
    return f"{found.labels[objective]}, to {found.goals[objective]}"
