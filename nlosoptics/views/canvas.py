"""New figures, made without pyplot, their colours, and round lengths and ticks for their scales."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache
from typing import TYPE_CHECKING, Any, Final
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from ..errors import MissingExtraError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

# Colours and markers: the Okabe-Ito palette, which is safe for colour blindness.
BLUE: Final = "#0072B2"
VERMILION: Final = "#D55E00"
GREEN: Final = "#009E73"
PURPLE: Final = "#CC79A7"
ORANGE: Final = "#E69F00"
SKY: Final = "#56B4E9"
BLACK: Final = "#000000"
BROWN: Final = "#7A3E00"  # not by Okabe and Ito; as distinct from their colours as those are
PALE_GREEN: Final = "#8FCFBA"  # mirror images of what is GREEN
PALE_SKY: Final = "#9FD3F5"  # glass
TEAL: Final = "#26828E"  # middle of the viridis colour map, for legends
INK: Final = "#222222"  # text in 3-D views
GREY: Final = "#767676"  # secondary information; contrast 4.5:1 on white
PALE_GREY: Final = "#A8A8A8"  # grid lines in 3-D views

SERIES: Final = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY, BROWN)
MARKERS: Final = ("o", "s", "^", "D", "v", "P", "X", "*")

DOTS_PER_INCH = 120
CHARACTER = 0.7  # width of a digit or minus sign over the font size, with a little to spare
LOG_GAP = 0.13  # least distance between labels of a log axis, in its width
GAP = 1.0  # least distance between tick labels, in characters

#: Superscripts of the characters of whole numbers.
RAISED: Final = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")

#: Space left, right, below and above all axes, and between columns and rows, inches, before the
#: labels are measured.
SPACE: Final = (0.78, 0.1, 0.52, 0.3, 0.9, 0.8)
BAR: Final = 1.01  # width of a colour bar with its labels, inches, before they are measured
#: Least part of the space that stays free, inches, and by how much more may stay free.
FREE: Final = (0.05, 0.05, 0.05, 0.05, 0.2, 0.15)
MORE_FREE: Final = 0.35
#: Largest part of a figure that is not axes. A legend wider than them would shrink them to nothing.
MOST_SPACE: Final = 0.75


def new_axes(
    count: int,
    *,
    width: float,
    height: float,
    columns: int | None = None,
    dots: int = DOTS_PER_INCH,
) -> tuple[Axes, ...]:
    """Return axes on a new figure of ``width`` by ``height`` inches, in one row by default.

    ``columns`` sets the number of axes in a row, ``dots`` the pixels per inch in raster formats.
    """
    figure_class, canvas_class = drawing_classes()
    figure = figure_class(figsize=(width, height), dpi=dots, layout=label_space())
    canvas_class(figure)
    columns = columns or count
    return tuple(figure.subplots(-(-count // columns), columns, squeeze=False).flat)


def drawing_classes() -> tuple[type[Figure], type[FigureCanvasAgg]]:
    """Import matplotlib; return its classes of figures and of canvases without a window."""
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ModuleNotFoundError:
        raise MissingExtraError(
            "matplotlib is not installed; run pip install 'nlosoptics[views]' for figures"
        ) from None
    return Figure, FigureCanvasAgg


def load_for_drawing() -> None:
    """Import matplotlib in a process that only draws, which then takes three quarters of the time.

    matplotlib's docstrings are left without the lists of properties that it adds at import. Ticks
    and the boxes around their labels are computed once for each place and range of an axis, where
    drawing asks for them four times.
    """
    from matplotlib import artist
    from matplotlib.axis import Axis

    artist.kwdoc = lambda artist: ""
    drawing_classes()
    axis: Any = Axis  # typed without private methods
    for name in ("_update_ticks", "_get_ticklabel_bboxes"):
        if hasattr(axis, name):  # a later matplotlib may draw the same in more time
            setattr(axis, name, _kept(getattr(axis, name)))


def _kept(method: Any) -> Any:
    """Return a method of an axis that keeps its result until the axis changes."""
    found = WeakKeyDictionary[Any, tuple[Any, Any]]()

    def keeping(axis: Any, *arguments: Any) -> Any:
        parts = [(part.locator, part.formatter) for part in (axis.major, axis.minor)]
        state = parts, axis.axes.bbox.bounds, tuple(axis.get_view_interval())
        known, result = found.get(axis, (None, None))
        if known != state:
            result = method(axis, *arguments)
            found[axis] = state, result
        return result

    return keeping


def set_title(axes: Axes, title: str) -> None:
    """Set the title of axes without ticks or labels above them.

    Without a given height, matplotlib measures all ticks at each drawing to move the title off
    them, which takes a quarter of the time of a figure.
    """
    axes.set_title(title, y=1.0)


def round_step(length: float) -> float:
    """Return the largest 1, 2 or 5 times a power of ten that does not exceed a length, m."""
    power = 10.0 ** math.floor(math.log10(length))
    return max(m * power for m in (1, 2, 5) if m * power <= length * (1 + 1e-9))


def power_of_ten(value: float, _: int = 0) -> str:
    """Return the label of a power of ten; matplotlib would load its typesetting of formulas."""
    return "10" + str(round(math.log10(value))).translate(RAISED)


def space_ticks(axes: Axes, *, integer: bool = False) -> None:
    """Keep the tick labels of a linear x axis apart, at any size of the axes."""
    axes.xaxis.set_major_locator(spaced_locator(integer))


def space_log_ticks(axes: Axes) -> None:
    """Label the x axis with as many round numbers as have room, for its present log limits."""
    from matplotlib.ticker import FixedLocator, LogFormatterSciNotation

    low, high = axes.get_xlim()
    powers = 10.0 ** np.arange(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    ticks = np.empty(0)
    for factors in ((1, 1.5, 2, 3, 4, 6, 8), (1, 2, 5), (1,)):
        ticks = np.sort(np.outer(powers, factors).ravel())
        ticks = ticks[(ticks >= low) & (ticks <= high)]
        places = np.log(ticks / low) / np.log(high / low)
        if len(ticks) < 2 or np.diff(places).min() > LOG_GAP:
            break
    axes.xaxis.set_major_locator(FixedLocator(ticks.tolist()))
    axes.xaxis.set_minor_formatter("")
    formatter = LogFormatterSciNotation(labelOnlyBase=False, minor_thresholds=(np.inf, np.inf))
    axes.xaxis.set_major_formatter(formatter)


def spaced_locator(integer: bool) -> Any:
    """Return a matplotlib locator that takes fewer ticks where their labels would overlap."""
    steps = [1, 2, 5, 10] if integer else [1, 2, 2.5, 5, 10]
    return _locator_class()(steps=steps, integer=integer, min_n_ticks=1)


def label_space() -> Any:
    """Return a matplotlib layout engine that leaves space for labels around axes of equal size.

    It suits figures whose axes are in rows and columns, with legends of the figure at its foot. It
    measures all labels once, and a second time if they did not fit; matplotlib's own engine
    measures them at least twice, which takes half of the time of a figure.
    """
    return _engine_class()()


@cache
def _engine_class() -> Any:
    """Return the class of `label_space`; defined here because matplotlib is optional."""
    from matplotlib.layout_engine import LayoutEngine

    class LabelSpace(LayoutEngine):
        _adjust_compatible, _colorbar_gridspec = True, True
        space: Any = None

        def begin(self, bars: bool) -> None:
            """Take the space that labels need as a rule, with colour bars or without."""
            bar = BAR if bars else 0.0
            self.space = np.array(SPACE) + np.array([0.0, bar, 0.0, 0.0, bar, 0.0])

        def misfit(self, fig: Any, boxes: Mapping[Any, Any]) -> Array | None:
            """Return a space for labels in ``boxes``, by axes; None if they fit the present one."""
            least = _extents(fig, boxes) + FREE
            wrong = (self.space < least) | (self.space > least + MORE_FREE)
            return np.where(wrong, least, self.space) if wrong.any() else None

        def execute(self, fig: Any) -> None:
            if self.space is None:
                self.begin(any(axes.child_axes for axes in fig.axes))
            for _ in range(2):
                place_axes(fig, self.space)
                found = self.misfit(fig, {axes: label_box(axes) for axes, _ in _grid(fig)[0]})
                if found is None:
                    return
                self.space = found
            place_axes(fig, self.space)

        def __reduce__(self) -> Any:
            # a class defined in a function cannot be pickled by name, and figures should be
            return label_space, (), self.__dict__

    return LabelSpace


def _grid(figure: Any) -> tuple[list[tuple[Any, Any]], int, int]:
    """Return axes with their cells in the grid of a figure, and its numbers of rows and columns."""
    specs = [(axes, axes.get_subplotspec()) for axes in figure.axes if axes.get_in_layout()]
    cells = [(axes, spec.get_topmost_subplotspec()) for axes, spec in specs if spec is not None]
    return cells, *(cells[0][1].get_gridspec().get_geometry() if cells else (1, 1))


def label_box(axes: Any) -> Any:
    """Return the box around axes and the labels for which a layout leaves space."""
    return axes.get_tightbbox(for_layout_only=True)


def _extents(figure: Any, boxes: Mapping[Any, Any]) -> Array:
    """Return the largest extents of labels: left, right, below, above, and in gaps, inches.

    ``boxes`` holds the `label_box` of each of the axes. The extent of a gap is NaN where the figure
    has a single column or row.
    """
    cells, n_rows, n_columns = _grid(figure)
    left, right = np.zeros((2, n_columns))
    above, below = np.zeros((2, n_rows))
    for axes, cell in cells:
        outer, inner = boxes[axes], axes.bbox
        if outer is None:  # not visible
            continue
        rows, columns = cell.rowspan, cell.colspan
        for extents, index, extent in (
            (left, columns[0], inner.x0 - outer.x0),
            (right, columns[-1], outer.x1 - inner.x1),
            (below, rows[-1], inner.y0 - outer.y0),
            (above, rows[0], outer.y1 - inner.y1),
        ):
            extents[index] = max(extents[index], extent)
    across = max(right[:-1] + left[1:], default=np.nan)
    down = max(below[:-1] + above[1:], default=np.nan)
    return np.array([left[0], right[-1], below[-1], above[0], across, down]) / float(figure.dpi)


def place_axes(figure: Any, space: Array) -> None:
    """Leave a space, see `SPACE`, around the axes of a figure and above its legends."""
    _, n_rows, n_columns = _grid(figure)
    tops = [legend.get_window_extent().y1 for legend in figure.legends]
    below = max(tops, default=0.0) / figure.dpi
    wide, high = figure.get_size_inches()
    across = space[[0, 1, 4]] / wide
    down = (space[[2, 3, 5]] + (below, 0.0, 0.0)) / high
    for part, count in ((across, n_columns), (down, n_rows)):
        total = part[0] + part[1] + (count - 1) * part[2]
        part *= min(1.0, MOST_SPACE / total)
        part[2] *= count / (1.0 - min(total, MOST_SPACE))  # relative to one of the axes
    figure.subplots_adjust(
        left=across[0],
        right=1.0 - across[1],
        wspace=across[2],
        bottom=down[0],
        top=1.0 - down[1],
        hspace=down[2],
    )


@cache
def _locator_class() -> Any:
    """Return the class of `spaced_locator`; defined here because matplotlib is optional."""
    from matplotlib.ticker import MaxNLocator

    class SpacedLocator(MaxNLocator):
        def __call__(self) -> Any:
            axis: Any = self.axis
            low, high = sorted(axis.get_view_interval())
            figure = axis.axes.get_figure(root=True)
            points = 72.0 * axis.axes.get_window_extent().width / figure.dpi
            character = CHARACTER * axis.get_major_ticks(1)[0].label1.get_size()
            ticks = np.empty(0)
            # matplotlib starts from the same number, but assumes labels of about four characters
            for count in range(int(np.clip(axis.get_tick_space(), 1, 9)), 0, -1):
                self.set_params(nbins=count)
                ticks = np.asarray(self.tick_values(low, high))
                ticks = ticks[(ticks >= low) & (ticks <= high)]
                labels = axis.get_major_formatter().format_ticks(ticks)
                if len(ticks) < 2:
                    break
                needed = character * (max(map(len, labels)) + GAP)
                if needed <= points * (ticks[1] - ticks[0]) / (high - low):
                    break
            return ticks

        def __reduce__(self) -> Any:
            # a class defined in a function cannot be pickled by name, and figures should be
            return spaced_locator, (False,), self.__dict__

    return SpacedLocator
