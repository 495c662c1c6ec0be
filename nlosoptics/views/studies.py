"""Figures of design studies: maps, tornado, yield, optimisations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from ..errors import SceneError
from .canvas import new_axes, space_ticks
from .palette import BLACK, BLUE, GREY, SERIES, VERMILION

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ..study import Fraction, Optimum, Results, Sensitivity

MOST_TEXTS = 80  # cells of a map that show their value
MOST_TICKS = 9
MOST_CURVES = len(SERIES)


def study_map(
    results: Results,
    figure: str,
    *,
    at: Mapping[str, int] | None = None,
    boundary: float | None = None,
    axes: Axes | None = None,
) -> Axes:
    """Draw a figure of merit over the last two dimensions of a study, or over its only one.

    Parameters
    ----------
    results : Results
        Results of a study, complete or not.
    figure : str
        Name of the figure.
    at : mapping of str to int, optional
        Step along each other dimension, counted from 0; by default the middle one. Dimensions of
        one step need none.
    boundary : float, optional
        Value of the figure at which to draw a line, for example where a picture becomes readable.
    axes : matplotlib Axes, optional
        Axes to draw on; a new figure by default.

    Returns
    -------
    Axes
        Axes with a map of equal cells, labelled by their values, or with a curve and its error.
        Points that failed are grey.

    Raises
    ------
    SceneError
        If the study has no such figure, dimension or step.

    See Also
    --------
    nlosoptics.study.Results : Results of a study.
    tornado : Bars of one-at-a-time changes.
    """
    figure, dataset = results.study.figure(figure).name, results.dataset
    wide = [str(name) for name in dataset[figure].dims if dataset.sizes[name] > 1]
    shown = [name for name in wide if name not in (at or {})][-2:]
    fixed = {
        str(name): dataset.sizes[name] // 2 if name in wide else 0
        for name in dataset[figure].dims
        if name not in shown
    }
    for name, step in (at or {}).items():
        if name not in dataset.sizes or not 0 <= step < dataset.sizes[name]:
            raise SceneError(f"at: {name} = {step} is no step of the study; give one from 0 on")
        fixed[name] = step
    titles = [_tick(dataset, name, step, named=True) for name, step in fixed.items()]
    chosen = dataset.isel(fixed)
    if axes is None:
        (axes,) = new_axes(1, width=7.2, height=4.6)
    if len(shown) == 2:
        _draw_map(axes, chosen, figure, shown, boundary)
    else:
        _draw_curve(axes, chosen, figure, shown, boundary)
    axes.set_title("\n".join(_lines(titles)), fontsize=9)
    return axes


def _lines(texts: list[str]) -> list[str]:
    """Join texts to lines of two."""
    return [", ".join(texts[i : i + 2]) for i in range(0, len(texts), 2)]


def _tick(dataset: Any, name: str, step: int, *, named: bool = False) -> str:
    """Return the text of one step of a dimension."""
    if name not in dataset.coords:  # draws and zipped values have coordinates of other names
        own = [key for key in dataset.coords if dataset.coords[key].dims == (name,)]
        texts = [_tick(dataset, str(key), step, named=True) for key in own]
        return ", ".join(texts) or f"{name} {step}"
    from ..study.design.values import label, with_unit  # reads units, which other views do not need

    coordinate = dataset.coords[name]
    value = coordinate.values[step]
    text = str(value)
    if coordinate.dtype.kind in "if":
        text = label(with_unit(float(value), coordinate.attrs.get("units", "")))
    return f"{name} = {text}" if named and name != "case" else text


def _name(dataset: Any, figure: str) -> str:
    unit = dataset[figure].attrs.get("units", "")
    return f"{figure} ({unit})" if unit else figure


def _ticks(dataset: Any, name: str) -> tuple[list[int], list[str]]:
    """Return the steps of a dimension that get a label, and the labels."""
    count = dataset.sizes[name]
    steps = list(range(0, count, -(-count // MOST_TICKS)))
    return steps, [_tick(dataset, name, step) for step in steps]


def _draw_map(
    axes: Axes, dataset: Any, figure: str, shown: list[str], boundary: float | None
) -> None:
    down, across = shown
    values = np.asarray(dataset[figure].transpose(down, across).values, dtype=np.float64)
    axes.set_facecolor("#DDDDDD")
    drawn = axes.imshow(values, origin="lower", aspect="auto", cmap="viridis")
    parent: Any = axes.get_figure()
    parent.colorbar(drawn, ax=axes, label=_name(dataset, figure))
    axes.set_xticks(*_ticks(dataset, across))
    axes.set_yticks(*_ticks(dataset, down))
    axes.set(xlabel=across, ylabel=down)
    if values.size <= MOST_TEXTS:
        low, high = np.nanmin(values, initial=np.inf), np.nanmax(values, initial=-np.inf)
        for (row, column), value in np.ndenumerate(values):
            dark = np.isfinite(value) and value < (low + high) / 2
            text = f"{value:.3g}" if np.isfinite(value) else "failed"
            axes.text(
                column, row, text, ha="center", va="center", fontsize=8,
                color="white" if dark else BLACK,
            )  # fmt: skip
    if boundary is not None:
        _draw_boundary(axes, values >= boundary)


def _draw_boundary(axes: Axes, above: np.ndarray[Any, np.dtype[np.bool_]]) -> None:
    """Draw a line along the edges of the cells between those above a boundary and the others."""
    rows, columns = above.shape
    for row, column in np.argwhere(above[:, 1:] != above[:, :-1]):
        x = [column + 0.5, column + 0.5]
        axes.plot(x, [row - 0.5, row + 0.5], color=VERMILION, lw=3)
    for row, column in np.argwhere(above[1:] != above[:-1]):
        y = [row + 0.5, row + 0.5]
        axes.plot([column - 0.5, column + 0.5], y, color=VERMILION, lw=3)
    axes.set(xlim=(-0.5, columns - 0.5), ylim=(-0.5, rows - 0.5))


def _draw_curve(
    axes: Axes, dataset: Any, figure: str, shown: list[str], boundary: float | None
) -> None:
    values = np.atleast_1d(dataset[figure].values)
    name = shown[0] if shown else ""
    numeric = name in dataset.coords and dataset.coords[name].dtype.kind in "if"
    places = dataset.coords[name].values if numeric else np.arange(len(values))
    errors = None
    if f"{figure}_error" in dataset:
        errors = np.nan_to_num(np.atleast_1d(dataset[f"{figure}_error"].values))
    axes.errorbar(places, values, yerr=errors, fmt="o-", color=BLUE, capsize=3, ms=4)
    if boundary is not None:
        axes.axhline(boundary, color=VERMILION, lw=1)
    axes.set(xlabel=name, ylabel=_name(dataset, figure))
    if numeric:
        unit = dataset.coords[name].attrs.get("units", "")
        axes.set_xlabel(f"{name} ({unit})" if unit else name)
        space_ticks(axes)
    elif name:
        axes.set_xticks(*_ticks(dataset, name))
    axes.grid(alpha=0.25)


def tornado(bars: Sequence[Sensitivity], *, label: str = "", axes: Axes | None = None) -> Axes:
    """Draw the changes of a figure of merit as bars, those of one address in one row.

    Parameters
    ----------
    bars : sequence of Sensitivity
        Result of `study.sensitivities`, the largest change first.
    label : str
        Name of the figure, with its unit.
    axes : matplotlib Axes, optional
        Axes to draw on; a new figure by default.

    Returns
    -------
    Axes
        Axes with the largest changes on top. Changes below their errors are pale, and rows of
        values that failed say so.

    See Also
    --------
    nlosoptics.study.sensitivities : Change of a figure with each value.
    study_map : Figure of merit over two dimensions.
    """
    rows: dict[str, list[Sensitivity]] = {}
    for bar in bars:
        rows.setdefault(bar.case.partition(" = ")[0], []).append(bar)
    if axes is None:
        (axes,) = new_axes(1, width=7.6, height=1.4 + 0.5 * len(rows))
    reach = max((abs(b.change) for b in bars if np.isfinite(b.change)), default=0.0) or 1.0
    for row, group in enumerate(rows.values()):
        for bar in group:
            text = bar.case.partition(" = ")[2]
            change = bar.change if np.isfinite(bar.change) else 0.0
            if np.isnan(bar.change):
                text = f"{text} failed"
            axes.barh(
                row, change, height=0.6, alpha=1.0 if bar.resolved else 0.3,
                color=BLUE if change < 0 else VERMILION,
            )  # fmt: skip
            axes.annotate(
                text, (change, row), xytext=(-4 if change < 0 else 4, 0),
                textcoords="offset points", va="center", fontsize=8,
                ha="right" if change < 0 else "left",
            )  # fmt: skip
    axes.axvline(0.0, color=BLACK, lw=1)
    axes.set_yticks(range(len(rows)), list(rows))
    axes.set(
        xlim=(-1.5 * reach, 1.5 * reach),
        ylim=(len(rows) - 0.4, -0.6),
        xlabel=f"change of {label}" if label else "change",
    )
    space_ticks(axes)
    axes.grid(axis="x", alpha=0.25)
    return axes


def yield_curve(
    limits: ArrayLike,
    fractions: Sequence[Fraction],
    *,
    label: str = "",
    axes: Axes | None = None,
) -> Axes:
    """Draw the yield against the limit that a figure of merit has to meet, with its interval.

    Parameters
    ----------
    limits : array_like, (n,)
        Limits of the figure.
    fractions : sequence of n Fraction
        Result of `study.fraction_within` for each limit.
    label : str
        Name of the figure, with its unit.
    axes : matplotlib Axes, optional
        Axes to draw on; a new figure by default.

    Returns
    -------
    Axes
        Axes with the yield in percent and a band between the ends of its interval.

    See Also
    --------
    nlosoptics.study.fraction_within : Share of points that meet a specification.
    """
    if axes is None:
        (axes,) = new_axes(1, width=6.4, height=4.2)
    x = np.asarray(limits, dtype=np.float64)
    value, low, high = (
        100 * np.array([getattr(one, name) for one in fractions])
        for name in ("value", "low", "high")
    )
    axes.fill_between(x, low, high, color=BLUE, alpha=0.2, lw=0, label="confidence interval")
    points = fractions[0].points if len(fractions) else 0
    failed = fractions[0].failed if len(fractions) else 0
    axes.step(x, value, color=BLUE, label=f"{points} draws, {failed} failed", where="mid")
    axes.axhline(50.0, color=GREY, lw=0.5)
    axes.set(
        xlabel=f"limit of {label}" if label else "limit", ylabel="yield (%)", ylim=(0.0, 102.0)
    )
    space_ticks(axes)
    axes.grid(alpha=0.25)
    axes.legend(loc="lower left", fontsize=8)
    return axes


def pareto(found: Optimum, *, first: int = 0, second: int = 1, axes: Axes | None = None) -> Axes:
    """Draw two objectives of an optimisation: all trials, and the front between them.

    Parameters
    ----------
    found : Optimum
        Result of `study.optimum`, with two objectives or more.
    first, second : int
        Numbers of the objectives across and up, counted from 0. With more than two, the front is
        that of all, and no line joins its points.
    axes : matplotlib Axes, optional
        Axes to draw on; a new figure by default.

    Returns
    -------
    Axes
        Axes with feasible trials as dots, those outside the constraints as crosses, and the front.
        Trials that failed have no objectives; the legend counts them.

    Raises
    ------
    SceneError
        If there are fewer than two objectives, or no trial with values.

    See Also
    --------
    nlosoptics.study.optimum : Best points of an optimisation.
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
    """Draw the objective of each trial of an optimisation, and the best one so far.

    Parameters
    ----------
    found : Optimum
        Result of `study.optimum`, with one objective.
    axes : matplotlib Axes, optional
        Axes to draw on; a new figure by default.

    Returns
    -------
    Axes
        Axes with the trials in their order; those outside the constraints are crosses.

    Raises
    ------
    SceneError
        If there are several objectives, or no trial has a value.

    See Also
    --------
    nlosoptics.study.optimum : Best points of an optimisation.
    pareto : Picture of two objectives.
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
