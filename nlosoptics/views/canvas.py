"""New figures, made without pyplot, and lengths for their scales."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ..errors import MissingExtraError

if TYPE_CHECKING:
    from matplotlib.axes import Axes

DOTS_PER_INCH = 120


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
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ModuleNotFoundError:
        raise MissingExtraError(
            "matplotlib is not installed; run pip install 'nlosoptics[views]' for pictures"
        ) from None
    figure = Figure(figsize=(width, height), dpi=dots, layout="constrained")
    FigureCanvasAgg(figure)
    columns = columns or count
    return tuple(figure.subplots(-(-count // columns), columns, squeeze=False).flat)


def round_step(length: float) -> float:
    """Return the largest 1, 2 or 5 times a power of ten that does not exceed a length, m."""
    power = 10.0 ** math.floor(math.log10(length))
    return max(m * power for m in (1, 2, 5) if m * power <= length * (1 + 1e-9))
