"""Figures of design studies: maps, slices, tornado, yield, Sobol indices."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from ..errors import SceneError
from .canvas import BLACK, BLUE, GREY, PALE_GREY, SERIES, VERMILION, new_axes, space_ticks

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ..study import Fraction, Results
    from ..study.answers import Sensitivity

MOST_TEXTS = 80  # cells of a map that show their value
MOST_TICKS = 9
MOST_CURVES = len(SERIES)
PANELS = 3  # in a row
MOST_PANELS = 6


def study_map(
    results: Results,
    figure: str,
    *,
    at: Mapping[str, int] | None = None,
    boundary: float | None = None,
    contours: Sequence[float] | None = None,
    axes: Axes | None = None,
) -> Axes:
    """Draw a figure of merit of a design study: a map over two dimensions, or a curve over one.

    A dimension is a value of the scene that the study varies, such as ``wall.radius``, and its
    steps are the values that it takes. The map shows the last two dimensions that have more than
    one step and no entry in ``at``.

    Parameters
    ----------
    results : Results
        Results of a study, complete or not.
    figure : str
        Name of the figure of merit, as in the study file, for example ``"strehl"``.
    at : mapping of str to int, optional
        Steps to show along the other dimensions: a mapping from the name of a dimension to the
        index of its step, from 0. A dimension without entry is shown at its middle step.
    boundary : float, optional
        Value of the figure of merit at which to draw a line between cells, for example the least
        value at which a reconstruction is readable. In a map, cells below this value are hatched.
    contours : sequence of float, optional
        Values of contour lines in a map, interpolated between the centres of its cells. None: no
        lines; instead, a map of at most 80 cells shows its values as numbers.
    axes : matplotlib Axes, optional
        Axes to draw on; a new figure by default.

    Returns
    -------
    Axes
        Axes with a map of equal cells, one for each pair of steps, or with a curve and error bars.
        Cells that could not be computed are grey. The title gives the steps of the other
        dimensions.

    Raises
    ------
    SceneError
        If the study has no such figure of merit, dimension or step.

    See Also
    --------
    nlosoptics.study.Results : Results of a study.
    study_slices : Curves along each dimension.
    tornado : Change of a figure of merit with each value.
    """
    figure, dataset = results.study.figure(figure).name, results.dataset
    wide = [str(name) for name in dataset[figure].dims if dataset.sizes[name] > 1]
    shown = [name for name in wide if name not in (at or {})][-2:]
    fixed = _fixed(dataset, figure, shown, at or {})
    titles = [_tick(dataset, name, step, named=True) for name, step in fixed.items()]
    chosen = dataset.isel(fixed)
    if axes is None:
        (axes,) = new_axes(1, width=7.2, height=4.6)
    if len(shown) == 2:
        drawn = _draw_map(axes, chosen, figure, shown, boundary, contours or ())
        parent: Any = axes.get_figure()
        parent.colorbar(drawn, ax=axes, label=_name(dataset, figure))
    else:
        _draw_curve(axes, chosen, figure, shown, boundary)
    axes.set_title("\n".join(_lines(titles)), fontsize=9)
    return axes


def study_panels(
    results: Results,
    figure: str,
    *,
    at: Mapping[str, int] | None = None,
    boundary: float | None = None,
    contours: Sequence[float] | None = None,
) -> tuple[Axes, ...]:
    """Draw a figure of merit over three dimensions of a design study, as maps side by side.

    A dimension is a value of the scene that the study varies, and its steps are the values that it
    takes. Shown are the last three dimensions with more than one step and no entry in ``at``.

    Parameters
    ----------
    results : Results
        Results of a study, complete or not.
    figure : str
        Name of the figure of merit, as in the study file, for example ``"strehl"``.
    at : mapping of str to int, optional
        Steps to show along the other dimensions: a mapping from the name of a dimension to the
        index of its step, from 0. A dimension without entry is shown at its middle step.
    boundary : float, optional
        Value of the figure of merit at which to draw a line between cells; cells below it are
        hatched.
    contours : sequence of float, optional
        Values of contour lines. None: no lines; instead, maps of at most 80 cells show their values
        as numbers.

    Returns
    -------
    tuple of Axes
        One map for each step of the first of the three dimensions, all with the same colour scale.

    Raises
    ------
    SceneError
        If the study has no such figure of merit or step, if fewer than three dimensions have more
        than one step, or if there would be more than 6 panels.

    See Also
    --------
    study_map : Figure of merit over two dimensions.
    study_slices : Curves along each dimension.
    """
    figure, dataset = results.study.figure(figure).name, results.dataset
    wide = [str(name) for name in dataset[figure].dims if dataset.sizes[name] > 1]
    shown = [name for name in wide if name not in (at or {})][-3:]
    if len(shown) < 3:
        raise SceneError(
            f"panels need three dimensions of several steps, not {', '.join(shown) or 'none'}; "
            "draw a map"
        )
    count = dataset.sizes[shown[0]]
    if count > MOST_PANELS:
        raise SceneError(
            f"{shown[0]} has {count} steps, limit {MOST_PANELS} panels; put another dimension first"
        )
    chosen = dataset.isel(_fixed(dataset, figure, shown, at or {}))
    values = np.asarray(chosen[figure].values, dtype=np.float64)
    good = values[np.isfinite(values)]
    span = (float(good.min()), float(good.max())) if len(good) else None
    rows, columns = -(-count // PANELS), min(count, PANELS)
    made = new_axes(count, width=3.1 * columns + 0.9, height=3.0 * rows + 0.4, columns=columns)
    for unused in made[count:]:
        unused.remove()
    for step, panel in enumerate(made[:count]):
        drawn = _draw_map(
            panel, chosen.isel({shown[0]: step}), figure, shown[1:], boundary, contours or (), span
        )
        told = _tick(dataset, shown[0], step, named=True)
        panel.set_title(told.replace(" = ", "\n", 1), fontsize=9)
        if step % columns:
            panel.set(ylabel="", yticklabels=[])
        panel.tick_params(axis="x", rotation=45)
    parent: Any = made[0].get_figure()
    parent.set_layout_engine("constrained")  # one colour bar for all rows and columns
    parent.colorbar(drawn, ax=list(made[:count]), label=_name(dataset, figure))
    return made[:count]


def _fixed(dataset: Any, figure: str, shown: list[str], at: Mapping[str, int]) -> dict[str, int]:
    """Return the step of each dimension that is not shown: that of ``at``, or the middle one."""
    fixed = {
        str(name): dataset.sizes[name] // 2 if dataset.sizes[name] > 1 else 0
        for name in dataset[figure].dims
        if name not in shown
    }
    for name, step in at.items():
        if name not in dataset.sizes or not 0 <= step < dataset.sizes[name]:
            raise SceneError(f"at: {name} = {step} is no step of the study; give one from 0 on")
        if name not in shown:
            fixed[name] = step
    return fixed


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
    axes: Axes,
    dataset: Any,
    figure: str,
    shown: list[str],
    boundary: float | None,
    contours: Sequence[float],
    span: tuple[float, float] | None = None,
) -> Any:
    """Draw a map of cells, with the colours from ``span``; return what a colour bar needs."""
    down, across = shown
    values = np.asarray(dataset[figure].transpose(down, across).values, dtype=np.float64)
    axes.set_facecolor("#DDDDDD")
    low, high = span or (None, None)
    drawn = axes.imshow(values, origin="lower", aspect="auto", cmap="viridis", vmin=low, vmax=high)
    axes.set_xticks(*_ticks(dataset, across))
    axes.set_yticks(*_ticks(dataset, down))
    axes.set(xlabel=across, ylabel=down)
    if values.size <= MOST_TEXTS and not contours:
        _write_values(axes, values, *drawn.get_clim())
    if contours and min(values.shape) > 1:
        lines = axes.contour(values, levels=sorted(contours), colors="white", linewidths=1.2)
        axes.clabel(lines, fontsize=8)
    if boundary is not None:
        _draw_boundary(axes, values >= boundary)
    return drawn


def _write_values(
    axes: Axes, values: np.ndarray[Any, np.dtype[np.float64]], least: float, most: float
) -> None:
    """Write the value of each cell, to a hundredth of the range of the colours."""
    from matplotlib.patheffects import withStroke

    # none where a hundredth of the range is very small or large
    power = round(math.log10(most - least)) if most > least else 9
    finite = values[np.isfinite(values)]
    digits = max(2 - power, 0) if np.any(finite % 1.0) else 0
    for (row, column), value in np.ndenumerate(values):
        text = f"{value:.{digits}f}" if -2 <= power <= 4 else f"{value:.3g}"
        if not np.isfinite(value):
            text = "failed"
        dark = np.isfinite(value) and value < (least + most) / 2
        ink, edge = ("white", "#00000080") if dark else (BLACK, "#FFFFFF80")
        # the edge keeps the value readable on hatches
        effects = [withStroke(linewidth=2, foreground=edge)]
        axes.text(
            column, row, text, ha="center", va="center",
            fontsize=8, color=ink, path_effects=effects,
        )  # fmt: skip


def _draw_boundary(axes: Axes, above: np.ndarray[Any, np.dtype[np.bool_]]) -> None:
    """Draw a line along the edges of the cells between those above a boundary and the others."""
    from matplotlib.patches import Rectangle

    rows, columns = above.shape
    for row, column in np.argwhere(~above):
        axes.add_patch(
            Rectangle(
                (column - 0.5, row - 0.5), 1.0, 1.0, fill=False, hatch="//", lw=0.0,
                edgecolor=PALE_GREY,
            )
        )  # fmt: skip
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
    """Draw how much each value of a scene changes a figure of merit, as bars (tornado diagram).

    Parameters
    ----------
    bars : sequence of Sensitivity
        Result of `nlosoptics.study.sensitivities`: changes of the figure of merit when one value
        changes alone, the largest first.
    label : str
        Name of the figure of merit, with its unit, for the axis label.
    axes : matplotlib Axes, optional
        Axes to draw on; a new figure by default.

    Returns
    -------
    Axes
        Axes with one row for each changed value, the largest change on top. Changes smaller than
        their errors are pale. If the computation failed, the row says so.

    See Also
    --------
    nlosoptics.study.sensitivities : Change of a figure of merit with each value.
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
        (axes,) = new_axes(1, width=6.4, height=4.2)
    x = np.asarray(limits, dtype=np.float64)
    value, low, high = (
        100 * np.array([getattr(one, name) for one in fractions])
        for name in ("value", "low", "high")
    )
    axes.fill_between(x, low, high, color=BLUE, alpha=0.2, lw=0, label="confidence interval")
    points = fractions[0].points if len(fractions) else 0
    failed = fractions[0].failed if len(fractions) else 0
    told = f"{points} draws, {failed} failed"
    axes.step(x, value, color=BLUE, label=told, where="mid")
    axes.axhline(50.0, color=GREY, lw=0.5)
    axes.set(
        xlabel=f"limit of {label}" if label else "limit", ylabel="yield (%)", ylim=(0.0, 102.0)
    )
    space_ticks(axes)
    axes.grid(alpha=0.25)
    axes.legend(loc="lower left", fontsize=8)
    return axes


