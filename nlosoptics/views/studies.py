"""Figures of design studies and searches."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from .._checks import expect, mapping, real
from ..errors import SceneError
from .answers import tornado, yield_curve
from .canvas import BLACK, BLUE, PALE_GREY, VERMILION, few_ticks, new_axes
from .maps import point_spread

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ..study import Results


def study_map(
    results: Results,
    figure: str,
    *,
    x: str | None = None,
    y: str | None = None,
    at: Mapping[str, int] | None = None,
    boundary: float | None = None,
    contours: Sequence[float] | None = None,
    axes: Axes | None = None,
) -> Axes:
    """Draw a figure of merit of a design study: a map over two dimensions, or a curve over one.

    A dimension is a value of the scene that the study varies, such as ``wall.radius``, and its
    steps are the values that it takes. By default the map shows the last two dimensions that have
    more than one step and no entry in ``at``.

    Parameters
    ----------
    results : Results
        Results of a study, complete or not.
    figure : str
        Name of the figure of merit, as in the study file, for example ``"strehl"``.
    x, y : str, optional
        Dimensions across and up, for example ``"camera.f_number"``. With ``x`` alone a curve over
        it is drawn; with ``y`` alone, the last other dimension is across.
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
    results = expect("results", results, "Results")
    figure, dataset = results.study.figure(figure).name, results.dataset
    wide = _wide(dataset, figure, at)
    for name in filter(None, (x, y)):
        if name not in wide or x == y:
            raise SceneError(
                f"{name} is not one of two dimensions of several steps; give x and y out of "
                f"{', '.join(wide) or 'none'}"
            )
    shown = wide[-2:]
    if x is not None:
        shown = [x] if y is None else [y, x]
    elif y is not None:
        shown = [y, *[name for name in wide if name != y][-1:]]
    fixed = _fixed(dataset, figure, shown, at)
    chosen = dataset.isel(fixed)
    if axes is None:
        (axes,) = new_axes(width=7.2, height=4.6)
    if len(shown) == 2:
        drawn = _draw_map(axes, chosen, figure, shown, boundary, contours or ())
        parent: Any = axes.get_figure()
        parent.colorbar(drawn, ax=axes, label=_label(dataset, figure))
    else:
        _draw_curve(axes, chosen, figure, shown[0] if shown else "", boundary)
    titles = [_tick(dataset, name, step, named=True) for name, step in fixed.items()]
    lines = [", ".join(titles[i : i + 2]) for i in range(0, len(titles), 2)]
    axes.set_title("\n".join(lines), fontsize=9)
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

    Shown are the last three dimensions with more than one step and no entry in ``at``.

    Parameters
    ----------
    results, figure, at, boundary, contours
        As of `study_map`.

    Returns
    -------
    tuple of Axes
        One map for each step of the first of the three dimensions, all with the same colour scale.

    Raises
    ------
    SceneError
        If the study has no such figure of merit or step, if fewer than three dimensions have more
        than one step, or if there would be more than 12 panels.

    See Also
    --------
    study_map : Figure of merit over two dimensions.
    study_slices : Curves along each dimension.
    """
    results = expect("results", results, "Results")
    figure, dataset = results.study.figure(figure).name, results.dataset
    shown = _wide(dataset, figure, at)[-3:]
    if len(shown) < 3:
        raise SceneError(
            f"panels need three dimensions of several steps, not {', '.join(shown) or 'none'}; "
            "draw a map"
        )
    count = dataset.sizes[shown[0]]
    if count > 12:
        raise SceneError(
            f"{shown[0]} has {count} steps, limit 12 panels; put another dimension first"
        )
    chosen = dataset.isel(_fixed(dataset, figure, shown, at))
    values = np.asarray(chosen[figure].values, dtype=np.float64)
    good = values[np.isfinite(values)]
    span = (float(good.min()), float(good.max())) if len(good) else None
    columns = min(count, 3)
    size = {"width": 3.1 * columns + 0.9, "height": 3.0 * -(-count // columns) + 0.4}
    panels = new_axes(count, columns=columns, **size)
    for step, panel in enumerate(panels):
        part = chosen.isel({shown[0]: step})
        drawn = _draw_map(panel, part, figure, shown[1:], boundary, contours or (), span)
        title = _tick(dataset, shown[0], step, named=True)
        panel.set_title(title.replace(" = ", "\n", 1), fontsize=9)
        if step % columns:
            panel.set(ylabel="", yticklabels=[])
        panel.tick_params(axis="x", rotation=45)
    parent: Any = panels[0].get_figure()
    parent.colorbar(drawn, ax=list(panels), label=_label(dataset, figure))
    return panels


def study_slices(
    results: Results,
    figure: str,
    *,
    at: Mapping[str, int] | None = None,
    boundary: float | None = None,
) -> tuple[Axes, ...]:
    """Draw a figure of merit over each dimension of a design study, one panel for each dimension.

    In each panel, the other dimensions are held at one step. If the study draws its values at
    random, each panel shows all draws against one of the values.

    Parameters
    ----------
    results, figure, at, boundary
        As of `study_map`; ``boundary`` is drawn as a horizontal line.

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
    results = expect("results", results, "Results")
    figure, dataset = results.study.figure(figure).name, results.dataset
    names = _wide(dataset, "status", None)
    drawn = names == ["draw"]
    if not names or "case" in names or ("draw" in names and not drawn):
        raise SceneError(
            f"slices need dimensions of several steps, or draws alone, not "
            f"{', '.join(names) or 'a single point'}; draw a tornado or a map"
        )
    if drawn:
        names = [str(key) for key, value in dataset.coords.items() if value.dims == ("draw",)]
    columns = min(len(names), 3)
    height = 3.1 * -(-len(names) // columns)
    panels = new_axes(len(names), width=3.7 * columns, height=height, columns=columns)
    for panel, name in zip(panels, names, strict=True):
        if drawn:
            _draw_dots(panel, dataset, figure, name, boundary)
            continue
        fixed = _fixed(dataset, figure, [name], at)
        _draw_curve(panel, dataset.isel(fixed), figure, name, boundary)
        titles = [_tick(dataset, other, step, named=True) for other, step in fixed.items()]
        panel.set_title("\n".join(titles), fontsize=8)
    limits = [panel.get_ylim() for panel in panels]
    for panel in panels:
        panel.set_ylim(min(low for low, _ in limits), max(high for _, high in limits))
    return panels


def _wide(dataset: Any, figure: str, at: Mapping[str, int] | None) -> list[str]:
    """Return the dimensions of several steps that have no entry in ``at``."""
    names = [str(name) for name in dataset[figure].dims if dataset.sizes[name] > 1]
    return [name for name in names if name not in (at or {})]


def _fixed(
    dataset: Any, figure: str, shown: list[str], at: Mapping[str, int] | None
) -> dict[str, int]:
    """Return the step of each dimension that is not shown: that of ``at``, or the middle one."""
    fixed = {
        str(name): dataset.sizes[name] // 2 if dataset.sizes[name] > 1 else 0
        for name in dataset[figure].dims
        if name not in shown
    }
    for name, step in mapping("at", at or {}, "{dimension: step}").items():
        if name not in dataset.sizes or not 0 <= step < dataset.sizes[name]:
            raise SceneError(f"at: {name} = {step} is no step of the study; give one from 0 on")
        if name not in shown:
            fixed[name] = step
    return fixed


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


def _label(dataset: Any, name: str) -> str:
    """Return the name of a figure of merit or coordinate with its unit."""
    unit = dataset[name].attrs.get("units", "")
    return f"{name} ({unit})" if unit else name


def _ticks(dataset: Any, name: str) -> tuple[list[int], list[str]]:
    """Return the steps of a dimension that get a label, at most nine, and the labels."""
    count = dataset.sizes[name]
    steps = list(range(0, count, -(-count // 9)))
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
    if values.size <= 80 and not contours:
        _write_values(axes, values, *drawn.get_clim())
    if contours and min(values.shape) > 1:
        lines = axes.contour(values, levels=sorted(contours), colors="white", linewidths=1.2)
        axes.clabel(lines, fontsize=8)
    if boundary is not None:
        _draw_boundary(axes, values >= real("boundary", boundary))
    return drawn


def _write_values(axes: Axes, values: Any, least: float, most: float) -> None:
    """Write the value of each cell, to a hundredth of the range of the colours."""
    from matplotlib.patheffects import withStroke

    power = round(math.log10(most - least)) if most > least else 9
    digits = max(2 - power, 0) if np.any(values[np.isfinite(values)] % 1.0) else 0
    # three digits where a hundredth of the range is very small or large
    form = f".{digits}f" if -2 <= power <= 4 else ".3g"
    for (row, column), value in np.ndenumerate(values):
        known = bool(np.isfinite(value))
        dark = known and value < (least + most) / 2
        # the edge keeps the value readable on hatches
        edge = withStroke(linewidth=2, foreground="#00000080" if dark else "#FFFFFF80")
        axes.text(
            column,
            row,
            f"{value:{form}}" if known else "failed",
            ha="center",
            va="center",
            fontsize=8,
            color="white" if dark else BLACK,
            path_effects=[edge],
        )


def _draw_boundary(axes: Axes, above: Any) -> None:
    """Draw a line between the cells above a boundary and the others, which are hatched."""
    from matplotlib.patches import Rectangle

    for row, column in np.argwhere(~above):
        corner = (column - 0.5, row - 0.5)
        axes.add_patch(Rectangle(corner, 1, 1, fill=False, hatch="//", lw=0.0, edgecolor=PALE_GREY))
    style: dict[str, Any] = {"color": VERMILION, "lw": 3, "scalex": False, "scaley": False}
    for row, column in np.argwhere(above[:, 1:] != above[:, :-1]):
        axes.plot([column + 0.5] * 2, [row - 0.5, row + 0.5], **style)
    for row, column in np.argwhere(above[1:] != above[:-1]):
        axes.plot([column - 0.5, column + 0.5], [row + 0.5] * 2, **style)


def _draw_curve(axes: Axes, dataset: Any, figure: str, name: str, boundary: float | None) -> None:
    """Draw a figure of merit over the dimension ``name``; a single point if it is empty."""
    values = np.atleast_1d(dataset[figure].values)
    numeric = name in dataset.coords and dataset.coords[name].dtype.kind in "if"
    places = dataset.coords[name].values if numeric else np.arange(len(values))
    errors = None
    if f"{figure}_error" in dataset:
        errors = np.nan_to_num(np.atleast_1d(dataset[f"{figure}_error"].values))
    if numeric or not name:
        axes.errorbar(places, values, yerr=errors, fmt="o-", color=BLUE, capsize=3, ms=4)
    else:  # no order, and nothing between
        axes.bar(places, values, 0.6, yerr=errors, color=BLUE, capsize=3)
    axes.set(xlabel=_label(dataset, name) if numeric else name)
    _finish(axes, dataset, figure, boundary)
    if numeric:
        few_ticks(axes)
    elif name:
        axes.set_xticks(*_ticks(dataset, name))


def _draw_dots(axes: Axes, dataset: Any, figure: str, name: str, boundary: float | None) -> None:
    """Draw a figure against a drawn value, and failed draws along the lower edge."""
    places, values = dataset.coords[name].values, dataset[figure].values
    good = np.isfinite(values)
    axes.plot(places[good], values[good], ".", color=BLUE, ms=4)
    failed = ~good & (dataset["status"].values != "pending")
    if failed.any():
        axes.plot(
            places[failed],
            np.zeros(failed.sum()),
            "|",
            color=VERMILION,
            ms=10,
            transform=axes.get_xaxis_transform(),
            clip_on=False,
            label=f"{failed.sum()} failed",
        )
        axes.legend(fontsize=8)
    axes.set(xlabel=_label(dataset, name))
    _finish(axes, dataset, figure, boundary)
    if dataset.coords[name].dtype.kind in "if":
        few_ticks(axes)


def _finish(axes: Axes, dataset: Any, figure: str, boundary: float | None) -> None:
    """Draw the boundary, the grid and the vertical label of a curve or cloud."""
    if boundary is not None:
        axes.axhline(real("boundary", boundary), color=VERMILION, lw=1)
    axes.set(ylabel=_label(dataset, figure))
    axes.grid(alpha=0.25)


def study_picture(
    results: Results,
    figure: str,
    kind: str = "auto",
    *,
    x: str | None = None,
    y: str | None = None,
    at: Mapping[str, int] | None = None,
    boundary: float | None = None,
    contours: Sequence[float] = (),
) -> Any:
    """Draw a picture of a study: "map", "panels", "slices", "tornado", "yield", "sobol", "gallery".

    The kind "auto" is the one that fits the tables of the study. ``x`` and ``y`` are for a map.
    """
    from .. import study
    from ..study import answers

    merit = results.study.figure(figure)
    label = f"{merit.name} ({merit.unit})" if merit.unit else merit.name
    kind = default_kind(results) if kind == "auto" else kind
    if kind == "tornado":
        return tornado(study.sensitivities(results, figure, incomplete=True), label=label)
    if kind == "sobol":
        return tornado(study.sobol_indices(results, figure), label=figure)
    if kind == "yield":
        limits, fractions = answers.yields(results, figure)
        return yield_curve(limits, fractions, label=label)
    if kind == "panels":
        return study_panels(results, figure, at=at, boundary=boundary, contours=contours)
    if kind == "slices":
        return study_slices(results, figure, at=at, boundary=boundary)
    if kind == "gallery":
        smallest = answers.smallest_is_best(merit)
        return study_gallery(results, figure, smallest_is_best=smallest)
    return study_map(results, figure, x=x, y=y, at=at, boundary=boundary, contours=contours)


def step_of(results: Results, name: str, value: str) -> int:
    """Return the step of a dimension that has a value, written as on the axis of a map."""
    dataset = results.dataset
    if name not in dataset.sizes:
        raise SceneError(f"{name} is no dimension of the study; give one of {[*dataset.sizes]}")
    texts = [_tick(dataset, name, step) for step in range(dataset.sizes[name])]
    for step, text in enumerate(texts):
        if text.replace(" ", "") == value.replace(" ", ""):
            return step
    raise SceneError(f"{name} has no step {value!r}; give one of: {', '.join(texts)}")


def default_kind(results: Results) -> str:
    """Return the kind of picture that fits the tables of a study."""
    names = [dimension.name for dimension in results.study.dimensions]
    if names == ["case"]:
        return "tornado"
    if names == ["draw"]:
        method = results.study.definition["draws"].get("method")
        return "sobol" if method == "saltelli" else "yield"
    return "map"


def study_gallery(
    results: Results, figure: str, *, smallest_is_best: bool = False
) -> tuple[Axes, ...]:
    """Draw the point spreads of the worst, the median and the best point, computed again.

    The titles give the figure of merit and the values that the study sets at the point. All three
    maps have the same limits.

    Raises
    ------
    SceneError
        If the study has no such figure of merit, or no point has a value of it.
    """
    from ..study.design.values import label

    figure = results.study.figure(figure).name
    chosen = ranked(results, figure, smallest_is_best=smallest_is_best)
    values = results.values(figure, incomplete=True)
    panels = new_axes(len(chosen), width=12.0, height=4.4)
    widest = 0.0
    for panel, (rank, index) in zip(panels, chosen.items(), strict=True):
        point_spread(results.point_spread(index).point_spread, axes=panel)
        widest = max(widest, *map(abs, (*panel.get_xlim(), *panel.get_ylim())))
        lines = [f"{rank}: {figure} = {values[index]:.3g}"]
        lines += [f"{name} = {label(value)}" for name, value in results.study.delta(index).items()]
        panel.set_title("\n".join(lines), fontsize=8)
    for panel in panels:
        panel.set(xlim=(-widest, widest), ylim=(-widest, widest))
    return panels


def ranked(results: Results, figure: str, *, smallest_is_best: bool = False) -> dict[str, int]:
    """Return the numbers of the worst, the median and the best point of a figure of merit.

    Raises
    ------
    SceneError
        If the figure of merit is known at no point.
    """
    values = results.values(figure, incomplete=True)
    order = np.argsort(-values if smallest_is_best else values, kind="stable")
    order = order[np.isfinite(values[order])]
    if not len(order):
        raise SceneError(f"{figure} is known at no point of {results.path}; run the study first")
    places = {"worst": 0, "median": len(order) // 2, "best": -1}
    return {rank: int(order[place]) for rank, place in places.items()}
