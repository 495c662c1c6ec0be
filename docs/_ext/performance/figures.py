"""Figures of error against run time."""

import math
from collections import defaultdict
from collections.abc import Callable, Iterable
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from tables import COLOURS, MARKERS, figure

from .cells import Cell, Row, fill

Series = dict[str, list[tuple[float, float]]]


def errors_against_seconds(axes: Axes, series: Series, label: str) -> None:
    """Draw seconds across and error up, both logarithmic, a line for each name."""
    for i, (name, points) in enumerate(series.items()):
        style = {"color": COLOURS[i % len(COLOURS)], "marker": MARKERS[i % len(MARKERS)]}
        axes.loglog(*zip(*sorted(points), strict=True), label=name, markersize=4, **style)
    axes.set(xlabel="run time (s)", ylabel=label)
    axes.xaxis.set_minor_formatter("")
    axes.yaxis.set_minor_formatter("")
    # a decade has its number; panels that share an axis keep what the others need
    low, high = axes.dataLim.intervalx
    old = axes.get_xlim() if axes.get_shared_x_axes().get_siblings(axes)[1:] else (low, high)
    axes.set_xlim(
        10 ** math.floor(math.log10(min(low, old[0]))),
        10 ** math.ceil(math.log10(max(high, old[1]))),
    )
    axes.grid(alpha=0.3)


def curves(
    name: Cell,
    error: Callable[[Row], float],
    label: str,
    keep: Callable[[Row], object] = bool,
) -> Callable[[Iterable[Row]], Figure]:
    """Return a function that draws error against seconds, a line for each name.

    `name` is the template of the line to which a row belongs, `error` a function of a row and
    `label` the title of its axis. Rows are drawn if `keep` is true of them.
    """

    def drawn(found: Iterable[Row]) -> Figure:
        series: Series = defaultdict(list)
        for row in filter(keep, found):
            series[fill(name, row)].append((row["seconds"], error(row)))
        made = figure(5.2, 4.4)
        errors_against_seconds(made.subplots(), series, label)
        legend(made, 2)
        return made

    return drawn


def legend(drawn: Figure, columns: int) -> Any:
    """Put the names of the first panel below the figure."""
    names = drawn.axes[0].get_legend_handles_labels()
    return drawn.legend(*names, loc="outside lower center", ncols=columns)
