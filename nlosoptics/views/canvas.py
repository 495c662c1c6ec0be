"""Figures without pyplot are made here, and every picture is written."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..errors import MissingExtraError

if TYPE_CHECKING:
    from matplotlib.axes import Axes

DOTS_PER_INCH = 120


def new_axes(
    count: int, *, width: float, height: float, stacked: bool = False, dots: int = DOTS_PER_INCH
) -> tuple[Axes, ...]:
    """Axes side by side, or one above the other, on a new figure of ``width`` by ``height`` inches.

    ``dots`` are those of an inch where the figure is written as pixels.
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
    shape = (count, 1) if stacked else (1, count)
    return tuple(figure.subplots(*shape, squeeze=False).flat)
