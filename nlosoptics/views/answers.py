"""Figures of what a study answers: sensitivities, yields, searches."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from .._checks import each, expect, numbers
from ..errors import SceneError
from .canvas import BLACK, BLUE, GREY, VERMILION, new_axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ..study import Fraction, Optimum
    from ..study.answers import Sensitivity


def tornado(
    bars: Sequence[Sensitivity] | Any, *, label: str = "", axes: Axes | None = None
) -> Axes:
    """Draw how much each value of a scene changes a figure of merit, as bars.

    Parameters
    ----------
    bars : sequence of Sensitivity, or Dataset
        Result of `nlosoptics.study.sensitivities`: changes of the figure of merit when one value
        changes alone, the largest first. Or the dataset of `nlosoptics.study.sobol_indices`: shares
        of its variance.
    label : str
        Name of the figure of merit, with its unit, for the axis label.
    axes : matplotlib Axes, optional
        Axes to draw on; a new figure by default.

    Returns
    -------
    Axes
        Axes with one row for each changed value, the largest change on top. Changes smaller than
        their errors are pale. If the computation failed, the row says so. For Sobol indices, each
        row has two bars: the share of the variance that the value causes alone (first order), and
        that with all interactions with other values (total). Lines on these bars are confidence
        intervals; a share whose interval contains zero cannot be told from zero.

    See Also
    --------
    nlosoptics.study.sensitivities : Change of a figure of merit with each value.
    nlosoptics.study.sobol_indices : Shares of the variance of a figure of merit.
    study_map : Figure of merit over two dimensions.
    """
    given: Any = bars
    if hasattr(bars, "data_vars"):
        order = np.argsort(-given["total"].values)
        names = [str(name) for name in given["address"].values[order]]
    else:
        bars = each("bars", bars, "Sensitivity")
        names = list(dict.fromkeys(bar.case.partition(" = ")[0] for bar in bars))
    if axes is None:
        (axes,) = new_axes(width=7.4, height=1.4 + 0.55 * len(names))
    if hasattr(bars, "data_vars"):
        _draw_shares(axes, given.sel(address=names))
        what = "share of the variance"
    else:
        _draw_changes(axes, bars, names)
        what = "change"
    axes.axvline(0.0, color=BLACK, lw=1)
    axes.set_yticks(range(len(names)), names)
    axes.set(ylim=(len(names) - 0.4, -0.6), xlabel=f"{what} of {label}" if label else what)
    axes.grid(axis="x", alpha=0.25)
    return axes


def _draw_changes(axes: Axes, bars: Sequence[Sensitivity], names: list[str]) -> None:
    """Draw the bars of a tornado diagram."""
    reach = max((abs(b.change) for b in bars if np.isfinite(b.change)), default=0.0) or 1.0
    for bar in bars:
        name, _, text = bar.case.partition(" = ")
        row = names.index(name)
        change = bar.change if np.isfinite(bar.change) else 0.0
        colour, side, gap = (BLUE, "right", -4) if change < 0 else (VERMILION, "left", 4)
        axes.barh(row, change, height=0.6, alpha=1.0 if bar.resolved else 0.3, color=colour)
        axes.annotate(
            f"{text} failed" if np.isnan(bar.change) else text,
            (change, row),
            xytext=(gap, 0),
            textcoords="offset points",
            va="center",
            ha=side,
            fontsize=8,
        )
    axes.set(xlim=(-1.5 * reach, 1.5 * reach))


def _draw_shares(axes: Axes, indices: Any) -> None:
    """Draw Sobol indices with their confidence intervals."""
    rows = np.arange(indices.sizes["address"])
    for offset, kind, text, colour in (
        (-0.19, "first", "alone (first order)", BLUE),
        (0.19, "total", "with interactions (total)", VERMILION),
    ):
        value, low, high = (indices[kind + end].values for end in ("", "_low", "_high"))
        # a percentile interval of a bootstrap may miss the estimate itself
        reach = np.maximum([value - low, high - value], 0.0)
        line = {"capsize": 3, "ecolor": BLACK, "lw": 1}
        style: dict[str, Any] = {"height": 0.36, "alpha": 0.75, "xerr": reach, "error_kw": line}
        axes.barh(rows + offset, value, color=colour, label=text, **style)
    axes.legend(loc="lower right", fontsize=8)


def yield_curve(
    limits: ArrayLike,
    fractions: Sequence[Fraction],
    *,
    label: str = "",
    axes: Axes | None = None,
) -> Axes:
    """Draw the yield of a tolerance study against the limit that the figure of merit must meet.

    The yield is the fraction of randomly drawn scenes (draws) that meet the limit.

    Parameters
    ----------
    limits : array_like, (n,)
        Limits on the figure of merit, in its unit.
    fractions : sequence of n Fraction
        Result of `nlosoptics.study.fraction_within` for each limit.
    label : str
        Name of the figure of merit, with its unit, for the axis label.
    axes : matplotlib Axes, optional
        Axes to draw on; a new figure by default.

    Returns
    -------
    Axes
        Axes with the yield in percent, and a band for its confidence interval. The legend gives the
        number of draws.

    See Also
    --------
    nlosoptics.study.fraction_within : Share of points that meet a specification.
    """
    if axes is None:
        (axes,) = new_axes(width=6.4, height=4.2)
    x = numbers("limits", limits)
    fractions = each("fractions", fractions, "Fraction")
    value, low, high = (
        100 * np.array([getattr(fraction, name) for fraction in fractions])
        for name in ("value", "low", "high")
    )
    axes.fill_between(x, low, high, color=BLUE, alpha=0.2, lw=0, label="confidence interval")
    first = fractions[0] if len(fractions) else None
    text = f"{first.points} draws, {first.failed} failed" if first else "no draws"
    axes.step(x, value, color=BLUE, label=text, where="mid")
    axes.axhline(50.0, color=GREY, lw=0.5)
    name = f"limit of {label}" if label else "limit"
    axes.set(xlabel=name, ylabel="yield (%)", ylim=(0.0, 102.0))
    axes.grid(alpha=0.25)
    axes.legend(loc="lower left", fontsize=8)
    return axes


def search(found: Optimum, *, first: int = 0, second: int = 1, axes: Axes | None = None) -> Axes:
    """Draw the trials of an optimisation: the Pareto front, or the progress of one objective.

    A trial is on the front if it meets all constraints and no other such trial is at least as good
    in all objectives and better in one.

    Parameters
    ----------
    found : Optimum
        Result of `nlosoptics.study.optimum`.
    first, second : int
        Index of the objective on the horizontal axis and of that on the vertical axis, from 0. If
        there are more than two objectives, the front is that of all of them, and no line joins its
        points. Not used if there is a single objective, which is drawn against the trials.
    axes : matplotlib Axes, optional
        Axes to draw on; a new figure by default.

    Returns
    -------
    Axes
        Axes with one mark for each trial: a dot if it meets all constraints, a cross if not. In
        red, the front, or the best value so far of the feasible trials. Trials that could not be
        computed appear only in the legend, with their number.

    Raises
    ------
    SceneError
        If no trial has values, or there are no such objectives.

    See Also
    --------
    nlosoptics.study.optimum : Best trials of an optimisation.
    """
    found = expect("found", found, "Optimum")
    count, values = len(found.labels), found.objectives
    if found.failed.all():
        raise SceneError(
            f"{found.results.path} has no trial with values to draw; run the search on"
        )
    if count > 1 and (first == second or not {first, second} <= set(range(count))):
        raise SceneError(
            f"objectives {first} and {second} are not two of {count}; give numbers from 0 to "
            f"{count - 1}"
        )
    if axes is None:
        (axes,) = new_axes(width=6.4, height=4.6)
    aims = [f"{name}, to {goal}" for name, goal in zip(found.labels, found.goals, strict=True)]
    single = count == 1
    x = np.arange(len(values)) if single else values[:, first]
    y = values[:, 0 if single else second]
    outside = ~found.feasible & ~found.failed
    for trials, marker, colour, text in (
        (found.feasible, "o", BLUE, "feasible"),
        (outside, "x", GREY, "outside constraints"),
    ):
        if trials.any():
            text = f"{text}: {int(trials.sum())} trials"
            axes.plot(x[trials], y[trials], marker, color=colour, ms=4, alpha=0.6, label=text)
    if found.failed.any():
        axes.plot([], [], " ", label=f"failed: {int(found.failed.sum())} trials")
    if single:
        better = np.fmin if found.goals[0] == "minimise" else np.fmax
        best = better.accumulate(np.where(found.feasible, y, np.nan))
        axes.step(x, best, where="post", color=VERMILION, lw=1.5, label="best so far")
    else:
        front = np.array(found.front, dtype=int)
        order = front[np.argsort(x[front], kind="stable")]
        # the corners of the steps are the worst objectives that the two points beside them dominate
        steps: Any = "steps-post" if found.goals[first] == "minimise" else "steps-pre"
        style: dict[str, Any] = {"color": VERMILION, "marker": "o", "ms": 5, "lw": 1}
        style |= {"ls": "-" if count == 2 else "", "label": f"front: {len(front)} trials"}
        axes.plot(x[order], y[order], drawstyle=steps, **style)
    axes.set(xlabel="trial" if single else aims[first], ylabel=aims[0 if single else second])
    axes.grid(alpha=0.25)
    axes.legend(fontsize=8)
    return axes
