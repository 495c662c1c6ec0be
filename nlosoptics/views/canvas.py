"""Figures without pyplot: made, and written to files."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import MissingExtraError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DOTS_PER_INCH = 120


def new_axes(columns: int, *, width: float, height: float) -> tuple[Axes, ...]:
    """Axes side by side on a new figure of ``width`` by ``height`` inches."""
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ModuleNotFoundError:
        raise MissingExtraError(
            "matplotlib is not installed; run pip install 'nlosoptics[views]' for pictures"
        ) from None
    figure = Figure(figsize=(width, height), dpi=DOTS_PER_INCH, layout="constrained")
    FigureCanvasAgg(figure)
    return tuple(figure.subplots(1, columns, squeeze=False)[0])


def save(picture: Figure | Axes | Iterable[Axes], path: str | Path) -> None:
    """Write a picture to a file, whose suffix names the format.

    Parameters
    ----------
    picture : matplotlib Figure, Axes or iterable of Axes
        What to write; the whole figure that the axes belong to.
    path : str or Path
        ``.png``, ``.pdf`` or ``.svg``.
    """
    if not hasattr(picture, "get_figure"):
        picture = next(iter(picture))
    # A figure is its own root; no program's name in the file, so equal pictures give equal bytes.
    figure: Any = picture.get_figure(root=True)
    figure.savefig(path, metadata={"Software": None} if Path(path).suffix == ".png" else None)