def study_slices(
    results: Results,
    figure: str,
    *,
    at: Mapping[str, int] | None = None,
    boundary: float | None = None,
    axes: Sequence[Axes] | None = None,
) -> tuple[Axes, ...]:
    """Draw a figure of merit over each dimension of a design study, one panel for each dimension.

    A dimension is a value of the scene that the study varies, such as ``wall.radius``, and its
    steps are the values that it takes. In each panel, the other dimensions are held at one step. If
    the study draws its values at random, each panel shows all draws against one of the values.

    Parameters
    ----------
    results : Results
        Results of a study, complete or not.
    figure : str
        Name of the figure of merit, as in the study file, for example ``"strehl"``.
    at : mapping of str to int, optional
        Steps at which dimensions are held: a mapping from the name of a dimension to the index of
        its step, from 0. A dimension without entry is held at its middle step.
    boundary : float, optional
        Value of the figure of merit at which to draw a horizontal line. None: no line.
    axes : sequence of matplotlib Axes, optional
        Axes to draw on, one for each panel; a new figure by default.

    Returns
    -------
    tuple of Axes
        One panel for each dimension of more than one step, with a curve. For random draws, one
        panel for each drawn value, with a dot for each draw and a mark at the lower edge for each
        draw that failed. All panels have the same vertical scale.

    Raises
    ------
    SceneError
        If the study has no such figure of merit, dimension or step; if it varies a base scene by
        one value at a time (table ``one_at_a_time``), which `tornado` draws; or if it mixes random
        draws with other dimensions.

    See Also
    --------
    study_map : Figure of merit over two dimensions.
    tornado : Change of a figure of merit with each value.
    """
    figure, dataset = results.study.figure(figure).name, results.dataset
    names = slice_names(results)
    panels = tuple(axes or ())[: len(names)]
    if len(panels) < len(names):
        if axes is not None:
            raise SceneError(f"axes has {len(panels)} axes, must have {len(names)}; add some")
        columns = min(len(names), PANELS)
        rows = -(-len(names) // columns)
        made = new_axes(len(names), width=3.7 * columns, height=3.1 * rows, columns=columns)
        panels = made[: len(names)]
        for unused in made[len(names) :]:
            unused.remove()
    for panel, name in zip(panels, names, strict=True):
        if "draw" in dataset[figure].dims:
            _draw_dots(panel, dataset, figure, name, boundary)
        else:
            fixed = _fixed(dataset, figure, [name], at or {})
            _draw_curve(panel, dataset.isel(fixed), figure, [name], boundary)
            told = [_tick(dataset, other, step, named=True) for other, step in fixed.items()]
            panel.set_title("\n".join(told), fontsize=8)
    limits = [panel.get_ylim() for panel in panels]
    for panel in panels:
        panel.set_ylim(min(low for low, _ in limits), max(high for _, high in limits))
    return panels


def slice_names(results: Results) -> list[str]:
    """Return the dimensions or drawn values that `study_slices` has panels for.

    Raises
    ------
    SceneError
        If the study is one of single changes, or mixes draws with other dimensions.
    """
    dataset = results.dataset
    wide = [str(name) for name in dataset["status"].dims if dataset.sizes[name] > 1]
    if not wide or "case" in wide or ("draw" in wide and len(wide) > 1):
        raise SceneError(
            f"slices need dimensions of several steps, or draws alone, not "
            f"{', '.join(wide) or 'a single point'}; draw a tornado or a map"
        )
    if wide == ["draw"]:
        return [str(key) for key, value in dataset.coords.items() if value.dims == ("draw",)]
    return wide


def _draw_dots(axes: Axes, dataset: Any, figure: str, name: str, boundary: float | None) -> None:
    """Draw a figure against a drawn value, and failed draws along the lower edge."""
    places, values = dataset.coords[name].values, dataset[figure].values
    good = np.isfinite(values)
    axes.plot(places[good], values[good], ".", color=BLUE, ms=4)
    lost = dataset["status"].values != "pending"
    if (failed := ~good & lost).any():
        axes.plot(
            places[failed], np.zeros(failed.sum()), "|", color=VERMILION, ms=10,
            transform=axes.get_xaxis_transform(), clip_on=False, label=f"{failed.sum()} failed",
        )  # fmt: skip
        axes.legend(fontsize=8)
    if boundary is not None:
        axes.axhline(boundary, color=VERMILION, lw=1)
    unit = dataset.coords[name].attrs.get("units", "")
    axes.set(xlabel=f"{name} ({unit})" if unit else name, ylabel=_name(dataset, figure))
    if dataset.coords[name].dtype.kind in "if":
        space_ticks(axes)
    axes.grid(alpha=0.25)


def sobol_bars(indices: Any, *, label: str = "", axes: Axes | None = None) -> Axes:
    """Draw Sobol indices as bars: which values of a scene cause the variance of a figure of merit.

    Parameters
    ----------
    indices : Dataset
        Dataset of xarray that `nlosoptics.study.sobol_indices` returns.
    label : str
        Name of the figure of merit, for the axis label.
    axes : matplotlib Axes, optional
        Axes to draw on; a new figure by default.

    Returns
    -------
    Axes
        Axes with two bars for each varied value, such as ``wall.radius``: the fraction of the
        variance that it causes alone (first order), and together with all interactions with other
        values (total). The largest total is on top. Lines on the bars are confidence intervals. If
        an interval contains zero, the fraction is not distinguishable from zero.

    See Also
    --------
    nlosoptics.study.sobol_indices : Shares of the variance of a figure of merit.
    tornado : Change of a figure of merit with each value.
    """
    order = np.argsort(-indices["total"].values, kind="stable")
    names = indices["address"].values[order]
    if axes is None:
        (axes,) = new_axes(1, width=7.2, height=1.4 + 0.6 * len(names))
    rows = np.arange(len(names))
    for offset, kind, told, colour in (
        (-0.19, "first", "alone (first order)", BLUE),
        (0.19, "total", "with interactions (total)", VERMILION),
    ):
        value, low, high = (
            np.asarray(indices[name].values)[order]
            for name in (kind, f"{kind}_low", f"{kind}_high")
        )
        # a percentile interval of a bootstrap may miss the estimate itself
        reach = np.maximum([value - low, high - value], 0.0)
        axes.barh(
            rows + offset, value, height=0.36, color=colour, alpha=0.75, label=told, xerr=reach,
            error_kw={"capsize": 3, "ecolor": BLACK, "lw": 1},
        )  # fmt: skip
    axes.axvline(0.0, color=BLACK, lw=1)
    axes.set_yticks(rows, list(names))
    axes.set(
        ylim=(len(names) - 0.4, -0.6),
        xlabel=f"share of the variance of {label}" if label else "share of the variance",
    )
    space_ticks(axes)
    axes.grid(axis="x", alpha=0.25)
    axes.legend(loc="lower right", fontsize=8)
    return axes
