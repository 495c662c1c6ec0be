"""New figures, made without pyplot, their colours, and round lengths and ticks for their scales."""

from __future__ import annotations

import math
from functools import cache
from typing import TYPE_CHECKING, Any, Final
from weakref import WeakKeyDictionary

import numpy as np

from ..errors import MissingExtraError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

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
    figure = figure_class(figsize=(width, height), dpi=dots, layout="constrained")
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
    are computed once for each place and range of an axis, where the layout asks for them four
    times.
    """
    from matplotlib import artist
    from matplotlib.axis import Axis

    artist.kwdoc = lambda artist: ""
    drawing_classes()
    axis: Any = Axis  # typed without private methods
    update, found = getattr(axis, "_update_ticks", None), WeakKeyDictionary[Any, tuple[Any, Any]]()
    if update is None:  # a later matplotlib, which draws the same in more time
        return

    def ticks(self: Any) -> list[Any]:
        parts = [(part.locator, part.formatter) for part in (self.major, self.minor)]
        state = parts, self.axes.bbox.bounds, tuple(self.get_view_interval())
        known, kept = found.get(self, (None, []))
        if known != state:
            kept = update(self)
            found[self] = state, kept
        return list(kept)

    axis._update_ticks = ticks


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
