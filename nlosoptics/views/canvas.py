"""New figures, made without pyplot, and their colours."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from ..errors import MissingExtraError

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# The Okabe-Ito palette, which is safe for colour blindness. In pictures of a scene VERMILION is the
# laser, GREEN the hidden object, BLUE the camera and BROWN the occluders.
BLUE = "#0072B2"
VERMILION = "#D55E00"
GREEN = "#009E73"
PURPLE = "#CC79A7"
ORANGE = "#E69F00"
SKY = "#56B4E9"
BLACK = "#000000"
BROWN = "#7A3E00"  # not by Okabe and Ito; as distinct from their colours as those are
INK = "#222222"  # text in 3-D views
GREY = "#767676"  # secondary information; contrast 4.5:1 on white
PALE_GREY = "#A8A8A8"  # grid lines in 3-D views

SERIES = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY, BROWN)


def new_axes(
    count: int = 1, *, width: float, height: float, columns: int | None = None
) -> tuple[Axes, ...]:
    """Return axes on a new figure of ``width`` by ``height`` inches, in one row by default.

    ``columns`` sets the number of axes in a row; the last row may have fewer.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
        from matplotlib.layout_engine import ConstrainedLayoutEngine
    except ModuleNotFoundError:
        raise MissingExtraError(
            "matplotlib is not installed; run pip install 'nlosoptics[views]' for figures"
        ) from None
    layout = ConstrainedLayoutEngine(w_pad=0.1, h_pad=0.06)
    figure = Figure(figsize=(width, height), dpi=120, layout=layout)
    FigureCanvasAgg(figure)
    columns = columns or count
    every = figure.subplots(-(-count // columns), columns, squeeze=False).flat
    for spare in every[count:]:
        spare.remove()
    return tuple(every[:count])


def round_step(length: float) -> float:
    """Return the largest 1, 2 or 5 times a power of ten that does not exceed a length, m."""
    power = 10.0 ** math.floor(math.log10(length))
    return max(m * power for m in (1, 2, 5) if m * power <= length * (1 + 1e-9))


def few_ticks(axes: Axes) -> None:
    """Leave room between the labels of a linear x axis in a narrow picture."""
    axes.locator_params(axis="x", nbins=5)


def pyvista() -> Any:
    """Import and return pyvista.

    Raises
    ------
    MissingExtraError
        If pyvista is not installed.
    """
    try:
        import pyvista
    except ModuleNotFoundError:
        raise MissingExtraError(
            "pyvista is not installed; run pip install 'nlosoptics[views]' for 3-D views"
        ) from None
    return pyvista
