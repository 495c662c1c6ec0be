"""Figure that compares the transforms from a wavefront to its point spread function."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING, Any

from .._checks import positive
from ..errors import SceneError
from .canvas import new_axes
from .palette import GREY, MARKERS, SERIES

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ..psf import Comparison

LEAST = 1e-17  # lowest error drawn, below rounding; keeps zeros on the logarithmic axis
APART = "hollow: difference from the best"


def compare_methods(
    comparison: Comparison, *, tol: float | None = None, axes: Axes | None = None
) -> Axes:
    """Draw the errors of the transforms against their computation times.

    Parameters
    ----------
    comparison : Comparison
        Result of `psf.compare`.
    tol : float, optional
        Requested error, max abs(dI) / max I, drawn as a line.
    axes : matplotlib Axes, optional
        Axes to draw on; a new figure by default.

    Returns
    -------
    Axes
        Axes with logarithmic scales. Filled markers show the error estimates, which bound the
        errors. Hollow markers show the difference from the best transform, which is the one with
        the smallest estimate; the title names it. Transforms that did not run are listed below
        the axes with the reason.

    Raises
    ------
    SceneError
        If no transform ran, or ``tol`` is not above 0.
    """
    ran = [row for row in comparison.rows if row.seconds is not None]
    if not ran:
        raise SceneError(
            "no transform ran, so there is nothing to draw; print the comparison for the reasons"
        )
    (axes,) = (axes,) if axes is not None else new_axes(1, width=7.0, height=5.2)
    if tol is not None:
        tol = positive("tol", tol)
        axes.axhline(tol, color=GREY, linestyle="--", label=f"requested, {tol:g}")
    for row, colour, marker in zip(ran, SERIES, MARKERS, strict=False):
        looks: dict[str, Any] = {
            "color": colour,
            "marker": marker,
            "linestyle": "",
            "markersize": 9,
        }
        seconds = row.seconds or 0.0
        errors = (row.error_estimate or 0.0, row.difference or 0.0)
        estimate, difference = (max(error, LEAST) for error in errors)
        axes.plot([seconds], [estimate], label=row.method, **looks)
        if row.method != comparison.best:
            looks["markerfacecolor"] = "none"
            axes.plot([seconds], [difference], **looks)
            axes.plot([seconds] * 2, [estimate, difference], color=colour, linewidth=0.8)
    axes.plot([], [], color=GREY, marker="o", linestyle="", markerfacecolor="none", label=APART)
    ny, nx = comparison.shape
    axes.set(
        xscale="log",
        yscale="log",
        xlabel="computation time (s)",
        ylabel="error, max |dI| / max I",
        title=f"{ny} x {nx} samples of {1e6 * comparison.pitch:.3g} µm, best: {comparison.best}",
    )
    axes.margins(x=0.15, y=0.12)
    axes.grid(alpha=0.25, which="both")
    axes.legend()
    _tell_left_out(comparison, axes)
    return axes


def _tell_left_out(comparison: Comparison, axes: Axes) -> None:
    """List the transforms that did not run, with the reasons, below the axes."""
    reasons = [
        textwrap.fill(f"{row.method}: {row.reason}", 100, subsequent_indent="    ")
        for row in comparison.rows
        if row.seconds is None
    ]
    if reasons:
        axes.text(
            0.0,
            -0.16,
            "did not run\n" + "\n".join(reasons),
            transform=axes.transAxes,
            verticalalignment="top",
            fontsize=8,
        )
